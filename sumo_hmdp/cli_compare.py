"""The command that says what a study shows: `sumo-hmdp compare`."""
# ruff: noqa: PLC0415 - a command imports what it needs when it runs, so that `--help` answers at once

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sumo_hmdp.cli_common import STUDIES, JsonOption, plain, print_json, progress_bar, say, show_table, tell

if TYPE_CHECKING:
    import pandas as pd
    from rich.table import Table

    from sumo_hmdp.report.study_comparison import StudyComparison


def add_commands(app: typer.Typer) -> None:
    """Add the commands of this file to the command line."""
    app.command(rich_help_panel=STUDIES)(compare)


def compare(
    folder: Annotated[Path, typer.Argument(help="A results directory.", show_default=False)],
    metric: Annotated[
        list[str] | None, typer.Option(help="A column of `runs`, or `contact_rate`; may be given several times.")
    ] = None,
    by: Annotated[
        list[str] | None,
        typer.Option(help="A factor whose values are compared, the planner if nothing is said; several times."),
    ] = None,
    as_json: JsonOption = False,  # noqa: FBT002 - a flag of the command line
) -> None:
    """Compare the cells of a study: means and rates with 95 % intervals, and differences on common seeds.

    Two cells are compared if they differ in `--by` and in nothing else that means something to both. p-values are
    corrected (Holm) for everything that one call compares: ask for few metrics.

    Examples:
    - `sumo-hmdp compare results/epsilon --metric speed_mean_mps --metric contact_rate`
    - `sumo-hmdp compare results/epsilon --by risk_level --json`

    No file comes out; `sumo-hmdp report` writes a page.
    """
    from sumo_hmdp.report.study_comparison import compare_study

    with progress_bar("comparing", at_once=True) as on_progress:
        found = compare_study(folder, metric or (), by or (), on_progress=on_progress)
    if as_json:
        print_json(document(found))
        return
    # In a file, too, a row is a line.
    show_table(cell_table(found), width=160)
    for sentence in found.verdicts:
        tell(f"- {sentence}")
    if found.differences.empty:
        tell("nothing to compare: no two cells differ in one factor alone")
    for note in found.notes:
        say(note, typer.colors.YELLOW)


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
    rows: list[dict[str, Any]] = plain(frame.to_dict("records"))
    return rows


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
