"""The commands that look at what there is: `sumo-hmdp check | list`."""
# ruff: noqa: PLC0415 - a command imports what it needs when it runs, so that `--help` answers at once

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sumo_hmdp.cli_common import (
    BAD_INPUT,
    FILES,
    JsonOption,
    complain,
    complete_checked,
    print_json,
    remark,
    show_table,
    tell,
)
from sumo_hmdp.errors import InputError

if TYPE_CHECKING:
    from rich.table import Table


def add_commands(app: typer.Typer) -> None:
    """Add the commands of this file to the command line."""
    app.command(rich_help_panel=FILES)(check)
    app.command(name="list", rich_help_panel=FILES)(list_all)


def check(
    files: Annotated[
        list[str],
        typer.Argument(
            help="Scenario or study files or names, or decision problems.",
            show_default=False,
            autocompletion=complete_checked,
        ),
    ],
    as_json: JsonOption = False,  # noqa: FBT002 - a flag of the command line
) -> None:
    """Validate files without running them; one line per mistake, exit code 2 if there is any.

    A scenario is started once, so that SUMO refuses nothing later. Notes name what a network says that is not used.

    Examples:
    - `sumo-hmdp check my_scenario.yaml`
    - `sumo-hmdp check results/decision_files/*/*.json --json`

    No file comes out. `sumo-hmdp study FILE --out DIR --dry-run` tells what a study will take, too.
    """
    found: list[dict[str, Any]] = []
    for name in files:
        problems: list[dict[str, str]] = []
        notes: tuple[str, ...] = ()
        try:
            notes = _checked(name)
        except InputError as error:
            complain(error)
            problems = [{"path": problem.path, "message": problem.message} for problem in error.problems]
        else:
            if not as_json:
                tell(f"{name}: ok")
        for note in notes:
            remark(f"{name}: note: {note}", as_json=as_json)
        found.append({"file": name, "ok": not problems, "problems": problems, "notes": list(notes)})
    if as_json:
        print_json({"files": found})
    if not all(file["ok"] for file in found):
        raise typer.Exit(BAD_INPUT)


def _checked(name: str) -> tuple[str, ...]:
    """Check a file, or what comes along by this name; return what is allowed but hardly meant.

    Raises:
        InputError: with every mistake and its path.
    """
    from sumo_hmdp.decision.problem_file import read_problem
    from sumo_hmdp.documents import is_file, read_yaml
    from sumo_hmdp.scenario.load import RunOptions, assemble_scenario, find_scenario
    from sumo_hmdp.scenario.packaged import study_names
    from sumo_hmdp.scenario.trial import start_once

    if name.endswith(".json"):
        read_problem(Path(name))
        return ()
    own_study = name in study_names() and not is_file(Path(name))
    path = study_names()[name] if own_study else find_scenario(name)
    document = read_yaml(path)
    content = document.content
    if isinstance(content, dict) and "scenarios" in content and "network" not in content:
        from sumo_hmdp.study.design import design_of

        return design_of(document, path).notes
    return start_once(assemble_scenario(document, RunOptions(), path), name).notes


def list_all(as_json: JsonOption = False) -> None:  # noqa: FBT002 - a flag of the command line
    """List the scenarios and studies that come with the package, the planners and the solvers.

    Examples:
    - `sumo-hmdp list`
    - `sumo-hmdp list --json`

    No file comes out. Planners of packages that are installed beside this one are listed, too.
    """
    from sumo_hmdp.decision.decide import SOLVERS
    from sumo_hmdp.decision.registry import planner_kinds
    from sumo_hmdp.scenario.packaged import scenario_names, study_names

    listed: dict[str, list[dict[str, str]]] = {
        "scenarios": [
            {"scenario": name, "planner": content["planner"], "what it is": " ".join(content["description"].split())}
            for name, content in _contents(scenario_names())
        ],
        "studies": [
            {"study": name, "scenarios": ", ".join(content["scenarios"]), "factors": ", ".join(content["factors"])}
            for name, content in _contents(study_names())
        ],
        "planners": [{"planner": name, "what it does": kind.summary} for name, kind in sorted(planner_kinds().items())],
    }
    if as_json:
        as_keys = {"what it is": "description", "what it does": "summary"}
        renamed = {
            title: [{as_keys.get(key, key): value for key, value in row.items()} for row in rows]
            for title, rows in listed.items()
        }
        print_json(renamed | {"solvers": list(SOLVERS)})
        return
    for title, rows in listed.items():
        show_table(_listing(title, rows))
    tell(f"solvers: {', '.join(SOLVERS)}")


def _contents(files: dict[str, Path]) -> list[tuple[str, Any]]:
    from sumo_hmdp.documents import read_yaml

    return [(name, read_yaml(path).content) for name, path in files.items()]


def _listing(title: str, rows: list[dict[str, str]]) -> "Table":
    from rich.table import Table

    table = Table(*rows[0], title=title)
    for row in rows:
        table.add_row(*row.values())
    return table
