"""References: values worked by hand."""

import math

import numpy as np
import pytest

from sumo_hmdp.domain.plan import Command
from sumo_hmdp.domain.road import Road
from sumo_hmdp.vehicle.bicycle import (
    BicycleParameters,
    BicycleState,
    Controls,
    advance,
    from_front_bumper,
    front_bumper,
)
from sumo_hmdp.vehicle.reference import CRAWL_SPEED, Reference, follow, quintic, sample

PARAMETERS = BicycleParameters()
ROAD = Road(lane_count=2, lane_width=4.0)  # centres at y = 2 and -2


def begin(command: Command, speed: float, lane: int = 2, **options: float) -> Reference:
    state = from_front_bumper(100.0, ROAD.center_y(lane), 0.0, speed, PARAMETERS)
    return follow(command, state, PARAMETERS, None, road=ROAD, time=10.0, lane_change_time=4.0, **options)


def test_a_lane_change_from_rest_is_half_done_at_half_time_where_it_is_steepest():
    reference = begin(Command(lane=1, accel=0.0), speed=20.0)

    got = sample(reference, [10.0, 11.0, 12.0, 14.0, 20.0])

    # 10 / 64 - 15 / 256 + 6 / 1024 = 106 / 1024 of 4 m after a quarter of the time.
    np.testing.assert_allclose(got.y, [-2.0, -2.0 + 4 * 106 / 1024, 0.0, 2.0, 2.0], atol=1e-12)
    # The steepest slope is 15 / 8 * width / duration = 1.875 m/s.
    np.testing.assert_allclose(np.tan(got.heading) * 20, [0.0, 1.0546875, 1.875, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(got.x, [100, 120, 140, 180, 300])


def test_quintic_meets_its_boundary_values():
    curve = quintic(1.0, 0.5, -0.4, end=3.0, duration=5.0)
    tiny = 1e-4
    y, _ = curve.at([0.0, tiny, 2 * tiny, 5 - 2 * tiny, 5 - tiny, 5.0])

    assert (y[0], y[5]) == (1.0, 3.0)
    assert (y[1] - y[0]) / tiny == pytest.approx(0.5, abs=1e-4)
    assert (y[5] - y[4]) / tiny == pytest.approx(0.0, abs=1e-4)
    assert (y[2] - 2 * y[1] + y[0]) / tiny**2 == pytest.approx(-0.4, abs=1e-3)
    assert (y[5] - 2 * y[4] + y[3]) / tiny**2 == pytest.approx(0.0, abs=1e-3)


def test_braking_ends_at_rest_after_half_v_squared_over_decel():
    got = sample(begin(Command(lane=2, accel=-2.0), speed=10.0), [10.0, 12.0, 15.0, 16.0, 30.0])

    np.testing.assert_allclose(got.x, [100, 116, 125, 125, 125])
    np.testing.assert_allclose(got.speed, [10, 6, 0, 0, 0])
    np.testing.assert_allclose(got.accel, [-2, -2, 0, 0, 0])


def test_acceleration_ends_at_the_speed_limit():
    got = sample(begin(Command(lane=2, accel=2.0), speed=10.0, max_speed=14.0), [10.0, 11.0, 12.0, 13.0])

    np.testing.assert_allclose(got.x, [100, 111, 124, 138])
    np.testing.assert_allclose(got.speed, [10, 12, 14, 14])
    np.testing.assert_allclose(got.accel, [2, 2, 0, 0])


def test_a_vehicle_above_the_speed_limit_keeps_its_speed():
    got = sample(begin(Command(lane=2, accel=2.0), speed=16.0, max_speed=14.0), [10.0, 11.0])

    np.testing.assert_allclose(got.speed, [16, 16])
    np.testing.assert_allclose(got.x, [100, 116])


def test_a_vehicle_at_rest_starts_with_its_acceleration():
    got = sample(begin(Command(lane=2, accel=2.0), speed=0.0), [10.0, 11.0])

    np.testing.assert_allclose(got.accel, [2, 2])
    np.testing.assert_allclose(got.x, [100, 101])


def test_times_before_the_beginning_count_as_the_beginning():
    got = sample(begin(Command(lane=1, accel=2.0), speed=10.0), [0.0, 10.0])

    assert got.x[0] == got.x[1] == 100.0
    assert got.y[0] == got.y[1] == -2.0


def test_nobody_moves_sideways_while_standing():
    got = sample(begin(Command(lane=1, accel=0.0), speed=0.0), [10.0, 12.0, 20.0])

    np.testing.assert_array_equal(got.y, [-2, -2, -2])
    np.testing.assert_array_equal(got.heading, [0, 0, 0])


def test_at_half_the_crawl_speed_a_lane_change_takes_twice_the_time():
    got = sample(begin(Command(lane=1, accel=0.0), speed=CRAWL_SPEED / 2), [14.0, 18.0])

    np.testing.assert_allclose(got.y, [0.0, 2.0], atol=1e-12)
    assert math.tan(got.heading[0]) == pytest.approx(1.875 / CRAWL_SPEED)


def test_a_vehicle_that_stops_in_a_lane_change_stays_where_it_stopped():
    # From 5 m/s at -2.5 m/s2: at rest after 2 s and 5 m, so after 1 s of the clock, a quarter of the change.
    got = sample(begin(Command(lane=1, accel=-2.5), speed=5.0), [12.0, 20.0])

    np.testing.assert_allclose(got.y, [-2 + 4 * 106 / 1024] * 2)
    np.testing.assert_allclose(got.x, [105, 105])


def test_a_command_for_the_same_lane_goes_on_with_the_quintic_and_restarts_along_the_road():
    first = begin(Command(lane=1, accel=0.0), speed=20.0)
    state = from_front_bumper(130.5, -0.9, 0.08, 19.0, PARAMETERS)

    second = follow(Command(lane=1, accel=2.0), state, PARAMETERS, first, road=ROAD, time=11.5, lane_change_time=9.0)

    times = np.linspace(11.5, 16, 10)
    np.testing.assert_allclose(sample(second, times).y, sample(first, times).y, atol=1e-12)
    assert sample(second, 11.5).x == 130.5
    assert sample(second, 11.5).speed == pytest.approx(19 * math.cos(0.08))
    assert sample(second, 12.5).x == pytest.approx(130.5 + 19 * math.cos(0.08) + 1)


def test_an_abort_starts_from_the_present_path_and_ends_in_the_old_lane():
    first = begin(Command(lane=1, accel=0.0), speed=20.0)
    state = from_front_bumper(130.0, -1.0, 0.05, 20.0, PARAMETERS, steering_angle=0.01)
    # The path that it is on: a little drive with the steering held.
    tiny = 1e-3
    ahead = front_bumper(advance(state, Controls(0, 0), PARAMETERS, tiny), PARAMETERS)

    back = follow(Command(lane=2, accel=0.0), state, PARAMETERS, first, road=ROAD, time=11.5, lane_change_time=4.0)

    got = sample(back, [11.5, 11.5 + tiny, 15.5, 20.0])
    assert got.y[0] == pytest.approx(-1.0)
    # To second order: with another curvature y would be off by a multiple of 20 m/s * 0.07 rad/s * tiny^2 / 2 = 7e-7 m.
    assert got.y[1] == pytest.approx(ahead[1], abs=2e-8)
    np.testing.assert_allclose(got.y[2:], [-2, -2])
    assert back.lane == 2


def test_below_the_crawl_speed_an_abort_goes_on_along_the_present_path():
    state = from_front_bumper(0.0, -1.0, 0.1, 2.0, PARAMETERS, steering_angle=0.05)
    first = begin(Command(lane=1, accel=0.0), speed=2.0)
    ahead = front_bumper(advance(state, Controls(0, 0), PARAMETERS, 0.01), PARAMETERS)

    back = follow(Command(lane=2, accel=0.0), state, PARAMETERS, first, road=ROAD, time=0.0, lane_change_time=4.0)

    got = sample(back, 0.01)
    assert (got.x, got.y) == pytest.approx(ahead, abs=1e-6)


@pytest.mark.parametrize("heading", [1.57, -1.57, 3.0])
def test_a_vehicle_across_the_road_still_gets_a_finite_reference(heading):
    state = BicycleState(0.0, 0.0, heading, 3.0, 0.3)

    reference = follow(Command(lane=1, accel=0.0), state, PARAMETERS, None, road=ROAD, time=0.0, lane_change_time=4.0)

    got = sample(reference, [0.0, 1.0, 30.0])
    assert np.isfinite(got.y).all()
    assert (got.speed >= 0).all()


def test_an_abort_while_braking_keeps_the_curvature_of_the_path():
    state = from_front_bumper(0.0, -1.0, 0.1, 20.0, PARAMETERS, steering_angle=0.01, accel=-8.0)
    ahead = front_bumper(advance(state, Controls(0, 0), PARAMETERS, 0.01), PARAMETERS)

    back = follow(Command(2, -8.0), state, PARAMETERS, None, road=ROAD, time=0.0, lane_change_time=4.0)

    # Without the braking y would be off by 8 m/s2 * tan(0.1 rad) * (0.01 s)^2 / 2 = 4e-5 m.
    assert float(sample(back, 0.01).y) == pytest.approx(ahead[1], abs=1e-5)


def test_no_times_have_no_samples():
    assert sample(begin(Command(lane=2, accel=-1.0), speed=20.0), []).x.shape == (0,)
