"""Which lanes a body takes up, now and during a lane change (docs/formulation.md, eq. 16).

`target`, the paper's rule: a vehicle takes up the lane it intends. `swept`: while its body is still over the lane
it leaves, it takes up that one as well.
"""

import math
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.domain.maneuver import Lateral
from sumo_hmdp.domain.road import Road

# A body that only touches a line is not over the lane beyond it [m].
BODY_TOLERANCE = 1e-9


class Occupancy(StrEnum):
    """Which lanes a vehicle takes up."""

    TARGET = "target"
    SWEPT = "swept"


@dataclass(frozen=True)
class LaneState:
    """What the ego does across the road at the end of a step.

    Attributes:
        lane: the lane it intends.
        leaving: (lane, number of steps, this one included, at whose end its body is still over it), by lane.
    """

    lane: int
    leaving: tuple[tuple[int, int], ...] = ()

    @property
    def occupied(self) -> tuple[int, ...]:
        """The lanes it takes up."""
        return (self.lane, *(lane for lane, _ in self.leaving))

    def after(self, lateral: Lateral, sweep_steps: int) -> "LaneState":
        """Return the state one step on.

        Args:
            lateral: the step's action.
            sweep_steps: how many steps end with the body still over a lane that is left; 0 counts none.
        """
        lane = self.lane + lateral
        leaving = {left: steps - 1 for left, steps in self.leaving if steps > 1 and left != lane}
        if lateral != Lateral.KEEP and sweep_steps:
            leaving[self.lane] = sweep_steps
        return LaneState(lane, tuple(sorted(leaving.items())))


@dataclass(frozen=True)
class LaneChange:
    """How the ego changes lanes.

    Attributes:
        road: the lanes.
        width: of its body [m].
        duration: of a lane change, a quintic [s].
        period: of a step [s].
    """

    road: Road
    width: float
    duration: float
    period: float

    @property
    def sweep_steps(self) -> int:
        """How many steps of a lane change end before the body has left the old lane, at least 1."""
        return max(1, math.ceil(clearing_progress(self.road, self.width) * self.duration / self.period - 1e-9) - 1)

    def state(self, lane: int, y: float) -> LaneState:
        """Return the lane state now; what is left of a running lane change follows from y.

        Args:
            lane: the lane it intends.
            y: of its front bumper across the road [m].
        """
        leaving = []
        for other in sorted({*body_lanes(self.road, y, self.width)} - {lane}):
            distance = abs(self.road.center_y(lane) - self.road.center_y(other))
            done = min(max(abs(y - self.road.center_y(other)) / distance, 0.0), 1.0)
            clear = clearing_progress(self.road, self.width)
            left = max(0.0, clear - quintic_progress(done)) * self.duration
            # This very instant counts as one; the steps that follow are those that end before the line is cleared.
            leaving.append((other, 1 + max(0, math.ceil(left / self.period - 1e-9) - 1)))
        return LaneState(lane, tuple(leaving))


def quintic_share(progress: float) -> float:
    """Return 10 t^3 - 15 t^4 + 6 t^5, the share of a lane change that is done at a share of its time."""
    return progress**3 * (10 - 15 * progress + 6 * progress**2)


def quintic_progress(share: float) -> float:
    """Return the share of its time at which a share of a lane change is done; the inverse of `quintic_share`."""
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if quintic_share(middle) < share else (low, middle)
    return (low + high) / 2


@lru_cache(maxsize=64)
def clearing_progress(road: Road, width: float) -> float:
    """Return the share of a lane change's time after which the body has left the old lane.

    The body of a vehicle clears the line when its centre is half a width beyond it.
    """
    return quintic_progress(min(1.0, (road.lane_width + width) / (2 * road.lane_width)))


def body_lanes(road: Road, y: float, width: float) -> tuple[int, ...]:
    """Return the lanes that a body at y [m] is over."""
    reach = (road.lane_width + width) / 2 - BODY_TOLERANCE
    return tuple(lane for lane in range(1, road.lane_count + 1) if abs(y - road.center_y(lane)) < reach)


def bodies_over(road: Road, y: NDArray[np.float64], width: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which lanes bodies at y [m] are over; the shape of y, with the lanes as one more axis."""
    centers = np.array([road.center_y(lane) for lane in range(1, road.lane_count + 1)])
    reach = (road.lane_width + width) / 2 - BODY_TOLERANCE
    # The lanes come first, and last only in the end: NumPy is slow over a last axis as short as theirs.
    return np.asarray(np.abs(y.T - centers.reshape(-1, *(1,) * y.ndim)) < reach.T).T
