"""Which lanes the vehicles of a decision take up, and which lane states the ego can be in (`domain/occupancy.py`)."""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.decision.problem import DecisionProblem, PlannerSettings
from sumo_hmdp.decision.risk import quantiles
from sumo_hmdp.decision.road_rules import Moves, banned_moves
from sumo_hmdp.domain.maneuver import Lateral
from sumo_hmdp.domain.occupancy import LaneChange, LaneState, Occupancy, bodies_over
from sumo_hmdp.domain.road import Road
from sumo_hmdp.prediction.branches import (
    Branches,
    IntArray,
    lane_change_means,
    lane_changing,
    lane_keeping_means,
    lateral_spread,
)
from sumo_hmdp.prediction.dynamics import FloatArray


@dataclass(frozen=True, eq=False)
class LaneStep:
    """The lane states that the ego can be in at the end of one step, S of them, and how it gets there.

    The branches only see which lanes a state takes up. There are many states and few such footprints, U of them.

    Attributes:
        states: by lane, then by what is left.
        lane: (S,) the lane that each intends.
        occupied: (U, lanes) which lanes each footprint covers.
        footprint: (S,) index of each state's footprint in `occupied`.
        move: (S one step before, S) whether there is a move between two states.
    """

    states: tuple[LaneState, ...]
    lane: IntArray
    occupied: NDArray[np.bool_]
    footprint: IntArray
    move: NDArray[np.bool_]


def _lane_change(problem: DecisionProblem) -> LaneChange:
    settings = problem.settings
    return LaneChange(problem.road, problem.ego.width, settings.lane_change_time, settings.period)


def sweep_steps(problem: DecisionProblem) -> int:
    """Return how many steps of a lane change of the ego end before its body has left the old lane; 0 counts none."""
    return 0 if problem.settings.occupancy is Occupancy.TARGET else _lane_change(problem).sweep_steps


def start_state(problem: DecisionProblem) -> LaneState:
    """Return the ego's lane state now; under `swept`, what is left of a running lane change follows from y."""
    ego = problem.ego
    if problem.settings.occupancy is Occupancy.TARGET:
        return LaneState(ego.lane)
    return _changing(_lane_change(problem), ego.lane, ego.y)


@lru_cache(maxsize=16)
def _changing(change: LaneChange, lane: int, y: float) -> LaneState:
    """Return the lane state of an ego; it is asked for several times a decision."""
    return change.state(lane, y)


def lane_steps(problem: DecisionProblem) -> tuple[LaneStep, ...]:
    """List the lane states that the ego can be in at the end of each step 0..H; forbidden lanes are left out."""
    settings = problem.settings
    return _lane_steps(
        start_state(problem),
        sweep_steps(problem),
        problem.road.lane_count,
        settings.forbidden_lanes,
        banned_moves(problem),
    )


@lru_cache(maxsize=256)
def _lane_steps(
    start: LaneState, sweep: int, lane_count: int, forbidden: frozenset[int], banned: tuple[Moves, ...]
) -> tuple[LaneStep, ...]:
    steps = [_lane_step(None, (start,), sweep, lane_count, frozenset())]
    for moves in banned:
        following = {after for state in steps[-1].states for after in _following(state, sweep, moves)}
        reachable = (s for s in following if 1 <= s.lane <= lane_count and s.lane not in forbidden)
        after = tuple(sorted(reachable, key=lambda state: (state.lane, state.leaving)))
        steps.append(_lane_step(steps[-1], after, sweep, lane_count, moves))
    return tuple(steps)


def _following(state: LaneState, sweep: int, banned: Moves) -> set[LaneState]:
    return {state.after(lateral, sweep) for lateral in Lateral if (state.lane, int(lateral)) not in banned}


def _lane_step(
    before: LaneStep | None, after: tuple[LaneState, ...], sweep: int, lane_count: int, banned: Moves
) -> LaneStep:
    footprints = [frozenset(state.occupied) for state in after]
    distinct = list(dict.fromkeys(footprints))
    occupied = np.zeros((len(distinct), lane_count), dtype=bool)
    for row, lanes in zip(occupied, distinct, strict=True):
        row[[lane - 1 for lane in lanes]] = True
    footprint = np.array([distinct.index(lanes) for lanes in footprints], dtype=np.int64)
    states = () if before is None else before.states
    move = np.zeros((len(states), len(after)), dtype=bool)
    for row, state in zip(move, states, strict=True):
        following = _following(state, sweep, banned)
        row[:] = [other in following for other in after]
    lane = np.array([state.lane for state in after], dtype=np.int64)
    return LaneStep(after, lane, occupied, footprint, move)


class _Occupied(NamedTuple):
    """Which lanes are taken up.

    Attributes:
        now: (V, lanes) by each vehicle.
        later: (B, H, lanes) by each branch at the end of each step.
    """

    now: NDArray[np.bool_]
    later: NDArray[np.bool_]


def shares_lane(problem: DecisionProblem, branches: Branches, state: LaneState) -> NDArray[np.bool_]:
    """Tell which vehicles take up any lane of a lane state now, shape (V,)."""
    return np.asarray(lanes_now(problem, branches)[:, [lane - 1 for lane in state.occupied]].any(axis=1))


def lanes_now(problem: DecisionProblem, branches: Branches) -> NDArray[np.bool_]:
    """Tell which lanes each vehicle takes up now, shape (V, lanes); not to be written to."""
    return _occupied(branches, problem.road, problem.settings).now


def occupied_lanes(problem: DecisionProblem, branches: Branches) -> NDArray[np.bool_]:
    """Tell which lanes each branch takes up at the end of each step, shape (B, H, lanes); not to be written to.

    Under `swept` a body counts as wider by z_b sqrt(Q_yy) on both sides, with the z_b of its distances (docs/
    formulation.md, eq. 34): the probability that it is over a lane beside those is at most eps_b.

    Raises:
        decision.risk.RiskBudgetError: as `decision.risk.tail_probabilities`.
    """
    return _occupied(branches, problem.road, problem.settings).later


# Everybody who works on one decision asks for it.
@lru_cache(maxsize=4)
def _occupied(branches: Branches, road: Road, settings: PlannerSettings) -> _Occupied:
    vehicles = [v.state for v in branches.vehicles]
    # The lanes come first, and last only in the end: NumPy is slow over a last axis as short as theirs.
    lanes = np.arange(1, road.lane_count + 1)[:, None]
    now: NDArray[np.bool_] = lanes == np.array([v.lane for v in vehicles], dtype=np.int64)
    later: NDArray[np.bool_] = lanes[:, :, None] == branches.lanes.T
    if settings.occupancy is Occupancy.SWEPT:
        y, widths = np.array([v.y for v in vehicles]), np.array([v.width for v in vehicles])
        z, spread = _lateral_margins(branches, settings)
        largest = np.zeros(len(vehicles))
        np.maximum.at(largest, branches.vehicle, z)
        now |= bodies_over(road, y, widths + 2 * largest * spread[:, 0]).T
        later |= _bodies_later(branches, road, settings, z, spread[:, 1:])
    now.flags.writeable = later.flags.writeable = False
    return _Occupied(now.T, later.T)


def _bodies_later(
    branches: Branches, road: Road, settings: PlannerSettings, z: FloatArray, spread: FloatArray
) -> NDArray[np.bool_]:
    """Tell which lanes the bodies of branches are over at the end of each step, (lanes, H, B).

    Args:
        branches: the branches.
        road: the lanes.
        settings: of the planner.
        z: (B,) how many standard deviations a body counts as wider on either side.
        spread: (V, H) standard deviation of y [m].
    """
    prediction, of_branch = settings.prediction(), branches.vehicle
    widths = np.array([v.state.width for v in branches.vehicles])[:, None]
    keeping = lane_keeping_means(branches, road, prediction)
    # Most branches stay in their lane. Those of a vehicle are the same then, but for z under `mixture`.
    some = np.zeros(len(branches.vehicles))
    some[of_branch] = z
    rows = lane_changing(branches)
    if np.array_equal(some[of_branch], z):
        wide = widths + 2 * some[:, None] * spread
        over = bodies_over(road, keeping, wide).T.take(of_branch, axis=2)
    else:
        wide = widths[of_branch] + 2 * z[:, None] * spread[of_branch]
        over = bodies_over(road, keeping[of_branch], wide).T
    if len(rows):
        mine = of_branch[rows]
        wide = widths[mine] + 2 * z[rows, None] * spread[mine]
        over[:, :, rows] = bodies_over(road, lane_change_means(branches, rows, road, prediction), wide).T
    return np.asarray(over)


def _lateral_margins(branches: Branches, settings: PlannerSettings) -> tuple[FloatArray, FloatArray]:
    """Return z of each branch, (B,), and sqrt(Q_yy) of each vehicle now and after each step, (V, 1 + H) [m] (eq. 34).

    Zeros by the paper's law: its variance grows like that along x.
    """
    if settings.gains is not None:
        return np.zeros(len(branches.vehicle)), np.zeros((len(branches.vehicles), 1 + settings.horizon_steps))
    return quantiles(branches, settings), lateral_spread(branches, settings.prediction())


def lanes_along(problem: DecisionProblem, laterals: tuple[Lateral, ...]) -> NDArray[np.bool_]:
    """Tell which lanes the ego takes up at the end of each step of a sequence of lateral actions, (H, lanes)."""
    return _lanes_along(start_state(problem), laterals, sweep_steps(problem), problem.road.lane_count)


@lru_cache(maxsize=256)
def _lanes_along(state: LaneState, laterals: tuple[Lateral, ...], sweep: int, lane_count: int) -> NDArray[np.bool_]:
    own = np.zeros((len(laterals), lane_count), dtype=bool)
    for lanes, lateral in zip(own, laterals, strict=True):
        state = state.after(lateral, sweep)
        lanes[[lane - 1 for lane in state.occupied]] = True
    own.flags.writeable = False
    return own
