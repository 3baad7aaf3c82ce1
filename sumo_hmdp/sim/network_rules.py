"""What the lanes of a road forbid, from the attributes of SUMO's lanes, and how that is told."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from sumo_hmdp.domain.maneuver import Lateral
from sumo_hmdp.domain.road_rules import NoChange, RoadRules, SpeedZone
from sumo_hmdp.sim.net_layout import Layout
from sumo_hmdp.sim.network_parts import LanePart, Stretch

if TYPE_CHECKING:
    from sumo_hmdp.sim.network import Network


def rules_of(stretches: Sequence[Stretch]) -> RoadRules:
    """Return the rules of a road; neighbouring stretches with one rule are one."""
    lanes = range(1, len(stretches[0].lane_parts) + 1)
    zones = [
        SpeedZone(lane, x_begin, x_end, limit)
        for lane in lanes
        for x_begin, x_end, limit in _runs(stretches, [_limit(s.lane_parts[lane - 1]) for s in stretches])
        if limit < math.inf
    ]
    bans = [
        NoChange(lane, lateral, x_begin, x_end)
        for lane in lanes
        for lateral in (Lateral.LEFT, Lateral.RIGHT)
        for x_begin, x_end, banned in _runs(stretches, [_is_banned(s, lane, lateral) for s in stretches])
        if banned
    ]
    return RoadRules(tuple(zones), tuple(bans))


def rules_in_force(network: "Network", speed_limit: float | None) -> RoadRules:
    """Return the rules of a network, with one speed limit for the whole road where one is given [m/s]."""
    if speed_limit is None:
        return network.rules
    lanes = range(1, network.road.lane_count + 1)
    zones = tuple(SpeedZone(lane, network.x_begin, network.x_end, speed_limit) for lane in lanes)
    return replace(network.rules, speed_zones=zones)


def _runs(stretches: Sequence[Stretch], values: Sequence[float]) -> Iterator[tuple[float, float, float]]:
    """Yield where the stretches have one value all along: from, to and the value."""
    begin = stretches[0].x_begin
    for number, (stretch, value) in enumerate(zip(stretches, values, strict=True)):
        if number + 1 == len(stretches) or values[number + 1] != value:
            yield begin, stretch.x_end, value
            begin = stretch.x_end


def _limit(part: LanePart | None) -> float:
    return math.inf if part is None or not part.is_open else part.speed_limit


def _is_banned(stretch: Stretch, lane: int, lateral: Lateral) -> bool:
    """Tell whether a change is forbidden on a stretch: by the lane, or because the one beside it is closed."""
    part = stretch.lane_parts[lane - 1]
    beside = lane + lateral
    if part is None or not 1 <= beside <= len(stretch.lane_parts):
        return False
    other = stretch.lane_parts[beside - 1]
    if other is None:
        return False
    return not other.is_open or not (part.left if lateral is Lateral.LEFT else part.right)


def lane_notes(stretches: Sequence[Stretch], layout: Layout) -> Iterator[str]:
    """Yield in words which lanes are closed and where no lane may be changed, and what lies beside the road."""
    lanes = range(1, len(stretches[0].lane_parts) + 1)
    for lane in lanes:
        for x_begin, x_end, closed in _runs(stretches, [_is_closed(s.lane_parts[lane - 1]) for s in stretches]):
            if closed:
                yield f"lane {lane}: closed to passenger cars from {x_begin:g} to {x_end:g} m; nobody drives there"
    for lane in lanes:
        for lateral in (Lateral.LEFT, Lateral.RIGHT):
            for x_begin, x_end, solid in _runs(stretches, [_is_solid(s, lane, lateral) for s in stretches]):
                if solid:
                    yield f"lane {lane}: no change to the {lateral.label} from {x_begin:g} to {x_end:g} m; nobody does"
    for edge in layout.main:
        for part in edge.lanes:
            if part.id not in layout.numbers:
                yield f"lane {part.id}: closed to passenger cars and beside the road; not one of its lanes"
    for edge in layout.net.closed:
        yield f"edge {edge.id}: closed to passenger cars; nobody drives there"


def _is_closed(part: LanePart | None) -> bool:
    return part is not None and not part.is_open


def _is_solid(stretch: Stretch, lane: int, lateral: Lateral) -> bool:
    """Tell whether a line may not be crossed between two lanes that are both open."""
    beside = lane + lateral
    if not 1 <= beside <= len(stretch.lane_parts):
        return False
    return stretch.lanes[lane - 1] and stretch.lanes[beside - 1] and _is_banned(stretch, lane, lateral)
