"""The command on the results of studies: `sumo-hmdp report`."""
# ruff: noqa: PLC0415 - a command imports what it needs when it runs, so that `--help` answers at once

import json
from pathlib import Path
from typing import Annotated

import typer

from sumo_hmdp.errors import InputError


def add_commands(app: typer.Typer) -> None:
    """Add the command of this file to the command line."""
    app.command()(report)


def report(
    folder: Annotated[Path, typer.Argument(help="A study's directory, finished or not.", show_default=False)],
    out: Annotated[
        Path | None, typer.Option(help="The HTML file; without it `report/report.html` in the study's directory.")
    ] = None,
    as_json: Annotated[  # noqa: FBT002 - a flag of the command line
        bool, typer.Option("--json", help="Print the verdict and all tables as JSON instead of in words.")
    ] = False,
) -> None:
    """Write the report of a study: which planner is better in what, and what that rests on.

    One page without a server or a network; every table (CSV, Markdown) and figure (SVG) stands in `report/` as well.

    Example: `sumo-hmdp report results/epsilon`
    """
    from sumo_hmdp.report.study_report import document, write_study_report

    if out is not None and out.suffix.lower() not in {".html", ".htm"}:
        raise InputError([f"--out: must end in .html, got {str(out)!r}. Name a file such as report.html"])
    made, page = write_study_report(folder, out)
    if as_json:
        typer.echo(json.dumps(document(made, page), allow_nan=False, default=str))
        return
    for sentence in made.verdict:
        typer.echo(sentence)
    typer.echo(f"page: {page}    tables and figures: {folder / 'report'}")
