"""A run as a film, without a display: the road from above, the decision in words, the ego's speed over time."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from sumo_hmdp.domain.plan import Status
from sumo_hmdp.report.case_road import BLUE, GREEN, GREY, ORANGE, PURPLE, ROAD_COLOR, SKY, VERMILLION
from sumo_hmdp.report.film import Film, Instant
from sumo_hmdp.report.video_file import write_frames
from sumo_hmdp.report.video_road import INK, SMOOTH, Layout, Point, View, font

MUTED, PAPER, LINE = "#59636e", "#ffffff", "#d8dce0"
STATUS_COLORS = {
    Status.OPTIMAL: GREEN, Status.INCUMBENT: SKY, Status.RELAXED: ORANGE, Status.FALLBACK: VERMILLION,
    Status.RULE: GREY,
}  # fmt: skip
MARK_COLORS = {str(status): color for status, color in STATUS_COLORS.items()} | {
    "left": BLUE,
    "right": BLUE,
    "near_miss": PURPLE,
    "contact": INK,
}
MARK_NAMES = {
    "left": "to the left", "right": "to the right", **{str(status): str(status) for status in Status if status.departs},
    "near_miss": "near miss", "contact": "contact",
}  # fmt: skip
MARK_SIGNS = {
    "left": "▲", "right": "▼", "incumbent": "◇", "relaxed": "◆", "fallback": "■", "near_miss": "○", "contact": "×",  # noqa: RUF001
}  # fmt: skip
KEY = "blue line: plan    purple: predicted branches, 2σ    red: forbidden at the next step"  # noqa: RUF001
# The ego is at this share of the road that is seen.
EGO_AT = 0.36


def write_film(path: Path, film: Film, on_progress: Callable[[float, float], None] | None = None) -> None:
    """Write a film.

    Args:
        path: of the file, whose ending is the format's.
        film: what it shows.
        on_progress: called after each frame with how many are done and how many there are.

    Raises:
        InputError: if the file cannot be written.
    """
    studio = Studio(film)

    def frames() -> Iterator[Image.Image]:
        for index, time in enumerate(film.frame_times, start=1):
            yield studio.frame(time)
            if on_progress is not None:
                on_progress(index, film.frame_count)

    write_frames(path, frames(), film.made)


class Studio:
    """Draws the frames of one film.

    Args:
        film: what is drawn.
    """

    def __init__(self, film: Film) -> None:
        self.film = film
        self.layout = Layout(film.made.width, film.lane_count)
        self.ground = self._ground()

    def frame(self, time: float) -> Image.Image:
        """Draw one instant of the run."""
        now = self.film.at(time)
        image = self.ground.copy()
        image.paste(self._road(now), (0, self.layout.head))
        pen = ImageDraw.Draw(image)
        clock = f"{time:.2f} s"
        pen.text(
            (self.layout.width - 16 * self.layout.unit, self.layout.head / 2),
            clock,
            INK,
            font(self.layout.text + 3, bold=True),
            "rm",
        )
        self._tell(pen, now)
        _, top, _, bottom = self.layout.plot_box
        x, y = self._plot_point(time, float(now.speed[0]))
        pen.line([(x, top), (x, bottom)], INK, 1)
        radius = 4 * self.layout.unit
        pen.ellipse([x - radius, y - radius, x + radius, y + radius], BLUE, PAPER)
        return image

    def _road(self, now: Instant) -> Image.Image:
        """Draw the road around the ego."""
        image = Image.new("RGB", (self.layout.width * SMOOTH, self.layout.road * SMOOTH), ROAD_COLOR)
        pen = ImageDraw.Draw(image, "RGBA")
        view = View(self.film, self.layout, float(now.x[0]) - EGO_AT * self.layout.span)
        view.lane_lines(pen)
        if now.decision is not None:
            view.decision(pen, now.decision)
        # The ego last: nothing may cover it.
        for index in reversed(range(len(now.ids))):
            view.vehicle(pen, now, index)
        smooth = image.reduce(SMOOTH)
        view.labels(ImageDraw.Draw(smooth), now)
        return smooth

    def _tell(self, pen: ImageDraw.ImageDraw, now: Instant) -> None:
        left, top = 16 * self.layout.unit, self.layout.head + self.layout.road + 8 * self.layout.unit
        line = self.layout.text * 1.5
        leader = now.leader()
        words = f"{now.speed[0]:.1f} m/s"
        if leader is None:
            words += ", nobody ahead in its path"
        else:
            name, gap, ttc = leader
            words += f", {name} ahead: gap {gap:.1f} m, " + ("not closing" if ttc is None else f"TTC {ttc:.1f} s")
        pen.text((left, top), words, INK, font(self.layout.text))
        if now.decision is None:
            return
        one = now.decision
        radius = 5 * self.layout.unit
        y = top + line + self.layout.text / 2
        pen.ellipse([left, y - radius, left + 2 * radius, y + radius], STATUS_COLORS[Status(one["status"])])
        lateral = {"left": "change left", "right": "change right"}.get(one["lateral"], "keep the lane")
        told = f"{one['status']}: {lateral}, {one['mode']}" + (f" ({one['reason']})" if one["reason"] else "")
        pen.text((left + 3 * radius, top + line), self._fitted(told), INK, font(self.layout.text))

    def _fitted(self, text: str) -> str:
        room = self.layout.width - 60 * self.layout.unit
        while font(self.layout.text).getlength(text) > room:
            text = text[:-2].rstrip("…") + "…"
        return text

    def _ground(self) -> Image.Image:
        """Draw what is the same in all frames."""
        image = Image.new("RGB", (self.layout.width, self.layout.height), PAPER)
        pen = ImageDraw.Draw(image)
        pen.text(
            (16 * self.layout.unit, self.layout.head / 2),
            self.film.title,
            INK,
            font(self.layout.text + 1, bold=True),
            "lm",
        )
        left, top, right, bottom = self.layout.plot_box
        small = font(max(self.layout.text - 2, 9))
        for speed in self._speed_ticks():
            y = self._plot_point(self.film.trace.time[0], speed)[1]
            pen.line([(left, y), (right, y)], LINE, 1)
            pen.text((left - 6, y), f"{speed:g}", MUTED, small, "rm")
        for time in ticks(float(self.film.trace.time[0]), float(self.film.trace.time[-1]), 8):
            x = self._plot_point(time, 0.0)[0]
            pen.line([(x, bottom), (x, bottom + 4)], MUTED, 1)
            pen.text((x, bottom + 6), f"{time:g} s", MUTED, small, "rt" if x > right - 20 else "mt")
        self._speeds(image)
        pen.text((left + 6, top + 2), "the ego's speed [m/s]", MUTED, small)
        self._marks(pen, small)
        return image

    def _speeds(self, image: Image.Image) -> None:
        """Draw the ego's speed over time, smoothed."""
        mask = Image.new("L", (self.layout.width * SMOOTH, self.layout.height * SMOOTH), 0)
        speeds = zip(self.film.trace.time.tolist(), self.film.trace.ego.speed[:, 0].tolist(), strict=True)
        line = [(SMOOTH * x, SMOOTH * y) for x, y in (self._plot_point(*one) for one in speeds)]
        if len(line) > 1:
            ImageDraw.Draw(mask).line(line, 255, round(2 * SMOOTH * self.layout.unit), joint="curve")
        image.paste(BLUE, (0, 0), mask.reduce(SMOOTH))

    def _marks(self, pen: ImageDraw.ImageDraw, small: ImageFont.FreeTypeFont) -> None:
        """Draw what happened when on the time line, and what the signs mean."""
        _, top, _, bottom = self.layout.plot_box
        for time, kind in self.film.marks:
            x, _ = self._plot_point(time, 0.0)
            pen.text((x, top - 1), MARK_SIGNS[kind], MARK_COLORS[kind], small, "mb")
        x = self.layout.plot_box[0]
        y = bottom + 30 * self.layout.unit + self.layout.text / 2
        if self.film.decisions:
            pen.text((self.layout.width - 16 * self.layout.unit, y), KEY, MUTED, small, "rm")
        for kind in dict.fromkeys(
            kind for _, kind in sorted(self.film.marks, key=lambda m: list(MARK_NAMES).index(m[1]))
        ):
            words = f" {MARK_NAMES[kind]}   "
            pen.text((x, y), MARK_SIGNS[kind], MARK_COLORS[kind], small, "lm")
            x += small.getlength(MARK_SIGNS[kind])
            pen.text((x, y), words, MUTED, small, "lm")
            x += small.getlength(words)

    def _speed_range(self) -> tuple[float, float]:
        speeds = self.film.trace.ego.speed
        low, high = float(np.nanmin(speeds)), float(np.nanmax(speeds))
        pad = max(0.12 * (high - low), 0.5)
        return max(0.0, low - pad), high + pad

    def _speed_ticks(self) -> list[float]:
        return ticks(*self._speed_range(), 4)

    def _plot_point(self, time: float, speed: float) -> Point:
        left, top, right, bottom = self.layout.plot_box
        first, last = float(self.film.trace.time[0]), float(self.film.trace.time[-1])
        low, high = self._speed_range()
        x = left + (right - left) * (time - first) / max(last - first, 1e-9)
        return x, bottom - (bottom - top) * (speed - low) / (high - low)


def ticks(low: float, high: float, most: int) -> list[float]:
    """Return round numbers from low to high, at most about so many."""
    least = max(high - low, 1e-9) / most
    power = 10.0 ** math.floor(math.log10(least))
    spacing = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= least * (1 - 1e-9))
    return [spacing * i for i in range(math.ceil(low / spacing - 1e-9), math.floor(high / spacing + 1e-9) + 1)]
