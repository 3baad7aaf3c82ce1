"""Why the planned distances of a study fell short: how the causes share the violations of each cell."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from sumo_hmdp.metrics.blame import Blame, blame_violations
from sumo_hmdp.metrics.planned_distances import Claim, audit_run
from sumo_hmdp.report.lane_panel import COLORS
from sumo_hmdp.report.study_canvas import INK, LINE, StudyFigure, cells, panels
from sumo_hmdp.report.study_table import StudyTable, each, number
from sumo_hmdp.report.study_traces import TracedCell

CAUSES = tuple(Blame)
# What each cause is, and how it is drawn.
WORDS = {
    Blame.PLANNER: ("planner", "the plan itself was not optimal and said so", COLORS[1], "xx"),
    Blame.TRACKING: ("tracking", "the ego was not where its plan put it", COLORS[3], "\\\\"),
    Blame.UNSEEN: ("unseen", "the vehicle was not predicted at all", COLORS[4], "++"),
    Blame.UNKNOWN: ("unknown", "the branches were not all recorded", LINE, ""),
    Blame.PRUNING: ("pruning", "the vehicle did what no retained branch says", COLORS[5], ".."),
    Blame.PREDICTOR: ("predictor", "the vehicle was outside the 99.9 % intervals of all branches", COLORS[0], "//"),
    Blame.CHANCE: ("chance", "none of these: the risk that the plan took", COLORS[2], ""),
}
_SHOWN = {Claim.PLANNED: "as planned, all steps", Claim.EXECUTED: "as driven, first step"}


def blame_frame(traced: Sequence[TracedCell]) -> pd.DataFrame:
    """Return the causes of the violated steps, two rows a cell: the ego as planned, and as driven.

    Args:
        traced: cells with traces.

    Returns:
        cell_label, claim, trial_count (steps that were looked up), violation_count, and a count of each cause.
    """
    rows = []
    for cell in traced:
        counts, looked_up = {claim: dict.fromkeys(CAUSES, 0) for claim in Claim}, dict.fromkeys(Claim, 0)
        for (_, decisions, steps), planned in zip(cell.runs(), cell.planned, strict=True):
            for claim in Claim:
                audited = planned if claim is Claim.PLANNED else audit_run(decisions, steps, cell.settings, claim)
                looked_up[claim] += int(audited["observed"].sum())
                if not audited["violated"].any():
                    continue
                # Only decisions with a violation need their branches opened.
                broken = decisions["decision_index"].isin(audited.loc[audited["violated"], "decision_index"])
                found = blame_violations(audited, decisions[broken], steps, cell.settings, claim)
                for cause, count in found["blame"].value_counts().items():
                    counts[claim][Blame(str(cause))] += int(count)
        rows += [
            (cell.label, str(claim), looked_up[claim], sum(counts[claim].values()), *counts[claim].values())
            for claim in Claim
        ]
    columns = ["cell_label", "claim", "trial_count", "violation_count", *(f"{cause}_count" for cause in CAUSES)]
    return pd.DataFrame(rows, columns=columns)


def blame_table(frame: pd.DataFrame) -> StudyTable:
    """Return the causes as people read them."""
    rows = [
        (
            row["cell_label"],
            _SHOWN[Claim(row["claim"])],
            f"{row['violation_count']} of {row['trial_count']}",
            *(number(row[f"{cause}_count"]) for cause in CAUSES),
        )
        for row in frame.to_dict("records")
    ]
    headings = ("cell", "the ego", "violated steps", *(WORDS[cause][0] for cause in CAUSES))
    causes = "; ".join(f"{WORDS[cause][0]}: {WORDS[cause][1]}" for cause in CAUSES)
    note = f"The first of these that is true of a violated step is its cause. {causes[0].upper()}{causes[1:]}."
    return StudyTable("blame", "Why planned distances fell short", frame, headings, tuple(rows), note)


def blame_figure(frame: pd.DataFrame) -> StudyFigure | None:
    """Draw the causes of the violations of plans, a bar a cell; None where there are none."""
    planned = frame[(frame["claim"] == Claim.PLANNED) & (frame["violation_count"] > 0)]
    if planned.empty:
        return None
    totals = {cause: int(planned[f"{cause}_count"].sum()) for cause in CAUSES}
    total = sum(totals.values())
    shares = [f"{WORDS[cause][0]} {number(100 * count / total, 2)} %" for cause, count in _by_size(totals) if count]
    title = f"Causes of the {total} violated steps of plans: {', '.join(shares)}"

    def draw() -> Figure:
        figure, (axes,) = panels(1, 1, 0.95 + 0.42 * len(planned), title)
        left = np.zeros(len(planned))
        for cause in CAUSES:
            name, _, color, hatch = WORDS[cause]
            count = planned[f"{cause}_count"].to_numpy(dtype=np.float64)
            if count.any():
                bars = axes.barh(range(len(planned)), count, 0.56, left, label=name, facecolor=color, edgecolor=INK)
                for bar in bars:
                    bar.set(hatch=hatch, linewidth=0.5)
            left += count
        cells(axes, planned["cell_label"].tolist())
        axes.set_xlim(left=0)
        axes.set_xlabel("violated steps of plans")
        axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=len(CAUSES), frameon=False, handlelength=1.2)
        return figure

    told = "; ".join(f"{row.cell_label}: {row.violation_count} violated of {row.trial_count}" for row in each(planned))
    key = "A bar a cell with violations, each step counted once, by the first cause that is true of it."
    return StudyFigure("blame", title, key, f"Causes of violated steps. {told}.", draw)


def _by_size(totals: dict[Blame, int]) -> list[tuple[Blame, int]]:
    return sorted(totals.items(), key=lambda item: -item[1])
