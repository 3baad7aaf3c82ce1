"""The nonlinear kinematic bicycle, with actuators that saturate (docs/formulation.md, eq. 19).

With the state (x, y, heading, speed v, steering_angle s, accel a) and the controls (jerk j, steering_rate r):

    x' = v cos(heading)    heading' = v tan(s) / wheelbase    a' = j
    y' = v sin(heading)    v' = a                             s' = r

x runs along the road, y to its left; heading and steering_angle count counter-clockwise. Tyres do not slip.
"""

import math
from dataclasses import dataclass, replace

# RK4 with these sub-steps stays below 1e-6 m and rad over 0.2 s, up to 40 m/s at full lock.
MAX_SUBSTEP = 0.02
MAX_TURN_PER_SUBSTEP = 0.05


@dataclass(frozen=True)
class BicycleParameters:
    """Size and limits of a passenger car.

    The steering limits are typical of a mid-size car: 0.6 rad at the wheels gives a turning circle of about
    10 m, and 0.4 rad/s is the rate limit of the CommonRoad vehicle models (Althoff, Koschi, Manzinger, 2017).
    The jerk limit is that of a hydraulic brake in an emergency, so of the actuators and not of comfort:
    8 m/s2 build up in 0.4 s, and the 2 m/s2 of a maneuver in 0.1 s, a sixth of a decision period of 0.6 s.

    Attributes:
        wheelbase: rear to front axle [m].
        front_overhang: front axle to front bumper [m].
        rear_overhang: rear bumper to rear axle [m].
        width: [m].
        max_accel: [m/s2], > 0.
        max_decel: [m/s2], a positive magnitude.
        max_jerk: magnitude of the change of acceleration [m/s3].
        max_steering_angle: at the front wheels, to either side [rad], < pi / 2.
        max_steering_rate: to either side [rad/s].
    """

    wheelbase: float = 2.7
    front_overhang: float = 0.9
    rear_overhang: float = 0.9
    width: float = 1.8
    max_accel: float = 3.0
    max_decel: float = 8.0
    max_jerk: float = 20.0
    max_steering_angle: float = 0.6
    max_steering_rate: float = 0.4

    @property
    def length(self) -> float:
        """Bumper to bumper [m]."""
        return self.rear_overhang + self.wheelbase + self.front_overhang

    @property
    def rear_axle_to_front_bumper(self) -> float:
        """Distance from the rear axle to the front bumper [m]."""
        return self.wheelbase + self.front_overhang


@dataclass(frozen=True)
class BicycleState:
    """The vehicle at one instant; (x, y) is the centre of its REAR AXLE.

    Attributes:
        x: rear axle along the road [m].
        y: rear axle across the road, to the left [m].
        heading: from the road's direction [rad].
        speed: of the rear axle, along the heading [m/s], >= 0.
        steering_angle: of the front wheels [rad].
        accel: along the heading [m/s2].
    """

    x: float
    y: float
    heading: float
    speed: float
    steering_angle: float = 0.0
    accel: float = 0.0


@dataclass(frozen=True)
class Controls:
    """What the tracker sets, held over one step.

    Attributes:
        jerk: [m/s3].
        steering_rate: [rad/s].
    """

    jerk: float
    steering_rate: float


def front_bumper(state: BicycleState, parameters: BicycleParameters) -> tuple[float, float]:
    """Return (x, y) of the centre of the front bumper [m]."""
    lever = parameters.rear_axle_to_front_bumper
    return state.x + lever * math.cos(state.heading), state.y + lever * math.sin(state.heading)


def front_bumper_velocity(state: BicycleState, parameters: BicycleParameters) -> tuple[float, float]:
    """Return (dx/dt, dy/dt) of the front bumper [m/s]: the rear axle's plus heading' times the lever."""
    turn_rate = state.speed * math.tan(state.steering_angle) / parameters.wheelbase
    across = turn_rate * parameters.rear_axle_to_front_bumper
    cos, sin = math.cos(state.heading), math.sin(state.heading)
    return state.speed * cos - across * sin, state.speed * sin + across * cos


def from_front_bumper(
    x: float,
    y: float,
    heading: float,
    speed: float,
    parameters: BicycleParameters,
    *,
    steering_angle: float = 0.0,
    accel: float = 0.0,
) -> BicycleState:
    """Return the state whose front bumper is at (x, y) [m]: the inverse of `front_bumper`."""
    lever = parameters.rear_axle_to_front_bumper
    rear_x, rear_y = x - lever * math.cos(heading), y - lever * math.sin(heading)
    return BicycleState(rear_x, rear_y, heading, speed, steering_angle, accel)


def advance(state: BicycleState, controls: Controls, parameters: BicycleParameters, dt: float) -> BicycleState:
    """Move the vehicle by dt seconds with the controls held.

    Acceleration and steering angle stop changing where they meet their limits. A vehicle that comes to rest
    stands for the rest of the step, held by its brakes with zero acceleration: it never rolls backwards. The
    step is cut at these instants, which have closed forms, so that every piece is smooth.

    Args:
        state: at the beginning; outside the limits it is taken to be on them.
        controls: clipped to the limits of jerk and steering rate.
        parameters: of the vehicle.
        dt: length of the step [s], >= 0.

    Returns:
        The state dt later.
    """
    jerk = _clip(controls.jerk, -parameters.max_jerk, parameters.max_jerk)
    rate = _clip(controls.steering_rate, -parameters.max_steering_rate, parameters.max_steering_rate)
    max_angle = parameters.max_steering_angle
    state = replace(
        state,
        steering_angle=_clip(state.steering_angle, -max_angle, max_angle),
        accel=_clip(state.accel, -parameters.max_decel if state.speed > 0 else 0.0, parameters.max_accel),
    )
    accel_end = parameters.max_accel if jerk > 0 else -parameters.max_decel
    angle_end = math.copysign(max_angle, rate)
    left = dt
    while left > 0:
        if state.speed == 0 and state.accel == 0 and jerk <= 0:
            return _stand(state, rate, left, max_angle)
        to_accel_end = (accel_end - state.accel) / jerk if jerk != 0 else math.inf
        to_angle_end = (angle_end - state.steering_angle) / rate if rate != 0 else math.inf
        to_stop = _time_to_stop(state.speed, state.accel, jerk)
        span = min(left, to_accel_end, to_angle_end, to_stop)
        state = _integrate(state, jerk, rate, parameters.wheelbase, span)
        left -= span
        if span == to_stop:
            return _stand(state, rate, left, max_angle)
        if span == to_accel_end:
            state, jerk = replace(state, accel=accel_end), 0.0
        if span == to_angle_end:
            state, rate = replace(state, steering_angle=angle_end), 0.0
    return state


def _stand(state: BicycleState, steering_rate: float, span: float, max_angle: float) -> BicycleState:
    """Hold the vehicle where it is; its wheels may still be turned."""
    angle = _clip(state.steering_angle + steering_rate * span, -max_angle, max_angle)
    return replace(state, speed=0.0, accel=0.0, steering_angle=angle)


def _time_to_stop(speed: float, accel: float, jerk: float) -> float:
    """Return the first t > 0 with speed + accel t + jerk t^2 / 2 = 0, or infinity [s].

    Of the two forms of a root, the one without cancellation is taken.
    """
    discriminant = accel**2 - 2 * jerk * speed
    if accel > 0:
        return (-accel - math.sqrt(discriminant)) / jerk if jerk < 0 else math.inf
    if discriminant < 0:
        return math.inf
    slowing = math.sqrt(discriminant) - accel
    return 2 * speed / slowing if slowing > 0 else math.inf


def _integrate(state: BicycleState, jerk: float, rate: float, wheelbase: float, span: float) -> BicycleState:
    """Integrate one smooth piece: speed and steering in closed form, heading and (x, y) with RK4."""

    def motion_at(time: float) -> tuple[float, float]:
        """Return speed [m/s] and heading' [rad/s]."""
        speed = max(state.speed + state.accel * time + jerk * time**2 / 2, 0.0)
        return speed, speed * math.tan(state.steering_angle + rate * time) / wheelbase

    v_start, turn_start = motion_at(0.0)
    turn = max(abs(turn_start), abs(motion_at(span)[1])) * span
    count = max(1, math.ceil(span / MAX_SUBSTEP), math.ceil(turn / MAX_TURN_PER_SUBSTEP))
    h = span / count
    x, y, heading = state.x, state.y, state.heading
    sixth, third = h / 6, h / 3
    for k in range(count):
        # The slopes depend on time and heading only, so RK4's stages reduce to headings at three instants.
        v_middle, turn_middle = motion_at((k + 0.5) * h)
        v_end, turn_end = motion_at((k + 1) * h)
        second, after_middle = heading + h / 2 * turn_start, heading + h / 2 * turn_middle
        last = heading + h * turn_middle
        dx = sixth * v_start * math.cos(heading) + third * v_middle * math.cos(second)
        dy = sixth * v_start * math.sin(heading) + third * v_middle * math.sin(second)
        x += dx + third * v_middle * math.cos(after_middle) + sixth * v_end * math.cos(last)
        y += dy + third * v_middle * math.sin(after_middle) + sixth * v_end * math.sin(last)
        heading += sixth * (turn_start + 4 * turn_middle + turn_end)
        v_start, turn_start = v_end, turn_end
    angle = state.steering_angle + rate * span
    return BicycleState(x, y, heading, motion_at(span)[0], angle, state.accel + jerk * span)


def _clip(value: float, lower: float, upper: float) -> float:
    return min(max(value, lower), upper)
