"""A study as one page: the verdict first, then what it rests on; and every table and figure as a file of its own."""

import math
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from sumo_hmdp.errors import InputError
from sumo_hmdp.report.study_audit import (
    StudyAudit,
    audit_sentences,
    audit_step_table,
    audit_study,
    audit_table,
    uncovered_sentences,
)
from sumo_hmdp.report.study_blame import blame_figure, blame_frame, blame_table
from sumo_hmdp.report.study_canvas import StudyFigure
from sumo_hmdp.report.study_data import StudyData, read_study
from sumo_hmdp.report.study_figures import (
    Points,
    decision_figure,
    distribution_figure,
    forest_figure,
    frontier_figure,
    risk_figure,
)
from sumo_hmdp.report.study_parameters import parameter_table, traffic_table, version_table
from sumo_hmdp.report.study_prediction import prediction_figure, prediction_tables, predictions
from sumo_hmdp.report.study_replays import COUNT as REPLAY_COUNT
from sumo_hmdp.report.study_replays import StudyReplay, study_replays
from sumo_hmdp.report.study_svg import inline, svg_of
from sumo_hmdp.report.study_table import StudyTable
from sumo_hmdp.report.study_tables import (
    cell_frame,
    cell_table,
    decision_frame,
    decision_table,
    distribution_frame,
    distribution_table,
    ledger_table,
    worst_runs,
    worst_table,
)
from sumo_hmdp.report.study_traces import TracedCell, traced_cells
from sumo_hmdp.report.study_verdict import findings_of, pairs_table, sentences, verdict_table
from sumo_hmdp.report.work import OnProgress, Work
from sumo_hmdp.study.store import whole, write_text

# What takes how long, in audits of a run; of the study `main`.
_REPLAY, _FIGURE = 4.0, 10.0
# How many figures there are where everything can be told.
_FIGURES = 8


@dataclass(frozen=True)
class Section:
    """One section of the report.

    Attributes:
        id: its anchor.
        title: its heading.
        texts: sentences before anything else.
        figures: what is drawn.
        tables: what is told in numbers.
        folded: whether its tables are behind a click on a screen; never in print.
    """

    id: str
    title: str
    texts: tuple[str, ...] = ()
    figures: tuple[StudyFigure, ...] = ()
    tables: tuple[StudyTable, ...] = ()
    folded: bool = False


@dataclass(frozen=True)
class StudyReport:
    """A report before it is written.

    Attributes:
        data: of the study.
        verdict: sentences.
        sections: in order, the verdict first.
        replays: the pages that it carries in itself.
    """

    data: StudyData
    verdict: tuple[str, ...]
    sections: tuple[Section, ...]
    replays: tuple[StudyReplay, ...] = ()


def study_report(folder: Path, page: Path, work: Work | None = None) -> StudyReport:
    """Compute everything that a report shows.

    Args:
        folder: written by `sumo-hmdp study`, finished or not.
        page: where the page will stand.
        work: told how far it is.

    Raises:
        InputError: if the folder is not a study's.
    """
    work = work or Work()
    data = read_study(folder)
    findings = findings_of(data)
    traced, untraced = traced_cells(data)
    worst = worst_runs(data)
    audits = sum(len(cell.run_ids) for cell in traced)
    work.expect(2 * audits + _REPLAY * min(REPLAY_COUNT, len(worst)) + _FIGURE * _FIGURES)
    for cell in traced:
        work.tick(len(cell.planned))
    audit = audit_study(data, traced, untraced)
    cells, spread, decisions = cell_frame(data), distribution_frame(data), decision_frame(data)
    verdict = (*sentences(data, findings), *audit_sentences(audit), *data.notes)
    replays = study_replays(data.folder, worst["run_id"], lambda: work.tick(_REPLAY))
    timed = len(decisions) and decisions["solve_time_p99_ms"].notna().any()
    sections = (
        Section("verdict", "Verdict", verdict, tuple(_opening(cells, audit)), (verdict_table(findings),)),
        Section("frontier", "Risk and efficiency", (), tuple(_contact_frontier(cells)), (cell_table(cells),)),
        *_risk_sections(audit, traced, uncovered_sentences(data)),
        Section(
            "differences", "Differences on common seeds", (), (forest_figure(findings),) if findings else (),
            (pairs_table(findings),), folded=True,
        ),
        Section(
            "distributions", "Distributions", (), (distribution_figure(spread),) if len(data.ended) else (),
            (distribution_table(spread),), folded=True,
        ),
        Section(
            "decisions", "Decision times and statuses", (), (decision_figure(decisions),) if timed else (),
            (decision_table(decisions),),
        ),
        Section(
            "worst", "Runs to look at first", replays.notes,
            tables=(worst_table(data, page, worst, replays.run_ids),),
        ),
        Section("ledger", "Failures", tables=(ledger_table(data, page),)),
        Section(
            "parameters", "Parameters and versions",
            tables=(traffic_table(data), parameter_table(data), version_table(data)), folded=True,
        ),
    )  # fmt: skip
    work.tick(audits)
    return StudyReport(data, verdict, sections, replays.pages)


def _risk_sections(audit: StudyAudit, traced: Sequence[TracedCell], uncovered: tuple[str, ...]) -> Iterator[Section]:
    """Yield what the plans risked, with the causes of violations, and whether the predictions were right."""
    figures, tables = [], [audit_table(audit)]
    if len(audit.rates):
        blame = blame_frame(traced)
        drawn = blame_figure(blame)
        figures += [drawn] if drawn is not None else []
        tables += [audit_step_table(audit), blame_table(blame)]
    notes = (*audit.notes, *uncovered)
    yield Section("risk", "Risk taken over risk asked for", notes, tuple(figures), tuple(tables))
    found, title = predictions(traced), "Predictions beside what happened"
    if found is None:
        told = "There is nothing to compare: no run kept both predictions and all vehicles (trace: all keeps them)."
        yield Section("prediction", title, (told,))
    else:
        yield Section("prediction", title, (), (prediction_figure(found),), prediction_tables(found), folded=True)


def _cells_that_ran(cells: pd.DataFrame) -> pd.DataFrame:
    """Return the cells with a speed and a rate of contacts [%], by the names that a frontier draws."""
    speeds = {"y": cells["speed_mean_mps"], "y_low": cells["speed_low_mps"], "y_high": cells["speed_high_mps"]}
    rates = {"x": cells["contact_rate"], "x_low": cells["contact_low_rate"], "x_high": cells["contact_high_rate"]}
    every = cells.assign(**speeds, **{name: 100 * values for name, values in rates.items()})
    return every[every["y"].notna() & every["x"].notna()]


def _contact_frontier(cells: pd.DataFrame) -> Iterator[StudyFigure]:
    """Yield the frontier of contacts, where a contact was seen: points that are all at 0 say nothing by their place."""
    ran = _cells_that_ran(cells)
    if ran["x"].any():
        yield frontier_figure("frontier_contacts", Points(ran, "contact rate", ran.iloc[:0]))


def _opening(cells: pd.DataFrame, audit: StudyAudit) -> Iterator[StudyFigure]:
    """Yield what a reader wants first: the frontier of violations, and the risk taken beside the risk asked for."""
    ran, plans = _cells_that_ran(cells), audit.plans[audit.plans["status"] == "optimal"]
    if len(ran) and len(plans):
        names = {"violation_rate": "x", "low_rate": "x_low", "high_rate": "x_high"}
        measured = plans.rename(columns=names)[["cell_label", *names.values()]]
        measured[list(names.values())] *= 100
        joined = ran.drop(columns=list(names.values())).merge(measured, on="cell_label")
        rest = ran[~ran["cell_label"].isin(joined["cell_label"]) & ran["risk_level"].isna()]
        yield frontier_figure("frontier_violations", Points(joined, "violation rate per plan", rest))
    if len(audit.plans):
        yield risk_figure(audit.plans)


def write_study_report(
    folder: Path, page: Path | None = None, on_progress: OnProgress | None = None
) -> tuple[StudyReport, Path]:
    """Write the report of a study: the page, and into `report/` of its folder every table and figure.

    The same folder gives the same bytes.

    Args:
        folder: written by `sumo-hmdp study`.
        page: the HTML file; without it `report/report.html` in the folder.
        on_progress: called with what is done and what there is in all.

    Returns:
        The report, and where its page stands.

    Raises:
        InputError: if the folder is not a study's, or the page cannot be written.
    """
    target = folder / "report" / "report.html" if page is None else page
    work = Work(on_progress)
    report = study_report(folder, target, work)
    try:
        files = _write_parts(report, folder / "report", work)
        with whole(target) as partial:
            partial.write_text(render(report, files), encoding="utf-8", newline="\n")
    except OSError as error:
        raise InputError([f"--out: {target} cannot be written: {error.strerror}. Choose another"]) from None
    return report, target


def _write_parts(report: StudyReport, folder: Path, work: Work) -> dict[str, str]:
    """Write every table and figure; return the figures by name. What an earlier report left goes first."""
    for pattern in ("tables/*.csv", "tables/*.md", "figures/*.svg"):
        for old in folder.glob(pattern):
            old.unlink()
    drawn: dict[str, str] = {}
    work.expect(work.done + _FIGURE * sum(len(section.figures) for section in report.sections))
    for section in report.sections:
        for table in section.tables:
            write_text(folder / "tables" / f"{table.name}.csv", table.csv())
            write_text(folder / "tables" / f"{table.name}.md", table.markdown())
        for figure in section.figures:
            drawn[figure.name] = svg_of(figure)
            write_text(folder / "figures" / f"{figure.name}.svg", drawn[figure.name])
            work.tick(_FIGURE)
    return drawn


def render(report: StudyReport, drawn: dict[str, str]) -> str:
    """Return the page.

    Args:
        report: what it shows.
        drawn: the SVG file of every figure, by name.
    """
    environment = Environment(
        loader=PackageLoader("sumo_hmdp.report"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    style, *scripts = (
        (resources.files("sumo_hmdp.report") / "templates" / name).read_text(encoding="utf-8")
        for name in ("study_report.css", "unpack.js", "study_replays.js")
    )
    folder = str(report.data.folder)
    return environment.get_template("study_report.html.j2").render(
        name=report.data.name,
        description=report.data.description,
        sections=report.sections,
        drawings={name: inline(svg, name) for name, svg in drawn.items()},
        file_text=report.data.file_text,
        again=shlex.join(["sumo-hmdp", "study", str(Path(folder) / "study.yaml"), "--out", f"{folder}_again"]),
        repro=f"{shlex.join(['sumo-hmdp', 'repro', folder])} RUN_ID",
        folder=folder,
        style=Markup(style),  # noqa: S704 - our own file
        script=Markup("\n".join(scripts)),  # noqa: S704 - our own files
        replays=report.replays,
    )


def document(report: StudyReport, page: Path) -> dict[str, Any]:
    """Return the report as JSON: missing numbers are null, infinite ones texts."""
    return {
        "study": report.data.name,
        "page": str(page),
        "verdict": list(report.verdict),
        "tables": {
            table.name: [{str(k): _plain(v) for k, v in row.items()} for row in table.frame.to_dict("records")]
            for section in report.sections
            for table in section.tables
        },
    }


def _plain(value: object) -> object:
    if value is None or value is pd.NA or (isinstance(value, float) and math.isnan(value)):
        return None
    if isinstance(value, float) and math.isinf(value):
        return "inf" if value > 0 else "-inf"
    return value
