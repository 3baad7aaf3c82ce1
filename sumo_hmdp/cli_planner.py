"""The command that begins a planner of one's own: `sumo-hmdp new-planner`."""
# ruff: noqa: PLC0415 - a command imports what it needs when it runs, so that `--help` answers at once

import shlex
from pathlib import Path
from typing import Annotated

import typer


def add_commands(app: typer.Typer) -> None:
    """Add the commands of this file to the command line."""
    app.command()(new_planner)


def new_planner(
    name: Annotated[str, typer.Argument(help="Of the planner and its package: small letters, digits, _.")],
    out_dir: Annotated[Path, typer.Option("--out", help="Where the package's folder is made.")] = Path(),
) -> None:
    """Write a package with a planner that drives, for you to change into your own.

    Example: `sumo-hmdp new-planner my_planner`
    """
    from sumo_hmdp.planning.new_planner import write_planner_package

    for path in write_planner_package(name, out_dir):
        typer.echo(path)
    folder = shlex.quote(str(out_dir / name))
    typer.echo(
        "now install it once, and drive:\n"
        f"pip install --no-deps --no-build-isolation --editable {folder}\n"
        f"sumo-hmdp run highway --planner {name}"
    )
