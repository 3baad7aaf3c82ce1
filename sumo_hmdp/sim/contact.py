"""Contact between the ego and other vehicles: oriented rectangles, followed through a simulation step.

Within a step a body moves evenly from its pose before to its pose after, in x, y and heading. Whether two bodies meet,
when, on which side and who moved into whom all follow from that motion. The poses after the step tell none of it once
a step carries a body farther than it is long.

The traffic simulation ignores lateral geometry, so it both misses contacts and reports false ones.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple

from sumo_hmdp.domain.distance import TOUCH
from sumo_hmdp.domain.scene import VehicleState

# A vehicle that moves more slowly toward the other does not run into it: it stands, or keeps its lane [m/s].
APPROACH_SPEED = 0.1


class Side(StrEnum):
    """The side of the ego that is touched."""

    FRONT = "front"
    REAR = "rear"
    SIDE = "side"


@dataclass(frozen=True)
class Contact:
    """The ego and one other vehicle meet.

    Attributes:
        other_id: whose body it is.
        side: the side of the ego that is touched.
        at_fault: the ego moved into the other: forward with its front, or sideways with its side.
        time: when the bodies met, within the step [s]; when they were seen, where they did not come from apart.
    """

    other_id: str
    side: Side
    at_fault: bool
    time: float


@dataclass(frozen=True)
class Snapshot:
    """Everybody who can touch the ego at one instant.

    Attributes:
        time: [s].
        ego: the ego; (x, y) is the centre of its front bumper, as everywhere.
        others: the other vehicles.
    """

    time: float
    ego: VehicleState
    others: tuple[VehicleState, ...]


class Sweep(NamedTuple):
    """A body's even motion from its pose at the beginning of a step to that at its end."""

    start: VehicleState
    end: VehicleState


class Meeting(NamedTuple):
    """The first moment at which two bodies overlap.

    Attributes:
        share: of the step that is over by then, in [0, 1].
        normal: unit vector from the first body to the second, across the gap that closed last.
    """

    share: float
    normal: tuple[float, float]


def contacts(ego: VehicleState, others: Iterable[VehicleState], time: float = 0.0) -> tuple[Contact, ...]:
    """List the vehicles whose body overlaps the ego's at one instant, in the order given; touching is not overlap.

    Args:
        ego: the ego.
        others: the vehicles to test.
        time: of the instant [s].
    """
    velocity = (ego.speed * math.cos(ego.heading), ego.speed * math.sin(ego.heading))
    found = []
    for other in others:
        if _may_meet(Sweep(ego, ego), Sweep(other, other)) and overlap_depth(ego, other) > TOUCH:
            side, toward = _side_of_overlap(ego, other)
            found.append(Contact(other.id, side, _runs_into(side, toward, velocity), time))
    return tuple(found)


def contacts_between(before: Snapshot, after: Snapshot, x_end: float = math.inf) -> tuple[Contact, ...]:
    """List the vehicles whose body the ego's meets between two instants, by the time of meeting.

    A vehicle that is gone afterwards goes on at its speed, until its front passes the end of the road. One that was not
    there before is looked at where it is afterwards.

    Args:
        before: everybody at the beginning of a step.
        after: everybody at its end.
        x_end: of the road [m].
    """
    duration = after.time - before.time
    ego = Sweep(before.ego, after.ego)
    velocity = ((ego.end.x - ego.start.x) / duration, (ego.end.y - ego.start.y) / duration)
    known = {other.id for other in before.others}
    found = list(contacts(after.ego, (other for other in after.others if other.id not in known), after.time))
    for other, until in _sweeps(before, after, duration, x_end):
        meeting = first_meeting(ego, other) if _may_meet(ego, other) else None
        if meeting is None or meeting.share > until:
            continue
        side, toward = _side_facing(_between(ego, meeting.share), meeting.normal), meeting.normal
        if meeting.share == 0.0 and overlap_depth(ego.start, other.start) > TOUCH:
            side, toward = _side_of_overlap(ego.start, other.start)
        time = before.time + meeting.share * duration
        found.append(Contact(other.start.id, side, _runs_into(side, toward, velocity), time))
    return tuple(sorted(found, key=lambda contact: contact.time))


def _sweeps(before: Snapshot, after: Snapshot, duration: float, x_end: float) -> Iterator[tuple[Sweep, float]]:
    """Yield the motion of everybody who was there before, and the share of the step up to which they are there."""
    now = {other.id: other for other in after.others}
    for other in before.others:
        if other.id in now:
            yield Sweep(other, now[other.id]), 1.0
            continue
        dx, dy = (other.speed * duration * part(other.heading) for part in (math.cos, math.sin))
        until = min(1.0, (x_end - other.x) / dx) if dx > 0.0 else 1.0
        yield Sweep(other, replace(other, x=other.x + dx, y=other.y + dy)), until


def _runs_into(side: Side, toward: tuple[float, float], velocity: tuple[float, float]) -> bool:
    """Tell whether the ego moves into the other: along the normal with its front, across the road with its side.

    A vehicle has no motion across its own heading. So what its side does shows across the road, of which a change of
    lanes is made.
    """
    if side is Side.FRONT:
        return velocity[0] * toward[0] + velocity[1] * toward[1] > APPROACH_SPEED
    return side is Side.SIDE and velocity[1] * math.copysign(1.0, toward[1]) > APPROACH_SPEED


def first_meeting(a: Sweep, b: Sweep) -> Meeting | None:
    """Return when two bodies first overlap by more than `TOUCH` in a step, None where they do not.

    The step is halved as long as its parts may hold an overlap: a part holds none where the gap along an edge direction
    is wider at the middle of the part than it can close up to the part's ends. Parts end where nothing in them moves by
    more than `TOUCH`.
    """
    motion = _Motion(a, b)
    if overlap_depth(a.start, b.start) > TOUCH:
        return Meeting(0.0, motion.normal(0.0))
    parts = [(0.0, 1.0)]
    while parts:
        start, end = parts.pop()
        middle, half = 0.5 * (start + end), 0.5 * (end - start)
        if motion.stays_apart(middle, half):
            continue
        if half * motion.fastest > 0.5 * TOUCH:
            parts += [(middle, end), (start, middle)]
        elif motion.depth(middle) > TOUCH:
            return Meeting(middle, motion.normal(middle))
    # An overlap that is reached with the end of the step is one of this step.
    return Meeting(1.0, motion.normal(1.0)) if overlap_depth(a.end, b.end) > TOUCH else None


class _Motion:
    """Two bodies through a step; rates are those of a whole step."""

    def __init__(self, a: Sweep, b: Sweep) -> None:
        self._a, self._b = a, b
        self._velocity = (b.end.x - b.start.x) - (a.end.x - a.start.x), (b.end.y - b.start.y) - (a.end.y - a.start.y)
        self._speed = math.hypot(*self._velocity)
        self._turns = abs(_turn(a)), abs(_turn(b))
        (turn_a, turn_b), bodies = self._turns, (a.start, b.start)
        # How fast the centres move about the front bumpers, and how fast any points of the bodies can approach.
        self._swing = 0.5 * (bodies[0].length * turn_a + bodies[1].length * turn_b)
        self._extents = tuple(body.length + body.width for body in bodies)
        self.fastest = self._speed + self._extents[0] * turn_a + self._extents[1] * turn_b

    def depth(self, share: float) -> float:
        """Return the overlap [m] at a share of the step."""
        return overlap_depth(_between(self._a, share), _between(self._b, share))

    def normal(self, share: float) -> tuple[float, float]:
        """Return the unit vector from the first body to the second along which they overlap least."""
        a, b = _between(self._a, share), _between(self._b, share)
        _, ux, uy, offset = max(_gaps(a, b))
        sign = math.copysign(1.0, offset)
        return sign * ux, sign * uy

    def stays_apart(self, middle: float, half: float) -> bool:
        """Tell whether a gap is sure to stay open from `middle - half` to `middle + half`, by shares of the step."""
        a, b = _between(self._a, middle), _between(self._b, middle)
        distance = math.hypot(*_center_offset(a, b)) + half * (self._speed + self._swing)
        (turn_a, turn_b), (extent_a, extent_b) = self._turns, self._extents
        for index, (gap, ux, uy, _) in enumerate(_gaps(a, b)):
            # Two edge directions of each body, the first one's first.
            turn = turn_a if index < 2 else turn_b
            other_turn, extent = (turn_b, extent_b) if index < 2 else (turn_a, extent_a)
            closing = abs(self._velocity[0] * ux + self._velocity[1] * uy) + turn * half * self._speed
            shadow = 0.5 * extent * (turn + other_turn)
            if gap + TOUCH >= half * (closing + self._swing + turn * distance + shadow):
                return True
        return False


def overlap_depth(a: VehicleState, b: VehicleState) -> float:
    """Return the shortest move that separates two bodies [m]; zero or below where they do not overlap.

    Separating axes: two rectangles are disjoint where their shadows on one of their edge directions are.
    """
    return min(-gap for gap, *_ in _gaps(a, b))


def _gaps(a: VehicleState, b: VehicleState) -> list[tuple[float, float, float, float]]:
    """Return for the edge directions of two bodies, two of each: the gap [m], the unit vector, and b's offset [m]."""
    dx, dy = _center_offset(a, b)
    cos_a, sin_a = math.cos(a.heading), math.sin(a.heading)
    cos_b, sin_b = math.cos(b.heading), math.sin(b.heading)
    gaps = []
    for ux, uy in ((cos_a, sin_a), (-sin_a, cos_a), (cos_b, sin_b), (-sin_b, cos_b)):
        shadow = 0.5 * (
            a.length * abs(cos_a * ux + sin_a * uy)
            + a.width * abs(cos_a * uy - sin_a * ux)
            + b.length * abs(cos_b * ux + sin_b * uy)
            + b.width * abs(cos_b * uy - sin_b * ux)
        )
        offset = dx * ux + dy * uy
        gaps.append((abs(offset) - shadow, ux, uy, offset))
    return gaps


def _may_meet(a: Sweep, b: Sweep) -> bool:
    """Tell whether two bodies come near each other at all; cheap, and right for any heading."""
    # No body reaches further from its front bumper along the road than this.
    widths = 0.5 * (a.start.width + b.start.width)
    reach = a.start.length + b.start.length + widths
    before, after = b.start.x - a.start.x, b.end.x - a.end.x
    if min(before, after) > reach or max(before, after) < -reach:
        return False
    reach = widths + _reach_across(a) + _reach_across(b)
    before, after = b.start.y - a.start.y, b.end.y - a.end.y
    return min(before, after) <= reach and max(before, after) >= -reach


def _reach_across(sweep: Sweep) -> float:
    """Return how far across the road a body's middle line may reach from its front bumper [m]."""
    first, last = abs(sweep.start.heading), abs(sweep.end.heading)
    steepest = max(first, last)
    return sweep.start.length * (math.sin(steepest) if steepest < 0.5 * math.pi else 1.0)


def _turn(sweep: Sweep) -> float:
    """Return by how much a body turns [rad], the short way round."""
    return math.remainder(sweep.end.heading - sweep.start.heading, 2.0 * math.pi)


def _between(sweep: Sweep, share: float) -> VehicleState:
    """Return a body at a share of the step."""
    start, end = sweep
    if start is end:
        return start
    return replace(
        start,
        x=start.x + share * (end.x - start.x),
        y=start.y + share * (end.y - start.y),
        heading=start.heading + share * _turn(sweep),
    )


def _center_offset(a: VehicleState, b: VehicleState) -> tuple[float, float]:
    """Return the vector from the centre of body a to the centre of body b [m]."""
    dx = (b.x - 0.5 * b.length * math.cos(b.heading)) - (a.x - 0.5 * a.length * math.cos(a.heading))
    dy = (b.y - 0.5 * b.length * math.sin(b.heading)) - (a.y - 0.5 * a.length * math.sin(a.heading))
    return dx, dy


def _side_facing(ego: VehicleState, normal: tuple[float, float]) -> Side:
    """Return the side of the ego that a direction points out of."""
    cos, sin = math.cos(ego.heading), math.sin(ego.heading)
    along, across = normal[0] * cos + normal[1] * sin, normal[1] * cos - normal[0] * sin
    if abs(along) < abs(across):
        return Side.SIDE
    return Side.FRONT if along >= 0.0 else Side.REAR


def _side_of_overlap(ego: VehicleState, other: VehicleState) -> tuple[Side, tuple[float, float]]:
    """Return the side of the ego that points at a body in it, measured in the bodies' extents, and the way out of it.

    For bodies that were never seen apart: nothing tells how they came into each other.
    """
    dx, dy = _center_offset(ego, other)
    cos, sin = math.cos(ego.heading), math.sin(ego.heading)
    along, across = dx * cos + dy * sin, dy * cos - dx * sin
    if abs(along) / (ego.length + other.length) < abs(across) / (ego.width + other.width):
        sign = math.copysign(1.0, across)
        return Side.SIDE, (-sign * sin, sign * cos)
    sign = math.copysign(1.0, along)
    return (Side.FRONT if sign > 0.0 else Side.REAR), (sign * cos, sign * sin)
