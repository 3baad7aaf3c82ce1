"""The command that begins a planner of one's own: `sumo-hmdp new-planner`."""
# ruff: noqa: PLC0415 - a command imports what it needs when it runs, so that `--help` answers at once

import shlex
from pathlib import Path
from typing import Annotated

import typer

from sumo_hmdp.cli_common import OWN, tell


def add_commands(app: typer.Typer) -> None:
    """Add the commands of this file to the command line."""
    app.command(rich_help_panel=OWN)(new_planner)


def new_planner(
    name: Annotated[
        str, typer.Argument(help="Of the planner and its package: small letters, digits, _.", show_default=False)
    ],
    out_dir: Annotated[Path, typer.Option("--out", help="Where the package's folder is made.")] = Path(),
) -> None:
    """Write a package with a planner that drives, for you to change into your own.

    Examples:
    - `sumo-hmdp new-planner my_planner`
    - `sumo-hmdp new-planner my_planner --out ~/my_work`

    Files, in a new folder NAME: `src/NAME.py`, the planner; `tests/test_NAME.py`; `pyproject.toml`, which offers it to
    sumo-hmdp; `README.md`, what a planner gets and what it must return.
    """
    from sumo_hmdp.decision.new_planner import write_planner_package

    for path in write_planner_package(name, out_dir):
        tell(str(path))
    folder = shlex.quote(str(out_dir / name))
    tell(
        "now install it once, and drive:\n"
        f"pip install --no-deps --no-build-isolation --editable {folder}\n"
        f"sumo-hmdp run highway --planner {name}"
    )
