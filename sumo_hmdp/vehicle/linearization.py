"""The bicycle in the coordinates that are tracked, linearised (docs/formulation.md, section 12).

The state is z = (x, y of the FRONT BUMPER, heading, speed v, steering_angle s, accel a), the input u = (jerk,
steering_rate). With g = lever / wheelbase * tan(s), lever = rear_axle_to_front_bumper,

    x' = v (cos(heading) - g sin(heading))    heading' = v tan(s) / wheelbase    s' = steering_rate
    y' = v (sin(heading) + g cos(heading))    v' = a                             a' = jerk

so the steering rate acts on y through two integrations only, and what is left over, the heading, settles by
itself in forward motion. The rear axle's y would take three.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.vehicle.bicycle import BicycleParameters, BicycleState, front_bumper
from sumo_hmdp.vehicle.reference import ReferenceSamples

FloatArray = NDArray[np.float64]

X, Y, HEADING, SPEED, STEERING, ACCEL = range(6)
JERK, RATE = range(2)
STATE_SIZE, INPUT_SIZE = 6, 2
_IDENTITY = np.eye(STATE_SIZE)


@dataclass(frozen=True)
class Transitions:
    """z[k+1] = A[k] z[k] + B[k] u[k] + c[k] for the steps k = 0..N-1.

    Attributes:
        A: shape (N, 6, 6).
        B: shape (N, 6, 2).
        c: shape (N, 6).
    """

    A: FloatArray
    B: FloatArray
    c: FloatArray


def tracked_state(state: BicycleState, parameters: BicycleParameters) -> FloatArray:
    """Return z of a vehicle, shape (6,)."""
    x, y = front_bumper(state, parameters)
    return np.array([x, y, state.heading, state.speed, state.steering_angle, state.accel])


def nominal_states(
    state: BicycleState, samples: ReferenceSamples, parameters: BicycleParameters, durations: FloatArray
) -> FloatArray:
    """Return z along the reference: what the vehicle does when its front bumper follows it exactly.

    The heading starts as it is and trails the bumper's course c: with the slip p = c - heading and d the
    distance of a step in levers, p+ = p exp(-d) + (c+ - c) (1 - exp(-d)) / d (small angles, c linear in a step).

    Args:
        state: of the vehicle now.
        samples: the reference now and after each step, shape (N + 1,).
        parameters: of the vehicle.
        durations: of the steps [s], shape (N,).

    Returns:
        z, shape (N + 1, 6).
    """
    bumper_speed = samples.speed / np.cos(samples.heading)
    mean_speed = (bumper_speed[:-1] + bumper_speed[1:]) / 2
    distances = mean_speed * durations / parameters.rear_axle_to_front_bumper
    decays = np.exp(-distances)
    shares = np.divide(-np.expm1(-distances), distances, out=np.ones_like(distances), where=distances > 0)
    turns = samples.heading[1:] - samples.heading[:-1]
    gear = parameters.wheelbase / parameters.rear_axle_to_front_bumper
    max_slip = math.atan(math.tan(parameters.max_steering_angle) / gear)
    # Numbers of Python: NumPy's are slow one by one.
    slip = min(max(float(samples.heading[0]) - state.heading, -max_slip), max_slip)
    followed = [slip]
    for decay, turned in zip(decays.tolist(), (turns * shares).tolist(), strict=True):
        slip = min(max(slip * decay + turned, -max_slip), max_slip)
        followed.append(slip)
    slips = np.array(followed)
    z = np.empty((len(slips), STATE_SIZE))
    z[:, X], z[:, Y], z[:, HEADING] = samples.x, samples.y, samples.heading - slips
    z[:, SPEED], z[:, ACCEL] = bumper_speed * np.cos(slips), samples.accel
    z[:, STEERING] = np.arctan(gear * np.tan(slips))
    return z


def transitions(points: FloatArray, parameters: BicycleParameters, durations: FloatArray) -> Transitions:
    """Linearise each step at a point and integrate it exactly over its duration, the input held.

    J, the derivative of z' by z, is nilpotent (J^4 = 0), so that its matrix exponential is a cubic.

    Args:
        points: z in the middle of each step, shape (N, 6).
        parameters: of the vehicle.
        durations: of the steps [s], shape (N,).
    """
    rates, J = _derivatives(points, parameters)
    # J @ J and J @ J @ J, of which few entries are not zero.
    J2, J3 = np.zeros_like(J), np.zeros_like(J)
    J2[:, :HEADING, SPEED:ACCEL] = J[:, :HEADING, HEADING, None] * J[:, HEADING, None, SPEED:ACCEL]
    J2[:, :SPEED, ACCEL] = J[:, :SPEED, SPEED]
    J3[:, :HEADING, ACCEL] = J2[:, :HEADING, SPEED]
    h = durations[:, None, None]
    square, cube = h**2, h**3
    A = _IDENTITY + h * J + square / 2 * J2 + cube / 6 * J3  # (N, 6, 6)
    held = h * (_IDENTITY + h / 2 * J + square / 6 * J2 + cube / 24 * J3)  # (N, 6, 6), integral of exp(J t)
    B = held[:, :, [ACCEL, STEERING]]  # (N, 6, 2), as jerk drives accel, and the rate the steering angle
    c = np.einsum("kij,kj->ki", held, rates - np.einsum("kij,kj->ki", J, points))  # (N, 6)
    return Transitions(A, B, c)


def _derivatives(points: FloatArray, parameters: BicycleParameters) -> tuple[FloatArray, FloatArray]:
    """Return z' without input, shape (N, 6), and its derivative by z, shape (N, 6, 6)."""
    heading, speed, steering, accel = (points[:, i] for i in (HEADING, SPEED, STEERING, ACCEL))
    ratio = parameters.rear_axle_to_front_bumper / parameters.wheelbase
    cos, sin, tan = np.cos(heading), np.sin(heading), np.tan(steering)
    forward, sideways = cos - ratio * tan * sin, sin + ratio * tan * cos
    tan_slope = 1 + tan**2
    rates = np.zeros_like(points)
    rates[:, X], rates[:, Y] = speed * forward, speed * sideways
    rates[:, HEADING], rates[:, SPEED] = speed * tan / parameters.wheelbase, accel
    J = np.zeros((len(points), STATE_SIZE, STATE_SIZE))
    J[:, X, HEADING], J[:, X, SPEED], J[:, X, STEERING] = (
        -speed * sideways,
        forward,
        -speed * ratio * sin * tan_slope,
    )
    J[:, Y, HEADING], J[:, Y, SPEED], J[:, Y, STEERING] = (
        speed * forward,
        sideways,
        speed * ratio * cos * tan_slope,
    )
    J[:, HEADING, SPEED] = tan / parameters.wheelbase
    J[:, HEADING, STEERING] = speed * tan_slope / parameters.wheelbase
    J[:, SPEED, ACCEL] = 1.0
    return rates, J
