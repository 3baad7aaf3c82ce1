"""The snapshots of the paper's Cases 1 and 2: the road at six instants, with what was predicted of the others."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Patch, Rectangle

from sumo_hmdp.domain.maneuver import Mode
from sumo_hmdp.domain.scene import EGO_ID
from sumo_hmdp.report.case_data import CaseBranch, CaseDecision, CaseRun
from sumo_hmdp.report.case_road import (
    HALO,
    MODE_COLORS,
    ORANGE,
    PURPLE,
    RoadView,
    draw_road,
    draw_vehicles,
    label_of,
    letter,
    named,
    panels,
    style,
    told,
)

# Less likely branches than this would only be noise on paper.
SHOWN_PROBABILITY = 0.005
# Half axes of an ellipse, in standard deviations.
DEVIATIONS = 2.0
# Height of a strip, and the strips' places beside the vehicle's course [m].
STRIP_HEIGHT = 0.95
STRIP_PLACE = {Mode.ACCELERATE: 1.05, Mode.CRUISE: 0.0, Mode.DECELERATE: -1.05}


def branch_snapshots(run: CaseRun, times: Sequence[float], view: RoadView) -> Figure:
    """Draw the scene at some instants with the branches of the decision in force: means and ellipses (Case 1).

    Args:
        run: a run of Case 1.
        times: the instants [s].
        view: which piece of road, around the ego.
    """
    with style():
        figure, axes = panels(len(times), 0.55 + 0.92 * len(times), sharex=True)
        for index, time in enumerate(times):
            here = _panel(axes[index], run, view, time, index)
            decision = run.decision_at(time)
            for branch in sorted(decision.branches, key=lambda branch: branch.probability):
                if branch.probability >= SHOWN_PROBABILITY:
                    _branch(axes[index], run, here, branch, time)
            _plan(axes[index], run, here, decision)
        _finish(figure, axes[-1], "Case 1: where each vehicle may go, at the paper's instants", _branch_legend())
        return figure


def strip_snapshots(run: CaseRun, times: Sequence[float], view: RoadView, title: str) -> Figure:
    """Draw the scene at some instants with a strip per mode of the surrounding vehicles, darker if likelier (Case 2).

    Args:
        run: a run of Case 2, under any planner; one that predicts nothing gets no strips.
        times: the instants [s].
        view: which piece of road, around the ego.
        title: of the figure.
    """
    with style():
        figure, axes = panels(len(times), 0.55 + 0.92 * len(times), sharex=True)
        for index, time in enumerate(times):
            here = _panel(axes[index], run, view, time, index)
            decision = run.decision_at(time)
            draw_strips(axes[index], run, here, time)
            _tell_speed(axes[index], run, here, time)
            _plan(axes[index], run, here, decision)
        _finish(figure, axes[-1], title, _strip_legend() if run.safe_distance is not None else [])
        return figure


def draw_strips(axes: Axes, run: CaseRun, view: RoadView, time: float) -> None:
    """Draw, for the vehicles that may change their mode, a strip per mode from now to the horizon's end."""
    decision = run.decision_at(time)
    for vehicle_id in dict.fromkeys(branch.vehicle_id for branch in decision.branches):
        shares = decision.mode_shares(vehicle_id)
        motion = run.motions[vehicle_id]
        at = motion.index(time)
        start, y = float(motion.x[at]) - view.zero, float(motion.y[at])
        if len(shares) < 2 or not view.low < start < view.high:
            continue
        for mode, (probability, end) in shares.items():
            corner = (start, y + STRIP_PLACE[mode] - STRIP_HEIGHT / 2)
            length = end - view.zero - start
            strip: dict[str, Any] = {"linewidth": 0.4, "zorder": 1.5, "clip_on": True}
            fill = Rectangle(corner, length, STRIP_HEIGHT, facecolor=MODE_COLORS[mode], alpha=_opacity(probability))
            axes.add_patch(fill)
            axes.add_patch(Rectangle(corner, length, STRIP_HEIGHT, facecolor="none", edgecolor="0.3", **strip))
        # The likeliest one gets its probability in figures.
        mode, (probability, end) = max(shares.items(), key=lambda share: share[1][0])
        place = (end - view.zero, y + STRIP_PLACE[mode])
        axes.annotate(
            f"{probability:.2f}", place, (1.5, 0.0), textcoords="offset points", va="center", fontsize=6.0,
            zorder=3.2, path_effects=HALO,
        )  # fmt: skip


def _tell_speed(axes: Axes, run: CaseRun, view: RoadView, time: float) -> None:
    """Write how fast the vehicle is that comes up in the left lane, where that lane is free."""
    motion = next(named(run))
    at = motion.index(time)
    words = f"{label_of(motion.vehicle_id)}: {motion.speed[at]:.1f} m/s"
    if abs(motion.accel[at]) >= 0.05:
        words += f", {motion.accel[at]:+.1f} m/s\N{SUPERSCRIPT TWO}".replace("-", "\N{MINUS SIGN}")
    place = (view.high, run.center_y(1))
    axes.annotate(
        words, place, (-2.0, 0.0), textcoords="offset points", ha="right", va="center", fontsize=6.0, path_effects=HALO
    )


def _opacity(probability: float) -> float:
    return 0.06 + 0.94 * probability


def _panel(axes: Axes, run: CaseRun, view: RoadView, time: float, index: int) -> RoadView:
    here = replace(view, zero=float(run.ego.x[run.ego.index(time)]))
    draw_road(axes, run, here)
    if run.safe_distance is not None:
        for side in (-1, 1):
            axes.axvline(side * run.safe_distance, color="0.25", linewidth=0.7, linestyle=(0, (1, 1.5)), zorder=0.8)
    draw_vehicles(axes, run, here, time)
    axes.set_title(f"{letter(index)} {told(run, time)}", loc="left")
    axes.set_ylabel("lane", labelpad=1)
    axes.tick_params(axis="x", length=2.5)
    return here


def _plan(axes: Axes, run: CaseRun, view: RoadView, decision: CaseDecision) -> None:
    """Draw where the plan has the ego at the ends of the steps, on the centres of the lanes that it intends."""
    places = [(point.x - view.zero, run.center_y(point.lane)) for point in decision.plan]
    if places:
        axes.plot(*zip(*places, strict=True), linestyle="", marker="+", markersize=3.5, color="black", zorder=2.8)


def _branch(axes: Axes, run: CaseRun, view: RoadView, branch: CaseBranch, time: float) -> None:
    motion = run.motions[branch.vehicle_id]
    at = motion.index(time)
    if not view.low < float(motion.x[at]) - view.zero < view.high:
        return
    off_center = abs(run.center_y(branch.lanes[0]) - float(motion.y[at]))
    changes = len(set(branch.lanes)) > 1 or off_center > run.lane_width / 2
    color = ORANGE if changes else PURPLE
    alpha = 0.25 + 0.75 * min(1.0, branch.probability / 0.3)
    x = [float(motion.x[at]) - view.zero, *(mean - view.zero for mean in branch.x)]
    y = [float(motion.y[at]), *branch.y]
    line = (0, (3.0, 1.5)) if changes else "-"
    axes.plot(x, y, color=color, linewidth=1.0, linestyle=line, alpha=alpha, zorder=1.4)
    for k, (mean_x, mean_y) in enumerate(zip(x[1:], y[1:], strict=True)):
        width, height = 2 * DEVIATIONS * branch.x_std[k], 2 * DEVIATIONS * branch.y_std[k]
        for look in ({"facecolor": color, "alpha": 0.35 * alpha}, {"facecolor": "none", "edgecolor": "0.2"}):
            axes.add_patch(Ellipse((mean_x, mean_y), width, height, linewidth=0.5, zorder=1.6, **look))


def _branch_legend() -> list[Line2D | Patch]:
    return [
        Line2D([], [], color=PURPLE, label="keeps its lane"),
        Line2D([], [], color=ORANGE, linestyle=(0, (3.0, 1.5)), label="changes lane"),
        Line2D(
            [], [], linestyle="", marker="o", markerfacecolor="none", markeredgecolor="0.2", label="2 std. deviations"
        ),
        *_common_legend(),
    ]


def _strip_legend() -> list[Line2D | Patch]:
    strips = [
        Patch(facecolor=MODE_COLORS[mode], edgecolor="0.3", linewidth=0.4, label=f"{mode.label} ({place})")
        for mode, place in ((Mode.ACCELERATE, "upper"), (Mode.CRUISE, "middle"), (Mode.DECELERATE, "lower"))
    ]
    return [*strips, *_common_legend()]


def _common_legend() -> list[Line2D | Patch]:
    return [
        Line2D([], [], linestyle="", marker="+", markersize=4, color="black", label=f"plan of the {EGO_ID}"),
        Line2D([], [], color="0.25", linewidth=0.7, linestyle=(0, (1, 1.5)), label="safe distance"),
    ]


def _finish(figure: Figure, last: Axes, title: str, legend: list[Line2D | Patch]) -> None:
    last.set_xlabel("front bumpers ahead of the ego's [m]", labelpad=1)
    figure.suptitle(title, fontsize=8, x=0.01, ha="left")
    if legend:
        figure.legend(handles=legend, loc="outside lower left", ncols=3, handlelength=2.0, columnspacing=1.2)
