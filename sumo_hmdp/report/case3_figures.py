"""The figures of the paper's Case 3: one scene under several risk levels."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FormatStrFormatter
from matplotlib.typing import LineStyleType, MarkerType

from sumo_hmdp.domain.scene import EGO_ID
from sumo_hmdp.report.case_data import CaseRun
from sumo_hmdp.report.case_road import (
    ORANGE,
    PURPLE,
    SKY,
    VERMILLION,
    RoadView,
    draw_body,
    draw_road,
    label_of,
    letter,
    look_of,
    panels,
    style,
    tidy,
)

# Length of road in a panel, and how far behind the ego's first place it begins [m].
LENGTH, BEHIND = 64.0, 38.0


class Outline(NamedTuple):
    """How the ego of one risk level is drawn.

    From dark to light, each with its own line and marker; widths grow, so that outlines on one another all show.
    """

    color: str
    line: LineStyleType
    width: float
    marker: MarkerType


OUTLINES = (
    Outline("black", "-", 0.8, "o"),
    Outline(VERMILLION, (0.0, (4.0, 1.0)), 1.3, "s"),
    Outline(PURPLE, (0.0, (5.0, 1.0, 1.0, 1.0)), 1.8, "D"),
    Outline(ORANGE, (0.0, (1.2, 0.8)), 2.3, "^"),
    Outline(SKY, "-", 2.8, "v"),
)


def threshold_snapshots(runs: Sequence[CaseRun], times: Sequence[float]) -> Figure:
    """Draw the egos of several risk levels in one scene, at some instants.

    Vehicles are drawn as long as they are. A run that ended in a contact leaves a cross where its ego was.

    Args:
        runs: one run a risk level, at most five, the smallest first; the surrounding vehicles move alike in all.
        times: the instants [s].
    """
    with style():
        figure, axes = panels(len(times), 0.62 + 0.95 * len(times))
        scene = max(runs, key=lambda run: float(run.ego.times[-1]))
        for index, (panel, time) in enumerate(zip(axes, times, strict=True)):
            start = scene.ego
            low = float(start.x[0]) - BEHIND + 0.9 * float(start.speed[0]) * time
            view = RoadView(0.0, low, low + LENGTH, 1.0)
            draw_road(panel, scene, view)
            # Nobody is in lane 3.
            panel.set_ylim(
                scene.center_y(2) - scene.lane_width / 2 - 0.2, scene.center_y(1) + scene.lane_width / 2 + 0.2
            )
            for vehicle_id, motion in scene.motions.items():
                if vehicle_id != EGO_ID:
                    at = motion.index(time)
                    x, y, color = float(motion.x[at]), float(motion.y[at]), look_of(scene, vehicle_id).color
                    draw_body(panel, motion, x, y, 1.0, facecolor=color, edgecolor="black")
                    panel.text(
                        x - 0.56 * motion.length, y - 0.05, label_of(vehicle_id).replace("_RIGHT", "-R"), fontsize=5.0,
                        color="white", weight="bold", ha="center", va="center", zorder=4, clip_on=True,
                    )  # fmt: skip
            done = [_ego(panel, run, outline, time) for run, outline in zip(runs, OUTLINES, strict=False)]
            changed = f"{sum(done)} of {len(runs)} have begun to change"
            panel.set_title(f"{letter(index)} {time:g} s: {changed}", loc="left")
            panel.set_ylabel("lane", labelpad=1)
            panel.tick_params(axis="x", length=2.5, pad=1.5)
        axes[-1].set_xlabel("front bumper along the road, x [m]", labelpad=1)
        figure.suptitle(f"Case 3: the lane change under {len(runs)} risk levels \u03b5", fontsize=8, x=0.01, ha="left")
        legend = [
            Line2D(
                [], [], color=outline.color, linestyle=outline.line, linewidth=outline.width, label=_legend_label(run)
            )
            for run, outline in zip(runs, OUTLINES, strict=False)
        ]
        figure.legend(handles=legend, loc="outside lower left", ncols=3, handlelength=2.6, columnspacing=1.0)
        return figure


def _legend_label(run: CaseRun) -> str:
    ended = f", contact at {run.ego.times[-1]:.2f} s" if run.row["contact_count"] else ""
    return f"\u03b5 = {run.risk_level:g}{ended}"


def _ego(axes: Axes, run: CaseRun, outline: Outline, time: float) -> bool:
    """Draw the ego of one risk level; tell whether it has begun its lane change."""
    at = run.ego.index(time)
    x, y = float(run.ego.x[at]), float(run.ego.y[at])
    if time > float(run.ego.times[-1]) and run.row["contact_count"]:
        axes.plot(x - run.ego.length / 2, y, marker="X", markersize=5, color=outline.color, markeredgecolor="black",
                  markeredgewidth=0.5, clip_on=True)  # fmt: skip
    else:
        look = {"facecolor": "none", "edgecolor": outline.color, "linestyle": outline.line, "linewidth": outline.width}
        draw_body(axes, run.ego, x, y, 1.0, zorder=3.9 - outline.width / 4, **look)
    return any(decision.time <= time for decision in run.changes())


def lane_change_by_risk(shown: Sequence[CaseRun], between: Sequence[CaseRun]) -> Figure:
    """Draw where and when the first lane change is decided, over the risk level.

    Args:
        shown: the runs of the other figure, at most five; they keep their markers.
        between: more runs, for the line; those without a lane change are left out.
    """
    with style():
        figure, (upper, lower) = panels(2, 2.9, sharex=True)
        runs = sorted((run for run in between if run.changes()), key=lambda run: run.risk_level or 0.0)
        levels = [run.risk_level or 0.0 for run in runs]
        for axes, values in ((upper, [place(run) for run in runs]), (lower, [moment(run) for run in runs])):
            axes.plot(levels, values, color="0.55", linewidth=1.0, marker=".", markersize=3, zorder=1)
        for run, outline in zip(shown, OUTLINES, strict=False):
            for axes, value in ((upper, place), (lower, moment)):
                axes.plot(
                    [run.risk_level or 0.0], [value(run)], linestyle="", marker=outline.marker, markersize=5.5,
                    markerfacecolor=outline.color, markeredgecolor="black", markeredgewidth=0.6, zorder=3,
                    label=f"\u03b5 = {run.risk_level:g}",
                )  # fmt: skip
        touched = [run for run in runs if run.row["contact_count"]]
        if touched:
            for axes, value in ((upper, place), (lower, moment)):
                axes.plot(
                    [run.risk_level or 0.0 for run in touched], [value(run) for run in touched], linestyle="",
                    marker="x", markersize=8, color="0.1", markeredgewidth=0.8, zorder=2, label="contact later",
                )  # fmt: skip
        upper.set_xscale("log")
        # A power of ten would be written with an exponent.
        upper.xaxis.set_major_formatter(FormatStrFormatter("%g"))
        upper.set_ylabel("x [m]")
        lower.set_ylabel("t [s]")
        lower.set_xlabel("risk level \u03b5 [-]", labelpad=1)
        upper.set_title("where the first lane change is decided", loc="left")
        lower.set_title("when it is decided", loc="left")
        for axes in (upper, lower):
            tidy(axes)
            axes.grid(color="0.92", linewidth=0.6)
        figure.align_ylabels([upper, lower])
        figure.suptitle("Case 3: the first lane change over the risk level", fontsize=8, x=0.01, ha="left")
        handles, labels = upper.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower left", ncols=3, handlelength=1.4, columnspacing=1.2)
        return figure


def moment(run: CaseRun) -> float:
    """Return when the first lane change is decided [s]; the run must have one."""
    return run.changes()[0].time


def place(run: CaseRun) -> float:
    """Return where the ego then is [m]."""
    return run.changes()[0].x


def never_earlier(runs: Sequence[CaseRun]) -> bool:
    """Tell whether no larger risk level changes lanes earlier or farther back; runs in the order of the level."""
    return all(moment(a) <= moment(b) and place(a) <= place(b) for a, b in pairwise(runs))
