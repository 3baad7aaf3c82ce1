"""The tables of a study's report: cells, distributions, decisions, worst runs, the ledger."""

import os
import shlex
from collections.abc import Collection
from pathlib import Path

import numpy as np
import pandas as pd

from sumo_hmdp.domain.plan import Status
from sumo_hmdp.metrics.catalogue import METRICS
from sumo_hmdp.report.frames import FloatArray, numbers
from sumo_hmdp.report.statistics import describe, rate_table, summary_table
from sumo_hmdp.report.study_data import StudyData
from sumo_hmdp.report.study_table import StudyTable, interval, number, printed
from sumo_hmdp.study.store import page_path, traceback_path

DISTRIBUTED = (
    "speed_mean_mps",
    "gap_min_m",
    "ttc_min_s",
    "distance_shortfall_max_m",
    "drac_max_mps2",
    "braking_imposed_max_mps2",
    "jerk_rms_mps3",
)
QUANTILES = {"min": 0.0, "q05": 0.05, "q25": 0.25, "median": 0.5, "q75": 0.75, "q95": 0.95, "max": 1.0}
# Rows of each kind among the worst runs, and rows of the ledger in the page; the CSV has the whole ledger.
WORST, LEDGER_SHOWN = 10, 100


def cell_frame(data: StudyData) -> pd.DataFrame:
    """Return contacts and speed of every cell with their intervals, one row a cell."""
    cell = ["cell_label"]
    base = pd.DataFrame(
        {
            "cell_label": [one.label for one in data.cells],
            "planner": [one.planner for one in data.cells],
            "risk_level": pd.Series([one.risk_level for one in data.cells], dtype="float64"),
            "context": [one.context for one in data.cells],
            "run_count": [int((data.runs["cell"] == one.id).sum()) for one in data.cells],
            "ended_count": [int((data.ended["cell"] == one.id).sum()) for one in data.cells],
        }
    )
    columns = {"hits": "contact_count", "rate": "contact_rate", "low": "contact_low_rate", "high": "contact_high_rate"}
    speeds = {"mean": "speed_mean_mps", "low": "speed_low_mps", "high": "speed_high_mps"}
    if data.ended.empty:
        return base.assign(**dict.fromkeys([*columns.values(), *speeds.values()], float("nan")))
    contacts = rate_table(data.ended, cell, ["contact"]).rename(columns=columns)
    speed = summary_table(data.ended, cell, ["speed_mean_mps"]).rename(columns=speeds)
    return base.merge(contacts[[*cell, *columns.values()]], on=cell, how="left").merge(
        speed[[*cell, *speeds.values()]], on=cell, how="left"
    )


def cell_table(frame: pd.DataFrame) -> StudyTable:
    """Return the risk and the efficiency of every cell."""
    rows = [
        (
            row["cell_label"],
            f"{row['ended_count']} of {row['run_count']}",
            number(row["contact_count"]),
            number(100 * row["contact_rate"]),
            interval(100 * row["contact_low_rate"], 100 * row["contact_high_rate"]),
            number(row["speed_mean_mps"], 4),
            interval(row["speed_low_mps"], row["speed_high_mps"], 4),
        )
        for row in frame.to_dict("records")
    ]
    headings = (
        "cell",
        "runs ended",
        "contacts",
        "contact rate [%]",
        "95 % interval",
        "mean speed [m/s]",
        "95 % interval",
    )
    note = (
        "Intervals: Clopper and Pearson of the rate, Student's t and the bootstrap-t together of the mean. Runs that "
        "failed are left out. The frontier goes by estimates."
    )
    return StudyTable("cells", "Risk and efficiency of every cell", frame, headings, tuple(rows), note)


def distribution_frame(data: StudyData) -> pd.DataFrame:
    """Return quantiles of the main metrics, one row per cell and metric.

    Quantiles are values that were seen, so that they hold with infinite ones; the median is the usual one.
    """
    records = []
    for cell in data.cells:
        runs = data.ended[data.ended["cell"] == cell.id]
        for metric in DISTRIBUTED:
            values = numbers(runs[metric])
            found = describe(values)
            records.append(
                {
                    "cell_label": cell.label,
                    "metric": metric,
                    "finite_count": found.count,
                    "infinite_count": found.infinite_count,
                    "missing_count": found.missing_count,
                    **_quantiles(values),
                    "median": found.median,
                    "mean": found.mean,
                    "std": found.std,
                }
            )
    columns = ["cell_label", "metric", "finite_count", "infinite_count", "missing_count", *QUANTILES, "mean", "std"]
    return pd.DataFrame(records, columns=columns)


def _quantiles(values: FloatArray) -> dict[str, float]:
    known = values[~np.isnan(values)]
    if not len(known):
        return dict.fromkeys(QUANTILES, float("nan"))
    found = np.quantile(known, list(QUANTILES.values()), method="inverted_cdf")
    return dict(zip(QUANTILES, map(float, found), strict=True))


def distribution_table(frame: pd.DataFrame) -> StudyTable:
    """Return the quantiles as people read them."""
    rows = [
        (
            row["cell_label"],
            f"{metric.label} [{printed(metric.unit)}]",
            *(number(row[name]) for name in ("finite_count", "infinite_count", "missing_count", *QUANTILES, "mean")),
        )
        for row in frame.to_dict("records")
        for metric in [METRICS.get(row["metric"])]
    ]
    headings = (
        "cell", "metric", "finite", "infinite", "missing", "least", "5 %", "25 %", "median", "75 %", "95 %", "largest",
        "mean",
    )  # fmt: skip
    note = "A run that a contact cut short had less time for extremes. There is no mean where a value is infinite."
    return StudyTable("distributions", "Distributions of the main metrics", frame, headings, tuple(rows), note)


def decision_frame(data: StudyData) -> pd.DataFrame:
    """Return times and statuses of all decisions of each cell, one row a cell."""
    records = []
    for cell in data.cells:
        decisions = data.decisions[data.decisions["cell_label"] == cell.label]
        times = numbers(decisions["solve_time_ms"])
        times = times[~np.isnan(times)]
        known = [float(np.quantile(times, q)) for q in (0.5, 0.99, 1.0)] if len(times) else [float("nan")] * 3
        period = 1000 * float(cell.manifest["period_s"])
        counts = decisions["status"].value_counts()
        records.append(
            {
                "cell_label": cell.label,
                "decision_count": len(decisions),
                "period_ms": period,
                **dict(zip(("solve_time_median_ms", "solve_time_p99_ms", "solve_time_max_ms"), known, strict=True)),
                "deadline_miss_count": int((times > period).sum()),
                **{f"{status}_count": int(counts.get(status, 0)) for status in Status},
            }
        )
    return pd.DataFrame(records)


def decision_table(frame: pd.DataFrame) -> StudyTable:
    """Return times and statuses as people read them."""
    rows = [
        (
            row["cell_label"],
            *(
                number(row[name])
                for name in ("decision_count", "period_ms", "solve_time_median_ms", "solve_time_p99_ms")
            ),
            *(number(row[name]) for name in ("solve_time_max_ms", "deadline_miss_count")),
            *(number(row[f"{status}_count"]) for status in Status),
        )
        for row in frame.to_dict("records")
    ]
    headings = (
        "cell", "decisions", "period [ms]", "median [ms]", "99 % [ms]", "worst [ms]", "later than the period",
        *Status,
    )  # fmt: skip
    note = "Times are of the machine that ran the study, with all its other work: predict, carve and solve."
    return StudyTable("decisions", "Times and statuses of all decisions", frame, headings, tuple(rows), note)


def worst_runs(data: StudyData) -> pd.DataFrame:
    """Return the runs to look at first: contacts, then the smallest times to collision, then the largest violations."""
    ended = data.ended
    contacts = ended[ended["contact"]].sort_values(["contact_at_fault_count", "ttc_min_s"], ascending=[False, True])
    picked = [
        ("contact", contacts),
        ("small time to collision", ended[np.isfinite(numbers(ended["ttc_min_s"]))].sort_values("ttc_min_s")),
        (
            "large violation planned",
            ended[numbers(ended["violation_max_m"]) > 0].sort_values("violation_max_m", ascending=False),
        ),
    ]
    records = []
    seen: set[str] = set()
    for why, runs in picked:
        for row in runs[~runs["run_id"].isin(list(seen))].head(WORST).to_dict("records"):
            seen.add(row["run_id"])
            keys = ("run_id", "cell_label", "seed", "reason", "ttc_min_s", "gap_min_m", "violation_max_m")
            command = shlex.join(["sumo-hmdp", "replay", str(data.folder), row["run_id"]])
            records.append({"why": why, **{key: row[key] for key in keys}, "command": command})
    columns = ["why", "run_id", "cell_label", "seed", "reason", "ttc_min_s", "gap_min_m", "violation_max_m", "command"]
    return pd.DataFrame(records, columns=columns)


def worst_table(data: StudyData, page: Path, worst: pd.DataFrame, inside: Collection[str]) -> StudyTable:
    """Return the runs to look at first as people read them.

    Args:
        data: the study.
        page: where the report will stand, from which replay pages are linked.
        worst: the runs.
        inside: those whose replay is in the report itself.
    """
    rows, links = [], []
    for row in worst.to_dict("records"):
        run_id = row["run_id"]
        replay = page_path(data.folder, run_id)
        links.append(f"#replay-{run_id}" if run_id in inside else _relative(replay, page) if replay.is_file() else "")
        measured = (number(row[key]) for key in ("ttc_min_s", "gap_min_m", "violation_max_m"))
        reason = row["reason"] if isinstance(row["reason"], str) else ""
        rows.append((run_id, reason or row["why"], *measured, row["command"]))
    headings = ("run", "why", "smallest ttc [s]", "smallest gap [m]", "violation [m]", "look at it")
    caption = "Contacts first, then the smallest times to collision, then the largest violations planned"
    left = int(data.ended["contact"].sum()) - WORST
    note = f"{left} more runs with a contact are in the table runs." if left > 0 else ""
    return StudyTable("worst_runs", caption, worst, headings, tuple(rows), note, tuple(links))


def _relative(target: Path, page: Path) -> str:
    return Path(os.path.relpath(target.resolve(), page.resolve().parent)).as_posix()


def ledger_table(data: StudyData, page: Path) -> StudyTable:
    """Return every attempt at a run that did not end well."""
    final = dict(zip(data.runs["run_id"], data.runs["status"], strict=True))
    rows: list[tuple[str, ...]] = []
    records, links = [], []
    for entry in data.ledger:
        run_id = str(entry.get("run_id", ""))
        became = str(final.get(run_id, "not finished"))
        records.append({**entry, "became": became})
        if len(rows) < LEDGER_SHOWN:
            told = (str(entry.get(key, "")) for key in ("status", "reason", "at"))
            traceback = traceback_path(data.folder, run_id)
            links.append(_relative(traceback, page) if traceback.is_file() else "")
            rows.append((run_id, number(entry.get("attempt")), *told, became))
    headings = ("run", "attempt", "ended", "reason", "at", "became")
    more = len(records) - len(rows)
    columns = ["run_id", "attempt", "status", "reason", "wall_time_s", "at", "became"]
    frame = pd.DataFrame(records).reindex(columns=columns)
    caption = "Attempts that did not end well"
    note = f"{more} more are in ledger.csv." if more > 0 else ""
    return StudyTable("ledger", caption, frame, headings, tuple(rows), note, tuple(links))
