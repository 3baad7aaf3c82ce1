"""The command on the results of studies: `sumo-hmdp report`."""
# ruff: noqa: PLC0415 - a command imports what it needs when it runs, so that `--help` answers at once

from pathlib import Path
from typing import Annotated

import typer

from sumo_hmdp.cli_common import STUDIES, JsonOption, print_json, progress_bar, tell
from sumo_hmdp.errors import InputError


def add_commands(app: typer.Typer) -> None:
    """Add the command of this file to the command line."""
    app.command(rich_help_panel=STUDIES)(report)


def report(
    folder: Annotated[Path, typer.Argument(help="A study's directory, finished or not.", show_default=False)],
    out: Annotated[
        Path | None, typer.Option(help="The HTML file; without it `report/report.html` in the study's directory.")
    ] = None,
    as_json: JsonOption = False,  # noqa: FBT002 - a flag of the command line
) -> None:
    """Write the report of a study: which planner is better in what, and what that rests on.

    One page without a server or a network; every table (CSV, Markdown) and figure (SVG) stands in `report/` as well.

    Examples:
    - `sumo-hmdp report results/epsilon`
    - `sumo-hmdp report results/epsilon --out epsilon.html`
    - `sumo-hmdp report results/epsilon --json`

    Files, in the study's `report/`: `report.html`; `tables/*.csv` and `*.md`; `figures/*.svg`.
    """
    from sumo_hmdp.report.study_report import document, write_study_report

    if out is not None and out.suffix.lower() not in {".html", ".htm"}:
        raise InputError([f"--out: must end in .html, got {str(out)!r}. Name a file such as report.html"])
    with progress_bar("writing the report", at_once=True) as on_progress:
        made, page = write_study_report(folder, out, on_progress)
    if as_json:
        print_json(document(made, page))
        return
    for sentence in made.verdict:
        tell(sentence)
    tell(f"page: {page}    tables and figures: {folder / 'report'}")
