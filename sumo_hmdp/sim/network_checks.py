"""What must hold of a network, so that it can be taken for a straight road."""

from collections.abc import Iterator
from itertools import chain, pairwise

from sumo_hmdp.errors import Problem
from sumo_hmdp.sim.net_layout import SAME, Layout
from sumo_hmdp.sim.net_xml import Edge, Lane

# netconvert writes two decimals.
_ROUNDING = 0.011
_BUILD = 'Build the network with spreadType="center" and --offset.disable-normalization true.'


def road_mistakes(layout: Layout) -> Iterator[Problem]:
    """Yield where the lanes of the network differ from the road's."""
    road = layout.road
    if not layout.main:
        half = 0.5 * road.lane_count * road.lane_width
        yield Problem("lanes", f"the network must have an edge between y = -{half} and {half} m, got none. {_BUILD}")
        return
    tops = [lane.shape[0][1] for edge in layout.main for lane in edge.lanes]
    count = max(round((max(tops) - min(tops)) / road.lane_width) + 1, *(len(edge.lanes) for edge in layout.main))
    widths = {lane.width for edge in layout.main for lane in edge.lanes}
    if count != road.lane_count and all(abs(width - road.lane_width) <= SAME for width in widths):
        yield Problem("lane_count", f"lane_count must equal the network's {count}, got {road.lane_count}.")
        return
    for edge in layout.main:
        for lane in edge.lanes:
            yield from _lane_mistakes(layout, lane)
        yield from _edge_mistakes(edge)


def _lane_mistakes(layout: Layout, lane: Lane) -> Iterator[Problem]:
    road, number = layout.road, layout.numbers[lane.id]
    center = road.center_y(number)
    if not abs(lane.width - road.lane_width) <= SAME:
        message = f"lane_width must equal the network's {lane.width} m (lane {number}), got {road.lane_width} m."
        yield Problem("lane_width", message)
    elif not all(abs(point[1] - center) <= SAME for point in lane.shape) or not lane.shape[0][0] < lane.shape[-1][0]:
        yield Problem(
            "lanes", f"lane {number} must run along y = {center} m with growing x, got {list(lane.shape)}. {_BUILD}"
        )
    elif not abs(lane.shape[-1][0] - lane.shape[0][0] - lane.length) <= _ROUNDING:
        found = lane.shape[-1][0] - lane.shape[0][0]
        message = f"lane {lane.id} must be as long as its shape, {found:g} m, got {lane.length} m; x would be scaled."
        yield Problem("lanes", f"{message} Give the junctions at its ends a shape.")


def _edge_mistakes(edge: Edge) -> Iterator[Problem]:
    if len({(lane.shape[0][0], lane.shape[-1][0]) for lane in edge.lanes}) > 1:
        yield Problem("lanes", f"the lanes of edge {edge.id} must begin and end together. {_BUILD}")
    steps = [left.shape[0][1] - right.shape[0][1] for right, left in pairwise(edge.lanes)]
    if not all(abs(step - edge.lanes[0].width) <= SAME for step in steps):
        yield Problem("lanes", f"the lanes of edge {edge.id} must lie side by side, from right to left. {_BUILD}")


def layout_mistakes(layout: Layout) -> Iterator[Problem]:
    """Yield what is wrong with the ways along the road, onto it and off it, where its lanes are right."""
    for number in range(len(layout.main) - 1):
        yield from _border_mistakes(layout, number)
    for link in layout.leaving(layout.names[-1]):
        yield Problem("network", f"the road must go on behind its last junction, got only an exit to {link.to}.")
    yield from _signal_mistakes(layout)
    yield from _ramp_mistakes(layout)
    known = set(layout.names)
    known |= set(chain.from_iterable(layout.chain(group[0].edge, forward=False) for group in layout.entries))
    known |= set(chain.from_iterable(layout.chain(group[0].to, forward=True) for group in layout.exits))
    for edge in sorted(layout.net.edges.keys() - known):
        yield Problem("network", f"edge {edge} must be the road's, or lead onto it or off it, got none of these.")


def _border_mistakes(layout: Layout, number: int) -> Iterator[Problem]:
    edge, following = layout.main[number], layout.main[number + 1]
    where = f"edge {following.id} must begin where {edge.id} ends or behind, at x = {edge.reach[1]} m"
    if following.reach[0] < edge.reach[1]:
        yield Problem("network", f"{where}, got {following.reach[0]} m.")
    elif not layout.straight(number):
        yield Problem("network", f"a connection must lead from edge {edge.id} to {following.id}, got none.")
    for link in layout.straight(number):
        lane, to_lane = layout.numbers[link.lane], layout.numbers[link.to_lane]
        if lane != to_lane:
            yield Problem("network", f"the connection from lane {lane} of edge {edge.id} must keep it, got {to_lane}.")
        # Otherwise a vehicle would jump over the junction, or be in none of the road's lanes for a moment.
        if (link.via is None) != (following.reach[0] <= edge.reach[1]):
            message = f"a junction must have inner lanes just where it has a length, got {link.via} behind {edge.id}."
            yield Problem("network", f"{message} Without a length build it with --no-internal-links true.")
    for link in layout.leaving(edge.id):
        if link.to in layout.names and link.to != following.id:
            yield Problem("network", f"edge {edge.id} must lead to {following.id}, got {link.to}.")


def _signal_mistakes(layout: Layout) -> Iterator[Problem]:
    for edge, following in pairwise(layout.names):
        links = [link for link in layout.net.connections if edge == link.edge or following == link.to]
        names = {link.signal for link in links}
        if len(names) > 1 or any((link.signal is None) != (link.link is None) for link in links):
            found = sorted(map(str, names))
            yield Problem("network", f"the ways from {edge} or to {following} must have one signal, got {found}.")


def _ramp_mistakes(layout: Layout) -> Iterator[Problem]:
    """Yield ramps that do not become, or come from, one lane that nothing else leads into, or out of."""
    for group in layout.entries:
        fed = [link for link in layout.net.connections if link.to_lane == group[0].to_lane]
        if group[0].signal is None and not len(group) == len(fed) == 1:
            message = f"on-ramp {group[0].edge} must lead into one lane of its own, got {len(group)} ways into it"
            yield Problem("network", f"{message}, or another way into the same lane.")
    for group in layout.exits:
        left = [link for link in layout.net.connections if link.lane == group[0].lane]
        if group[0].signal is None and not len(group) == len(left) == 1:
            message = f"off-ramp {group[0].to} must come from one lane of its own, got {len(group)} ways into it"
            yield Problem("network", f"{message}, or another way out of the same lane.")
