"""What the commands share: how they speak, what they complete, how they print JSON, and how a mistake looks."""
# ruff: noqa: PLC0415 - imported where it is used, so that `--help` answers at once

import json
import math
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.exceptions import TyperException

from sumo_hmdp.errors import InputError, SumoHmdpError, printable

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

FAILED, BAD_INPUT, INTERRUPTED = 1, 2, 130
# Nobody reads more lines about one file.
MISTAKES_SHOWN = 100

# The groups of `sumo-hmdp --help`, in this order.
RUNS, STUDIES, FILES, OWN = "Runs", "Studies", "Scenarios and decisions", "Your own planner"


def say(line: str, colour: str | None = None) -> None:
    """Write a line for people to standard error; coloured on a terminal, unless NO_COLOR is set."""
    typer.secho(printable(line), fg=colour, err=True, color=False if os.environ.get("NO_COLOR") else None)


def tell(text: str) -> None:
    """Write a command's answer to standard output."""
    typer.echo(printable(text))


def remark(line: str, *, as_json: bool) -> None:
    """Write a line beside a command's answer: to standard output, unless that is to hold JSON alone."""
    typer.echo(printable(line), err=as_json)


def complain(error: InputError) -> None:
    """Write one red line for each mistake; beyond many, how many more there are."""
    lines = error.lines()
    for line in lines[:MISTAKES_SHOWN]:
        say(line, typer.colors.RED)
    if len(lines) > MISTAKES_SHOWN:
        source = f"{error.source}: " if error.source else ""
        more = f"{source}{len(lines) - MISTAKES_SHOWN} more mistakes; mend these first, or see all with `check --json`"
        say(more, typer.colors.RED)


def print_json(document: object) -> None:
    """Write one JSON document to standard output: what is not defined is null, infinite is the text `inf`."""
    typer.echo(json.dumps(plain(document), indent=1, allow_nan=False, default=str))


def plain(value: Any) -> Any:  # noqa: ANN401 - whatever a table holds
    """Return a value, or all values inside it, as JSON has them."""
    if isinstance(value, dict):
        return {str(key): plain(inside) for key, inside in value.items()}
    if isinstance(value, list | tuple):
        return [plain(inside) for inside in value]
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    # pandas writes a missing whole number or truth value as a thing of its own.
    return None if type(value).__name__ in {"NAType", "NaTType"} else value


def plain_console(*, stderr: bool = False, width: int | None = None) -> "Console":
    """Return where tables and progress are shown: names of users are printed as they are, `[/red]` is no markup.

    Args:
        stderr: whether it is standard error.
        width: [characters] where the output is no terminal; None for 80.
    """
    from rich.console import Console
    from rich.text import Text

    class PlainConsole(Console):
        """A console through which all text goes by `render_str`."""

        def render_str(self, text: str, **options: Any) -> Text:  # noqa: ANN401 - rich's own
            return super().render_str(printable(text), **options)

    console = PlainConsole(stderr=stderr, markup=False, emoji=False)
    if width is not None and not console.is_terminal:
        console.width = width
    return console


def show_table(table: "Table", width: int | None = None) -> None:
    """Write a table to standard output.

    Args:
        table: the table.
        width: [characters] where the output is no terminal, so that a row is a line; None for 80.
    """
    plain_console(width=width).print(table)


def error_console() -> "Console":
    """Return where progress is shown; it is a terminal or shows nothing."""
    return plain_console(stderr=True)


@contextmanager
def busy(text: str) -> Iterator[None]:
    """Show on a terminal that something is going on."""
    console = error_console()
    if not console.is_terminal:
        yield
        return
    from rich.text import Text

    with console.status(Text(printable(text))):
        yield


@contextmanager
def progress_bar(what: str, *, at_once: bool = False) -> Iterator[Callable[[float, float], None]]:
    """Show a bar with the time left on a terminal, nothing where nobody looks at one.

    Args:
        what: is going on.
        at_once: show it before the first call says how much there is.
    """
    from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    console = error_console()
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeRemainingColumn())
    with Bar(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(what, total=None, visible=at_once)

        def on_progress(done: float, total: float) -> None:
            bar.update(task, completed=done, total=total, visible=True)

        yield on_progress


def usage_line(error: TyperException) -> str:
    """Say in one line what is wrong with a call: the option, what must hold, what was given, and the remedy."""
    from pydantic import ValidationError

    from sumo_hmdp.validation import value_problem

    context, parameter, cause = getattr(error, "ctx", None), getattr(error, "param", None), error.__cause__
    command = context.command_path if context is not None else "sumo-hmdp"
    if parameter is not None and isinstance(cause, ValidationError):
        name = parameter.opts[0] if parameter.param_type_name == "option" else parameter.name.upper()
        return f"{name}: {value_problem(cause)}; see `{command} --help`"
    message = error.format_message().rstrip(".")
    remedy = f"see `{command} --help`"
    joint = " or" if message.endswith("?") else ";"
    return f"{message[0].lower()}{message[1:]}{joint} {remedy}"


def _beginning_with(incomplete: str, names: Iterable[str]) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]


def _files(incomplete: str, *endings: str) -> list[str]:
    """Return the files with one of the endings, and the folders, that a path may be completed to."""
    with suppress(OSError, ValueError):
        head, slash, _ = incomplete.rpartition(os.sep)
        folder = Path(head + slash)
        found = [path for path in sorted(folder.iterdir()) if path.is_dir() or path.suffix in endings]
        names = [f"{head}{slash}{path.name}{os.sep if path.is_dir() else ''}" for path in found]
        return _beginning_with(incomplete, names)
    return []


def complete_scenario(incomplete: str) -> list[str]:
    """Complete a scenario's name or file."""
    from sumo_hmdp.scenario.packaged import scenario_names

    return _beginning_with(incomplete, scenario_names()) + _files(incomplete, ".yaml", ".yml")


def complete_checked(incomplete: str) -> list[str]:
    """Complete what `check` takes: a scenario or a decision problem."""
    return list(dict.fromkeys(complete_scenario(incomplete) + _files(incomplete, ".json")))


def complete_study(incomplete: str) -> list[str]:
    """Complete a study's name or file."""
    from sumo_hmdp.scenario.packaged import study_names

    return _beginning_with(incomplete, study_names()) + _files(incomplete, ".yaml", ".yml")


def complete_planner(incomplete: str) -> list[str]:
    """Complete a planner's name, those of other packages included."""
    from sumo_hmdp.decision.names import planner_names

    return _beginning_with(incomplete, planner_names())


def complete_solver(incomplete: str) -> list[str]:
    """Complete a solver's name."""
    from sumo_hmdp.decision.names import SOLVER_NAMES

    return _beginning_with(incomplete, SOLVER_NAMES)


def complete_run(context: typer.Context, incomplete: str) -> list[str]:
    """Complete the name of a run in the results directory that stands before it."""
    from sumo_hmdp.study.store import read_table, run_files

    folder = Path(context.params.get("folder") or "results")
    with suppress(SumoHmdpError, OSError, KeyError):
        tables = [read_table(folder / "runs" / file) for file in run_files(folder)]
        return _beginning_with(incomplete, [name for table in tables for name in table["run_id"]])
    return []


ScenarioArgument = Annotated[
    str,
    typer.Argument(
        help="A scenario's name (see `list`) or YAML file.", show_default=False, autocompletion=complete_scenario
    ),
]
PlannerOption = Annotated[
    str | None, typer.Option(help="Another planner than the scenario's own.", autocompletion=complete_planner)
]
SolverOption = Annotated[
    str,
    typer.Option(help="How a decision is solved; `sumo-hmdp list` names the solvers.", autocompletion=complete_solver),
]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print one JSON document on standard output instead of words.")
]
