"""The course of a recorded road: (x, y) of the record to (s, d) along it, and to lanes of one width.

The reference line is a polyline whose normals at the vertices are bisectors scaled by 1 / cos(turn / 2). So a lane line
at a constant offset is parallel to it, and d is the distance from the segment's line.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.domain.road import Road
from sumo_hmdp.errors import InputError

FloatArray = NDArray[np.float64]

# The ego drives in (s, d) as on a straight road. So ds/dt is wrong by |curvature d|, at most this.
CURVATURE_MAX = 0.05
# The road is taken for straight where its middle is nowhere farther from a straight line [m].
STRAIGHT = 0.3
# Distance of the vertices of a curved reference line, long enough to even out rounded points [m].
STATION = 20.0
# No part of the road may turn farther from the line between its ends [rad].
_TURN_MAX = 0.7
# Lanes of any country, with construction sites [m].
LANE_WIDTHS = (2.0, 6.0)


@dataclass(frozen=True)
class RoadShape:
    """A road with lanes beside each other; beyond both ends it goes straight on.

    Attributes:
        points: (m, 2) vertices of the reference line in the record's frame, m >= 2 [m].
        lines: (lanes + 1, m) offsets of the lane lines from it at the vertices, from left to right, positive left [m].
        mirrored: whether the record's y axis points to the right of its x axis, as in images.
    """

    points: FloatArray
    lines: FloatArray
    mirrored: bool = False

    @cached_property
    def road(self) -> Road:
        """The same road with lanes of one width, the mean of all."""
        return Road(len(self.lines) - 1, float(np.mean(self.lines[0] - self.lines[-1]) / (len(self.lines) - 1)))

    @cached_property
    def stations(self) -> FloatArray:
        """Positions of the vertices along the road, (m,), from 0 [m]."""
        return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(self.points, axis=0).T))])

    @property
    def length(self) -> float:
        """Of the part of which the lanes are recorded [m]."""
        return float(self.stations[-1])

    @cached_property
    def _headings(self) -> FloatArray:
        """Directions of the segments [rad], (m - 1,), without jumps."""
        dx, dy = np.diff(self.points, axis=0).T
        return np.unwrap(np.arctan2(dy, dx))

    @cached_property
    def _vertex_headings(self) -> FloatArray:
        """Directions at the vertices [rad], (m,)."""
        h = self._headings
        return np.hstack([h[:1], 0.5 * (h[1:] + h[:-1]), h[-1:]])

    @cached_property
    def curvature(self) -> FloatArray:
        """At the inner vertices [1/m], (m - 2,): the turn over the mean of the adjacent lengths."""
        lengths = np.diff(self.stations)
        return np.diff(self._headings) / (0.5 * (lengths[1:] + lengths[:-1]))

    def locate(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return s along the road and d from its reference line, to the left [m].

        Args:
            x: (n,) in the record's frame [m].
            y: (n,) in the record's frame [m].
        """
        h, lengths = self._headings, np.diff(self.stations)
        side = -1.0 if self.mirrored else 1.0
        best_s, best_d = np.empty(len(x)), np.full(len(x), np.inf)
        for i in range(len(lengths)):
            dx, dy = x - self.points[i, 0], y - self.points[i, 1]
            along = dx * np.cos(h[i]) + dy * np.sin(h[i])
            across = -dx * np.sin(h[i]) + dy * np.cos(h[i])
            # How far the normals at both ends lean forward, per metre across.
            lean_a = 0.0 if i == 0 else np.tan(0.5 * (h[i] - h[i - 1]))
            lean_b = 0.0 if i == len(lengths) - 1 else -np.tan(0.5 * (h[i + 1] - h[i]))
            share = (along - across * lean_a) / (lengths[i] + across * (lean_b - lean_a))
            inside = (share >= 0.0) | (i == 0)
            inside &= (share < 1.0) | (i == len(lengths) - 1)
            nearer = inside & (np.abs(across) < np.abs(best_d))
            best_s = np.where(nearer, self.stations[i] + share * lengths[i], best_s)
            best_d = np.where(nearer, across, best_d)
        return best_s, side * best_d

    def heading_at(self, s: FloatArray) -> FloatArray:
        """Return the road's direction in the record's frame at s [rad]."""
        return np.asarray(np.interp(s, self.stations, self._vertex_headings), dtype=float)

    def outside(self, s: FloatArray, d: FloatArray) -> FloatArray:
        """Return how far points are beside the outermost lane lines, at most 0 on the road [m]."""
        left = np.interp(s, self.stations, self.lines[0])
        right = np.interp(s, self.stations, self.lines[-1])
        return np.asarray(np.maximum(d - left, right - d), dtype=float)

    def across(self, s: FloatArray, d: FloatArray) -> FloatArray:
        """Return y on the road with lanes of one width [m]: linear between lane centres, a constant offset beside."""
        lines = np.array([np.interp(s, self.stations, line) for line in self.lines])
        centers = 0.5 * (lines[1:] + lines[:-1])
        wanted = np.array([self.road.center_y(lane) for lane in range(1, len(centers) + 1)])
        y = np.where(d >= centers[0], wanted[0] + d - centers[0], wanted[-1] + d - centers[-1])
        for k in range(len(centers) - 1):
            between = (d < centers[k]) & (d >= centers[k + 1])
            share = (d - centers[k + 1]) / (centers[k] - centers[k + 1])
            y = np.where(between, wanted[k + 1] + share * self.road.lane_width, y)
        return np.asarray(y, dtype=float)


def straight_road(lines: Sequence[float], begin: float, end: float, *, forward: bool, mirrored: bool) -> RoadShape:
    """Return the road of straight lane lines along the record's x axis.

    Args:
        lines: y of the lane lines in the record's frame [m].
        begin: least x of the record [m].
        end: greatest x of the record [m].
        forward: whether traffic drives towards greater x.
        mirrored: whether y points to the right of x.
    """
    sign = (1.0 if forward else -1.0) * (-1.0 if mirrored else 1.0)
    points = np.array([[begin, 0.0], [end, 0.0]]) if forward else np.array([[end, 0.0], [begin, 0.0]])
    offsets = np.sort(sign * np.asarray(lines, dtype=float))[::-1]
    require_lanes(shape := RoadShape(points, np.repeat(offsets[:, None], 2, axis=1), mirrored))
    return shape


def require_lanes(shape: RoadShape) -> None:
    """Refuse lanes of no width of a lane.

    Raises:
        InputError: for the first.
    """
    widths = shape.lines[:-1] - shape.lines[1:]
    low, high = LANE_WIDTHS
    for lane, width in enumerate(widths, 1):
        wrong = (width < low) | (width > high)
        if wrong.any():
            message = f"lane {lane} must be {low:g} to {high:g} m wide, got {float(width[wrong][0]):.2f} m"
            raise InputError([f"{message}. Check the lane lines and their units"])


def road_along(lines: Sequence[FloatArray]) -> RoadShape:
    """Return the road between polylines.

    Args:
        lines: lane lines from left to right, each (m_k, 2) in driving direction [m].

    Raises:
        InputError: it turns too far, is too curved, or a lane has no width of a lane.
    """
    first = np.mean([line[0] for line in lines], axis=0)
    last = np.mean([line[-1] for line in lines], axis=0)
    chord = float(np.arctan2(last[1] - first[1], last[0] - first[0]))
    axis = np.array([[np.cos(chord), np.sin(chord)], [-np.sin(chord), np.cos(chord)]])
    turned = []
    for line in lines:
        uv = (line - first) @ axis.T
        # Doubled points, and points that rounding has put a little back, add nothing.
        keep = [0]
        for i in range(1, len(uv)):
            if uv[i, 0] > uv[keep[-1], 0] + 1e-6:
                keep.append(i)
        if len(keep) < 2 or uv[:, 0].max() - uv[-1, 0] > 1.0:
            raise InputError(["the road must not turn back on itself. Choose a straighter part by tracks.lanelet"])
        turned.append(uv[keep])
    begin, end = max(uv[0, 0] for uv in turned), min(uv[-1, 0] for uv in turned)
    if not end > begin:
        raise InputError(["the lanes of the road must lie beside each other. Name another lanelet as tracks.lanelet"])
    u = np.linspace(begin, end, max(2, round((end - begin) / STATION) + 1))
    offsets = np.array([np.interp(u, *uv.T) for uv in turned])
    middle = 0.5 * (offsets[0] + offsets[-1])
    slope, level = np.polyfit(u, middle, 1)
    if np.abs(middle - (slope * u + level)).max() <= STRAIGHT:
        middle = slope * u + level
    steepness = np.gradient(middle, u)
    if np.abs(np.arctan(steepness)).max() > _TURN_MAX:
        message = f"the road must turn by at most {_TURN_MAX:g} rad from the line between its ends"
        raise InputError([f"{message}. Choose a straighter part by tracks.lanelet"])
    points = np.column_stack([u, middle]) @ axis + first
    shape = RoadShape(points, (offsets - middle) * np.cos(np.arctan(steepness)))
    reach = float(np.abs(shape.lines).max())
    curvature = float(np.abs(shape.curvature).max(initial=0.0))
    if curvature * reach > CURVATURE_MAX:
        message = f"the road's curvature times its half width must be at most {CURVATURE_MAX:g}"
        got = f"got {curvature * reach:.3f} (radius {1.0 / curvature:.0f} m)"
        raise InputError([f"{message}, {got}. Choose a straighter part by tracks.lanelet"])
    require_lanes(shape)
    return shape
