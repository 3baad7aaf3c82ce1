"""Lanes of a straight road, their signs, and their numbers here and in SUMO."""

import math
from dataclasses import dataclass

# A lane centre that is passed by less, in lane widths, is not passed: sums of small steps are not exact.
_ON_CENTER = 1e-6


@dataclass(frozen=True)
class Road:
    """A straight road: x runs forward, y to the left, lanes are numbered 1..n from the left.

    Attributes:
        lane_count: number of lanes n.
        lane_width: [m].
    """

    lane_count: int
    lane_width: float

    def center_y(self, lane: int) -> float:
        """Return y of a lane's centre, ((n + 1) / 2 - lane) * width [m] (docs/formulation.md, eq. 1)."""
        return ((self.lane_count + 1) / 2 - lane) * self.lane_width

    def has_lane(self, lane: int) -> bool:
        """Tell whether the lane exists."""
        return 1 <= lane <= self.lane_count

    def lane_at(self, y: float) -> int:
        """Return the lane whose strip holds y [m], or the outermost one for a y beside the road."""
        lane = round((self.lane_count + 1) / 2 - y / self.lane_width)
        return min(max(lane, 1), self.lane_count)

    def lane_headed_for(self, y: float, lateral_speed: float) -> int:
        """Return the lane whose centre is reached next, or the lane at y where there is no lateral motion.

        Args:
            y: across the road, to the left [m].
            lateral_speed: dy/dt [m/s].
        """
        position = (self.lane_count + 1) / 2 - y / self.lane_width
        if lateral_speed > 0.0:
            lane = math.floor(position + _ON_CENTER)
        elif lateral_speed < 0.0:
            lane = math.ceil(position - _ON_CENTER)
        else:
            return self.lane_at(y)
        return min(max(lane, 1), self.lane_count)

    def sumo_index(self, lane: int) -> int:
        """Return SUMO's lane index, which counts from the right and starts at 0."""
        return self.lane_count - lane

    def lane_of_sumo_index(self, index: int) -> int:
        """Return the lane number of SUMO's lane index."""
        return self.lane_count - index
