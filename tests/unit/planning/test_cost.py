"""Stage and terminal cost, worked by hand."""

import pytest

from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.planning.cost import cost_to_go, objective, stage_cost, terminal_table
from sumo_hmdp.planning.lattice import EgoLattice
from sumo_hmdp.planning.problem import ManeuverSequence, Preferences

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


def test_cost_to_go_of_a_rollout_by_hand():
    # From lane 2, 18.8 m/s, cruising; speed steps of 1 m/s. Step 1: accelerate and left, 19.8 m/s in the band:
    # 6. Step 2: cruise, keep: 0. Then the goal mode.
    assert cost_to_go(LIKES, lane=2, speed=18.8, mode=0, speed_step=1.0) == pytest.approx(6.0)
    # From braking at 18 m/s in lane 1: cruise (0 + 2 * 1.5), accelerate to 19 (5 + 2 * 0.5), accelerate to 20 (5),
    # cruise 0.
    assert cost_to_go(LIKES, lane=1, speed=18.0, mode=-1, speed_step=1.0) == pytest.approx(3 + 6 + 5)
    # Already there.
    assert cost_to_go(LIKES, lane=1, speed=20.2, mode=0, speed_step=1.0) == 0


def test_a_band_too_narrow_to_hit_is_an_error():
    narrow = Preferences(desired_speed=20.0, speed_deadband=0.1, terminal_weight=1.0)
    with pytest.raises(ValueError, match="half a speed step"):
        cost_to_go(narrow, lane=1, speed=19.5, mode=0, speed_step=1.0)


def test_terminal_table_holds_the_cost_to_go_of_every_end():
    likes = Preferences(speed_weight=1.0, desired_speed=15.0, speed_deadband=0.6, goal_lane=2, terminal_weight=1.5)
    lattice = EgoLattice(x=0.0, speed=13.0, period=0.5, accel=2.0, steps=2, level_min=-9, level_max=9)
    table = terminal_table(likes, lattice, 3)
    assert table.shape == (3, 5, 3)
    for lane, level, mode in ((1, -2, -1), (2, 0, 0), (3, 2, 1), (2, 2, 0)):
        expected = 1.5 * cost_to_go(likes, lane=lane, speed=13.0 + level, mode=mode, speed_step=1.0)
        assert table[lane - 1, level + 2, mode + 1] == pytest.approx(expected, abs=1e-12)
    assert table[1, 4, 1] == 0


def test_objective_sums_stages_and_terminal_cost():
    lattice = EgoLattice(x=0.0, speed=19.0, period=0.5, accel=2.0, steps=2, level_min=-9, level_max=9)
    sequence = ManeuverSequence((Lateral.LEFT, Lateral.KEEP), (Mode.ACCELERATE, Mode.CRUISE))
    # Step 1: accelerate left to 20 m/s in lane 1: 6. Step 2: nothing.
    assert objective(LIKES, lattice, 2, sequence) == pytest.approx(6.0)


def test_lattice_positions_equal_a_step_by_step_motion():
    lattice = EgoLattice(x=3.0, speed=11.0, period=0.4, accel=1.5, steps=5, level_min=-9, level_max=9)
    modes = (1, 1, 0, -1, -1)
    levels, points = lattice.walk(modes)
    x, v = 3.0, 11.0
    for k, mode in enumerate(modes):
        x += v * 0.4 + mode * 1.5 * 0.4**2 / 2
        v += mode * 1.5 * 0.4
        assert lattice.position_at(k + 1, points[k]) == pytest.approx(x, abs=1e-12)
        assert lattice.speed_at(levels[k]) == pytest.approx(v, abs=1e-12)
