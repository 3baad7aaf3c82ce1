"""Which lanes a vehicle takes up, and which lane states the ego can be in (docs/formulation.md, eq. 16).

`target`, the paper's rule: a vehicle takes up the lane it intends. `swept`: while its body is still over the lane
it leaves, it takes up that one as well.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.domain.maneuver import Lateral
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.hmdp.branches import Branches, IntArray, PredictionSettings, lateral_means
from sumo_hmdp.hmdp.dynamics import FloatArray
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


@dataclass(frozen=True)
class LaneStep:
    """The lane states that the ego can be in at the end of one step, S of them, and how it gets there.

    The branches only see which lanes a state takes up. There are many states and few such footprints, U of them.

    Attributes:
        states: by lane, then by what is left.
        lane: (S,) the lane that each intends.
        occupied: (U, lanes) which lanes each footprint covers.
        footprint: (S,) index of each state's footprint in `occupied`.
        before: (M,) of each pair of footprints between which there is a move, the index of the one a step before.
        after: (M,) of each such pair, the index of the one in `occupied`.
        move: (S one step before, S) number of the pair of the move between two states, -1 where there is none.
    """

    states: tuple[LaneState, ...]
    lane: IntArray
    occupied: NDArray[np.bool_]
    footprint: IntArray
    before: IntArray
    after: IntArray
    move: IntArray


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


def lane_steps(problem: DecisionProblem) -> tuple[LaneStep, ...]:
    """List the lane states that the ego can be in at the end of each step 0..H; forbidden lanes are left out."""
    settings = problem.settings
    return _lane_steps(
        start_state(problem),
        sweep_steps(problem),
        problem.road.lane_count,
        settings.forbidden_lanes,
        settings.horizon_steps,
    )


@lru_cache(maxsize=256)
def _lane_steps(
    start: LaneState, sweep: int, lane_count: int, forbidden: frozenset[int], horizon: int
) -> tuple[LaneStep, ...]:
    steps = [_lane_step(None, (start,), sweep, lane_count)]
    for _ in range(horizon):
        before = steps[-1].states
        following = {state.after(lateral, sweep) for state in before for lateral in Lateral}
        reachable = (s for s in following if 1 <= s.lane <= lane_count and s.lane not in forbidden)
        after = tuple(sorted(reachable, key=lambda state: (state.lane, state.leaving)))
        steps.append(_lane_step(steps[-1], after, sweep, lane_count))
    return tuple(steps)


def _lane_step(before: LaneStep | None, after: tuple[LaneState, ...], sweep: int, lane_count: int) -> LaneStep:
    footprints = [frozenset(state.occupied) for state in after]
    distinct = list(dict.fromkeys(footprints))
    occupied = np.zeros((len(distinct), lane_count), dtype=bool)
    for row, lanes in zip(occupied, distinct, strict=True):
        row[[lane - 1 for lane in lanes]] = True
    number = {state: index for index, state in enumerate(after)}
    footprint = np.array([distinct.index(lanes) for lanes in footprints], dtype=np.int64)
    states = () if before is None else before.states
    move = np.full((len(states), len(after)), -1, dtype=np.int64)
    pairs: dict[tuple[int, int], int] = {}
    for i, state in enumerate(states):
        for following in (state.after(lateral, sweep) for lateral in Lateral):
            if before is not None and following in number:
                j = number[following]
                pair = int(before.footprint[i]), int(footprint[j])
                move[i, j] = pairs.setdefault(pair, len(pairs))
    ends = np.array(list(pairs), dtype=np.int64).reshape(-1, 2)
    lane = np.array([state.lane for state in after], dtype=np.int64)
    return LaneStep(after, lane, occupied, footprint, ends[:, 0], ends[:, 1], move)


def shares_lane(problem: DecisionProblem, state: LaneState) -> NDArray[np.bool_]:
    """Tell which vehicles take up any lane of a lane state now, shape (V,)."""
    vehicles = [v.state for v in problem.vehicles]
    lanes = np.array(state.occupied)
    shares: NDArray[np.bool_] = np.array([v.lane for v in vehicles], dtype=np.int64)[:, None] == lanes
    if problem.settings.occupancy is Occupancy.SWEPT:
        y, widths = np.array([v.y for v in vehicles]), np.array([v.width for v in vehicles])
        shares = shares | _bodies_over(problem.road, y, widths)[:, lanes - 1]
    return np.asarray(shares.any(axis=1))


def occupied_lanes(problem: DecisionProblem, branches: Branches) -> NDArray[np.bool_]:
    """Tell which lanes each branch takes up at the end of each step, shape (B, H, lanes); not to be written to."""
    return _occupied_lanes(branches, problem.road, problem.settings.occupancy, problem.settings.prediction())


# Everybody who works on one decision asks for it.
@lru_cache(maxsize=4)
def _occupied_lanes(
    branches: Branches, road: Road, occupancy: Occupancy, prediction: PredictionSettings
) -> NDArray[np.bool_]:
    occupied: NDArray[np.bool_] = branches.lanes[:, :, None] == np.arange(1, road.lane_count + 1)
    if occupancy is Occupancy.SWEPT:
        widths = np.array([v.state.width for v in branches.vehicles])[branches.vehicle]
        occupied |= _bodies_over(road, lateral_means(branches, road, prediction), widths[:, None])
    occupied.flags.writeable = False
    return occupied


def _bodies_over(road: Road, y: FloatArray, width: FloatArray) -> NDArray[np.bool_]:
    """Tell which lanes bodies at y [m] are over; the shape of y, with the lanes as one more axis."""
    centers = np.array([road.center_y(lane) for lane in range(1, road.lane_count + 1)])
    reach = (road.lane_width + width) / 2 - BODY_TOLERANCE
    return np.asarray(np.abs(y[..., None] - centers) < reach[..., None])
