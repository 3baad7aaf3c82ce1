"""Contact between the ego and other vehicles as oriented rectangles.

The traffic simulation ignores lateral geometry, so it both misses contacts and reports false ones.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from sumo_hmdp.domain.scene import VehicleState

# Slower sideways motion is lane keeping: so slow a lane change, at its outer ends, is still in its own lane.
LATERAL_SPEED_OF_A_CHANGE = 0.1


class Side(StrEnum):
    """The side of the ego that is touched."""

    FRONT = "front"
    REAR = "rear"
    SIDE = "side"


@dataclass(frozen=True)
class Contact:
    """The ego and one other vehicle overlap.

    Attributes:
        other_id: whose body it is.
        side: the side of the ego that is touched.
        depth: the shortest move that would separate the two bodies [m], > 0.
        at_fault: the ego caused it: with its front, or with its side while it changes lanes.
    """

    other_id: str
    side: Side
    depth: float
    at_fault: bool


def contacts(ego: VehicleState, others: Iterable[VehicleState]) -> tuple[Contact, ...]:
    """List the vehicles whose body overlaps the ego's, in the order given; touching is not overlap.

    Args:
        ego: its (x, y) is the centre of its front bumper, as everywhere.
        others: the vehicles to test.
    """
    found = []
    for other in others:
        # Cheap, and right for any heading: no body reaches further from its front bumper than this.
        if abs(other.x - ego.x) > ego.length + other.length + 0.5 * (ego.width + other.width):
            continue
        depth = overlap_depth(ego, other)
        if depth > 0.0:
            side = _touched_side(ego, other)
            changing = abs(ego.speed * math.sin(ego.heading)) > LATERAL_SPEED_OF_A_CHANGE
            at_fault = side is Side.FRONT or (side is Side.SIDE and changing)
            found.append(Contact(other.id, side, depth, at_fault))
    return tuple(found)


def overlap_depth(a: VehicleState, b: VehicleState) -> float:
    """Return the shortest move that separates two bodies [m]; zero or below where they do not overlap.

    Separating axes: two rectangles are disjoint where their shadows on one of their edge directions are.
    """
    dx, dy = _center_offset(a, b)
    cos_a, sin_a = math.cos(a.heading), math.sin(a.heading)
    cos_b, sin_b = math.cos(b.heading), math.sin(b.heading)
    axes = ((cos_a, sin_a), (-sin_a, cos_a), (cos_b, sin_b), (-sin_b, cos_b))
    depth = math.inf
    for ux, uy in axes:
        shadow = 0.5 * (
            a.length * abs(cos_a * ux + sin_a * uy)
            + a.width * abs(cos_a * uy - sin_a * ux)
            + b.length * abs(cos_b * ux + sin_b * uy)
            + b.width * abs(cos_b * uy - sin_b * ux)
        )
        depth = min(depth, shadow - abs(dx * ux + dy * uy))
        if depth <= 0.0:
            break
    return depth


def _center_offset(a: VehicleState, b: VehicleState) -> tuple[float, float]:
    """Return the vector from the centre of body a to the centre of body b [m]."""
    dx = (b.x - 0.5 * b.length * math.cos(b.heading)) - (a.x - 0.5 * a.length * math.cos(a.heading))
    dy = (b.y - 0.5 * b.length * math.sin(b.heading)) - (a.y - 0.5 * a.length * math.sin(a.heading))
    return dx, dy


def _touched_side(ego: VehicleState, other: VehicleState) -> Side:
    """Return the side of the ego that points at the other body, measured in the bodies' own extents.

    The least penetration would take a fast rear-end contact for a side contact, once a step carries the ego
    further into the other body than a vehicle is wide.
    """
    dx, dy = _center_offset(ego, other)
    cos, sin = math.cos(ego.heading), math.sin(ego.heading)
    along, across = dx * cos + dy * sin, dy * cos - dx * sin
    if abs(along) / (ego.length + other.length) < abs(across) / (ego.width + other.width):
        return Side.SIDE
    return Side.FRONT if along >= 0.0 else Side.REAR
