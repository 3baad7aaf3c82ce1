"""The panel of one lane in the figure of a decision.

Colours are those of Okabe and Ito, which colour-blind readers can tell apart; shapes of markers and hatches carry
the same information in grey.
"""

from itertools import pairwise
from typing import Any, Literal

from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FixedLocator, FormatStrFormatter, MaxNLocator

from sumo_hmdp.decision.explain import Explanation
from sumo_hmdp.decision.stop_lines import nearest_line
from sumo_hmdp.domain.occupancy import LaneState
from sumo_hmdp.report.figure_data import LaneView, Stretch, Track, View, ego_path, relative

# Blue, vermillion, bluish green, reddish purple, orange, sky blue; black is the ego's.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
MARKERS = ("s", "^", "D", "v", "P", "X", "<", ">")
SAFE_COLOR, REACH_COLOR, REACH_EDGE = "#EDF5FB", "#B5D8EE", "#5E9CC7"
FORBIDDEN_COLOR, HATCH_COLOR = "#F4F4F4", "#9A9A9A"
LINE_COLOR = "#A00000"
# Branches at one place that are less likely together than this get no bar for their margin.
LIKELY = 0.05
# Width of what holds at a step's end, as a share of the period.
BAR = 0.8
# Keeps text readable on hatching.
HALO = [withStroke(linewidth=2.5, foreground="white")]


def look_of(index: int) -> tuple[str, str]:
    """Return the colour and the marker of a vehicle by its place in the problem."""
    return COLORS[index % len(COLORS)], MARKERS[index % len(MARKERS)]


def draw_frame(axes: Axes, view: View, title: str) -> None:
    """Set up the axes of a lane."""
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


def draw_bars(axes: Axes, view: View, content: LaneView) -> None:
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
    """Draw a stretch, made as long as `least` [m] where it is shorter."""
    low, high = max(stretch.low, view.low - 1.0), min(stretch.high, view.high + 1.0)
    if low > high:
        return
    missing = max(0.0, least - (high - low)) / 2
    corner = (stretch.step - BAR / 2) * view.period, low - missing
    patch = Rectangle(corner, BAR * view.period, high - low + 2 * missing, linewidth=0.5, zorder=1.0, **look)
    axes.add_patch(patch)


def draw_track(axes: Axes, view: View, index: int, track: Track) -> bool:
    """Draw a vehicle in a lane; tell whether any of it is in view."""
    color, marker = look_of(index)
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


def draw_ego(axes: Axes, view: View, explanation: Explanation, lane: int) -> None:
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
        told = f"too near {worst.vehicle_id}" if worst.line is None else "beyond the stop line"
        _note(axes, f"{worst.metres:.2f} m {told}", place, (0, -11), ha="center")


def draw_stop_line(axes: Axes, view: View, explanation: Explanation, lane: int) -> None:
    """Draw the nearest stop line of a lane; it falls back behind an ego that cruises."""
    problem = explanation.problem
    line = nearest_line(problem.ego, problem.stop_lines, LaneState(lane))
    if line is None:
        return
    places = [(k * view.period, relative(explanation, k, line.x)) for k in range(view.steps + 1)]
    axes.plot(*zip(*places, strict=True), color=LINE_COLOR, linewidth=1.8, zorder=2.5, scalex=False, scaley=False)
    shown = [place for place in places if view.low <= place[1] <= view.high]
    if shown:
        _note(axes, "stop line", shown[0], (2.0, 7.0), color=LINE_COLOR)
    else:
        ahead = relative(explanation, view.steps, line.x)
        place = view.steps * view.period, view.high
        _note(axes, f"stop line at {ahead:.1f} m, out of view", place, (0.0, -5.0), ha="right", color=LINE_COLOR)


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
