"""Stage and terminal cost, worked by hand."""

import numpy as np
import pytest

from sumo_hmdp.decision.cost import cost_to_go, objective, stage_cost, terminal_table
from sumo_hmdp.decision.lattice import EgoLattice
from sumo_hmdp.decision.problem import ManeuverSequence, Preferences
from sumo_hmdp.domain.maneuver import Lateral, Mode

LIKES = Preferences(speed_weight=2.0, desired_speed=20.0, speed_deadband=0.5, lane_weight=0.3, goal_lane=1)


@pytest.mark.parametrize(
    ("mode", "lateral", "cost"), [(1, -1, 6), (1, 0, 5), (1, 1, 6), (0, 0, 0), (0, 1, 2), (-1, -1, 11), (-1, 0, 9)]
)
def test_published_maneuver_costs(mode, lateral, cost):
    assert stage_cost(Preferences(), mode=mode, lateral=lateral, speed=33.0, lane=2) == cost


def test_preferences_count_outside_the_dead_band_and_away_from_the_goal():
    # 2 * (|17 - 20| - 0.5) + 0.3 * |3 - 1| + cruise, keep 0
    assert stage_cost(LIKES, mode=0, lateral=0, speed=17.0, lane=3) == pytest.approx(5.6)
    assert stage_cost(LIKES, mode=0, lateral=0, speed=20.5, lane=1) == 0


def lattice(speed=13.0, steps=2, period=0.5, **changes):
    return EgoLattice(0.0, speed, period, 2.0, steps, 0.0, 90.0, **changes)


def test_cost_to_go_of_a_rollout_by_hand():
    # From lane 2, 18.8 m/s, cruising; speed steps of 1 m/s. Step 1: accelerate and left, 19.8 m/s in the band:
    # 6. Step 2: cruise, keep: 0. Then the goal mode.
    assert cost_to_go(LIKES, lattice(), lane=2, speed=18.8, mode=0) == pytest.approx(6.0)
    # From braking at 18 m/s in lane 1: cruise (0 + 2 * 1.5), accelerate to 19 (5 + 2 * 0.5), accelerate to 20 (5),
    # cruise 0.
    assert cost_to_go(LIKES, lattice(), lane=1, speed=18.0, mode=-1) == pytest.approx(3 + 6 + 5)
    # Already there.
    assert cost_to_go(LIKES, lattice(), lane=1, speed=20.2, mode=0) == 0


def test_a_band_too_narrow_to_hit_is_an_error():
    narrow = Preferences(desired_speed=20.0, speed_deadband=0.1, terminal_weight=1.0)
    with pytest.raises(ValueError, match="half a speed step"):
        cost_to_go(narrow, lattice(), lane=1, speed=19.5, mode=0)
    with pytest.raises(ValueError, match="half a speed step"):
        terminal_table(narrow, lattice(), 3)


@pytest.mark.parametrize("seed", range(40))
def test_terminal_table_holds_the_rolled_out_cost_to_go_of_every_end(seed):
    rng = np.random.default_rng(seed)
    stopping = bool(seed % 2)
    now = lattice(
        speed=float(rng.choice([0.0, 1.0, rng.uniform(0, 3), rng.uniform(5, 40)])),
        steps=int(rng.integers(1, 6)),
        period=float(rng.choice([0.4, 0.5, 0.8])),
        stopping=stopping,
    )
    likes = Preferences(
        maneuver_cost=tuple(tuple(row) for row in rng.uniform(0, 12, (3, 3)).tolist()),
        speed_weight=float(rng.uniform(0, 4)),
        desired_speed=float(rng.uniform(0, 35)),
        speed_deadband=float(now.speed_step * rng.uniform(0.5, 1.3)),
        lane_weight=float(rng.uniform(0, 1)),
        goal_lane=[None, 1, 2, 4][seed % 4],
    )
    table = terminal_table(likes, now, 4)
    assert table.shape == (4, 2 * now.steps + 1, 1 + stopping, 3)
    for lane, level, phase, mode in np.ndindex(table.shape):
        speed = now.speed_at(level - now.steps, phase)
        if speed < 0:
            continue
        rolled = cost_to_go(likes, now, lane=lane + 1, speed=speed, mode=mode - 1)
        assert table[lane, level, phase, mode] == pytest.approx(rolled, abs=1e-9)


def test_objective_sums_stages_and_terminal_cost():
    sequence = ManeuverSequence((Lateral.LEFT, Lateral.KEEP), (Mode.ACCELERATE, Mode.CRUISE))
    # Step 1: accelerate left to 20 m/s in lane 1: 6. Step 2: nothing.
    assert objective(LIKES, lattice(speed=19.0), 2, sequence) == pytest.approx(6.0)


def step_by_step(x, v, modes, period, accel, *, stopping):
    path = []
    for mode in modes:
        following = v + mode * accel * period
        if stopping and following < -1e-9:
            x, v = x + v**2 / (2 * accel), 0.0
        else:
            x, v = x + v * period + mode * accel * period**2 / 2, following
        path.append((x, v))
    return path


@pytest.mark.parametrize("speed", [11.0, 0.0, 0.8, 1.2, 2.0, 0.3])
@pytest.mark.parametrize("modes", [(1, 1, 0, -1, -1), (-1, -1, -1, 0, 1), (0, -1, -1, -1, -1), (-1, 0, 1, 0, -1)])
def test_lattice_positions_equal_a_step_by_step_motion(speed, modes):
    stopping = speed < 5
    now = EgoLattice(3.0, speed, 0.4, 1.5, 5, 0.0, 90.0, stopping=stopping)
    path = step_by_step(3.0, speed, modes, 0.4, 1.5, stopping=stopping)
    for k, (motion, (x, v)) in enumerate(zip(now.walk(modes), path, strict=True)):
        assert now.position_at(k + 1, motion.point) == pytest.approx(x, abs=1e-12)
        assert motion.speed == pytest.approx(v, abs=1e-12)
        assert now.speed_at(motion.level, motion.phase) == pytest.approx(v, abs=1e-12)
