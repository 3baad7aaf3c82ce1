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


@dataclass(frozen=True)
class Transitions:
    """z[k+1] = B[k] u[k] + A[k] z[k] + c[k] for the steps k = 0..N-1.

    Attributes:
        F: [B A], which multiplies (u, z), shape (N, 6, 8).
        c: shape (N, 6).
    """

    F: FloatArray
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
    """Linearise each step at a point and integrate it exactly over its duration h, the input held.

    J, the derivative of z' by z, is nilpotent (J^4 = 0), so exp(J h), which is A, and its integral, which gives B and
    c, are polynomials in h; their entries are written out below. x and y are the parts of one complex number.

    Args:
        points: z in the middle of each step, shape (N, 6).
        parameters: of the vehicle.
        durations: of the steps [s], shape (N,).
    """
    heading, speed, steering = points[:, HEADING], points[:, SPEED], points[:, STEERING]
    lever, tan = parameters.rear_axle_to_front_bumper, np.tan(steering)
    # Derivatives of heading', then of x' + i y'.
    turn_by_speed = tan / parameters.wheelbase
    turn_by_steering = speed * (1 + tan**2) / parameters.wheelbase
    sideways = 1j * np.exp(1j * heading)  # where the bumper goes when the vehicle turns
    by_speed = sideways * (lever * turn_by_speed - 1j)
    by_heading = 1j * speed * by_speed
    by_steering = lever * turn_by_steering * sideways
    # Their entries of J^2.
    by_speed_twice, by_steering_twice = by_heading * turn_by_speed, by_heading * turn_by_steering

    h, square, cube = durations, durations**2 / 2, durations**3 / 6
    jerk, rate, state = JERK, RATE, INPUT_SIZE
    xy = np.zeros((len(points), INPUT_SIZE + STATE_SIZE), dtype=np.complex128)
    xy[:, state + X], xy[:, state + Y] = 1.0, 1j
    xy[:, state + HEADING] = h * by_heading
    xy[:, state + SPEED] = h * by_speed + square * by_speed_twice
    xy[:, state + STEERING] = h * by_steering + square * by_steering_twice
    xy[:, state + ACCEL] = square * by_speed + cube * by_speed_twice
    xy[:, jerk] = cube * (by_speed + h / 4 * by_speed_twice)
    xy[:, rate] = square * by_steering + cube * by_steering_twice
    F = np.zeros((len(points), STATE_SIZE, INPUT_SIZE + STATE_SIZE))
    F[:, X], F[:, Y] = xy.real, xy.imag
    F[:, HEADING, state + HEADING] = 1.0
    F[:, HEADING, state + SPEED], F[:, HEADING, state + STEERING] = h * turn_by_speed, h * turn_by_steering
    F[:, HEADING, state + ACCEL] = square * turn_by_speed
    F[:, HEADING, jerk], F[:, HEADING, rate] = cube * turn_by_speed, square * turn_by_steering
    F[:, SPEED, state + SPEED], F[:, SPEED, state + ACCEL], F[:, SPEED, jerk] = 1.0, h, square
    F[:, STEERING, state + STEERING], F[:, STEERING, rate] = 1.0, h
    F[:, ACCEL, state + ACCEL], F[:, ACCEL, jerk] = 1.0, h

    # z' - J z at the points, which is linear in speed and accel already.
    turn = -turn_by_steering * steering
    c_xy = h * (-by_heading * heading - by_steering * steering) + square * by_heading * turn
    c = np.zeros(points.shape)
    c[:, X], c[:, Y], c[:, HEADING] = c_xy.real, c_xy.imag, h * turn
    return Transitions(F, c)
