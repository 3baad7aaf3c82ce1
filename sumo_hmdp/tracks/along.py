"""Tracks along their road: front bumpers in lanes of one width, as the rest of the package has them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.errors import Problem
from sumo_hmdp.tracks.record import FloatArray, Track
from sumo_hmdp.tracks.shape import RoadShape

# A vehicle is on the road while the centre of its body is at most this far beside the outermost lane lines [m].
BESIDE = 1.0
# Half the window of the differences that smooth recorded accelerations and lateral speeds [s].
_HALF_WINDOW = 0.3
# Whoever has a steeper angle to the road crosses it [rad]; below the speed it is a matter of the record's noise [m/s].
_CROSSING, _MOVING = np.pi / 4, 1.0
# A course is taken over at least so long a way [m].
_COURSE = 2.0
# The road goes straight on at both ends for so long [m].
EXTENSION = 1000.0
# An instant that is nearer counts as reached [s].
SOON = 1e-6


@dataclass(frozen=True)
class RoadTrack:
    """A recorded vehicle along the road.

    Attributes:
        id: its name.
        length: [m].
        width: [m].
        time: (n,) instants since the record began [s].
        x: (n,) front bumper along the road [m].
        y: (n,) front bumper across the road, to the left [m].
        heading: (n,) from the road's direction [rad].
        speed: (n,) [m/s].
        accel: (n,) smoothed [m/s2].
        lateral_speed: (n,) smoothed [m/s].
    """

    id: str
    length: float
    width: float
    time: FloatArray
    x: FloatArray
    y: FloatArray
    heading: FloatArray
    speed: FloatArray
    accel: FloatArray
    lateral_speed: FloatArray

    @cached_property
    def ahead(self) -> FloatArray:
        """(n,) The farthest x so far [m]: a standing vehicle's record goes back and forth."""
        return np.maximum.accumulate(self.x)

    def holds(self, time: float) -> bool:
        """Tell whether the vehicle is recorded at a time [s]."""
        return bool(self.time[0] - SOON <= time <= self.time[-1] + SOON)

    def at(self, time: float, road: Road) -> VehicleState:
        """Return the vehicle at a time [s]: at an instant of the record exactly, between two linearly."""
        after = int(np.searchsorted(self.time, time - SOON))
        after = min(after, len(self.time) - 1)
        columns = (self.x, self.y, self.speed, self.accel, self.heading, self.lateral_speed)
        if after == 0 or self.time[after] <= time + SOON:
            values = [float(column[after]) for column in columns]
        else:
            share = (time - self.time[after - 1]) / (self.time[after] - self.time[after - 1])
            values = [float(column[after - 1] + share * (column[after] - column[after - 1])) for column in columns]
        x, y, speed, accel, heading, lateral_speed = values
        return VehicleState(
            id=self.id,
            x=x,
            y=y,
            speed=speed,
            lane=road.lane_at(y),
            accel=accel,
            heading=heading,
            length=self.length,
            width=self.width,
            lateral_speed=lateral_speed,
        )


def along_road(
    track: Track, shape: RoadShape, dt: float, begin: float, span: float
) -> tuple[RoadTrack | None, Problem | str | None]:
    """Return a track along the road while it is on it, None where it never is, and what a reader should know of it.

    Args:
        track: as recorded.
        shape: the road.
        dt: the record's step [s].
        begin: when the record begins [s].
        span: how long it is [s].
    """
    s, d = shape.locate(track.x, track.y)
    on_road = (shape.outside(s, d) <= BESIDE) & (s > -EXTENSION) & (s < shape.length + EXTENSION)
    if not on_road.any():
        where = f"{track.id} at {track.time[0] - begin:g} s, {shape.outside(s, d)[0]:.1f} m beside the outermost line"
        return None, where
    rows = _longest(on_road)
    s, d, time = s[rows], d[rows], track.time[rows] - begin
    y = shape.across(s, d)
    heading = _headings(track, rows, shape, s, y, dt)
    speed = _speeds(track, rows, s, y, dt)
    crossing = (np.abs(heading) > _CROSSING) & (speed > _MOVING)
    if crossing.any() and not track.is_static:
        first = int(np.argmax(crossing))
        message = f"a vehicle on the road must drive along it, got {track.id} at an angle of {heading[first]:.2f} rad"
        remedy = "List it in tracks.leave_out, or name another road by tracks.lanelet"
        return None, Problem("", f"{message} at {time[first]:g} s. {remedy}")
    if track.is_static:
        # A parked body looks the same from behind.
        heading = np.arctan(np.tan(heading))
        time, s, y, heading, speed = (np.repeat(values[:1], 2) for values in (time, s, y, heading, speed))
        time = np.array([0.0, span])
    lateral = np.zeros(len(time)) if track.is_static else _smooth_rate(y, dt)
    accel = np.zeros(len(time)) if track.is_static else _smooth_rate(speed, dt)
    front_x, front_y = s + 0.5 * track.length * np.cos(heading), y + 0.5 * track.length * np.sin(heading)
    along = RoadTrack(track.id, track.length, track.width, time, front_x, front_y, heading, speed, accel, lateral)
    if on_road.all():
        return along, None
    first = int(np.argmin(on_road))
    return along, f"{track.id} at {track.time[first] - begin:g} s"


def _longest(mask: NDArray[np.bool_]) -> slice:
    """Return the longest run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(mask, dtype=int), [0]])))
    begins, ends = edges[::2], edges[1::2]
    longest = int(np.argmax(ends - begins))
    return slice(int(begins[longest]), int(ends[longest]))


def _smooth_rate(values: FloatArray, dt: float) -> FloatArray:
    """Return the rate of change by differences over 0.6 s, over less at the ends [1/s]."""
    half = max(1, round(_HALF_WINDOW / dt))
    index = np.arange(len(values))
    before, after = np.maximum(index - half, 0), np.minimum(index + half, len(values) - 1)
    return np.asarray((values[after] - values[before]) / (np.maximum(after - before, 1) * dt), dtype=float)


def _headings(track: Track, rows: slice, shape: RoadShape, s: FloatArray, y: FloatArray, dt: float) -> FloatArray:
    """Return headings from the road's direction: as recorded, or from the smoothed way where they are not."""
    if track.heading is not None:
        relative = track.heading[rows] - shape.heading_at(s)
        return np.asarray(np.arctan2(np.sin(relative), np.cos(relative)), dtype=float)
    window = 2.0 * _HALF_WINDOW
    forward = np.maximum(np.abs(_smooth_rate(s, dt)) * window, _COURSE)
    backward = _smooth_rate(s, dt) * window < -_COURSE
    return np.asarray(np.where(backward, np.pi, np.arctan2(_smooth_rate(y, dt) * window, forward)), dtype=float)


def _speeds(track: Track, rows: slice, s: FloatArray, y: FloatArray, dt: float) -> FloatArray:
    if track.speed is not None:
        return track.speed[rows]
    return np.asarray(np.hypot(_smooth_rate(s, dt), _smooth_rate(y, dt)), dtype=float)


def instants_on(tracks: Sequence[Track], shape: RoadShape) -> int:
    """Return how many recorded instants are on a road."""
    return sum(int(np.count_nonzero(_inside(track, shape))) for track in tracks)


def _inside(track: Track, shape: RoadShape) -> NDArray[np.bool_]:
    s, d = shape.locate(track.x, track.y)
    return np.asarray((shape.outside(s, d) <= 0.0) & (s >= 0.0) & (s <= shape.length), dtype=np.bool_)
