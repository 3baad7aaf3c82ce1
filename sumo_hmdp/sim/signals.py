"""Which stop lines are closed to the ego: red, amber it can stop for, an exit that is blocked, a lane that ends."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import StopLine, VehicleState
from sumo_hmdp.errors import SimulationError
from sumo_hmdp.sim.network import Signal
from sumo_hmdp.sim.right_of_way import AMBER, GOES, STOPS, YIELDS
from sumo_hmdp.sim.routes import Routes

# Who has to brake harder than this after a second of reaction may pass at amber: 10 ft/s2 and 1 s are the values from
# which traffic engineers time it (Institute of Transportation Engineers).
_AMBER_DECEL, _AMBER_REACTION = 3.05, 1.0
# The front bumper stops so far before the line, as SUMO's own vehicles do [m].
_BEFORE_LINE = 1.0
# Who cannot stop there any more stops so far before the line at least: tracking does not hold a place exactly [m].
_SPARE = 0.1
# Who has to leave a lane that ends stops so far before its end that it can start and change lanes before it: the way of
# a lane change of 4 s from rest with 3 m/s2, as the ego's planner in town starts and changes lanes [m].
_MERGING_ROOM = 0.5 * 3.0 * 4.0**2
# A vehicle slower than this may come to rest where it is [m/s].
_CRAWLS = 5.0
# A vehicle slower than this stands [m/s].
_STANDS = 0.1
# Between the rear bumper of the ego and the junction, and its front bumper and the vehicle ahead of it, at rest [m].
_ROOM = 2.0
# Lines farther ahead are nobody's concern yet [m].
_SIGHT = 250.0
# Nobody enters a lane that ends within this, as the traffic looks ahead for its lane, 30 s at 50 km/h [m].
_ROUTE_SIGHT = 417.0


@dataclass(frozen=True)
class Breaches:
    """Rules that the ego broke in one step.

    Attributes:
        red_light: it passed a stop line at red.
        junction_stop: it stands inside a junction.
    """

    red_light: bool = False
    junction_stop: bool = False


def closed_lines(
    routes: Routes,
    lights: Mapping[str, str],
    ego: VehicleState,
    others: Iterable[VehicleState],
    told: Sequence[StopLine] = (),
) -> tuple[StopLine, ...]:
    """Return the lines that are closed to the ego now.

    A line at amber, or before a blocked exit, is closed where the ego can stop before it as traffic engineers assume,
    or was told before. So who has been told to stop is not let through because it has come near in the meantime.
    Lanes that do not lead along the road are closed where they end, and to who intends one of them a merging room
    before that; to an ego that is not in one of them, from where it is, so that it does not enter a lane that it would
    have to leave. So are lanes that do not exist where it is.

    Args:
        routes: of the network.
        lights: the state of every traffic light by its name, SUMO's letter for each link.
        ego: now.
        others: who drives along the road.
        told: the lines that were closed when the ego last decided.
    """
    signal = next((s for s in routes.network.signals if s.x_stop > ego.x), None)
    closed: dict[tuple[float, float | None], set[int]] = {}
    for index in np.flatnonzero(~routes.network.lane_exists([ego.x])[0]).tolist():
        # Whose body still is over a lane that it has left in time may go on.
        if not _in_lane(routes.network.road, ego, index + 1):
            closed.setdefault((ego.x, None), set()).add(index + 1)
    for index, end in enumerate(routes.lane_ends(None, np.array([ego.x]))[0].tolist()):
        if not ego.x < end <= ego.x + _ROUTE_SIGHT:
            continue
        if not _in_lane(routes.network.road, ego, index + 1):
            closed.setdefault((ego.x, None), set()).add(index + 1)
        elif end <= ego.x + _SIGHT:
            mine = [line for line in told if index + 1 in line.lanes]
            closed.setdefault(_places_of_an_end(ego, end, mine), set()).add(index + 1)
    if signal is not None and signal.x_stop <= ego.x + _SIGHT:
        ahead = list(others)
        held = {lane for line in told if signal.x_stop - _BEFORE_LINE <= line.x <= signal.x_stop for lane in line.lanes}
        for lane, link in enumerate(signal.straight, 1):
            if link is not None and _closes(signal, lane, lights[signal.name][link], ego, ahead, held):
                closed.setdefault((_stopping_place(ego, signal.x_stop, told), None), set()).add(lane)
    places = sorted(closed, key=lambda place: place[0])
    return tuple(StopLine(frozenset(closed[place]), *place) for place in places)


def _places_of_an_end(ego: VehicleState, end: float, told: Sequence[StopLine]) -> tuple[float, float]:
    """Return where the ego is to stop before the end of a lane that it is in, and where while it leaves that lane [m].

    Who is beyond the first place is to stop as soon as it can: the more room is left, the better.
    """
    leaving = _stopping_place(ego, end, told)
    return min(leaving, _stopping_place(ego, end, told, _BEFORE_LINE + _MERGING_ROOM)), leaving


def _stopping_place(ego: VehicleState, x_stop: float, told: Sequence[StopLine], room: float = _BEFORE_LINE) -> float:
    """Return where the ego is to stop before a line, as a rule with some room left [m].

    Who is a little beyond that place has not passed the line: it is to stop as soon as it can, and to stay there.
    """
    place = x_stop - room
    if ego.x <= place:
        return place
    before = [line.x for line in told if ego.x <= line.x <= x_stop]
    return min([max(ego.x, x_stop - _SPARE), *(before or [ego.x + _needed(ego.speed)])])


def _in_lane(road: Road, ego: VehicleState, lane: int) -> bool:
    """Tell whether the ego is in a lane, intends it, or has not left it yet."""
    return ego.lane == lane or abs(ego.y - road.center_y(lane)) < 0.5 * (road.lane_width + ego.width)


def _closes(
    signal: Signal, lane: int, letter: str, ego: VehicleState, others: Iterable[VehicleState], held: set[int]
) -> bool:
    """Tell whether a lane's line is closed; `held` are the lanes for which it was when the ego last decided."""
    if letter in STOPS:
        return True
    if letter not in AMBER + GOES + YIELDS:
        raise SimulationError(f"signal {signal.name} must show a letter of SUMO's, got {letter!r} for lane {lane}.")
    # Where it would have to yield to somebody, the network has been refused.
    return (lane in held or _can_stop(ego, signal.x_stop)) and (letter in AMBER or _blocked(signal, lane, ego, others))


def _can_stop(ego: VehicleState, x_stop: float) -> bool:
    return ego.speed < _STANDS or ego.x + _needed(ego.speed) <= x_stop - _BEFORE_LINE


def _needed(speed: float) -> float:
    """Return how far a driver goes until it rests [m]."""
    return speed * _AMBER_REACTION + speed**2 / (2.0 * _AMBER_DECEL)


def _blocked(signal: Signal, lane: int, ego: VehicleState, others: Iterable[VehicleState]) -> bool:
    """Tell whether the ego might have to stand inside the junction.

    It would stand behind somebody slow beyond the line, and behind everybody between who takes up room there too.
    """
    room = math.inf
    ahead = sorted((v for v in others if v.lane == lane and v.x > ego.x), key=lambda v: v.x, reverse=True)
    for vehicle in ahead:
        room -= vehicle.length + _ROOM
        if vehicle.x > signal.x_stop and vehicle.speed < _CRAWLS:
            room = min(room, vehicle.x - vehicle.length - _ROOM)
    return room - ego.length < signal.x_exit


def breaches(
    routes: Routes, lights: Mapping[str, str], before: VehicleState, after: VehicleState, lane: int
) -> Breaches:
    """Return the rules that a step of the ego broke.

    Args:
        routes: of the network.
        lights: the state of every traffic light during the step.
        before: the ego at its beginning.
        after: the ego at its end.
        lane: in which its front bumper is.
    """
    red, stands = False, False
    for signal in routes.network.signals:
        link = signal.straight[lane - 1]
        if before.x <= signal.x_stop < after.x:
            red |= link is None or lights[signal.name][link] in STOPS
        inside = after.x > signal.x_stop and after.x - after.length < signal.x_exit
        stands |= inside and after.speed < _STANDS
    return Breaches(red, stands)
