"""Figures for print: what a decision saw, lane by lane over time.

Colours are those of Okabe and Ito, which colour-blind readers can tell apart; shapes of markers and hatches carry
the same information in grey. Nothing here touches the global state of matplotlib for longer than a call.
"""

from contextlib import AbstractContextManager
from itertools import pairwise
from pathlib import Path
from textwrap import fill
from typing import Any, Literal

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FixedLocator, FormatStrFormatter, MaxNLocator

from sumo_hmdp.errors import InputError
from sumo_hmdp.planning.explain import Explanation
from sumo_hmdp.report.figure_data import LaneView, Stretch, Track, View, decision_view, ego_path, lane_view

FORMATS = (".svg", ".png", ".pdf")
# Blue, vermillion, bluish green, reddish purple, orange, sky blue; black is the ego's.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
MARKERS = ("s", "^", "D", "v", "P", "X", "<", ">")
SAFE_COLOR, REACH_COLOR, REACH_EDGE = "#EDF5FB", "#B5D8EE", "#5E9CC7"
FORBIDDEN_COLOR, HATCH_COLOR = "#F4F4F4", "#9A9A9A"
# A file tells when it was written unless it is asked not to.
METADATA: dict[str, dict[str, Any]] = {
    ".svg": {"Date": None},
    ".pdf": {"CreationDate": None},
    ".png": {"Software": None},
}
# Branches at one place that are less likely together than this get no bar for their margin.
LIKELY = 0.05
# Width of what holds at a step's end, as a share of the period.
BAR = 0.8
# Letters in a line of the legend.
LEGEND_WIDTH = 22
# Keeps text readable on hatching.
HALO = [withStroke(linewidth=2.5, foreground="white")]


def figure_path(path: Path) -> Path:
    """Return a path to draw to, if its suffix is one of `FORMATS` and its folder exists.

    Raises:
        InputError: if not.
    """
    if path.suffix.lower() not in FORMATS:
        raise InputError(
            [f"--figure: must end in .svg, .png or .pdf, got {str(path)!r}. Give it one of these suffixes"]
        )
    if not path.parent.is_dir():
        raise InputError([f"--figure: must be in a folder that exists, got {str(path)!r}. Make {path.parent} first"])
    return path


def write_decision_figure(path: Path, explanation: Explanation) -> None:
    """Draw a decision to a file; the same explanation gives the same bytes.

    Args:
        path: its suffix chooses the format, one of `FORMATS`.
        explanation: what to draw.

    Raises:
        InputError: if the suffix is another one or the file cannot be written.
    """
    figure_path(path)
    with _style():
        figure = decision_figure(explanation)
        try:
            figure.savefig(path, dpi=200, metadata=METADATA[path.suffix.lower()])
        except OSError as error:
            raise InputError([f"--figure: {path} cannot be written: {error.strerror}. Check its permissions"]) from None


def _style() -> AbstractContextManager[None]:
    """Return the settings of matplotlib for a figure in print, as a context."""
    return mpl.rc_context(
        {
            "font.family": "DejaVu Sans",
            "font.size": 8,
            "axes.titlesize": 8,
            "axes.linewidth": 0.6,
            "hatch.linewidth": 0.5,
            "legend.fontsize": 7.5,
            # Element names of an SVG file are drawn from this, not from chance.
            "svg.hashsalt": "sumo-hmdp",
        }
    )


def decision_figure(explanation: Explanation) -> Figure:
    """Draw the lanes over time, one panel a lane, lane 1 (the leftmost) on top.

    Positions are relative to where the ego would be if it cruised, so that what keeps the ego's present speed runs
    level. Distances hold at the end of each step; a bar there stands for that instant.
    """
    view = decision_view(explanation)
    road = explanation.problem.road
    figure = Figure(figsize=(7.0, 0.7 + 1.9 * road.lane_count), layout="constrained")
    panels = figure.subplots(road.lane_count, 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    in_view: set[str] = set()
    for lane, axes in enumerate(panels, start=1):
        content = lane_view(explanation, lane)
        _frame(axes, view, _lane_title(explanation, lane))
        _bars(axes, view, content)
        for index, track in enumerate(content.tracks):
            if track is not None and _track(axes, view, index, track):
                in_view.add(track.vehicle_id)
        _ego(axes, view, explanation, lane)
    panels[-1].set_xlabel("time from now [s]")
    figure.supylabel("position ahead of the cruising ego [m]", fontsize=8)
    figure.suptitle(_title(explanation), fontsize=9, x=0.01, ha="left")
    figure.legend(handles=_legend(explanation, in_view), loc="outside right upper", frameon=False, handlelength=2.4)
    return figure


def _title(explanation: Explanation) -> str:
    answer = explanation.answer
    told = f"{answer.lateral.label}, {answer.mode.label}: {answer.status}"
    if answer.objective is not None:
        told += f", cost {answer.objective:.2f}"
    if answer.violation:
        told += f", {answer.violation:.2f} m missing"
    if answer.brake is not None:
        told += f", brakes in lane with {answer.brake:.1f} m/s$^2$"
    return told


def _lane_title(explanation: Explanation, lane: int) -> str:
    settings = explanation.problem.settings
    told = f"lane {lane}"
    if lane == settings.preferences.goal_lane:
        told += ", the goal"
    if lane in settings.forbidden_lanes:
        told += ", not to be chosen"
    return told


def _frame(axes: Axes, view: View, title: str) -> None:
    axes.set_xlim(-0.75 * view.period, (view.steps + 0.55) * view.period)
    axes.set_ylim(view.low, view.high)
    axes.set_title(title, loc="left", pad=3)
    axes.xaxis.set_major_locator(FixedLocator([round(k * view.period, 6) for k in _ticks(view.steps)]))
    axes.xaxis.set_major_formatter(FormatStrFormatter("%g"))
    axes.yaxis.set_major_locator(MaxNLocator(5))
    axes.tick_params(width=0.6, length=2.5)
    axes.spines[["top", "right"]].set_visible(False)
    axes.axhline(0.0, color="0.6", linewidth=0.5, linestyle=(0, (1, 3)), zorder=1.5)


def _ticks(steps: int) -> range:
    return range(0, steps + 1, 1 + steps // 11)


def _bars(axes: Axes, view: View, content: LaneView) -> None:
    """Draw what is safe and what is forbidden at each step's end."""
    for stretch in content.safe:
        _bar(axes, view, stretch, 0.0, facecolor=SAFE_COLOR, edgecolor="none")
    for stretch in content.reachable:
        # A window of no length is a place after all.
        _bar(axes, view, stretch, 0.006 * (view.high - view.low), facecolor=REACH_COLOR, edgecolor=REACH_EDGE)
    for stretch in content.forbidden:
        _bar(axes, view, stretch, 0.0, facecolor=FORBIDDEN_COLOR, edgecolor=HATCH_COLOR, hatch="/////")


def _bar(
    axes: Axes,
    view: View,
    stretch: Stretch,
    least: float,
    **look: Any,  # noqa: ANN401 - whatever a patch takes
) -> None:
    low, high = max(stretch.low, view.low - 1.0), min(stretch.high, view.high + 1.0)
    if low > high:
        return
    missing = max(0.0, least - (high - low)) / 2
    corner = (stretch.step - BAR / 2) * view.period, low - missing
    patch = Rectangle(corner, BAR * view.period, high - low + 2 * missing, linewidth=0.5, zorder=1.0, **look)
    axes.add_patch(patch)


def _track(axes: Axes, view: View, index: int, track: Track) -> bool:
    """Draw a vehicle in a lane; tell whether any of it is in view."""
    color, marker = COLORS[index % len(COLORS)], MARKERS[index % len(MARKERS)]
    for leg in track.legs:
        axes.plot(
            [(leg.step - 1) * view.period, leg.step * view.period],
            [leg.x_from, leg.x_to],
            color=color,
            alpha=_opacity(leg.probability),
            linewidth=1.1,
            linestyle=(0, (2, 1.5)) if leg.enters else "-",
            zorder=2.0,
        )
    for spot in track.spots:
        time = spot.step * view.period
        if spot.intended and spot.probability >= LIKELY and spot.margin > 0:
            axes.errorbar(
                time, spot.x, spot.margin, color=color, alpha=_opacity(spot.probability), linewidth=0.9, capsize=2.5
            )
        axes.plot(
            time,
            spot.x,
            marker=marker,
            markersize=3.6,
            color=color,
            markerfacecolor=color if spot.intended else "white",
            alpha=_opacity(spot.probability),
            zorder=2.2,
        )
    shown = [spot for spot in track.spots if view.low <= spot.x <= view.high]
    if shown:
        ha: Literal["right", "center"]
        first = max((spot for spot in shown if spot.step == shown[0].step), key=lambda spot: spot.probability)
        place = first.step * view.period, first.x
        offset, ha = ((-5.0, 0.0), "right") if first.step == 0 else ((0.0, 8.0), "center")
        _note(axes, track.vehicle_id, place, offset, ha=ha, color=color)
    return bool(shown)


def _opacity(probability: float) -> float:
    """Return an opacity at which an unlikely branch is visible and a hundred of them do not look like a likely one."""
    return float(min(1.0, 0.04 + 0.96 * probability**0.5))


def _ego(axes: Axes, view: View, explanation: Explanation, lane: int) -> None:
    """Draw the ego and its plan where it is in a lane."""
    path = ego_path(explanation)
    for before, after in pairwise(path):
        times = [before.step * view.period, after.step * view.period]
        if after.lane == lane:
            style = "-" if before.lane == lane else (0, (1.6, 1.0))
            axes.plot(times, [before.x, after.x], color="black", linewidth=2.4, linestyle=style, zorder=3.0)
        elif before.lane == lane:
            arrow = "\N{BLACK DOWN-POINTING TRIANGLE}" if after.lane > lane else "\N{BLACK UP-POINTING TRIANGLE}"
            _note(axes, f"{arrow} to lane {after.lane}", (times[0], before.x), (7, 0))
    for point in path:
        if lane in (point.lane, *point.over):
            face = "black" if point.lane == lane else "white"
            axes.plot(
                point.step * view.period,
                point.x,
                marker="o",
                markersize=7 if point.step == 0 else 4.2,
                color="black",
                markerfacecolor=face,
                zorder=3.1,
            )
    worst = explanation.chosen.worst
    if worst is not None and path[worst.step].lane == lane:
        place = worst.step * view.period, path[worst.step].x
        _note(axes, f"{worst.metres:.2f} m too near {worst.vehicle_id}", place, (0, -11), ha="center")


def _note(
    axes: Axes,
    text: str,
    place: tuple[float, float],
    offset: tuple[float, float],
    *,
    ha: Literal["left", "center", "right"] = "left",
    color: str = "black",
) -> None:
    """Write beside a place; the offset is in points."""
    axes.annotate(
        text,
        place,
        offset,
        textcoords="offset points",
        ha=ha,
        va="center",
        color=color,
        fontsize=7,
        path_effects=HALO,
        zorder=4.0,
    )


def _legend(explanation: Explanation, in_view: set[str]) -> list[Line2D | Patch]:
    def line(label: str, **look: Any) -> Line2D:  # noqa: ANN401 - whatever a line takes
        return Line2D([], [], label=label, **look)

    entries: list[Line2D | Patch] = [
        line("ego now", color="black", marker="o", markersize=7, linestyle=""),
    ]
    if explanation.answer.plan:
        entries += [
            line("its plan", color="black", linewidth=2.4, marker="o", markersize=4.2),
        ]
    if any(point.over for point in ego_path(explanation)):
        entries.append(line("still over the lane", color="black", marker="o", markerfacecolor="white", linestyle=""))
    if _changes_lane(explanation, in_view):
        entries.append(line("entering the lane", color="black", linewidth=2.4, linestyle=(0, (1.6, 1.0))))
    entries += [
        Patch(facecolor=REACH_COLOR, edgecolor=REACH_EDGE, linewidth=0.5, label="safe, within reach"),
        Patch(facecolor=SAFE_COLOR, edgecolor="none", label="safe, out of reach"),
        Patch(facecolor=FORBIDDEN_COLOR, edgecolor=HATCH_COLOR, linewidth=0.5, hatch="/////", label="too near"),
    ]
    for index, vehicle in enumerate(explanation.vehicles):
        if vehicle.id not in in_view:
            continue
        color, marker = COLORS[index % len(COLORS)], MARKERS[index % len(MARKERS)]
        entries.append(line(vehicle.id, color=color, marker=marker, markersize=3.6, linewidth=1.1))
    if in_view:
        entries += [
            line("means, fainter\nif less likely", color="0.4", linewidth=1.1, marker="s", markersize=3.6, alpha=0.4),
            line("margin either way", color="0.4", marker="|", markersize=9, linestyle=""),
        ]
    away = ", ".join(vehicle.id for vehicle in explanation.vehicles if vehicle.id not in in_view)
    if away:
        entries.append(line(fill(f"out of view: {away}", LEGEND_WIDTH), linestyle=""))
    return entries


def _changes_lane(explanation: Explanation, in_view: set[str]) -> bool:
    """Tell whether anything that is drawn changes its lane."""
    seen = [branch for vehicle in explanation.vehicles if vehicle.id in in_view for branch in vehicle.branches]
    laterals = [step.lateral for step in explanation.answer.plan]
    return any(laterals) or any(any(branch.laterals) for branch in seen)
