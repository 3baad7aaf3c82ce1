"""The bicycle: closed forms that a student can check on paper."""

import math

import pytest

from sumo_hmdp.vehicle.bicycle import (
    BicycleParameters,
    BicycleState,
    Controls,
    advance,
    from_front_bumper,
    front_bumper,
    front_bumper_velocity,
)

PARAMETERS = BicycleParameters()
COAST = Controls(0.0, 0.0)


def test_the_default_car_is_4_5_m_long():
    assert PARAMETERS.length == pytest.approx(4.5)


def test_front_bumper_is_3_6_m_ahead_of_the_rear_axle_along_the_heading():
    x, y = front_bumper(BicycleState(10.0, 1.0, math.pi / 6, 5.0), PARAMETERS)

    assert (x, y) == pytest.approx((10 + 3.6 * math.sqrt(3) / 2, 1 + 1.8))


def test_from_front_bumper_is_the_inverse():
    state = from_front_bumper(7.0, -2.0, 0.3, 12.0, PARAMETERS, steering_angle=0.1, accel=-1.0)

    assert front_bumper(state, PARAMETERS) == pytest.approx((7.0, -2.0))
    assert (state.heading, state.speed, state.steering_angle, state.accel) == (0.3, 12.0, 0.1, -1.0)


def test_front_bumper_velocity_is_what_the_front_bumper_does():
    state = BicycleState(0.0, 0.0, 0.2, 8.0, 0.15)
    tiny = 1e-6
    before, after = front_bumper(state, PARAMETERS), front_bumper(advance(state, COAST, PARAMETERS, tiny), PARAMETERS)

    velocity = front_bumper_velocity(state, PARAMETERS)

    assert velocity == pytest.approx(((after[0] - before[0]) / tiny, (after[1] - before[1]) / tiny), abs=1e-4)


def test_with_steering_held_the_rear_axle_drives_a_circle_of_radius_wheelbase_over_tan():
    steering = math.atan(0.27)  # radius 10 m
    quarter = 10 * math.pi / 2

    state = BicycleState(0.0, 0.0, 0.0, quarter, steering)
    for _ in range(10):
        state = advance(state, COAST, PARAMETERS, 0.1)

    assert (state.x, state.y, state.heading) == pytest.approx((10.0, 10.0, math.pi / 2), abs=1e-5)


def test_braking_from_4_mps_at_8_mps2_takes_1_m_and_half_a_second_then_it_stands():
    state = BicycleState(0.0, 0.0, 0.0, 4.0, accel=-8.0)
    for _ in range(5):
        state = advance(state, COAST, PARAMETERS, 0.15)

    assert state.x == pytest.approx(1.0, abs=1e-12)
    assert state.speed == 0.0
    assert state.accel == 0.0


@pytest.mark.parametrize("jerk", [-20.0, 0.0])
def test_a_standing_vehicle_does_not_roll_back(jerk):
    standing = BicycleState(5.0, 1.0, 0.1, 0.0, accel=-3.0)

    after = advance(standing, Controls(jerk, 0.0), PARAMETERS, 0.2)

    assert (after.x, after.y, after.speed, after.accel) == (5.0, 1.0, 0.0, 0.0)


def test_a_vehicle_that_stops_within_a_step_stands_for_the_rest_of_it():
    # 0.1 m/s at -1 m/s2 stop after 0.1 s, or a little later as the brakes are released; then jerk would move it on.
    after = advance(BicycleState(0.0, 0.0, 0.0, 0.1, accel=-1.0), Controls(4.0, 0.0), PARAMETERS, 0.2)

    assert after.speed == 0.0
    assert after.accel == 0.0


def test_a_vehicle_starts_from_rest_with_the_jerk():
    after = advance(BicycleState(0.0, 0.0, 0.0, 0.0), Controls(10.0, 0.0), PARAMETERS, 0.2)

    assert (after.x, after.speed, after.accel) == pytest.approx((10 * 0.2**3 / 6, 10 * 0.2**2 / 2, 2.0))


def test_wheels_can_be_turned_while_standing():
    after = advance(BicycleState(0.0, 0.0, 0.0, 0.0), Controls(0.0, 0.4), PARAMETERS, 0.2)

    assert after.steering_angle == pytest.approx(0.08)
    assert after.heading == 0.0


@pytest.mark.parametrize(("jerk", "limit"), [(100.0, 3.0), (-100.0, -8.0)])
def test_accel_stays_on_its_limit(jerk, limit):
    state = BicycleState(0.0, 0.0, 0.0, 30.0)
    for _ in range(4):
        state = advance(state, Controls(jerk, 0.0), PARAMETERS, 0.2)

    assert state.accel == limit


@pytest.mark.parametrize("side", [1, -1])
def test_steering_stays_on_its_limit_and_no_rate_is_faster_than_its_own(side):
    state = advance(BicycleState(0.0, 0.0, 0.0, 1.0), Controls(0.0, side * 9.0), PARAMETERS, 0.5)
    assert state.steering_angle == pytest.approx(side * 0.2)

    for _ in range(3):
        state = advance(state, Controls(0.0, side * 9.0), PARAMETERS, 0.5)
    assert state.steering_angle == side * 0.6


def test_jerk_is_clipped_to_its_limit():
    after = advance(BicycleState(0.0, 0.0, 0.0, 10.0), Controls(100.0, 0.0), PARAMETERS, 0.1)

    assert after.accel == pytest.approx(2.0)


def test_no_time_changes_nothing():
    state = BicycleState(1.0, 2.0, 0.3, 4.0, 0.1, -1.0)

    assert advance(state, Controls(5.0, 0.1), PARAMETERS, 0.0) == state
