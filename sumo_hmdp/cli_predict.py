"""The command that scores predictors on recorded traffic: `sumo-hmdp predict`."""
# ruff: noqa: PLC0415 - a command imports what it needs when it runs, so that `--help` answers at once

from pathlib import Path
from typing import Annotated

import typer

from sumo_hmdp.cli_common import STUDIES, JsonOption, plain, print_json, progress_bar, show_table

DEFAULT = ("fixed", "belief", "idm_rollout", "fading_acceleration", "constant_velocity")


def add_commands(app: typer.Typer) -> None:
    """Add the commands of this file to the command line."""
    app.command(rich_help_panel=STUDIES)(predict)


def predict(
    folder: Annotated[Path, typer.Argument(help="A results directory with `trace: all`.", show_default=False)],
    predictor: Annotated[
        list[str] | None, typer.Option(help="A predictor; may be given several times. Left out: those built in.")
    ] = None,
    every: Annotated[int, typer.Option(min=1, help="Score every n-th decision.")] = 4,
    as_json: JsonOption = False,  # noqa: FBT002 - a flag of the command line
) -> None:
    """Score predictors on the runs of a study: every one answers for the same vehicles at the same instants.

    Log loss and Brier score of the lane intended at the end of the horizon; along the road the negative log likelihood
    of the position, coverage of the 50, 90 and 95 % intervals, NEES (1 is right), mean and final error; time a vehicle.
    Intervals of 95 % are over seeds.

    Example:
    - `sumo-hmdp predict results/highway --predictor belief --predictor idm_rollout`

    No file comes out.
    """
    from rich.table import Table

    from sumo_hmdp.report.predictor_scores import predictor_scores

    with progress_bar("predicting", at_once=True) as on_progress:
        found = predictor_scores(folder, predictor or DEFAULT, every, on_progress)
    rows = plain(found.to_dict("records"))
    if as_json:
        print_json({"scores": rows})
        return
    table = Table("world", "predictor", "score", "mean", "95 % interval", "seeds", "predictions")
    for row in rows:
        interval = "-" if row["low"] is None else f"{row['low']:.4g} to {row['high']:.4g}"
        table.add_row(
            row["world"], row["predictor"], row["score"], f"{row['mean']:.4g}", interval, str(row["seed_count"]),
            str(row["trial_count"]),
        )  # fmt: skip
    show_table(table, width=160)
