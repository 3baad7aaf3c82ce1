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
_UNMOVED = np.eye(STATE_SIZE, INPUT_SIZE + STATE_SIZE + 1, INPUT_SIZE)  # z of (u, z, 1)


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
    losses = -np.expm1(-distances)
    shares = np.divide(losses, distances, out=np.ones_like(distances), where=distances > 0)
    turns = samples.heading[1:] - samples.heading[:-1]
    gear = parameters.wheelbase / parameters.rear_axle_to_front_bumper
    max_slip = math.atan(math.tan(parameters.max_steering_angle) / gear)
    # Numbers of Python: NumPy's are slow one by one.
    slip = min(max(float(samples.heading[0]) - state.heading, -max_slip), max_slip)
    followed = [slip]
    for loss, turned in zip(losses.tolist(), (turns * shares).tolist(), strict=True):
        slip += turned - slip * loss
        if abs(slip) > max_slip:
            slip = math.copysign(max_slip, slip)
        followed.append(slip)
    slips = np.array(followed)
    z = np.empty((len(slips), STATE_SIZE))
    z[:, X], z[:, Y], z[:, HEADING] = samples.x, samples.y, samples.heading - slips
    z[:, SPEED], z[:, ACCEL] = bumper_speed * np.cos(slips), samples.accel
    z[:, STEERING] = np.arctan(gear * np.tan(slips))
    return z


def transitions(points: FloatArray, parameters: BicycleParameters, durations: FloatArray) -> Transitions:
    """Linearise each step at a point and integrate it exactly over its duration, the input held.

    With w = (u, z, 1), z' = M w, and T what M has for z, z after a time h is z + M h w + T M h^2 w / 2 + ... As
    T^3 M has the last terms (jerk drives accel, speed, heading, x), that is the whole series.

    Args:
        points: z in the middle of each step, shape (N, 6).
        parameters: of the vehicle.
        durations: of the steps [s], shape (N,).
    """
    Mh = _derivatives(points, parameters, durations)  # (N, 6, 9)
    Th = Mh[:, :, INPUT_SIZE:-1]
    second = Th @ Mh
    third = Th @ second
    after = _UNMOVED + Mh + 0.5 * second + (1 / 6) * third + (1 / 24) * (Th @ third)
    return Transitions(after[:, :, :-1], after[:, :, -1])


def _derivatives(points: FloatArray, parameters: BicycleParameters, durations: FloatArray) -> FloatArray:
    """Return h times the matrix M of z' = M (u, z, 1) at each point, shape (N, 6, 9), h the durations."""
    heading, speed, steering = points[:, HEADING], points[:, SPEED], points[:, STEERING]
    lever, h = parameters.rear_axle_to_front_bumper, durations
    cos, sin, tan = np.cos(heading), np.sin(heading), np.tan(steering)
    gear = h / parameters.wheelbase
    turn, turn_by_steering = gear * tan, gear * speed * (1 + tan * tan)  # of the heading, by speed and steering angle
    side, swing = lever * turn, lever * turn_by_steering
    forward, sideways = h * cos - side * sin, h * sin + side * cos
    M = np.zeros((STATE_SIZE, INPUT_SIZE + STATE_SIZE + 1, len(points)))
    by_input, by_state, constant = M[:, :INPUT_SIZE], M[:, INPUT_SIZE:], M[:, -1]
    by_state[X, HEADING], by_state[X, SPEED], by_state[X, STEERING] = -speed * sideways, forward, -swing * sin
    by_state[Y, HEADING], by_state[Y, SPEED], by_state[Y, STEERING] = speed * forward, sideways, swing * cos
    by_state[HEADING, SPEED], by_state[HEADING, STEERING] = turn, turn_by_steering
    by_state[SPEED, ACCEL] = by_input[STEERING, RATE] = by_input[ACCEL, JERK] = h
    # z' is linear in speed and accel, so nothing is left of it but what heading and steering angle add.
    constant[:SPEED] = -by_state[:SPEED, HEADING] * heading - by_state[:SPEED, STEERING] * steering
    return np.ascontiguousarray(M.transpose(2, 0, 1))
