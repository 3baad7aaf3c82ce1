"""Stage cost and terminal cost (docs/formulation.md, eqs. 12 and 13)."""

from dataclasses import dataclass
from functools import lru_cache
from typing import overload

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.decision.lattice import EgoLattice
from sumo_hmdp.decision.problem import SPEED_TOLERANCE, ManeuverSequence, Preferences
from sumo_hmdp.prediction.branches import IntArray
from sumo_hmdp.prediction.dynamics import FloatArray

# The baseline policy needs one step per speed level and lane; a rollout that takes longer than this never ends.
MAX_ROLLOUT_STEPS = 100_000
UNREACHABLE = "the baseline policy must reach the goal mode: the dead band is under half a speed step"


@overload
def speed_cost(preferences: Preferences, speed: float) -> float: ...
@overload
def speed_cost(preferences: Preferences, speed: FloatArray) -> FloatArray: ...
def speed_cost(preferences: Preferences, speed: float | FloatArray) -> float | FloatArray:
    """Return speed_weight * max(0, |v - v_des| - deadband) for speeds [m/s], any shape."""
    if isinstance(speed, np.ndarray):
        beyond = np.abs(speed - preferences.desired_speed) - preferences.speed_deadband
        return np.where(beyond > SPEED_TOLERANCE, preferences.speed_weight * beyond, 0.0)
    excess = abs(speed - preferences.desired_speed) - preferences.speed_deadband
    return preferences.speed_weight * excess if excess > SPEED_TOLERANCE else 0.0


@overload
def lane_cost(preferences: Preferences, lane: int) -> float: ...
@overload
def lane_cost(preferences: Preferences, lane: IntArray) -> FloatArray: ...
def lane_cost(preferences: Preferences, lane: int | IntArray) -> float | FloatArray:
    """Return lane_weight * |lane - goal_lane| for lanes, any shape; 0 without a goal lane."""
    goal = preferences.goal_lane
    if isinstance(lane, np.ndarray):
        return np.zeros(lane.shape) if goal is None else preferences.lane_weight * np.abs(lane - goal)
    return 0.0 if goal is None else preferences.lane_weight * abs(lane - goal)


def stage_cost(preferences: Preferences, *, mode: int, lateral: int, speed: float, lane: int) -> float:
    """Return the cost of one step; speed [m/s] and lane are those at its end (docs/formulation.md, eq. 12)."""
    return preferences.maneuver(mode, lateral) + speed_cost(preferences, speed) + lane_cost(preferences, lane)


def baseline_action(preferences: Preferences, *, lane: int, speed: float, mode: int) -> tuple[int, int]:
    """Return (lateral action, mode after it) of the baseline policy.

    The mode moves one level toward what the speed needs, the lane one toward the goal at the same time.
    """
    error = speed - preferences.desired_speed
    band = preferences.speed_deadband + SPEED_TOLERANCE
    wanted = 0 if abs(error) <= band else (1 if error < 0 else -1)
    lateral = 0 if preferences.goal_lane is None else int(np.sign(preferences.goal_lane - lane))
    return lateral, mode + int(np.sign(wanted - mode))


def cost_to_go(preferences: Preferences, lattice: EgoLattice, *, lane: int, speed: float, mode: int) -> float:
    """Return the cost of the baseline policy until the goal mode, without traffic (docs/formulation.md, eq. 13).

    Args:
        preferences: with a dead band of at least half a speed step, else the goal may never be reached.
        lattice: for its speed step; where it allows stopping, the baseline stops within a step too.
        lane: to start from.
        speed: to start from [m/s].
        mode: to start from.

    Raises:
        ValueError: if the goal mode is not reached.
    """
    total = 0.0
    for _ in range(MAX_ROLLOUT_STEPS):
        lateral, next_mode = baseline_action(preferences, lane=lane, speed=speed, mode=mode)
        in_band = abs(speed - preferences.desired_speed) <= preferences.speed_deadband + SPEED_TOLERANCE
        if lateral == 0 and mode == 0 and in_band:
            return total
        lane, mode = lane + lateral, next_mode
        speed = next_speed(lattice, speed, mode)
        total += stage_cost(preferences, mode=mode, lateral=lateral, speed=speed, lane=lane)
    raise ValueError(UNREACHABLE)


def next_speed(lattice: EgoLattice, speed: float, mode: int) -> float:
    """Return the ego's speed one step on [m/s]."""
    following = speed + mode * lattice.speed_step
    return max(0.0, following) if lattice.stopping else following


def terminal_table(preferences: Preferences, lattice: EgoLattice, lane_count: int) -> FloatArray:
    """Tabulate the cost-to-go J_H of every end of the horizon, all together.

    Once lane and mode are what the baseline wants, only the speed is left, and its cost has a closed form; before
    that, at most lane_count + 1 steps are rolled out.

    Returns:
        Shape (lanes, 2 H + 1, phases, 3): lane - 1, level n + H, phase, mode + 1; one phase unless stopping.

    Raises:
        ValueError: if the goal mode cannot be reached.
    """
    band = preferences.speed_deadband + SPEED_TOLERANCE
    if band < lattice.speed_step / 2:
        raise ValueError(UNREACHABLE)
    ends = _ends(lane_count, lattice.steps, lattice.stopping, preferences.goal_lane)
    speed: FloatArray = lattice.speed + lattice.speed_step * ends.level
    if lattice.stopping:
        rested = lattice.speed_step * np.maximum(lattice.levels_to_rest + ends.level, 0)
        speed = np.where(ends.rested, rested, speed)
    costs = np.array(preferences.maneuver_cost)[::-1].ravel()
    mode, total = ends.mode, np.zeros(len(speed))
    error = speed - preferences.desired_speed
    outside = np.abs(error) - preferences.speed_deadband
    for lanes in ends.lanes:
        turn = np.subtract(error < -band, error > band, dtype=np.int64) - mode
        # An end in its goal lane, and in the mode that its speed wants, is settled and stays so.
        moving = (turn != 0) | lanes.changes
        if not np.logical_or.reduce(moving):
            break
        mode = mode + np.sign(turn)
        speed = np.where(moving, speed + mode * lattice.speed_step, speed)
        if lattice.stopping:
            speed = np.maximum(speed, 0.0)
        error = speed - preferences.desired_speed
        outside = np.abs(error) - preferences.speed_deadband
        stage = costs[3 * mode + lanes.cost_column]
        stage += np.where(outside > SPEED_TOLERANCE, preferences.speed_weight * outside, 0.0)
        total += np.where(moving, stage + preferences.lane_weight * lanes.away, 0.0)
    return (total + _speed_to_go(preferences, lattice, error, outside)).reshape(ends.shape)


@dataclass(frozen=True, eq=False)
class _LaneStep:
    """One step of the baseline across the road, for each of N ends of the horizon.

    Attributes:
        changes: (N,) whether it changes lanes.
        cost_column: (N,) where the maneuver costs of a cruise with that lateral action lie, row by row.
        away: (N,) how many lanes it then is away from the goal.
    """

    changes: NDArray[np.bool_]
    cost_column: IntArray
    away: IntArray


@dataclass(frozen=True, eq=False)
class _Ends:
    """The N ends of the horizon, but for their speeds.

    Attributes:
        shape: (lanes, 2 H + 1, phases, 3).
        level: (N,).
        rested: (N,) whether the phase is 1.
        mode: (N,).
        lanes: steps of the baseline until it is in the goal lane and in the mode that the speed needs, and one more.
    """

    shape: tuple[int, int, int, int]
    level: FloatArray
    rested: NDArray[np.bool_]
    mode: IntArray
    lanes: tuple[_LaneStep, ...]


@lru_cache(maxsize=64)
def _ends(lane_count: int, steps: int, stopping: bool, goal_lane: int | None) -> _Ends:  # noqa: FBT001 - cached
    """List the ends of the horizon and the lanes of the baseline from each: they hang on no speed."""
    shape = (lane_count, 2 * steps + 1, 1 + stopping, 3)
    lane, level, phase, mode = (index.ravel() for index in np.indices(shape))
    lane = lane + 1
    goal = lane if goal_lane is None else np.full_like(lane, goal_lane)
    across = []
    for _ in range(lane_count + 2):
        lateral = np.sign(goal - lane)
        lane = lane + lateral
        across.append(_LaneStep(lateral != 0, lateral + 4, np.abs(lane - goal)))
    return _Ends(shape, (level - steps).astype(np.float64), phase == 1, mode - 1, tuple(across))


def _speed_to_go(preferences: Preferences, lattice: EgoLattice, error: FloatArray, outside: FloatArray) -> FloatArray:
    """Return the cost of bringing the speed into the band in the mode that does it, and of cruising then.

    With e outside the band and a speed step d it takes m = ceil(e / d) steps, whose ends are e - d, ..., e - (m - 1) d
    and 0 outside the band.

    Args:
        preferences: the cost.
        lattice: for its speed step.
        error: speed above the desired one [m/s].
        outside: by how much it is outside the band, not above 0 inside [m/s].
    """
    steps = np.where(outside > SPEED_TOLERANCE, np.ceil((outside - SPEED_TOLERANCE) / lattice.speed_step), 0.0)
    less = steps - 1
    left = less * outside - lattice.speed_step * less * steps / 2
    each = np.where(error < 0, preferences.maneuver(1, 0), preferences.maneuver(-1, 0))
    cost = steps * each + preferences.speed_weight * left + preferences.maneuver(0, 0)
    return np.where(steps > 0, cost, 0.0)


def objective(preferences: Preferences, lattice: EgoLattice, start_lane: int, sequence: ManeuverSequence) -> float:
    """Return the whole cost of a sequence of maneuvers, step by step."""
    motions = lattice.walk(tuple(int(mode) for mode in sequence.modes))
    total, lane = 0.0, start_lane
    for lateral, mode, motion in zip(sequence.laterals, sequence.modes, motions, strict=True):
        lane += lateral
        total += stage_cost(preferences, mode=mode, lateral=lateral, speed=motion.speed, lane=lane)
    if preferences.terminal_weight:
        end = cost_to_go(preferences, lattice, lane=lane, speed=motions[-1].speed, mode=sequence.modes[-1])
        total += preferences.terminal_weight * end
    return total
