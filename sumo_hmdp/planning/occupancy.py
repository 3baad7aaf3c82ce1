"""Which lanes a vehicle takes up, and which lane states the ego can be in (docs/formulation.md, eq. 16).

`target`, the paper's rule: a vehicle takes up the lane it intends. `swept`: while its body is still over the lane
it leaves, it takes up that one as well.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.domain.maneuver import Lateral
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.hmdp.branches import Branches, lateral_means
from sumo_hmdp.planning.problem import DecisionProblem, Occupancy

# A body that only touches a line is not over the lane beyond it [m].
BODY_TOLERANCE = 1e-9


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


def clearing_progress(road: Road, width: float) -> float:
    """Return the share of a lane change's time after which the body has left the old lane.

    The body of a vehicle clears the line when its centre is half a width beyond it.
    """
    return quintic_progress(min(1.0, (road.lane_width + width) / (2 * road.lane_width)))


def sweep_steps(problem: DecisionProblem) -> int:
    """Return how many steps of a lane change of the ego end before its body has left the old lane, at least 1."""
    settings = problem.settings
    if settings.occupancy is Occupancy.TARGET:
        return 0
    time = clearing_progress(problem.road, problem.ego.width) * settings.lane_change_time
    return max(1, math.ceil(time / settings.period - 1e-9) - 1)


def body_lanes(road: Road, y: float, width: float) -> tuple[int, ...]:
    """Return the lanes that a body at y [m] is over."""
    reach = (road.lane_width + width) / 2 - BODY_TOLERANCE
    return tuple(lane for lane in range(1, road.lane_count + 1) if abs(y - road.center_y(lane)) < reach)


def present_lanes(problem: DecisionProblem, vehicle: VehicleState) -> frozenset[int]:
    """Return the lanes that a vehicle takes up now."""
    if problem.settings.occupancy is Occupancy.TARGET:
        return frozenset({vehicle.lane})
    return frozenset({vehicle.lane, *body_lanes(problem.road, vehicle.y, vehicle.width)})


def start_state(problem: DecisionProblem) -> LaneState:
    """Return the ego's lane state now; under `swept`, what is left of a running lane change follows from y."""
    ego, settings = problem.ego, problem.settings
    leaving = []
    for lane in sorted(present_lanes(problem, ego) - {ego.lane}):
        distance = abs(problem.road.center_y(ego.lane) - problem.road.center_y(lane))
        done = min(max(abs(ego.y - problem.road.center_y(lane)) / distance, 0.0), 1.0)
        clear = clearing_progress(problem.road, ego.width)
        left = max(0.0, clear - quintic_progress(done)) * settings.lane_change_time
        # This very instant counts as one; the steps that follow are those that end before the line is cleared.
        leaving.append((lane, 1 + max(0, math.ceil(left / settings.period - 1e-9) - 1)))
    return LaneState(ego.lane, tuple(leaving))


def lane_states(problem: DecisionProblem) -> list[list[LaneState]]:
    """List the lane states that the ego can be in at the end of each step 0..H; forbidden lanes are left out."""
    sweep = sweep_steps(problem)
    allowed = {lane for lane in range(1, problem.road.lane_count + 1) if lane not in problem.settings.forbidden_lanes}
    states = [[start_state(problem)]]
    for _ in range(problem.settings.horizon_steps):
        following = {state.after(lateral, sweep) for state in states[-1] for lateral in Lateral}
        reachable = (state for state in following if state.lane in allowed)
        states.append(sorted(reachable, key=lambda state: (state.lane, state.leaving)))
    return states


def occupied_lanes(problem: DecisionProblem, branches: Branches) -> NDArray[np.bool_]:
    """Tell which lanes each branch takes up at the end of each step, shape (B, H, lanes)."""
    lanes = np.arange(1, problem.road.lane_count + 1)
    occupied: NDArray[np.bool_] = branches.lanes[:, :, None] == lanes
    if problem.settings.occupancy is Occupancy.SWEPT:
        y = lateral_means(branches, problem.road, problem.settings.prediction())
        centers = np.array([problem.road.center_y(int(lane)) for lane in lanes])
        widths = np.array([v.state.width for v in branches.vehicles])[branches.vehicle]
        reach = (problem.road.lane_width + widths[:, None, None]) / 2 - BODY_TOLERANCE
        occupied |= np.abs(y[:, :, None] - centers) < reach
    return occupied
