"""The tracker in closed loop with the bicycle, and its promises to who replays it."""

import numpy as np
import pytest

from sumo_hmdp.domain.plan import Command
from sumo_hmdp.domain.road import Road
from sumo_hmdp.errors import InputError
from sumo_hmdp.vehicle.bicycle import BicycleParameters, BicycleState, advance, from_front_bumper, front_bumper
from sumo_hmdp.vehicle.reference import follow
from sumo_hmdp.vehicle.tracking import TrackingMpc, TrackingWeights, safe_controls

PARAMETERS = BicycleParameters()
ROAD = Road(lane_count=2, lane_width=4.0)
STEP_SIZES = [0.02, 0.15, 0.2]


def always(lane: int, accel: float = 0.0):
    return lambda _: Command(lane, accel)


def assert_within_limits(result):
    assert result.solved.all()
    assert (result.speed >= 0).all()
    assert (result.accel <= 3 + 1e-9).all()
    assert (result.accel >= -8 - 1e-9).all()
    assert (np.abs(result.steering_angle) <= 0.6 + 1e-9).all()
    assert (np.abs(result.jerk) <= 20).all()
    assert (np.abs(result.steering_rate) <= 0.4).all()


@pytest.mark.parametrize("dt", STEP_SIZES)
def test_one_period_of_2_mps2_gains_1_2_mps_and_then_it_cruises(drive, dt):
    result = drive(lambda time: Command(2, 2.0 if time < 0.6 else 0.0), speed=20.0, dt=dt, duration=3.0)

    assert_within_limits(result)
    after_a_period = round(0.6 / dt) - 1
    assert result.speed[after_a_period] == pytest.approx(21.2, abs=0.07)
    assert result.speed[-1] == pytest.approx(21.2, abs=0.01)
    assert np.abs(result.x_error).max() < 0.1
    assert np.abs(result.accel).max() < 2.6
    np.testing.assert_allclose(result.y, -2.0, atol=1e-6)


@pytest.mark.parametrize(
    ("speed", "dt", "lane_change_time"),
    [(30.0, 0.15, 8.0), (10.0, 0.02, 4.0), (10.0, 0.2, 4.0), (40.0, 0.2, 4.0), (6.0, 0.15, 4.0)],
)
def test_a_lane_change_is_on_the_quintic_and_does_not_overshoot(drive, speed, dt, lane_change_time):
    result = drive(always(1), speed=speed, dt=dt, duration=lane_change_time + 3, lane_change_time=lane_change_time)

    assert_within_limits(result)
    assert np.abs(result.y_error).max() < 0.01
    assert np.interp(lane_change_time / 2, result.time, result.y) == pytest.approx(0.0, abs=0.02)
    assert result.y.max() < 2.01
    assert result.y[-1] == pytest.approx(2.0, abs=1e-3)
    assert np.abs(result.x_error).max() < 0.05
    assert result.speed[-1] == pytest.approx(speed, abs=0.05)


@pytest.mark.parametrize("dt", STEP_SIZES)
def test_an_aborted_lane_change_returns_without_a_kink(drive, dt):
    result = drive(lambda time: Command(1 if time < 1.8 else 2, 0.0), speed=15.0, dt=dt, duration=8.0)

    assert_within_limits(result)
    assert result.y.max() > -1.0
    assert result.y.max() < 2.0
    assert np.abs(result.y_error).max() < 0.01
    assert result.y[-1] == pytest.approx(-2.0, abs=0.01)


@pytest.mark.parametrize("dt", STEP_SIZES)
def test_it_brakes_to_rest_and_stands(drive, dt):
    result = drive(always(2, -2.0), speed=10.0, dt=dt, duration=8.0)

    assert_within_limits(result)
    # v^2 / 2a, and what the brakes lose while they build up, 2 m/s2 within 0.1 s at the earliest: 0.1 m/s for 5 s.
    assert 25.0 <= result.x[-1] < 25.5
    standing = result.time > 6.5
    np.testing.assert_array_equal(result.speed[standing], 0.0)
    np.testing.assert_array_equal(result.jerk[standing], 0.0)
    np.testing.assert_array_equal(result.steering_rate[standing], 0.0)


@pytest.mark.parametrize("dt", STEP_SIZES)
def test_a_standing_vehicle_is_left_alone(drive, dt):
    result = drive(always(1), speed=0.0, dt=dt, duration=1.2)

    np.testing.assert_array_equal(result.x, 0.0)
    np.testing.assert_array_equal(result.y, -2.0)
    np.testing.assert_array_equal(result.steering_angle, 0.0)


@pytest.mark.parametrize("dt", STEP_SIZES)
def test_an_emergency_stop_is_as_hard_as_the_brakes_allow(drive, dt):
    result = drive(always(2, -8.0), speed=30.0, dt=dt, duration=5.4)

    assert_within_limits(result)
    # Full jerk for 0.4 s: 11.7867 m, then 28.4 m/s at 8 m/s2: 50.41 m. The release at the end costs some decimetres.
    hardest = 30 * 0.4 - 20 * 0.4**3 / 6 + 28.4**2 / 16
    assert hardest <= result.x[-1] < hardest + 0.3
    assert result.accel.min() == pytest.approx(-8.0, abs=1e-3)
    assert result.speed[-1] == 0.0


def test_a_command_beyond_the_limits_is_followed_as_far_as_they_allow(drive):
    result = drive(always(2, 9.0), speed=10.0, dt=0.15, duration=3.0)

    assert_within_limits(result)
    # 0.15 s to build up 3 m/s2.
    assert result.speed[-1] == pytest.approx(10 + 3.0 * (3 - 0.075), abs=0.01)


@pytest.mark.parametrize("dt", STEP_SIZES)
def test_an_emergency_stop_in_a_lane_change_stays_on_its_path(drive, dt):
    result = drive(lambda time: Command(1, 0.0 if time < 1.8 else -8.0), speed=10.0, dt=dt, duration=6.0)

    assert_within_limits(result)
    assert np.abs(result.y_error).max() < 0.05
    assert np.abs(result.heading).max() < 0.3
    assert result.speed[-1] == 0.0


@pytest.mark.parametrize("dt", STEP_SIZES)
def test_a_lane_change_from_rest(drive, dt):
    result = drive(always(1, 2.0), speed=0.0, dt=dt, duration=9.0)

    assert_within_limits(result)
    assert np.abs(result.y_error).max() < 0.02
    assert np.abs(result.heading).max() < 0.35
    assert result.y[-1] == pytest.approx(2.0, abs=1e-3)


@pytest.mark.parametrize("dt", STEP_SIZES)
def test_commands_that_flip_every_period_leave_the_errors_bounded(drive, dt):
    def flipping(time: float) -> Command:
        odd = round(time / 0.6) % 2
        return Command(2 - odd, 2.0 if odd else -2.0)

    result = drive(flipping, speed=15.0, dt=dt, duration=9.0)

    assert_within_limits(result)
    assert np.abs(result.y_error).max() < 0.02
    assert np.abs(result.x_error).max() < 0.5
    assert np.abs(result.heading).max() < 0.15
    assert np.abs(result.accel).max() < 4.5


@pytest.mark.parametrize("dt", STEP_SIZES)
@pytest.mark.parametrize("speed", [1.0, 5.0, 15.0, 40.0])
def test_a_vehicle_set_beside_its_reference_returns_to_it(speed, dt):
    tracker = TrackingMpc(PARAMETERS, TrackingWeights(), 15, dt)
    on_it = from_front_bumper(0.0, -2.0, 0.0, speed, PARAMETERS)
    reference = follow(Command(2, 0.0), on_it, PARAMETERS, None, road=ROAD, time=0.0, lane_change_time=4.0)
    state, offsets = from_front_bumper(0.0, -1.0, 0.1, speed, PARAMETERS), []
    for step in range(round(10 / dt)):
        controls, _ = tracker.control(state, reference, step * dt)
        state = advance(state, controls, PARAMETERS, dt)
        offsets.append(front_bumper(state, PARAMETERS)[1] + 2)

    assert min(offsets) > -0.3
    assert max(offsets) < 1.6
    assert offsets[-1] == pytest.approx(0.0, abs=0.01)


def situation(seed: int):
    rng = np.random.default_rng(seed)
    speed, lane, accel = rng.uniform(0, 30), int(rng.integers(1, 3)), float(rng.choice([-8.0, -2.0, 0.0, 2.0]))
    state = from_front_bumper(
        rng.uniform(0, 500), rng.uniform(-2, 2), rng.uniform(-0.1, 0.1), speed, PARAMETERS, accel=rng.uniform(-3, 2)
    )
    return state, follow(Command(lane, accel), state, PARAMETERS, None, road=ROAD, time=0.0, lane_change_time=4.0)


@pytest.mark.parametrize("seed", range(4))
def test_the_same_call_answers_the_same_to_the_bit_whatever_happened_in_between(seed):
    tracker = TrackingMpc(PARAMETERS, TrackingWeights(), 15, 0.15)
    state, reference = situation(seed)
    controls, info = tracker.control(state, reference, 0.3)
    for other in range(4, 14):
        tracker.control(*situation(other), 0.1)
    broken = BicycleState(0.0, 0.0, 0.0, 10.0, steering_angle=1.5)
    assert not tracker.control(broken, reference, 0.0)[1].solved

    again = tracker.control(state, reference, 0.3)
    fresh = TrackingMpc(PARAMETERS, TrackingWeights(), 15, 0.15).control(state, reference, 0.3)

    assert (controls, info) == again == fresh


def test_only_a_limit_that_is_met_needs_the_solver():
    tracker = TrackingMpc(PARAMETERS, TrackingWeights(), 15, 0.15)
    state = from_front_bumper(0.0, -2.0, 0.0, 20.0, PARAMETERS)

    def iterations(accel: float) -> int:
        reference = follow(Command(2, accel), state, PARAMETERS, None, road=ROAD, time=0.0, lane_change_time=4.0)
        return tracker.control(state, reference, 0.0)[1].iterations

    assert iterations(2.0) == 0
    assert iterations(9.0) > 0  # beyond 3 m/s2


def test_a_program_without_solution_is_reported_and_answered_by_safe_controls():
    tracker = TrackingMpc(PARAMETERS, TrackingWeights(), 15, 0.15)
    _, reference = situation(0)
    beyond = BicycleState(0.0, 0.0, 0.0, 10.0, steering_angle=1.5, accel=2.0)

    controls, info = tracker.control(beyond, reference, 0.0)

    assert not info.solved
    assert "infeasible" in info.status
    assert controls.jerk <= -2.0 / 0.15 + 1e-9
    assert controls.steering_rate == -0.4


def test_a_solver_that_gives_up_is_reported():
    tracker = TrackingMpc(PARAMETERS, TrackingWeights(), 15, 0.15, max_iterations=1)

    _, info = tracker.control(*situation(0), 0.0)

    assert not info.solved
    assert info.status == "max iter reached"


def test_safe_controls_brake_with_the_reference_but_do_not_accelerate_with_it():
    state = BicycleState(0.0, 0.0, 0.0, 10.0, steering_angle=0.1, accel=1.0)

    braking = safe_controls(state, -1.0, 0.13, PARAMETERS, 0.2)
    coasting = safe_controls(state, 2.0, 0.1, PARAMETERS, 0.2)
    hardest = safe_controls(state, -20.0, -2.0, PARAMETERS, 0.2)

    assert (braking.jerk, braking.steering_rate) == pytest.approx((-10.0, 0.15))
    assert (coasting.jerk, coasting.steering_rate) == pytest.approx((-5.0, 0.0))
    assert (hardest.jerk, hardest.steering_rate) == (-20.0, -0.4)


def test_the_errors_are_those_of_the_front_bumper_now():
    tracker = TrackingMpc(PARAMETERS, TrackingWeights(), 15, 0.15)
    on_it = from_front_bumper(50.0, -2.0, 0.0, 10.0, PARAMETERS)
    reference = follow(Command(2, 0.0), on_it, PARAMETERS, None, road=ROAD, time=0.0, lane_change_time=4.0)
    beside = from_front_bumper(53.0, -1.5, 0.0, 10.0, PARAMETERS)

    _, info = tracker.control(beside, reference, 0.2)

    assert (info.x_error, info.y_error) == pytest.approx((1.0, 0.5))


def test_all_mistakes_of_a_set_up_are_listed():
    with pytest.raises(InputError, match=r"horizon_steps(?s:.*)dt(?s:.*)jerk"):
        TrackingMpc(PARAMETERS, TrackingWeights(jerk=0.0), 0, -0.1)
