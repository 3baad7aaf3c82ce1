"""Whether a study's predictions were as uncertain as they said: coverage, scores, reliability, errors of the path."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sumo_hmdp.metrics.calibration import (
    displacement_errors,
    lane_reliability,
    lane_scores,
    position_coverage,
    position_nees,
)
from sumo_hmdp.metrics.decision_tables import realised_branches, realised_predictions, with_intents
from sumo_hmdp.report.case_road import GREY
from sumo_hmdp.report.study_canvas import INK, StudyFigure, look, panels
from sumo_hmdp.report.study_table import StudyTable, each, interval, number
from sumo_hmdp.report.study_traces import TracedCell

# Decisions of a cell whose branches are opened, evenly spread over its runs: thousands of predictions.
OPENED = 200
# Cells in the figure; the tables have all.
DRAWN = 4
# How the 50, 90 and 95 % intervals are drawn.
_STYLES = (":", "--", "-")


@dataclass(frozen=True)
class Prediction:
    """Predictions of a study beside what happened, by cell.

    Attributes:
        coverage: as of `position_coverage`, with `cell_label`.
        scores: as of `lane_scores` and `position_nees`, a row per cell and horizon step.
        reliability: as of `lane_reliability`.
        paths: as of `displacement_errors`, a row a cell.
    """

    coverage: pd.DataFrame
    scores: pd.DataFrame
    reliability: pd.DataFrame
    paths: pd.DataFrame


def predictions(traced: Sequence[TracedCell]) -> Prediction | None:
    """Score the predictions of every cell whose branches were recorded; None where there are none."""
    parts: dict[str, list[pd.DataFrame]] = {"coverage": [], "scores": [], "reliability": [], "paths": []}
    for cell in traced:
        realised, branches = _realised(cell)
        if realised.empty:
            continue
        nees = position_nees(realised).rename(columns={"trial_count": "nees_trial_count"})
        found = {
            "coverage": position_coverage(realised),
            "scores": lane_scores(realised).merge(nees, on="horizon_step", how="left"),
            "reliability": lane_reliability(realised),
            "paths": pd.DataFrame([displacement_errors(branches)]),
        }
        for name, table in found.items():
            table.insert(0, "cell_label", cell.label)
            parts[name].append(table)
    if not parts["coverage"]:
        return None
    return Prediction(**{name: pd.concat(tables, ignore_index=True) for name, tables in parts.items()})


def _realised(cell: TracedCell) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return whole predictions, and the branches that were written down, beside what happened."""
    told = cell.decisions.get("prediction_json", pd.Series("[]", index=cell.decisions.index))
    shown = cell.decisions[np.array([isinstance(text, str) and text != "[]" for text in told.tolist()], dtype=bool)]
    chosen = shown.iloc[np.unique(np.linspace(0, len(shown) - 1, min(OPENED, len(shown))).astype(int))]
    parts: tuple[list[pd.DataFrame], list[pd.DataFrame]] = [], []
    for run_id, decisions in chosen.groupby("run_id"):
        steps = with_intents(cell.traces[str(run_id)], cell.settings.road, cell.settings.told)
        parts[0].append(realised_predictions(decisions, steps, cell.settings.period))
        parts[1].append(realised_branches(decisions, steps, cell.settings.period))
    whole, branches = (pd.concat(each, ignore_index=True) if each else pd.DataFrame() for each in parts)
    return whole, branches


def prediction_tables(found: Prediction) -> tuple[StudyTable, ...]:
    """Return the tables of the predictions."""
    return (_score_table(found.scores), _coverage_table(found.coverage), _reliability_table(found.reliability),
            _path_table(found.paths))  # fmt: skip


def _score_table(frame: pd.DataFrame) -> StudyTable:
    rows = [
        (
            row["cell_label"], str(row["horizon_step"]), number(row["trial_count"]), number(row["log_loss_mean"]),
            number(row["brier_mean"]), number(row["impossible_count"]),
            number(100 * row["pruned_mean"]), number(row["nees_mean"]), interval(row["nees_low"], row["nees_high"]),
        )
        for row in frame.to_dict("records")
    ]  # fmt: skip
    headings = (
        "cell", "horizon step", "predictions", "log loss", "Brier", "not foreseen", "pruned [%]", "NEES",
        "95 % interval",
    )  # fmt: skip
    note = (
        "Of the whole prediction, all branches together. Log loss and Brier score of the lane: what was pruned is "
        "spread evenly over all lanes, and one in a million at least, so that the log loss is finite; not foreseen are "
        "lanes that no branch led to. NEES: squared error over the variance of the prediction, along and across; 2 is "
        "right, above it the prediction was too sure, below too careful. Its interval is Student's over the runs."
    )
    return StudyTable("prediction_scores", "Scores of the predictions", frame, headings, tuple(rows), note)


def _coverage_table(frame: pd.DataFrame) -> StudyTable:
    rows = [
        (
            row["cell_label"], str(row["horizon_step"]), number(100 * row["level"]),
            f"{row['hit_count']} of {row['trial_count']}", number(100 * row["coverage_share"]),
            interval(100 * row["low_share"], 100 * row["high_share"]),
        )
        for row in frame.to_dict("records")
    ]  # fmt: skip
    headings = ("cell", "horizon step", "interval of [%]", "inside", "coverage [%]", "95 % interval")
    note = (
        "Central intervals of the place along the road, of the mixture of all branches; what was pruned counts as "
        "spread like the rest. The runs are the sampling unit of the 95 % intervals."
    )
    return StudyTable("prediction_coverage", "Coverage of the predicted places", frame, headings, tuple(rows), note)


def _reliability_table(frame: pd.DataFrame) -> StudyTable:
    rows = [
        (
            row["cell_label"], f"{number(row['low_probability'])} to {number(row['high_probability'])}",
            number(row["probability_mean"]), f"{row['hit_count']} of {row['trial_count']}", number(row["taken_share"]),
            interval(row["low_share"], row["high_share"]),
        )
        for row in frame.to_dict("records")
    ]  # fmt: skip
    headings = ("cell", "predicted", "predicted on average", "taken", "share", "95 % interval")
    note = "Lanes by the probability that was predicted for them, all horizon steps together."
    return StudyTable("prediction_reliability", "Reliability of the lanes", frame, headings, tuple(rows), note)


def _path_table(frame: pd.DataFrame) -> StudyTable:
    names = ("ade_best_m", "fde_best_m", "ade_likeliest_m", "fde_likeliest_m")
    rows = [
        (row["cell_label"], number(row["trial_count"]), *(number(row[name]) for name in names))
        for row in frame.to_dict("records")
    ]
    headings = ("cell", "predictions", "ADE best [m]", "FDE best [m]", "ADE likeliest [m]", "FDE likeliest [m]")
    note = (
        "Average and final distance between predicted and driven path, of the best and of the likeliest of the at most "
        "twelve branches a vehicle that are written down."
    )
    return StudyTable("prediction_paths", "Errors of the predicted paths", frame, headings, tuple(rows), note)


def prediction_figure(found: Prediction) -> StudyFigure:
    """Draw the coverage by horizon step, and how often lanes were taken against their probability."""
    at95 = found.coverage[found.coverage["level"] == 0.95]
    inside, trials = int(at95["hit_count"].sum()), int(at95["trial_count"].sum())
    title = f"The 95 % intervals of the predicted places held {number(100 * inside / trials)} % of {trials} places"
    labels = list(dict.fromkeys(found.coverage["cell_label"]))

    def draw() -> Figure:
        figure, (left, right) = panels(2, 2, 2.9, title)
        for place, label in enumerate(labels[:DRAWN]):
            _coverage(left, found.coverage[found.coverage["cell_label"] == label], place)
            mine = found.reliability[found.reliability["cell_label"] == label]
            color, marker = look(place)
            spread = [mine["taken_share"] - mine["low_share"], mine["high_share"] - mine["taken_share"]]
            right.errorbar(
                mine["probability_mean"], mine["taken_share"], yerr=spread, color=color, marker=marker, markersize=5,
                lw=0.9, linestyle="none", label=label,
            )  # fmt: skip
        left.set_ylim(0, 105)
        left.set_xlabel("horizon step")
        left.legend(loc="lower left", frameon=False, handlelength=3)
        left.set_ylabel("places inside [%]")
        right.plot([0, 1], [0, 1], color=INK, lw=0.8, ls=(0, (4, 2)))
        right.set(xlim=(-0.03, 1.03), ylim=(-0.03, 1.03), xlabel="predicted probability of a lane")
        right.set_ylabel("share of times it was taken")
        right.legend(loc="upper left", frameon=False)
        return figure

    told = "; ".join(
        f"{row.cell_label}, step {row.horizon_step}: {number(100 * row.coverage_share)} %"
        for row in each(at95.head(40))
    )
    more = f" The first {DRAWN} cells; the tables have all." if len(labels) > DRAWN else ""
    key = f"Left: coverage of the 50, 90 and 95 % intervals, grey: as it should be. Right: on the line is right.{more}"
    return StudyFigure("prediction", title, key, f"Coverage of the 95 % intervals. {told}.", draw)


def _coverage(axes: Axes, coverage: pd.DataFrame, place: int) -> None:
    color, marker = look(place)
    for (level, part), style in zip(coverage.groupby("level"), _STYLES, strict=True):
        told = 100 * float(str(level))
        if not place:
            axes.axhline(told, color=GREY, lw=0.8, ls=style)
            axes.plot([], [], color=INK, lw=0.9, ls=style, label=f"{told:g} % interval")
        share = 100 * part["coverage_share"]
        axes.plot(part["horizon_step"], share, color=color, marker=marker, markersize=4, lw=0.9, ls=style)
