"""Where the ego would have to give way: refused, since nothing in this package yields to a stream that crosses.

The right of way is the junction's own (`<request response=...>`), and at a signal what its letters say of it: an ego
whose link has g, o or s gives way to those of the links before its own that are not stopped in the same phase.
"""

from collections.abc import Iterable, Iterator

from sumo_hmdp.errors import Problem
from sumo_hmdp.sim.net_layout import Layout
from sumo_hmdp.sim.net_xml import Connection, Junction

# SUMO's letters of a signal: stop, stop unless it is too late, go, and go after those that have priority.
STOPS, AMBER, GOES, YIELDS = "rRuU", "yY", "GO", "gos"
_LETTERS = STOPS + AMBER + GOES + YIELDS


def right_of_way_mistakes(layout: Layout) -> Iterator[Problem]:
    """Yield where the way along the road gives way to another stream, and signals that cannot be read."""
    yield from _program_mistakes(layout)
    for number in range(len(layout.main) - 1):
        found: dict[tuple[str, ...], str] = {}
        for link in layout.straight(number):
            for text in _yields(layout, link):
                found.setdefault((link.signal or "", text), link.lane)
        for (_, text), lane in found.items():
            yield Problem("network", f"lane {lane} of the road must have the right of way, got {text}.")
    yield from _offset_mistakes(layout)


def _program_mistakes(layout: Layout) -> Iterator[Problem]:
    for number in range(len(layout.main) - 1):
        links = [link for link in layout.leaving(layout.names[number]) if link.signal is not None]
        for name in sorted({str(link.signal) for link in links}):
            most = max((link.link or 0 for link in links if link.signal == name), default=0)
            states = layout.net.programs.get(name, ())
            if not states:
                yield Problem("network", f"signal {name} must have a program with phases, got none.")
            for state in states:
                wrong = sorted(set(state) - set(_LETTERS))
                if len(state) <= most:
                    yield Problem("network", f"signal {name} must have a letter for link {most}, got {state!r}.")
                elif wrong:
                    message = f"signal {name} must have letters of {_LETTERS}, got {wrong[0]!r} in {state!r}."
                    yield Problem("network", message)


def _yields(layout: Layout, link: Connection) -> Iterator[str]:
    """Yield in words the streams that a connection of the road has to let pass, at most one of each phase."""
    foes = _foes(layout, link)
    if link.signal is None:
        if foes:
            foe = foes[0]
            yield f"priority of the way from {foe.edge} to {foe.to}, which an ego that cannot yield would ignore"
        return
    for state in layout.net.programs.get(link.signal, ()):
        if link.link is None or len(state) <= link.link or state[link.link] not in YIELDS:
            continue
        crossing = next((foe for foe in foes if _moves(foe, link, state)), None)
        if crossing is not None:
            where = f"letter {state[link.link]!r} in state {state!r} of signal {link.signal}"
            foe_way = f"the way from {crossing.edge} to {crossing.to} goes"
            yield f"{where} while {foe_way}; an ego that cannot yield would ignore it. Give it a phase of its own"
            return


def _moves(foe: Connection, link: Connection, state: str) -> bool:
    """Tell whether vehicles may come from a connection in a state of a signal."""
    controlled = foe.signal == link.signal and foe.link is not None and foe.link < len(state)
    return not controlled or state[foe.link or 0] not in STOPS


def _foes(layout: Layout, link: Connection) -> list[Connection]:
    """Return the connections from other edges that one of the road gives way to."""
    junction = layout.net.junctions.get(layout.net.edges[link.edge].end)
    if junction is None or not any(junction.yields):
        return []
    ways = _links(layout, junction)
    numbers: Iterable[int] = range(len(ways))
    if len(ways) == len(junction.yields) and link in ways:
        numbers = sorted(junction.yields[ways.index(link)])
    # Else who gives way to whom cannot be told: whoever comes from elsewhere may have priority.
    found = (ways[number] for number in numbers if number < len(ways))
    return [way for way in found if way is not None and way.edge != link.edge]


def _links(layout: Layout, junction: Junction) -> list[Connection | None]:
    """Return the connections of a junction in the order of its links, None for those that cars may not take."""
    links = layout.net.connections
    if junction.inner:
        by_via = {link.via: link for link in links if link.via is not None}
        return [by_via.get(name) for name in junction.inner]
    return [link for lane in junction.incoming for link in links if link.lane == lane]


def _offset_mistakes(layout: Layout) -> Iterator[Problem]:
    """Yield stop lines that are farther before a junction with a signal than the ego takes them to be."""
    for number in range(len(layout.main) - 1):
        lanes = {link.lane for link in layout.leaving(layout.names[number]) if link.signal is not None}
        for lane in layout.main[number].lanes:
            if lane.id in lanes and lane.stop_offset > 0.0:
                message = f"lane {lane.id} must have its stop line at its end, got stopOffset {lane.stop_offset:g} m."
                yield Problem("network", f"{message} Take it out, or move the junction's shape.")
