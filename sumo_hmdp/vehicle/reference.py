"""What the front bumper should do after a command: a quintic across the road, an acceleration along it.

The reference is that of the FRONT BUMPER, the point at which the planner and SUMO see the vehicle. The rear
axle follows it as a trailer follows its hitch, a lever = rear_axle_to_front_bumper behind it:

    heading' = |velocity of the bumper| * sin(course - heading) / lever,    course = atan2(dy/dt, dx/dt),
    tan(steering_angle) = wheelbase / lever * tan(course - heading),

so a smooth path of the bumper gives a smooth heading and steering angle (docs/formulation.md, eq. 18).
The reverse choice, a quintic for the rear axle, would put the bumper lever * sin(heading) off the quintic:
0.7 m in the middle of a 4 s lane change at 10 m/s.
"""

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.polynomial import polyval
from numpy.typing import ArrayLike, NDArray

from sumo_hmdp.domain.plan import Command
from sumo_hmdp.domain.road import Road
from sumo_hmdp.vehicle.bicycle import BicycleParameters, BicycleState, front_bumper, front_bumper_velocity

FloatArray = NDArray[np.float64]

# Below this speed a lane change is a path in space, not in time: nobody moves sideways while standing.
CRAWL_SPEED = 5.0

# A vehicle that heads across the road begins its way back along this course.
MAX_COURSE = 1.0


@dataclass(frozen=True)
class Quintic:
    """y(t) = sum of coefficients[i] t^i for 0 <= t <= duration, and `end` from then on.

    Attributes:
        coefficients: c0..c5 [m, m/s, ...].
        duration: [s], > 0.
        end: y at the end [m].
    """

    coefficients: tuple[float, ...]
    duration: float
    end: float

    def at(self, time: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return y [m] and dy/dt [m/s] at times since the beginning [s], >= 0, each of the times' shape."""
        t = np.asarray(time, dtype=np.float64)
        over = t >= self.duration
        if over.all():
            # Most of the time a vehicle keeps its lane.
            return np.full(t.shape, self.end), np.zeros(t.shape)
        slopes = [i * c for i, c in enumerate(self.coefficients)][1:]
        return np.where(over, self.end, polyval(t, self.coefficients)), np.where(over, 0.0, polyval(t, slopes))


def quintic(y: float, lateral_speed: float, lateral_accel: float, end: float, duration: float) -> Quintic:
    """Return the quintic from (y, y', y'') to (end, 0, 0) (docs/formulation.md, eq. 18).

    From rest it is y + (end - y) (10 p^3 - 15 p^4 + 6 p^5) with p = t / duration.

    Args:
        y: [m].
        lateral_speed: y' at the beginning [m/s].
        lateral_accel: y'' at the beginning [m/s2].
        end: [m].
        duration: [s], > 0.
    """
    rise, v, a = end - y, lateral_speed * duration, lateral_accel * duration**2
    third, fourth, fifth = (
        10 * rise - 6 * v - 1.5 * a,
        -15 * rise + 8 * v + 1.5 * a,
        6 * rise - 3 * v - 0.5 * a,
    )
    scaled = (y, v, a / 2, third, fourth, fifth)
    return Quintic(tuple(c / duration**i for i, c in enumerate(scaled)), duration, end)


@dataclass(frozen=True)
class Reference:
    """Where the front bumper should be from `time` on.

    Along the road it moves with constant acceleration until it stands or meets `max_speed`. Across the road
    it follows the quintic by a clock that runs with time, but at the rate speed / CRAWL_SPEED below
    CRAWL_SPEED. So a vehicle that brakes to rest in a lane change stops on its path, and goes on along it when
    it starts again.

    Attributes:
        time: of its beginning [s].
        lane: that it leads to.
        x: along the road at the beginning [m].
        speed: dx/dt at the beginning [m/s], >= 0.
        accel: d2x/dt2 [m/s2].
        lateral: y by the clock.
        clock: of `lateral` at the beginning [s].
        max_speed: dx/dt does not grow beyond it [m/s]; None for no such limit.
    """

    time: float
    lane: int
    x: float
    speed: float
    accel: float
    lateral: Quintic
    clock: float = 0.0
    max_speed: float | None = None

    @property
    def top_speed(self) -> float:
        """The limit of dx/dt [m/s]; a faster beginning is not slowed down."""
        return np.inf if self.max_speed is None else max(self.max_speed, self.speed)


@dataclass(frozen=True)
class ReferenceSamples:
    """The reference of the front bumper at some times; arrays of one shape.

    Attributes:
        x: [m].
        y: [m].
        heading: course of the bumper, atan2(dy/dt, dx/dt) [rad]; defined at rest as well.
        speed: dx/dt, along the road [m/s].
        accel: d2x/dt2, along the road [m/s2].
    """

    x: FloatArray
    y: FloatArray
    heading: FloatArray
    speed: FloatArray
    accel: FloatArray


def sample(reference: Reference, times: ArrayLike) -> ReferenceSamples:
    """Evaluate a reference.

    Args:
        reference: of the front bumper.
        times: [s], any shape; those before its beginning count as its beginning.
    """
    t = _since(reference, times)
    free_speed = reference.speed + reference.accel * t
    top_speed = reference.top_speed
    speed = np.minimum(np.maximum(free_speed, 0.0), top_speed)
    y, y_by_clock = reference.lateral.at(_clock(reference, t))
    # The clock runs at speed / max(speed, CRAWL_SPEED), so dy/dx needs no division by the speed.
    slope = y_by_clock / np.maximum(speed, CRAWL_SPEED)
    moving = (free_speed > 0) & (free_speed < top_speed)
    if reference.accel > 0 and reference.speed < top_speed:
        moving |= t == 0
    return ReferenceSamples(
        x=reference.x + _ramp_integral(reference.speed, reference.accel, top_speed, t),
        y=y,
        heading=np.arctan(slope),
        speed=speed,
        accel=np.where(moving, reference.accel, 0.0),
    )


def clock_at(reference: Reference, times: ArrayLike) -> FloatArray:
    """Return the clock of the lane change at some times [s]: clock' = min(1, speed / CRAWL_SPEED)."""
    return _clock(reference, _since(reference, times))


def _since(reference: Reference, times: ArrayLike) -> FloatArray:
    """Return the times from the beginning of the reference on [s]; none is before it."""
    return np.maximum(np.asarray(times, dtype=np.float64) - reference.time, 0.0)


def _clock(reference: Reference, t: FloatArray) -> FloatArray:
    """Return the clock t after the beginning of the reference [s]."""
    top_speed = min(reference.top_speed, CRAWL_SPEED)
    return reference.clock + _ramp_integral(reference.speed, reference.accel, top_speed, t) / CRAWL_SPEED


def _ramp_integral(start: float, slope: float, upper: float, t: FloatArray) -> FloatArray:
    """Integrate clip(start + slope s, 0, upper) over s from 0 to t >= 0, for start >= 0; shape of t.

    The ramp lasts from first to last; besides it the integrand is `upper`, or zero after a fall to zero.
    """
    if slope == 0 or (slope > 0 and start >= upper):
        return np.asarray(t * min(start, upper))
    to_upper, to_zero = (upper - start) / slope, -start / slope
    if slope < 0 and to_upper >= t.max(initial=0.0):
        return np.asarray(t * upper)
    ramp_from, ramp_to = (to_upper, to_zero) if slope < 0 else (0.0, to_upper)
    first, last = np.minimum(max(ramp_from, 0.0), t), np.minimum(max(ramp_to, 0.0), t)
    at_upper = first if slope < 0 else t - last
    plateau = at_upper * (upper if np.isfinite(upper) else 0.0)
    return np.asarray(plateau + (last - first) * (start + slope * (first + last) / 2))


def follow(
    command: Command,
    state: BicycleState,
    parameters: BicycleParameters,
    previous: Reference | None,
    *,
    road: Road,
    time: float,
    lane_change_time: float,
    max_speed: float | None = None,
) -> Reference:
    """Return the reference of a command that is given now, which may be in the middle of a lane change.

    Along the road it begins at the present front bumper with its present dx/dt. Across the road the previous
    quintic goes on by its own clock if the command keeps its lane; else (an abort, a second change, or no
    previous reference) a new one begins at the front bumper's present y, course and curvature of path.

    Args:
        command: lane and acceleration.
        state: of the vehicle now.
        parameters: of the vehicle.
        previous: what it followed until now, if anything.
        road: it is on.
        time: now [s].
        lane_change_time: of a new lane change [s], > 0; a quintic that goes on keeps its own.
        max_speed: as in `Reference`.
    """
    x, _ = front_bumper(state, parameters)
    speed = max(front_bumper_velocity(state, parameters)[0], 0.0)
    if previous is not None and previous.lane == command.lane:
        lateral, clock = previous.lateral, float(clock_at(previous, time))
    else:
        end = road.center_y(command.lane)
        accel_of_clock = command.accel if speed > CRAWL_SPEED else 0.0
        start = _lateral_start(state, parameters, max(speed, CRAWL_SPEED), accel_of_clock)
        lateral, clock = quintic(*start, end=end, duration=lane_change_time), 0.0
    return Reference(time, command.lane, x, speed, command.accel, lateral, clock, max_speed)


def _lateral_start(
    state: BicycleState, parameters: BicycleParameters, pace: float, pace_change: float
) -> tuple[float, float, float]:
    """Return y [m], y' [m/s] and y'' [m/s2] of the front bumper that goes on with its steering held.

    The derivatives are by a clock with dx/dclock = pace: y' = slope * pace and
    y'' = d(slope)/dx * pace^2 + slope * pace_change, where slope = dy/dx = tan(course).
    """
    _, y = front_bumper(state, parameters)
    tan_steering = np.tan(state.steering_angle)
    slip = np.arctan(tan_steering * parameters.rear_axle_to_front_bumper / parameters.wheelbase)
    course = np.clip(state.heading + slip, -MAX_COURSE, MAX_COURSE)
    slope = np.tan(course)
    slope_by_x = tan_steering * np.cos(slip) / (parameters.wheelbase * np.cos(course) ** 3)
    return y, float(slope * pace), float(slope_by_x * pace**2 + slope * pace_change)
