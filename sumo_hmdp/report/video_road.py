"""The road in a frame of a film: vehicles, branches, forbidden stretches, the plan; drawn twice as large as shown."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from PIL import ImageDraw, ImageFont

from sumo_hmdp.domain.scene import EGO_ID
from sumo_hmdp.report.case_road import BLUE, GREY, PURPLE, ROAD_COLOR, VERMILLION
from sumo_hmdp.report.film import Film, Instant

# Drawn so many times as large as shown, so that lines are smooth.
SMOOTH = 2
INK, OTHER = "#16191d", "#6b747d"
# Metres of road at the width of a laptop's screen, and the least.
SPAN, SPAN_WIDTH, NARROW_SPAN = 190.0, 1280, 120.0
# The step of the horizon whose ellipses and forbidden stretches are drawn.
STEP = 1
Point = tuple[float, float]


@cache
def font(size: int, *, bold: bool = False) -> ImageFont.FreeTypeFont:
    """Return a font that comes with matplotlib, so that a frame is the same on every machine."""
    name = f"DejaVuSans{'-Bold' if bold else ''}.ttf"
    return ImageFont.truetype(Path(mpl.get_data_path()) / "fonts" / "ttf" / name, size)


@dataclass(frozen=True)
class Layout:
    """Sizes of a frame, which follow its width within what stays readable.

    Attributes:
        width: of the frame [px].
        lane_count: lanes of the road.
    """

    width: int
    lane_count: int

    @property
    def unit(self) -> float:
        """What a pixel of the widest laptop screen becomes."""
        return min(max(self.width / SPAN_WIDTH, 0.75), 2.0)

    @property
    def lane(self) -> int:
        """Height of a lane [px]."""
        return round(48 * self.unit)

    @property
    def road(self) -> int:
        """Height of the road [px]."""
        return self.lane * self.lane_count

    @property
    def head(self) -> int:
        """Height of the title [px]."""
        return round(38 * self.unit)

    @property
    def text(self) -> int:
        """Size of letters [px]."""
        return round(15 * self.unit)

    @property
    def plot_box(self) -> tuple[float, float, float, float]:
        """Left, top, right and bottom of the plot of speeds [px]."""
        top = self.head + self.road + round(66 * self.unit)
        return 52 * self.unit, top, self.width - 16 * self.unit, top + round(120 * self.unit)

    @property
    def height(self) -> int:
        """Height of the frame, even [px]."""
        height = round(self.plot_box[3] + 60 * self.unit)
        return height + height % 2

    @property
    def span(self) -> float:
        """Length of the road that is seen [m]."""
        return max(NARROW_SPAN, SPAN * self.width / SPAN_WIDTH)


class View:
    """The road of one frame, in smoothed pixels: x runs to the right, y upwards.

    Args:
        film: what is drawn.
        layout: sizes.
        left: x at the left end [m].
    """

    def __init__(self, film: Film, layout: Layout, left: float) -> None:
        self.film, self.layout, self.left = film, layout, left
        self.per_x = SMOOTH * layout.width / layout.span
        self.per_y = SMOOTH * layout.lane / film.lane_width
        self.right = left + layout.span
        self.middle = SMOOTH * layout.road / 2

    def at(self, x: float, y: float) -> Point:
        """Return where a point of the road is in the picture."""
        return (x - self.left) * self.per_x, self.middle - y * self.per_y

    def lane_lines(self, pen: ImageDraw.ImageDraw) -> None:
        """Draw marks that stand still on the road, 6 m in 18 m."""
        for lane in range(1, self.film.lane_count):
            y = self.film.lane_y(lane) - self.film.lane_width / 2
            start = math.floor(self.left / 18) * 18
            for x in np.arange(start, self.right, 18.0).tolist():
                pen.line([self.at(x, y), self.at(x + 6, y)], "#ffffff", round(2.4 * SMOOTH * self.layout.unit))
        bottom = 2 * self.middle - SMOOTH
        for edge in (0.0, bottom):
            pen.line([(0, edge), (SMOOTH * self.layout.width, edge)], GREY, 2 * SMOOTH)

    def decision(self, pen: ImageDraw.ImageDraw, one: Mapping[str, Any]) -> None:
        """Draw what is forbidden at the first step, the branches and the plan."""
        for block in one["forbidden"]:
            if block["step"] == STEP:
                self._block(pen, block)
        for branch in sorted(one["branches"], key=lambda branch: branch["probability"] or 0.0):
            self._branch(pen, branch)
        plan = [self.at(step["x_m"], self.film.lane_y(step["lane"])) for step in one["plan"]]
        if plan:
            pen.line(plan, BLUE, round(2.2 * SMOOTH * self.layout.unit), joint="curve")
        for point in plan:
            self._dot(pen, point, 4.0, BLUE)

    def _block(self, pen: ImageDraw.ImageDraw, block: Mapping[str, Any]) -> None:
        low = self.left - 5 if block["x_from_m"] is None else max(block["x_from_m"], self.left - 5)
        high = self.right + 5 if block["x_to_m"] is None else min(block["x_to_m"], self.right + 5)
        if high <= low:
            return
        y = self.film.lane_y(block["lane"])
        half = 0.46 * self.film.lane_width
        (x1, y1), (x2, y2) = self.at(low, y + half), self.at(high, y - half)
        pen.rectangle([x1, y1, x2, y2], (*rgb(VERMILLION), 38))
        for x in (x1, x2):
            pen.line([(x, y1), (x, y2)], (*rgb(VERMILLION), 200), SMOOTH)

    def _branch(self, pen: ImageDraw.ImageDraw, branch: Mapping[str, Any]) -> None:
        points = [self.at(x, y) for x, y in zip(branch["x_m"], branch["y_m"], strict=True)]
        if not points or points[-1][0] < 0 or points[0][0] > SMOOTH * self.layout.width:
            return
        alpha = round(255 * min(0.12 + 0.8 * (branch["probability"] or 0.0), 1.0))
        pen.line(points, (*rgb(PURPLE), alpha), round(1.4 * SMOOTH * self.layout.unit))
        i = STEP - 1
        rx, ry = 2 * (branch["x_std_m"][i] or 0) * self.per_x, 2 * (branch["y_std_m"][i] or 0) * self.per_y
        (x, y), fill = points[i], (*rgb(PURPLE), alpha // 3)
        pen.ellipse([x - rx, y - ry, x + rx, y + ry], fill, (*rgb(PURPLE), alpha), SMOOTH)

    def _dot(self, pen: ImageDraw.ImageDraw, point: Point, radius: float, color: str) -> None:
        r = radius * SMOOTH * self.layout.unit
        pen.ellipse([point[0] - r, point[1] - r, point[0] + r, point[1] + r], "#ffffff", color, 2 * SMOOTH)

    def vehicle(self, pen: ImageDraw.ImageDraw, now: Instant, index: int) -> None:
        """Draw a vehicle with its nose at the front."""
        x, y, length = float(now.x[index]), float(now.y[index]), float(now.length[index])
        if not self.left < x + 1 or x - length > self.right:
            return
        cos, sin = math.cos(now.heading[index]), math.sin(now.heading[index])
        half, nose = float(now.width[index]) / 2, min(1.2, 0.28 * length)
        corners = [(0.0, 0.0), (nose, half), (length, half), (length, -half), (nose, -half)]
        points = [self.at(x - back * cos - side * sin, y - back * sin + side * cos) for back, side in corners]
        pen.polygon(points, BLUE if index == 0 else OTHER, INK, SMOOTH)

    def labels(self, pen: ImageDraw.ImageDraw, now: Instant) -> None:
        """Name the vehicles below their bodies, the nearest to the ego first; a name without room is left out."""
        letters = font(max(self.layout.text - 4, 8))
        taken: list[tuple[float, float, float, float]] = []
        for index in self._nearest(now):
            name = "ego" if now.ids[index] == EGO_ID else now.ids[index]
            x, y = self.at(float(now.x[index] - now.length[index] / 2), float(now.y[index] - now.width[index] / 2))
            place, anchor = (x / SMOOTH, y / SMOOTH + 1), "mt"
            if place[1] + letters.size > self.layout.road:
                # The last lane has no room below.
                place, anchor = (place[0], place[1] - 3 - float(now.width[index]) * self.per_y / SMOOTH), "mb"
            box = pen.textbbox(place, name, letters, anchor)
            if box[0] < 2 or box[2] > self.layout.width - 2 or any(_overlap(box, other) for other in taken):
                continue
            taken.append(box)
            pen.text(place, name, INK, letters, anchor, stroke_width=2, stroke_fill=ROAD_COLOR)

    def _nearest(self, now: Instant) -> Iterator[int]:
        order: Sequence[int] = np.argsort(np.abs(now.x - now.x[0]), kind="stable").tolist()
        yield 0
        yield from (index for index in order if index and self.left < now.x[index] < self.right + now.length[index])


def rgb(color: str) -> tuple[int, int, int]:
    """Return the channels of a colour such as `#0072B2`."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


def _overlap(a: tuple[float, float, float, float], b: tuple[float, float, float, float]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
