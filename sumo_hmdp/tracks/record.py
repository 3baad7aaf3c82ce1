"""Tracks as they were recorded, in the record's own frame, and the checks that need no road."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.errors import Problem

FloatArray = NDArray[np.float64]

# A step between two instants may differ from the record's by this share: cameras' clocks round to milliseconds.
_JITTER = 0.05
# Half of all vehicles of a road are narrower than a bus and wider than a motorcycle [m]; feet or centimetres are not.
_WIDTHS, _LENGTHS = (1.2, 3.0), (2.5, 13.0)
# Nobody is faster [m/s]; a position that jumps farther is a mistake in the record.
_FASTEST, _ROUNDING = 100.0, 0.5
# How much the recorded speed may differ from that of the positions, for half of all instants.
_SPEED_SHARE, _SPEED_OFFSET = 0.2, 1.0


@dataclass(frozen=True)
class Track:
    """One recorded vehicle.

    Attributes:
        id: its name in the record.
        length: [m].
        width: [m].
        time: (n,) instants [s], one step apart.
        x: (n,) centre of its body in the record's frame [m].
        y: (n,) centre of its body in the record's frame [m].
        heading: (n,) of its body in the record's frame, counter-clockwise [rad]; None where it is not recorded.
        speed: (n,) along its heading [m/s]; None where it is not recorded.
        is_static: whether it stands at one place all the time.
    """

    id: str
    length: float
    width: float
    time: FloatArray
    x: FloatArray
    y: FloatArray
    heading: FloatArray | None = None
    speed: FloatArray | None = None
    is_static: bool = False


def record_problems(tracks: Sequence[Track], dt: float, *, is_metric: bool = False) -> Iterator[Problem]:
    """Yield what makes tracks unusable, whatever the road: one line per kind of mistake.

    Args:
        tracks: of one record.
        dt: its step [s].
        is_metric: whether the format itself says that lengths are metres, so that sizes tell nothing of the units.
    """
    moving = [track for track in tracks if not track.is_static]
    if not moving:
        yield Problem("", "the record must hold at least one moving vehicle, got none. Check the file")
        return
    seen: set[str] = set()
    for track in tracks:
        if track.id in seen:
            yield Problem("", f"each vehicle must have an id of its own, got {track.id!r} twice. Rename one")
            return
        seen.add(track.id)
    mistakes = [problem for track in moving if (problem := _time_problem(track, dt)) is not None]
    yield from mistakes[:1]
    if mistakes:
        return
    mistakes = list(_size_problems(moving, is_metric=is_metric))
    mistakes = mistakes or [problem for track in moving if (problem := _jump_problem(track, dt)) is not None]
    mistakes = mistakes or list(_speed_problems(moving, dt))
    yield from mistakes[:1]


def _time_problem(track: Track, dt: float) -> Problem | None:
    steps = np.diff(track.time)
    if (steps == 0.0).any():
        time = track.time[int(np.argmax(steps == 0.0))]
        return Problem("", f"each vehicle must have one row per instant, got two of {track.id} at {time:g} s")
    wrong = np.abs(steps - dt) > _JITTER * dt
    if wrong.any():
        first = int(np.argmax(wrong))
        message = (
            f"a track must have an instant every {dt:g} s, got a gap of vehicle {track.id} from "
            f"{track.time[first]:g} to {track.time[first + 1]:g} s. Fill it, or list the vehicle in tracks.leave_out"
        )
        return Problem("", message)
    return None


def _size_problems(tracks: Sequence[Track], *, is_metric: bool) -> Iterator[Problem]:
    for track in tracks:
        if not (track.length > 0.0 and track.width > 0.0):
            yield Problem("", f"a vehicle must have a length and a width above 0, got {track.id} without. Correct it")
            return
    if is_metric:
        return
    for what, values, (low, high) in (
        ("wide", [t.width for t in tracks], _WIDTHS),
        ("long", [t.length for t in tracks], _LENGTHS),
    ):
        median = float(np.median(values))
        if not low <= median <= high:
            message = f"vehicles must be {low:g} to {high:g} m {what} in the median, got {median:.2f} m"
            yield Problem("", f"{message}. Check the units")
            return


def _jump_problem(track: Track, dt: float) -> Problem | None:
    distance = np.hypot(np.diff(track.x), np.diff(track.y))
    wrong = distance > _FASTEST * dt + _ROUNDING
    if not wrong.any():
        return None
    first = int(np.argmax(wrong))
    most = _FASTEST * dt + _ROUNDING
    message = f"a vehicle must move less than {most:.1f} m in {dt:g} s, got {distance[first]:.1f} m"
    where = f"of {track.id} after {track.time[first]:g} s"
    return Problem("", f"{message} {where}. Check the units, or list the vehicle in tracks.leave_out")


def _speed_problems(tracks: Sequence[Track], dt: float) -> Iterator[Problem]:
    """Yield that recorded speeds are not those of the positions, as with km/h for m/s or a wrong frame rate."""
    recorded, moved = [], []
    for track in tracks:
        if track.speed is not None and len(track.time) > 1:
            recorded.append(0.5 * (track.speed[1:] + track.speed[:-1]))
            moved.append(np.hypot(np.diff(track.x), np.diff(track.y)) / dt)
    if not recorded:
        return
    told, seen = np.concatenate(recorded), np.concatenate(moved)
    if (told < 0.0).any():
        yield Problem("", "recorded speeds must be at least 0, got a negative one. Correct it")
    elif np.median(np.abs(told - seen) - _SPEED_SHARE * seen) > _SPEED_OFFSET:
        message = f"recorded speeds must fit the positions, got {np.median(told):.1f} m/s where the positions move by"
        yield Problem("", f"{message} {np.median(seen):.1f} m/s (medians). Check the units and the time step")
