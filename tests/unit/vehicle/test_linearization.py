"""The linearised bicycle against the bicycle."""

import math

import numpy as np
import pytest

from sumo_hmdp.vehicle.bicycle import BicycleParameters, BicycleState, Controls, advance
from sumo_hmdp.vehicle.linearization import nominal_states, tracked_state, transitions
from sumo_hmdp.vehicle.reference import ReferenceSamples

PARAMETERS = BicycleParameters()
STATES = [
    BicycleState(0.0, 0.0, 0.0, 30.0, 0.0, 0.0),
    BicycleState(4.0, -1.0, 0.2, 12.0, 0.05, -2.0),
    BicycleState(4.0, -1.0, -0.4, 3.0, -0.3, 2.0),
    BicycleState(4.0, -1.0, 0.3, 0.0, 0.2, 0.0),
]


def one_step(state: BicycleState, controls: Controls, point: np.ndarray, dt: float) -> np.ndarray:
    step = transitions(point[None, :], PARAMETERS, np.array([dt]))
    inputs = np.array([controls.jerk, controls.steering_rate])
    return step.F[0] @ np.concatenate([inputs, tracked_state(state, PARAMETERS)]) + step.c[0]


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("controls", [Controls(0.0, 0.0), Controls(5.0, 0.1), Controls(2.0, -0.2)])
def test_a_step_is_the_bicycle_s_up_to_third_order_in_its_duration(state, controls):
    def error(dt: float) -> float:
        middle = tracked_state(advance(state, controls, PARAMETERS, dt / 2), PARAMETERS)
        exact = tracked_state(advance(state, controls, PARAMETERS, dt), PARAMETERS)
        return float(np.abs(one_step(state, controls, middle, dt) - exact).max())

    coarse, fine = error(0.1), error(0.05)

    assert coarse < 5e-3
    assert fine < coarse / 6 + 1e-9


@pytest.mark.parametrize("state", STATES)
def test_the_derivatives_are_those_of_the_bicycle(state):
    dt, tiny = 1e-3, 1e-5
    z = tracked_state(state, PARAMETERS)
    step = transitions(z[None, :], PARAMETERS, np.array([dt]))

    def bumper_after(column: int, change: float) -> np.ndarray:
        values = [state.x, state.y, state.heading, state.speed, state.steering_angle, state.accel]
        moved = np.array(values)
        moved[column] += change
        if column == 2:  # the heading turns about the front bumper, which is what z holds
            moved[0] = z[0] - 3.6 * math.cos(moved[2])
            moved[1] = z[1] - 3.6 * math.sin(moved[2])
        return tracked_state(advance(BicycleState(*moved), Controls(0, 0), PARAMETERS, dt), PARAMETERS)

    columns = range(6) if state.speed > 0 else (0, 1, 2, 4)
    for column in columns:
        numeric = (bumper_after(column, tiny) - bumper_after(column, -tiny)) / (2 * tiny)
        np.testing.assert_allclose(step.F[0][:, 2 + column], numeric, atol=2e-5)


def test_the_heading_trails_the_bumper_like_a_trailer_its_hitch():
    # A gentle lane change at 15 m/s, the trailer's equation integrated with steps of 0.1 ms.
    fine = np.linspace(0, 4, 40001)
    course = 0.08 * np.sin(np.pi * fine / 4) ** 2
    heading = np.zeros_like(fine)
    bumper_speed = 15 / np.cos(course)
    for k in range(len(fine) - 1):
        heading[k + 1] = heading[k] + 1e-4 * bumper_speed[k] * math.sin(course[k] - heading[k]) / 3.6
    pick = slice(None, None, 1000)
    steps = len(fine[pick])
    samples = ReferenceSamples(15 * fine[pick], np.zeros(steps), course[pick], np.full(steps, 15.0), np.zeros(steps))

    got = nominal_states(BicycleState(0, 0, 0, 15), samples, PARAMETERS, np.full(steps - 1, 0.1))

    np.testing.assert_allclose(got[:, 2], heading[pick], atol=2e-4)
    np.testing.assert_allclose(got[:, 4], np.arctan(0.75 * np.tan(course - heading))[pick], atol=2e-4)


def test_at_rest_the_heading_stays():
    samples = ReferenceSamples(np.zeros(4), np.zeros(4), np.full(4, 0.1), np.zeros(4), np.zeros(4))

    got = nominal_states(BicycleState(0, 0, 0.05, 0), samples, PARAMETERS, np.full(3, 0.2))

    np.testing.assert_allclose(got[:, 2], 0.05)


@pytest.mark.parametrize("side", [1, -1])
def test_a_course_across_the_road_asks_for_no_more_than_the_steering_limit(side):
    samples = ReferenceSamples(np.zeros(4), np.zeros(4), np.full(4, side * 1.2), np.full(4, 1.0), np.zeros(4))

    got = nominal_states(BicycleState(0, 0, 0, 1), samples, PARAMETERS, np.full(3, 0.1))

    assert got[0, 4] == pytest.approx(side * PARAMETERS.max_steering_angle)
    assert (np.abs(got[:, 4]) <= PARAMETERS.max_steering_angle + 1e-12).all()
