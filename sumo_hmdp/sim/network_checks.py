"""What must hold of a network, so that it can be taken for a straight road."""

from collections.abc import Iterator
from itertools import chain, pairwise

from sumo_hmdp.errors import Problem
from sumo_hmdp.sim.net_layout import ROUNDING, SAME, Layout
from sumo_hmdp.sim.net_xml import Edge, Lane
from sumo_hmdp.sim.right_of_way import right_of_way_mistakes

# The end of a lane and its length are each rounded to two decimals.
_LENGTH_ROUNDING = 2 * ROUNDING + 1e-3
_BUILD = 'Build the network with spreadType="center" and --offset.disable-normalization true.'


def road_mistakes(layout: Layout) -> Iterator[Problem]:
    """Yield where the lanes of the network differ from the road's."""
    road = layout.road
    shift = _shift(layout)
    if shift is not None:
        yield shift
        return
    if not layout.main:
        half = 0.5 * road.lane_count * road.lane_width
        yield Problem("lanes", f"the network must have an edge between y = -{half} and {half} m, got none. {_BUILD}")
        return
    tops = [lane.shape[0][1] for edge in layout.main for lane in edge.lanes if lane.is_open or layout.fits(lane)]
    widths = {lane.width for edge in layout.main for lane in layout.lanes_of(edge)}
    count = max(round((max(tops) - min(tops)) / road.lane_width) + 1, *(len(layout.lanes_of(e)) for e in layout.main))
    if count != road.lane_count and all(abs(width - road.lane_width) <= ROUNDING + SAME for width in widths):
        yield Problem("lane_count", f"lane_count must equal the network's {count}, got {road.lane_count}.")
        return
    for edge in layout.main:
        for lane in layout.lanes_of(edge):
            yield from _lane_mistakes(layout, lane)
        yield from _edge_mistakes(layout, edge)


def _shift(layout: Layout) -> Problem | None:
    """Return the mistake of a road that is right but for its place across x, None for any other network."""
    road = layout.road
    along = [
        lane
        for edge in layout.net.edges.values()
        for lane in edge.lanes
        if lane.is_open and lane.shape[0][0] < lane.shape[-1][0] and abs(lane.shape[0][1] - lane.shape[-1][1]) <= SAME
    ]
    if not along or not all(abs(lane.width - road.lane_width) <= ROUNDING + SAME for lane in along):
        return None
    ys = [lane.shape[0][1] for lane in along]
    middle = (max(ys) + min(ys)) / 2
    spread, whole = max(ys) - min(ys), (road.lane_count - 1) * road.lane_width
    if abs(spread - whole) > 2 * layout.tolerance(1) or abs(middle) <= layout.tolerance(1):
        return None
    message = f"the middle of the road must be at y = 0, got y = {middle:g} m. Shift it: netconvert -s OLD.net.xml"
    return Problem("lanes", f"{message} --offset.y {-middle:g} -o NEW.net.xml")


def _lane_mistakes(layout: Layout, lane: Lane) -> Iterator[Problem]:
    road, number = layout.road, layout.numbers[lane.id]
    center = road.center_y(number)
    if not abs(lane.width - road.lane_width) <= ROUNDING + SAME:
        message = f"lane_width must equal the network's {lane.width} m (lane {number}), got {road.lane_width} m."
        widths = {other.width for edge in layout.main for other in layout.lanes_of(edge)}
        yield Problem("lane_width", message + " All lanes that cars may use must have one width." * (len(widths) > 1))
    elif (
        not all(abs(point[1] - center) <= layout.tolerance(number) for point in lane.shape)
        or not lane.shape[0][0] < lane.shape[-1][0]
    ):
        yield Problem(
            "lanes", f"lane {number} must run along y = {center} m with growing x, got {list(lane.shape)}. {_BUILD}"
        )
    elif not abs(lane.shape[-1][0] - lane.shape[0][0] - lane.length) <= _LENGTH_ROUNDING:
        found = lane.shape[-1][0] - lane.shape[0][0]
        message = f"lane {lane.id} must be as long as its shape, {found:g} m, got {lane.length} m; x would be scaled."
        slopes = len({point[2] if len(point) > 2 else 0.0 for point in lane.shape}) > 1
        yield Problem(
            "lanes",
            message
            + (" Take the slope out (z in its shape)." if slopes else " Give the junctions at its ends a shape."),
        )


def _edge_mistakes(layout: Layout, edge: Edge) -> Iterator[Problem]:
    lanes = layout.lanes_of(edge)
    ends = [(lane.shape[0][0], lane.shape[-1][0]) for lane in lanes]
    if any(max(place) - min(place) > 2 * ROUNDING + SAME for place in zip(*ends, strict=True)):
        yield Problem("lanes", f"the lanes of edge {edge.id} must begin and end together. {_BUILD}")
    if any(layout.numbers[right.id] != layout.numbers[left.id] + 1 for right, left in pairwise(lanes)):
        yield Problem("lanes", f"the lanes of edge {edge.id} must lie side by side, from right to left. {_BUILD}")
    if edge.opposite is not None:
        message = f"edge {edge.id} must be one-way, got {edge.opposite} as its other direction, into which SUMO may"
        yield Problem("network", f"{message} overtake. Build it without.")


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
    lost = sorted(layout.net.edges.keys() - known)
    if lost:
        others = f" and {len(lost) - 1} more" if len(lost) > 1 else ""
        message = f"edge {lost[0]}{others} must be the road's, or lead onto it or off it, got none of these."
        yield Problem("network", message)
    half = 0.5 * layout.road.lane_count * layout.road.lane_width
    for edge in layout.net.closed:
        x_begin, x_end = edge.reach
        inside = all(abs(lane.shape[n][1]) <= half for lane in edge.lanes[:1] for n in (0, -1))
        if inside and layout.main[0].reach[0] <= x_begin < x_end <= layout.main[-1].reach[1]:
            yield Problem(
                "network", f"edge {edge.id} of the road must be open to passenger cars, got none of its lanes."
            )
    yield from _inner_mistakes(layout)
    yield from right_of_way_mistakes(layout)


def _border_mistakes(layout: Layout, number: int) -> Iterator[Problem]:
    edge, following = layout.main[number], layout.main[number + 1]
    where = f"edge {following.id} must begin where {edge.id} ends or behind, at x = {edge.reach[1]} m"
    if following.reach[0] < edge.reach[1] - 2 * ROUNDING - SAME:
        yield Problem("network", f"{where}, got {following.reach[0]} m.")
    elif not layout.straight(number):
        yield Problem("network", f"a connection must lead from edge {edge.id} to {following.id}, got none.")
    for link in layout.straight(number):
        lane, to_lane = layout.numbers[link.lane], layout.numbers[link.to_lane]
        if lane != to_lane:
            yield Problem("network", f"the connection from lane {lane} of edge {edge.id} must keep it, got {to_lane}.")
        # Otherwise a vehicle would jump over the junction, or be in none of the road's lanes for a moment.
        if (link.via is None) != (following.reach[0] <= edge.reach[1] + 2 * ROUNDING + SAME):
            message = f"a junction must have inner lanes just where it has a length, got {link.via} behind {edge.id}."
            remedy = (
                "Without a length build it again: netconvert -s OLD.net.xml --no-internal-links true -o NEW.net.xml"
            )
            yield Problem("network", f"{message} {remedy}")
    for link in layout.leaving(edge.id):
        if link.to in layout.names and link.to != following.id:
            yield Problem("network", f"edge {edge.id} must lead to {following.id}, got {link.to}.")


def _inner_mistakes(layout: Layout) -> Iterator[Problem]:
    """Yield lanes inside junctions that are not the lanes of the road, gone straight on."""
    for number in range(len(layout.main) - 1):
        for link in layout.straight(number):
            lane = layout.net.inner.get(link.via or "")
            center = layout.road.center_y(layout.numbers[link.lane])
            tolerance = layout.tolerance(layout.numbers[link.lane])
            if lane is not None and not all(abs(point[1] - center) <= tolerance for point in lane.shape):
                message = f"lane {lane.id} inside a junction must run along y = {center:g} m, got {list(lane.shape)}."
                yield Problem("network", message)


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
