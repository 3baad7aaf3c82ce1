"""The bicycle against a general-purpose integrator that knows nothing of pieces and closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from sumo_hmdp.vehicle.bicycle import BicycleParameters, BicycleState, Controls, advance

PARAMETERS = BicycleParameters()


def integrate(state: BicycleState, controls: Controls, dt: float) -> np.ndarray:
    """Integrate (x, y, heading, speed, steering_angle, accel), saturation and standstill as switches of the slopes."""
    limits = PARAMETERS

    def slopes(_: float, z: np.ndarray) -> list[float]:
        _, _, heading, speed, steering, accel = z
        pushes_out = accel >= limits.max_accel if controls.jerk > 0 else accel <= -limits.max_decel
        turns_out = abs(steering) >= limits.max_steering_angle and steering * controls.steering_rate > 0
        return [
            speed * math.cos(heading),
            speed * math.sin(heading),
            speed * math.tan(steering) / limits.wheelbase,
            accel,
            0.0 if turns_out else controls.steering_rate,
            0.0 if pushes_out else controls.jerk,
        ]

    def stopped(_: float, z: np.ndarray) -> float:
        return z[3]

    stopped.terminal = True
    stopped.direction = -1
    start = [state.x, state.y, state.heading, state.speed, state.steering_angle, state.accel]
    tolerances = {"rtol": 1e-10, "atol": 1e-11, "method": "DOP853"}
    solution = solve_ivp(slopes, (0, dt), start, events=stopped, **tolerances)
    end = solution.y[:, -1]
    if solution.status == 1:
        end[3] = end[5] = 0.0
        angle = end[4] + controls.steering_rate * (dt - solution.t[-1])
        end[4] = np.clip(angle, -limits.max_steering_angle, limits.max_steering_angle)
    return end


def as_array(state: BicycleState) -> np.ndarray:
    return np.array([state.x, state.y, state.heading, state.speed, state.steering_angle, state.accel])


@pytest.mark.parametrize("dt", [0.02, 0.15, 0.2])
@settings(derandomize=True, max_examples=40, deadline=None)
@given(
    heading=st.floats(-1, 1),
    speed=st.floats(0.1, 40),
    steering=st.floats(-0.55, 0.55),
    accel=st.floats(-7.5, 2.9),
    jerk=st.floats(-20, 20),
    rate=st.floats(-0.4, 0.4),
)
def test_one_step_matches_a_fine_step_ode(dt, heading, speed, steering, accel, jerk, rate):
    state = BicycleState(3.0, -2.0, heading, speed, steering, accel)
    controls = Controls(jerk, rate)

    got = advance(state, controls, PARAMETERS, dt)

    np.testing.assert_allclose(as_array(got), integrate(state, controls, dt), atol=1e-6, rtol=0)


@pytest.mark.parametrize(
    ("state", "controls", "what"),
    [
        (BicycleState(0, 0, 0.2, 20, 0.1, 2.5), Controls(20, 0.1), "accel meets its limit"),
        (BicycleState(0, 0, 0.2, 20, 0.1, -7.5), Controls(-20, -0.1), "decel meets its limit"),
        (BicycleState(0, 0, 0.2, 6, 0.55, 0), Controls(0, 0.4), "steering meets its limit"),
        (BicycleState(0, 0, 0.2, 6, -0.55, 2.9), Controls(20, -0.4), "both meet their limits"),
        (BicycleState(0, 0, 0.2, 0.9, 0.3, -7.5), Controls(-20, 0.4), "meets the decel limit, then stops"),
        (BicycleState(0, 0, 0.2, 0.3, 0.58, -4), Controls(5, 0.4), "stops although the brakes are released"),
        (BicycleState(0, 0, 0.2, 0.1, 0.3, 0.5), Controls(-20, 0.0), "still gains speed, then stops"),
    ],
    ids=lambda value: value.replace(" ", "-") if isinstance(value, str) else "",
)
def test_a_step_with_a_switch_matches_a_fine_step_ode(state, controls, what):
    got = advance(state, controls, PARAMETERS, 0.2)

    np.testing.assert_allclose(as_array(got), integrate(state, controls, 0.2), atol=1e-6, rtol=0)


def test_the_fastest_turn_matches_a_fine_step_ode():
    state = BicycleState(0, 0, 0, 40, 0.6, 0)

    got = advance(state, Controls(0, -0.4), PARAMETERS, 0.2)

    np.testing.assert_allclose(as_array(got), integrate(state, Controls(0, -0.4), 0.2), atol=1e-6, rtol=0)
