"""Stage cost and terminal cost (docs/formulation.md, eqs. 12 and 13)."""

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.planning.lattice import EgoLattice
from sumo_hmdp.planning.problem import SPEED_TOLERANCE, ManeuverSequence, Preferences

# The baseline policy needs one step per speed level and lane; a rollout that takes longer than this never ends.
MAX_ROLLOUT_STEPS = 100_000


def speed_cost(preferences: Preferences, speed: float) -> float:
    """Return speed_weight * max(0, |v - v_des| - deadband) for a speed [m/s]."""
    excess = abs(speed - preferences.desired_speed) - preferences.speed_deadband
    return preferences.speed_weight * excess if excess > SPEED_TOLERANCE else 0.0


def lane_cost(preferences: Preferences, lane: int) -> float:
    """Return lane_weight * |lane - goal_lane|, 0 without a goal lane."""
    return 0.0 if preferences.goal_lane is None else preferences.lane_weight * abs(lane - preferences.goal_lane)


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


def cost_to_go(preferences: Preferences, *, lane: int, speed: float, mode: int, speed_step: float) -> float:
    """Return the cost of the baseline policy until the goal mode, without traffic (docs/formulation.md, eq. 13).

    Args:
        preferences: with a dead band of at least half a speed step, else the goal may never be reached.
        lane: to start from.
        speed: to start from [m/s].
        mode: to start from.
        speed_step: accel * T [m/s].

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
        speed += mode * speed_step
        total += stage_cost(preferences, mode=mode, lateral=lateral, speed=speed, lane=lane)
    raise ValueError("the baseline policy must reach the goal mode: the dead band is under half a speed step")


def terminal_table(preferences: Preferences, lattice: EgoLattice, lane_count: int) -> NDArray[np.float64]:
    """Tabulate terminal_weight * J_H over all ends of the horizon.

    Returns:
        Shape (lanes, 2 H + 1, 3): lane - 1, level n + H, mode + 1; all zero with a terminal weight of 0.
    """
    H = lattice.steps
    table = np.zeros((lane_count, 2 * H + 1, 3))
    if preferences.terminal_weight == 0:
        return table
    speed_step = lattice.accel * lattice.period
    for lane in range(1, lane_count + 1):
        for level in range(-H, H + 1):
            for mode in (-1, 0, 1):
                table[lane - 1, level + H, mode + 1] = preferences.terminal_weight * cost_to_go(
                    preferences, lane=lane, speed=lattice.speed_at(level), mode=mode, speed_step=speed_step
                )
    return table


def objective(preferences: Preferences, lattice: EgoLattice, start_lane: int, sequence: ManeuverSequence) -> float:
    """Return the whole cost of a sequence of maneuvers."""
    levels, _ = lattice.walk(tuple(int(mode) for mode in sequence.modes))
    total, lane = 0.0, start_lane
    for lateral, mode, level in zip(sequence.laterals, sequence.modes, levels, strict=True):
        lane += lateral
        total += stage_cost(preferences, mode=mode, lateral=lateral, speed=lattice.speed_at(level), lane=lane)
    if preferences.terminal_weight:
        total += preferences.terminal_weight * cost_to_go(
            preferences,
            lane=lane,
            speed=lattice.speed_at(levels[-1]),
            mode=sequence.modes[-1],
            speed_step=lattice.accel * lattice.period,
        )
    return total
