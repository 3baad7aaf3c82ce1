"""The point that moves exactly as told, against steps worked by hand."""

import math
from dataclasses import replace

import pytest

from sumo_hmdp.vehicle.point_mass import advance, advance_as_published, change_lane, in_lane


def moved(state, accel, dt, steps):
    for _ in range(steps):
        state = advance(state, accel, dt)
    return state


def test_the_motion_is_exact():
    # 20 m/s and 2 m/s2 for half a second: 10 m and a quarter.
    state = advance(in_lane(10.0, 0.0, 20.0, lane=2), 2.0, 0.5)
    assert (state.speed, state.x, state.accel, state.y) == (21.0, 20.25, 2.0, 0.0)


def test_it_stops_within_a_step_and_stands():
    # 1 m/s, braked with 5 m/s2: 0.1 m.
    state = advance(in_lane(0.0, 4.0, 1.0, lane=1), -5.0, 0.5)
    assert (state.speed, state.x, state.accel) == (0.0, 0.1, -2.0)
    assert advance(state, -5.0, 0.5).x == 0.1


@pytest.mark.parametrize("accel", [2.0, -3.0, -8.0])
def test_halving_the_step_changes_nothing(accel):
    start = in_lane(0.0, 0.0, 5.0, lane=2)
    whole, half = moved(start, accel, 0.8, 3), moved(start, accel, 0.4, 6)
    assert (whole.x, whole.speed) == pytest.approx((half.x, half.speed), abs=1e-12)


def test_the_published_code_takes_the_speed_first_then_the_position():
    state = advance_as_published(in_lane(10.0, 0.0, 20.0, lane=2), 2.0, 0.5)
    assert (state.speed, state.x, state.accel, state.y) == (21.0, 20.5, 2.0, 0.0)
    state = advance_as_published(in_lane(0.0, 4.0, 1.0, lane=1), -5.0, 0.5)
    assert (state.speed, state.x, state.accel) == (0.0, 0.0, -2.0)
    assert advance_as_published(state, -5.0, 0.5).x == 0.0


# 10 p^3 - 15 p^4 + 6 p^5 at p = 1/4 and 1/2 is 53/512 and 1/2.
@pytest.mark.parametrize(
    ("steps", "y"), [(0, 0.0), (1, 4 * 53 / 512), (2, 2.0), (3, 4 * 459 / 512), (4, 4.0), (9, 4.0)]
)
def test_lane_change_is_the_quintic(steps, y):
    state = change_lane(in_lane(0.0, 0.0, 20.0, lane=2), 1, y_end=4.0, duration=8.0)
    state = moved(state, 0.0, 2.0, steps)
    assert state.y == pytest.approx(y, abs=1e-12)
    assert state.x == 40.0 * steps


def test_the_same_lane_again_goes_on():
    state = moved(change_lane(in_lane(0.0, 0.0, 20.0, lane=2), 1, y_end=4.0, duration=8.0), 0.0, 1.0, 3)
    assert change_lane(state, 1, y_end=4.0, duration=8.0) is state


def test_heading_is_the_course():
    state = change_lane(in_lane(0.0, 0.0, 20.0, lane=2), 1, y_end=4.0, duration=8.0)
    assert state.heading == 0.0
    middle = moved(state, 0.0, 1.0, 4)
    # dy/dt in the middle is 15/8 of the mean 0.5 m/s.
    assert middle.lateral_speed == pytest.approx(0.9375)
    assert middle.heading == pytest.approx(math.atan2(0.9375, 20.0))
    assert replace(middle, speed=0.0).heading == 1.0
    assert moved(state, 0.0, 1.0, 8).heading == 0.0


def test_an_abort_begins_without_a_jump():
    going = moved(change_lane(in_lane(0.0, 0.0, 20.0, lane=2), 1, y_end=4.0, duration=8.0), 0.0, 1.0, 3)
    back = change_lane(going, 2, y_end=0.0, duration=8.0)
    assert (back.y, back.lateral_speed) == pytest.approx((going.y, going.lateral_speed))
    h = 1e-3
    there, here = (advance(state, 0.0, h) for state in (going, back))
    # Position, slope and curvature agree, so that the two part with the third power of time.
    assert there.y == pytest.approx(here.y, abs=1e-9)
    assert moved(back, 0.0, 1.0, 8).y == pytest.approx(0.0, abs=1e-12)
