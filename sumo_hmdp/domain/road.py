"""Lanes of a straight road, their signs, and their numbers here and in SUMO."""

from dataclasses import dataclass


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

    def sumo_index(self, lane: int) -> int:
        """Return SUMO's lane index, which counts from the right and starts at 0."""
        return self.lane_count - lane

    def lane_of_sumo_index(self, index: int) -> int:
        """Return the lane number of SUMO's lane index."""
        return self.lane_count - index
