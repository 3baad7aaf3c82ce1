"""The command `sumo-hmdp watch`."""
# ruff: noqa: PLC0415 - a command imports what it needs when it runs, so that `--help` answers at once

import os
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import typer

from sumo_hmdp.cli_common import RUNS, PlannerOption, ScenarioArgument, complete_solver
from sumo_hmdp.errors import InputError


def add_commands(app: typer.Typer) -> None:
    """Add the command to the command line."""
    app.command(rich_help_panel=RUNS)(watch)


def watch(
    scenario: ScenarioArgument,
    planner: PlannerOption = None,
    solver: Annotated[str, typer.Option(help="milp, search or both.", autocompletion=complete_solver)] = "search",
    seed: Annotated[int, typer.Option(help="Seed of everything random.", min=0)] = 0,
    delay: Annotated[int, typer.Option("--delay-ms", help="Pause after each step.", min=0, max=2000)] = 100,
    out_dir: Annotated[Path, typer.Option("--out", help="Directory for tables, manifest and page.")] = Path("results"),
) -> None:
    """Run one scenario in SUMO's own window, the ego in orange.

    It is the same run as with `run`, over TraCI instead of libsumo, and so slower.
    Needs sumo-gui and TraCI: `pip install "sumo-hmdp[gui]"`.

    Examples:
    - `sumo-hmdp watch highway --delay-ms 50`
    - `sumo-hmdp watch urban --planner idm_mobil --seed 2`

    Files: those of `run`, in `--out`.
    """
    from sumo_hmdp.sim import window

    if window.program() is None:
        raise InputError(["watch must find sumo-gui, got none; install it with `pip install 'sumo-hmdp[gui]'`"])
    options = ["--solver", solver, "--seed", str(seed), "--out", str(out_dir)]
    if planner is not None:
        options += ["--planner", planner]
    # A process of its own: which interface to SUMO is used is settled when it is first imported.
    code = "from sumo_hmdp.cli import main; main()"
    done = subprocess.run(  # noqa: S603 - our own command with the options of this one
        [sys.executable, "-c", code, "run", scenario, *options],
        env={**os.environ, window.DELAY: str(delay)},
        check=False,
    )
    raise typer.Exit(done.returncode)
