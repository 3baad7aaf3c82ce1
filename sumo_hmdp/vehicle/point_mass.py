"""A point that moves exactly as told (docs/formulation.md, eq. 37).

    v+ = v + a dt,   x+ = x + v dt + a dt^2 / 2,   y by a quintic over the lane-change time,

without actuators, limits or a tracker; it comes to rest within a step, and stands. The published rule-based code takes
x+ = x + v+ dt instead (eq. 22), which only its own case does. The point is the front bumper. The quintic runs with
time, as in the published code, also while the vehicle stands.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from sumo_hmdp.vehicle.reference import MAX_COURSE, Quintic, quintic


@dataclass(frozen=True)
class PointMass:
    """The point at one instant.

    Attributes:
        x: front bumper along the road [m].
        speed: dx/dt [m/s], >= 0; as published, the lateral part is not counted.
        lane: that `lateral` leads to.
        lateral: y by the time since the lane change began.
        clock: the time since then [s].
        accel: over the step before [m/s2].
    """

    x: float
    speed: float
    lane: int
    lateral: Quintic
    clock: float = 0.0
    accel: float = 0.0

    @property
    def y(self) -> float:
        """Front bumper across the road, to the left [m]."""
        return float(self.lateral.at(self.clock)[0])

    @property
    def lateral_speed(self) -> float:
        """dy/dt [m/s]."""
        return float(self.lateral.at(self.clock)[1])

    @property
    def heading(self) -> float:
        """The course atan2(dy/dt, dx/dt), within +-MAX_COURSE, which a slow vehicle would exceed [rad].

        The published point has no heading. This one gives the body its place in both lanes and tells a lane
        change from lane keeping where a contact's fault is judged; it moves nothing.
        """
        course = math.atan2(self.lateral_speed, self.speed) if self.lateral_speed else 0.0
        return min(max(course, -MAX_COURSE), MAX_COURSE)


def in_lane(x: float, y: float, speed: float, lane: int) -> PointMass:
    """Return a point that keeps its y.

    Args:
        x: front bumper [m].
        y: front bumper [m].
        speed: [m/s].
        lane: that it is in.
    """
    return PointMass(x, speed, lane, quintic(y, 0.0, 0.0, end=y, duration=1.0))


def change_lane(state: PointMass, lane: int, y_end: float, duration: float) -> PointMass:
    """Begin a quintic from the present y, dy/dt and d2y/dt2 to a lane; one that leads there already goes on.

    Args:
        state: now.
        lane: to go to.
        y_end: the lane's centre [m].
        duration: [s], > 0.
    """
    if lane == state.lane:
        return state
    lateral_accel = 0.0
    if state.clock < state.lateral.duration:
        second = np.polynomial.Polynomial(state.lateral.coefficients).deriv(2)
        lateral_accel = float(second(state.clock))
    lateral = quintic(state.y, state.lateral_speed, lateral_accel, end=y_end, duration=duration)
    return replace(state, lane=lane, lateral=lateral, clock=0.0)


def advance(state: PointMass, accel: float, dt: float) -> PointMass:
    """Move the point by one step, exactly (docs/formulation.md, eq. 37).

    Args:
        state: at the beginning.
        accel: over the step [m/s2]; a point that comes to rest stands from then on.
        dt: the step [s], > 0.
    """
    if state.speed + accel * dt < 0.0:
        way, speed = state.speed**2 / (-2.0 * accel), 0.0
    else:
        way, speed = state.speed * dt + accel * dt**2 / 2.0, state.speed + accel * dt
    return replace(state, x=state.x + way, speed=speed, accel=(speed - state.speed) / dt, clock=state.clock + dt)


def advance_as_published(state: PointMass, accel: float, dt: float) -> PointMass:
    """Move the point by one step as the published rule-based code does (docs/formulation.md, eq. 22).

    Args:
        state: at the beginning.
        accel: over the step [m/s2]; a point that comes to rest stands.
        dt: the step [s], > 0.
    """
    speed = max(0.0, state.speed + accel * dt)
    return replace(state, x=state.x + speed * dt, speed=speed, accel=(speed - state.speed) / dt, clock=state.clock + dt)
