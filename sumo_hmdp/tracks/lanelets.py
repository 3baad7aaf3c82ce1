"""Lanelets: pieces of lanes with two bounds each, and the roads that neighbours and successors make of them."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from sumo_hmdp.tracks.shape import FloatArray

# Bounds of consecutive lanelets that are this near are one point [m].
_SAME = 0.05


@dataclass(frozen=True)
class Lanelet:
    """A piece of a lane.

    Attributes:
        id: its name.
        left: (n, 2) points of its left bound in driving direction [m].
        right: (m, 2) points of its right bound [m].
        beside_left: the neighbour on the left that is driven in the same direction, None for none.
        beside_right: that on the right.
        after: its successors.
        before: its predecessors.
    """

    id: str
    left: FloatArray
    right: FloatArray
    beside_left: str | None = None
    beside_right: str | None = None
    after: tuple[str, ...] = ()
    before: tuple[str, ...] = ()


# The lanelets of one cross section of a road, from left to right.
Section = tuple[str, ...]


def section_of(lanelets: Mapping[str, Lanelet], name: str) -> Section:
    """Return the lanelets beside one, itself too, from left to right."""
    found = [name]
    for beside, at_end in (("beside_left", False), ("beside_right", True)):
        current = name
        while (following := getattr(lanelets[current], beside)) in lanelets and following not in found:
            found.insert(len(found) if at_end else 0, following)
            current = following
    return tuple(found)


def roads(lanelets: Mapping[str, Lanelet]) -> Iterator[tuple[Section, ...]]:
    """Yield every road: consecutive sections with the same lanes, each continued as far as all its lanes go on."""
    seen: set[tuple[Section, ...]] = set()
    for section in dict.fromkeys(section_of(lanelets, name) for name in lanelets):
        road = road_of(lanelets, section)
        if road not in seen:
            seen.add(road)
            yield road


def road_of(lanelets: Mapping[str, Lanelet], section: Section) -> tuple[Section, ...]:
    """Return the road of which a section is a part."""
    road = [section]
    for links, at_end in (("after", True), ("before", False)):
        current = section
        while (following := _continued(lanelets, current, links)) is not None and following not in road:
            road.insert(len(road) if at_end else 0, following)
            current = following
    return tuple(road)


def _continued(lanelets: Mapping[str, Lanelet], section: Section, links: str) -> Section | None:
    """Return the section after (or before) one, None where a lane ends, or does not stay beside its neighbour."""
    choices = []
    for first in getattr(lanelets[section[0]], links):
        following, current = [first], first
        for name in section[1:]:
            right = lanelets[current].beside_right if current in lanelets else None
            if right is None or right not in getattr(lanelets[name], links):
                break
            following.append(right)
            current = right
        if len(following) == len(section) and all(name in lanelets for name in following):
            choices.append(tuple(following))
    if not choices:
        return None
    return min(choices, key=lambda choice: _turn(lanelets[section[0]], lanelets[choice[0]]))


def _turn(a: Lanelet, b: Lanelet) -> float:
    """Return the angle between two lanelets from end to end [rad]."""
    first, second = a.left[-1] - a.left[0], b.left[-1] - b.left[0]
    cross = first[0] * second[1] - first[1] * second[0]
    return float(abs(np.arctan2(cross, first @ second)))


def lane_lines(lanelets: Mapping[str, Lanelet], road: tuple[Section, ...]) -> list[FloatArray]:
    """Return the lane lines of a road from left to right; between two lanes, the right bound of the left one."""
    lines = [_joined([lanelets[section[0]].left for section in road])]
    rights = range(len(road[0]))
    return [*lines, *(_joined([lanelets[section[lane]].right for section in road]) for lane in rights)]


def _joined(pieces: list[FloatArray]) -> FloatArray:
    points = pieces[0]
    for piece in pieces[1:]:
        skip = 1 if np.hypot(*(piece[0] - points[-1])) < _SAME else 0
        points = np.concatenate([points, piece[skip:]])
    return points
