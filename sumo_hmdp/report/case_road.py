"""What the figures of the paper's cases share: style, files, and a piece of road with vehicles on it.

Colours are those of Okabe and Ito. Nothing is told by colour alone: vehicles are named beside their shape, curves
differ in line style and marker, and what is likely is darker.
"""

from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FixedLocator
from matplotlib.typing import LineStyleType, MarkerType

from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.domain.scene import EGO_ID
from sumo_hmdp.report.case_data import CaseRun, Motion
from sumo_hmdp.report.figures import METADATA

# Width of a column of print [in].
COLUMN = 3.5
BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, YELLOW = (
    "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#F0E442",
)  # fmt: skip
GREY = "#777777"
ROAD_COLOR = "#EFEFEF"
# Keeps text readable on whatever is below it.
HALO = [withStroke(linewidth=1.8, foreground="white")]


class Look(NamedTuple):
    """How a vehicle is drawn."""

    color: str
    marker: MarkerType
    line: LineStyleType


# Red, blue and green are the colours of the paper's text.
LOOKS = (
    Look(BLUE, "s", (0.0, (4.0, 1.2))),
    Look(GREEN, "D", (0.0, (5.0, 1.2, 1.2, 1.2))),
)
EGO_LOOK = Look(VERMILLION, "o", "-")
OTHER_LOOK = Look(GREY, "x", (0.0, (1.2, 1.2)))
MODE_COLORS = {Mode.ACCELERATE: ORANGE, Mode.CRUISE: PURPLE, Mode.DECELERATE: SKY}


@dataclass(frozen=True)
class RoadView:
    """A piece of road, along which positions are told from a zero of its own.

    Attributes:
        zero: where the axis has its 0 [m].
        low: left end [m from zero].
        high: right end [m from zero].
        stretch: by how much vehicles are drawn longer than they are; their fronts are where they are.
        labels: size of the letters on a vehicle [pt].
        mark: length of a lane mark [m].
        mark_period: from mark to mark [m].
    """

    zero: float
    low: float
    high: float
    stretch: float
    labels: float = 5.0
    mark: float = 6.0
    mark_period: float = 18.0


def style() -> AbstractContextManager[None]:
    """Return the settings of matplotlib for a figure as wide as a column, as a context."""
    return mpl.rc_context(
        {
            "font.family": "DejaVu Sans",
            "font.size": 7,
            "axes.titlesize": 7,
            "axes.linewidth": 0.6,
            "axes.titlepad": 2.5,
            "hatch.linewidth": 0.5,
            "legend.fontsize": 6.5,
            "legend.frameon": False,
            "xtick.major.size": 2.5,
            "ytick.major.size": 2.5,
            "xtick.major.width": 0.6,
            "ytick.major.width": 0.6,
            "text.parse_math": False,
            # Element names of an SVG file are drawn from this, not from chance.
            "svg.hashsalt": "sumo-hmdp",
        }
    )


def write_figure(
    figure: Figure, folder: Path, name: str, suffixes: tuple[str, ...] = (".svg", ".png")
) -> tuple[Path, ...]:
    """Write a figure, as SVG and PNG if not asked otherwise; the same figure gives the same bytes.

    Args:
        figure: what to write.
        folder: made if it does not exist.
        name: of the files, without suffix.
        suffixes: of the files, of those known to `figures.METADATA`.

    Returns:
        The files.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths = tuple(folder / f"{name}{suffix}" for suffix in suffixes)
    with style():
        for path in paths:
            figure.savefig(path, dpi=300, metadata=METADATA[path.suffix])
    return paths


def panels(count: int, height: float, **options: Any) -> tuple[Figure, list[Axes]]:  # noqa: ANN401 - matplotlib's own
    """Return a figure one column wide with panels one below the other; height in inches."""
    figure = Figure(figsize=(COLUMN, height), layout="constrained")
    axes = figure.subplots(count, 1, squeeze=False, **options)[:, 0]
    return figure, list(axes)


def tidy(axes: Axes) -> None:
    """Leave an axis only the spines that carry a scale."""
    axes.spines[["top", "right"]].set_visible(False)


def look_of(run: CaseRun, vehicle_id: str) -> Look:
    """Return how a vehicle looks: the ego red, the first two others blue and green, the rest grey."""
    if vehicle_id == EGO_ID:
        return EGO_LOOK
    place = [other for other in run.motions if other != EGO_ID].index(vehicle_id)
    return LOOKS[place] if place < len(LOOKS) else OTHER_LOOK


def label_of(vehicle_id: str) -> str:
    """Return the name of a vehicle in a figure."""
    return vehicle_id.upper() if vehicle_id.startswith("sv") else vehicle_id.rstrip("0123456789")


def named(run: CaseRun) -> Iterator[Motion]:
    """Yield the surrounding vehicles that the paper's figures show, those with a colour of their own."""
    for vehicle_id, motion in run.motions.items():
        if vehicle_id != EGO_ID and look_of(run, vehicle_id) is not OTHER_LOOK:
            yield motion


def draw_road(axes: Axes, run: CaseRun, view: RoadView) -> None:
    """Draw the lanes; the marks stand still on the road, whatever the view."""
    edge = run.lane_count * run.lane_width / 2
    axes.set_xlim(view.low, view.high)
    axes.set_ylim(-edge - 0.3, edge + 0.3)
    axes.add_patch(Rectangle((view.low, -edge), view.high - view.low, 2 * edge, color=ROAD_COLOR, zorder=0))
    first = np.floor((view.low + view.zero) / view.mark_period) * view.mark_period - view.zero
    for lane in range(1, run.lane_count):
        y = run.center_y(lane) - run.lane_width / 2
        starts = np.arange(first, view.high, view.mark_period)
        marks = [[(start, y), (start + view.mark, y)] for start in starts]
        axes.add_collection(LineCollection(marks, colors="white", linewidths=1.2, zorder=0.5))
    for y in (-edge, edge):
        axes.axhline(y, color="0.35", linewidth=0.8, zorder=0.6)
    axes.yaxis.set_major_locator(FixedLocator([run.center_y(lane) for lane in range(1, run.lane_count + 1)]))
    axes.set_yticklabels([str(lane) for lane in range(1, run.lane_count + 1)])
    axes.tick_params(axis="y", length=0, pad=1.5)
    axes.spines[["top", "right", "left", "bottom"]].set_visible(False)


def draw_vehicles(axes: Axes, run: CaseRun, view: RoadView, time: float) -> None:
    """Draw every vehicle at a time, named on its roof; the paper's vehicles out of view are told at the edge."""
    for vehicle_id, motion in run.motions.items():
        at = motion.index(time)
        front, y = float(motion.x[at]) - view.zero, float(motion.y[at])
        look = look_of(run, vehicle_id)
        body = view.stretch * motion.length
        if view.low + 0.5 * body < front < view.high + 0.5 * body:
            draw_body(axes, motion, front, y, view.stretch, facecolor=look.color, edgecolor="black")
            name: dict[str, Any] = {"color": "white", "weight": "bold", "ha": "center", "clip_on": True}
            axes.text(
                front - 0.54 * body, y - 0.05, label_of(vehicle_id), fontsize=view.labels, va="center", zorder=4, **name
            )
        elif look is not OTHER_LOOK:
            _tell_far(axes, label_of(vehicle_id), front, y, view)


def _tell_far(axes: Axes, name: str, front: float, y: float, view: RoadView) -> None:
    """Write at the edge of the view where a vehicle is that is out of it."""
    behind = front < view.high
    words = f"\N{BLACK LEFT-POINTING TRIANGLE} {name}" if behind else f"{name} \N{BLACK RIGHT-POINTING TRIANGLE}"
    axes.annotate(
        f"{words} {front:+.0f} m".replace("-", "\N{MINUS SIGN}"), (view.low if behind else view.high, y),
        (1.5, 0.0) if behind else (-1.5, 0.0), textcoords="offset points", ha="left" if behind else "right",
        va="center", fontsize=view.labels + 0.5, path_effects=HALO, zorder=4.5,
    )  # fmt: skip


def draw_body(
    axes: Axes,
    motion: Motion,
    front: float,
    y: float,
    stretch: float,
    **look: Any,  # noqa: ANN401 - whatever a patch takes
) -> None:
    """Draw a vehicle from above, with a nose that shows where its front is."""
    length, half = stretch * motion.length, motion.width / 2
    nose = front - 0.28 * length
    corners = [(front - length, -half), (nose, -half), (front, 0.0), (nose, half), (front - length, half)]
    options = {"linewidth": 0.6, "zorder": 3.0} | look
    axes.add_patch(Polygon([(x, y + side) for x, side in corners], closed=True, **options))


def letter(index: int) -> str:
    """Return the mark of a panel: (a), (b), ..."""
    return f"({chr(ord('a') + index)})"


def told(run: CaseRun, time: float) -> str:
    """Say where the ego is and what it does at a time."""
    ego, decision = run.ego, run.decision_at(time)
    at = ego.index(time)
    action = {Lateral.LEFT: "changes left", Lateral.RIGHT: "changes right"}
    words = [f"x = {ego.x[at]:.0f} m", f"{ego.speed[at]:.1f} m/s"]
    if run.safe_distance is not None:
        words.append(decision.mode.label)
    if decision.lateral and time - decision.time < 0.99 * run.period:
        words.append(action[decision.lateral])
    elif abs(float(ego.y[at]) - run.center_y(decision.lane)) > 0.1:
        words.append(f"on the way to lane {decision.lane}")
    else:
        words.append(f"in lane {decision.lane}")
    return f"{time:.2f} s: {', '.join(words)}"
