"""The command line: `sumo-hmdp decide | run | check | list`, and the commands of the other files `cli_*.py`."""
# ruff: noqa: PLC0415 - a command imports what it needs when it runs, so that `--help` answers at once

import json
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from sumo_hmdp import cli_compare, cli_planner, cli_replay, cli_report, cli_study, cli_watch
from sumo_hmdp.cli_study import INTERRUPTED
from sumo_hmdp.errors import InputError, Problem, SumoHmdpError
from sumo_hmdp.validation import nearest

if TYPE_CHECKING:
    from rich.table import Table

    from sumo_hmdp.planning.decide import Answer
    from sumo_hmdp.planning.problem import DecisionProblem
    from sumo_hmdp.scenario.load import ReadyRun
    from sumo_hmdp.study.run import RunRecord

BAD_INPUT, FAILED = 2, 1

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    help="Co-simulation studies of hybrid-MDP, chance-constrained driving decisions in SUMO.",
    epilog="Start with `sumo-hmdp run case2`, then open the page that it names.",
)


def main() -> None:
    """Run the command line; a mistake of the user ends with exit code 2 and one line per mistake."""
    try:
        app()
    except InputError as error:
        _complain(error)
        sys.exit(BAD_INPUT)
    except SumoHmdpError as error:
        _say(f"error: {error}")
        sys.exit(FAILED)


def _complain(error: InputError) -> None:
    for line in error.lines():
        _say(line)


def _say(line: str) -> None:
    """Write one line to standard error, red on a terminal."""
    typer.secho(line, fg=typer.colors.RED, err=True)


def _print(table: "Table") -> None:
    from rich.console import Console

    Console().print(table)


def _show_version(wanted: bool) -> None:  # noqa: FBT001 - a callback of Typer
    if wanted:
        typer.echo(f"sumo-hmdp {version('sumo-hmdp')}")
        raise typer.Exit


@app.callback()
def options(
    _version: Annotated[  # noqa: FBT002 - a flag of the command line
        bool, typer.Option("--version", help="Show the version and exit.", callback=_show_version, is_eager=True)
    ] = False,
) -> None:
    """Take the options that stand before a command."""


SolverOption = Annotated[str, typer.Option(help="How a decision is solved; `sumo-hmdp list` names the solvers.")]


@app.command()
def decide(
    files: Annotated[list[Path], typer.Argument(help="Decision problems, JSON.", show_default=False)],
    solver: SolverOption = "milp",
    explain: Annotated[  # noqa: FBT002 - a flag of the command line
        bool,
        typer.Option("--explain", help="Tell on standard error what was predicted and why no other action was taken."),
    ] = False,
    figure: Annotated[
        Path | None, typer.Option(help="Draw the decision, lanes over time: .svg, .png or .pdf. Takes a single file.")
    ] = None,
) -> None:
    """Solve decision problems from files; one line of JSON each, in the order of the files.

    A file with mistakes gets one line per mistake on standard error and none on standard output; the others are
    still answered, and the exit code is 2.

    Example: `sumo-hmdp decide results/decision_files/case2-hmdp_mpc-eps0.05-seed0/0010.json`
    """
    from sumo_hmdp.planning.decide import SOLVERS, answer
    from sumo_hmdp.planning.problem_file import answer_document, read_problem
    from sumo_hmdp.planning.risk import RiskBudgetError

    if solver not in SOLVERS:
        raise InputError([f"--solver: must be a known solver, got {solver!r}; {nearest(solver, SOLVERS)}"])
    if figure is not None:
        _require_drawable(figure, len(files))
    code = 0
    for file in files:
        try:
            problem = read_problem(file)
        except InputError as error:
            _complain(error)
            code = BAD_INPUT
            continue
        try:
            found = answer(problem, solver)
        except RiskBudgetError as error:
            _complain(InputError([Problem("planner.risk_level", str(error).removeprefix("risk_level "))], str(file)))
            code = BAD_INPUT
            continue
        except SumoHmdpError as error:
            _say(f"{file}: {error}")
            code = code or FAILED
            continue
        sys.stdout.write(json.dumps(answer_document(found), allow_nan=False) + "\n")
        sys.stdout.flush()
        if explain or figure is not None:
            _explain(file, problem, found, figure, told=explain)
    raise typer.Exit(code)


def _require_drawable(figure: Path, file_count: int) -> None:
    """Refuse a figure that cannot be drawn before anything is solved."""
    from sumo_hmdp.report.figures import figure_path

    if file_count > 1:
        raise InputError([f"--figure: must be given with a single file, got {file_count}. Call once for each file"])
    figure_path(figure)


def _explain(file: Path, problem: "DecisionProblem", found: "Answer", figure: Path | None, *, told: bool) -> None:
    """Tell why an answer is as it is, draw it, or both."""
    from sumo_hmdp.planning.explain import explain
    from sumo_hmdp.report.explain_text import explanation_text

    explanation = explain(problem, found)
    if told:
        typer.echo(explanation_text(explanation, str(file)), err=True)
    if figure is not None:
        from sumo_hmdp.report.figures import write_decision_figure

        write_decision_figure(figure, explanation)


@app.command()
def run(
    scenario: Annotated[str, typer.Argument(help="A scenario's name (see `list`) or YAML file.", show_default=False)],
    planner: Annotated[str | None, typer.Option(help="Another planner than the scenario's own.")] = None,
    solver: SolverOption = "milp",
    seed: Annotated[int, typer.Option(help="Seed of everything random.", min=0, max=2**31 - 1)] = 0,
    epsilon: Annotated[float | None, typer.Option(help="Another risk level than the scenario's, in (0, 0.5].")] = None,
    out_dir: Annotated[Path, typer.Option("--out", help="Directory for tables, manifest and page.")] = Path("results"),
    trace: Annotated[
        Literal["none", "ego", "all"], typer.Option(help="Which vehicles the `steps` table keeps.")
    ] = "all",
    dump_decisions: Annotated[  # noqa: FBT002 - a flag of the command line
        bool,
        typer.Option("--dump-decisions", help="Write every decision as a file that `decide` answers again."),
    ] = False,
) -> None:
    """Run one scenario: tables in Parquet, a manifest, and a page with a replay.

    Example: `sumo-hmdp run case2 --epsilon 0.01 --out results`

    Read it back with `import sumo_hmdp; results = sumo_hmdp.load("results")`.
    """
    from sumo_hmdp.report.replay import write_replay
    from sumo_hmdp.scenario.load import RunOptions, find_scenario, load_scenario
    from sumo_hmdp.study.record import RunStatus, Trace
    from sumo_hmdp.study.run import save
    from sumo_hmdp.study.store import dispute_path, page_path, traceback_path, writable_folder

    ready = load_scenario(find_scenario(scenario), RunOptions(planner, solver, seed, epsilon))
    folder = writable_folder(out_dir)
    record = _execute_with_progress(ready)
    shown = f"tables: {folder}"
    with _writing():
        save(record, folder, Trace(trace), dump_decisions=dump_decisions)
        if len(record.steps):
            page = page_path(folder, record.run_id)
            write_replay(page, record.manifest, record.steps, record.decisions)
            shown += f"    page: {page}"
    _print(summary_table(record))
    typer.echo(shown)
    if record.status is RunStatus.FAILED:
        _say(f"the run failed: {record.reason}; the traceback is in {traceback_path(folder, record.run_id)}")
        if record.disputed is not None:
            _say(f"the decision that the solvers dispute is in {dispute_path(folder, record.run_id)}")
        raise typer.Exit(FAILED)
    if record.status is RunStatus.INTERRUPTED:
        _say("interrupted; everything up to here was kept")
        raise typer.Exit(INTERRUPTED)


@contextmanager
def _writing() -> Iterator[None]:
    """Finish what is being written in spite of Ctrl-C; a disk that takes no more is an error in one line."""
    in_main = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGINT, signal.SIG_IGN) if in_main else None
    try:
        yield
    except OSError as error:
        raise SumoHmdpError(f"the results cannot be written: {error}. Make room, or choose another --out") from error
    finally:
        if in_main:
            signal.signal(signal.SIGINT, before)


def _execute_with_progress(ready: "ReadyRun") -> "RunRecord":
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from sumo_hmdp.sim.episode import Moment
    from sumo_hmdp.study.run import execute

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[now]}"), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(f"{ready.scenario} · {ready.planner_name}", total=ready.episode.steps, now="0.0 s")

        def on_moment(moment: Moment) -> None:
            progress.update(task, completed=moment.step, now=f"{moment.scene.time:.1f} of {ready.episode.duration:g} s")

        return execute(ready, on_moment)


SUMMARY = (
    ("distance_m", "distance", "m", 1),
    ("speed_mean_mps", "mean speed", "m/s", 2),
    ("gap_min_m", "smallest gap", "m", 1),
    ("ttc_min_s", "smallest time to collision", "s", 1),
    ("lane_change_count", "lane changes", "", 0),
    ("lane_change_first_s", "first lane-change decision at", "s", 2),
    ("decision_count", "decisions", "", 0),
    ("solve_time_median_ms", "decision time, median", "ms", 1),
    ("solve_time_max_ms", "decision time, worst", "ms", 1),
    ("contact_count", "contacts", "", 0),
)


def summary_table(record: "RunRecord") -> "Table":
    """Return what a reader wants to know of a run first."""
    from rich.table import Table

    table = Table(title=f"{record.run_id}: {record.status}", show_header=False)
    if record.reason:
        table.add_row("why", record.reason)
    # What was published is of the scenario's own planner.
    own = record.row["planner"] == record.manifest["configuration"]["planner"]
    published = (record.manifest["configuration"].get("published") or {}) if own else {}
    for key, label, unit, digits in SUMMARY:
        value = record.row[key]
        shown = "none" if value in (None, float("inf")) else f"{value:.{digits}f} {unit}".rstrip()
        if value is not None and published.get(key) is not None:
            shown += f" (published {published[key]:.{digits}f}, {value - published[key]:+.{digits}f} {unit})"
        table.add_row(label, shown)
    shares = ", ".join(
        f"{name} {100 * share:.1f} %"
        for name in ("optimal", "relaxed", "fallback")
        if (share := record.row[f"{name}_share"]) is not None
    )
    table.add_row("statuses", shares or ("rule" if record.row["decision_count"] else "none"))
    if not record.row["reproducible"]:
        table.add_row("not reproducible", "the deadline was enforced: results depend on the machine's speed")
    table.add_row("trace hash", record.row["trace_hash"][:16])
    return table


@app.command()
def check(
    files: Annotated[
        list[str], typer.Argument(help="Scenario files or names, or decision problems.", show_default=False)
    ],
) -> None:
    """Validate files without running them; one line per mistake, exit code 2 if there is any.

    Example: `sumo-hmdp check my_scenario.yaml results/decision_files/*/*.json`
    """
    from sumo_hmdp.planning.problem_file import read_problem
    from sumo_hmdp.scenario.load import find_scenario, load_scenario

    clean = True
    for name in files:
        try:
            if name.endswith(".json"):
                read_problem(Path(name))
            else:
                load_scenario(find_scenario(name))
        except InputError as error:
            _complain(error)
            clean = False
        else:
            typer.echo(f"{name}: ok")
    if not clean:
        raise typer.Exit(BAD_INPUT)


@app.command(name="list")
def list_all() -> None:
    """List the scenarios that come with the package, the planners and the solvers.

    Example: `sumo-hmdp list`
    """
    from rich.table import Table

    from sumo_hmdp.documents import read_yaml
    from sumo_hmdp.planning.decide import SOLVERS
    from sumo_hmdp.planning.registry import planner_kinds
    from sumo_hmdp.scenario.load import scenario_names

    scenarios = Table("scenario", "planner", "what it is", title="scenarios")
    for name, path in scenario_names().items():
        content = read_yaml(path).content
        scenarios.add_row(name, content["planner"], " ".join(content["description"].split()))
    planners = Table("planner", "what it does", title="planners")
    for name, kind in sorted(planner_kinds().items()):
        planners.add_row(name, kind.summary)
    _print(scenarios)
    _print(planners)
    typer.echo(f"solvers: {', '.join(SOLVERS)}")


for commands in (cli_study, cli_report, cli_replay, cli_compare, cli_planner, cli_watch):
    commands.add_commands(app)
