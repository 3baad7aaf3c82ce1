"""The command that says what a study shows: `sumo-hmdp compare`."""
# ruff: noqa: PLC0415 - a command imports what it needs when it runs, so that `--help` answers at once

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    import pandas as pd
    from rich.table import Table

    from sumo_hmdp.report.study_comparison import StudyComparison


def add_commands(app: typer.Typer) -> None:
    """Add the commands of this file to the command line."""
    app.command()(compare)


def compare(
    folder: Annotated[Path, typer.Argument(help="A results directory.", show_default=False)],
    metric: Annotated[
        list[str] | None, typer.Option(help="A column of `runs`, or `contact_rate`; may be given several times.")
    ] = None,
    by: Annotated[
        list[str] | None,
        typer.Option(help="A factor whose values are compared, the planner if nothing is said; several times."),
    ] = None,
    as_json: Annotated[  # noqa: FBT002 - a flag of the command line
        bool, typer.Option("--json", help="Print everything as JSON instead.")
    ] = False,
) -> None:
    """Compare the cells of a study: means and rates with 95 % intervals, and differences on common seeds.

    Two cells are compared if they differ in `--by` and in nothing else that means something to both. p-values are
    corrected (Holm) for everything that one call compares: ask for few metrics.

    Example: `sumo-hmdp compare results/epsilon --metric speed_mean_mps --metric contact_rate`
    """
    from sumo_hmdp.report.study_comparison import compare_study

    found = compare_study(folder, metric or (), by or ())
    if as_json:
        typer.echo(json.dumps(document(found), indent=1, allow_nan=False))
        return
    from rich.console import Console

    # In a file, too, a row is a line.
    console = Console()
    console = console if console.is_terminal else Console(width=160)
    console.print(cell_table(found))
    for sentence in found.verdicts:
        typer.echo(f"- {sentence}")
    if found.differences.empty:
        typer.echo("nothing to compare: no two cells differ in one factor alone")
    for note in found.notes:
        typer.secho(note, fg=typer.colors.YELLOW, err=True)


def document(found: "StudyComparison") -> dict[str, Any]:
    """Return a comparison as it is written to JSON; what is not defined is null, infinite is text."""
    return {
        "metrics": list(found.metrics),
        "by": list(found.by),
        "means": _records(found.means),
        "rates": _records(found.rates),
        "differences": _records(found.differences),
        "notes": list(found.notes),
    }


def _records(frame: "pd.DataFrame") -> list[dict[str, Any]]:
    return [{str(key): _plain(value) for key, value in row.items()} for row in frame.to_dict("records")]


def _plain(value: Any) -> Any:  # noqa: ANN401 - whatever a table holds
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    return value


def cell_table(found: "StudyComparison") -> "Table":
    """Return one row a cell and one column a metric: means (medians where a value is infinite) and rates."""
    from rich.table import Table

    cells: dict[str, dict[str, str]] = {}
    for row in _records(found.means):
        cells.setdefault(row["cell"], {})[row["metric"]] = _mean_text(row)
    for row in _records(found.rates):
        text = f"{row['hits']}/{row['trials']} [{row['low']:.2g}, {row['high']:.2g}]"
        cells.setdefault(row["cell"], {})[row["metric"]] = text
    table = Table("cell", *found.metrics)
    for cell, values in cells.items():
        table.add_row(cell, *(values[metric] for metric in found.metrics))
    return table


def _mean_text(row: dict[str, Any]) -> str:
    if row["infinite_count"]:
        median = f"{row['median']:.4g}" if isinstance(row["median"], float) else row["median"]
        return f"median {median}, {row['infinite_count']} inf"
    if row["mean"] is None:
        return "-"
    interval = "" if row["low"] is None else f" [{row['low']:.4g}, {row['high']:.4g}]"
    return f"{row['mean']:.4g}{interval}"
