"""Which edges of a network are the road, in the order of x, and what leads onto it and off it."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from sumo_hmdp.domain.road import Road
from sumo_hmdp.sim.net_xml import Connection, Edge, Lane, Net

# netconvert writes two decimals: a number is off by half of the last one at most [m].
ROUNDING = 0.005
SAME = 1e-6


@dataclass(frozen=True)
class Layout:
    """A network seen from the road.

    Attributes:
        net: edges and connections.
        road: what the road should be.
        main: the edges of the road along x.
    """

    net: Net
    road: Road
    main: tuple[Edge, ...]

    @cached_property
    def numbers(self) -> dict[str, int]:
        """The number of each lane of the road, by SUMO's name of it."""
        return {lane.id: self.road.lane_at(lane.shape[0][1]) for edge in self.main for lane in self.lanes_of(edge)}

    def lanes_of(self, edge: Edge) -> list[Lane]:
        """Return the lanes of an edge that are lanes of the road.

        One that passenger cars may not use is a lane where it has a lane's width and place, as a bus lane; a sidewalk
        or a bicycle lane beside the road is none.
        """
        return [lane for lane in edge.lanes if lane.is_open or self.fits(lane)]

    def fits(self, lane: Lane) -> bool:
        """Tell whether a lane has the width of a lane of the road, and begins where one is."""
        return abs(lane.width - self.road.lane_width) <= ROUNDING + SAME and any(
            abs(lane.shape[0][1] - self.road.center_y(number)) <= self.tolerance(number)
            for number in range(1, self.road.lane_count + 1)
        )

    def tolerance(self, number: int) -> float:
        """Return by how much y of a lane's centre may differ from the road's [m].

        The centre is rounded, and so is the width that a scenario may have taken from the network.
        """
        return ROUNDING * (1.0 + abs((self.road.lane_count + 1) / 2 - number)) + SAME

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The edges of the road by name."""
        return tuple(edge.id for edge in self.main)

    def names_from(self, edge: str) -> tuple[str, ...]:
        """Return the edges of the road from one of them to the last."""
        return self.names[self.names.index(edge) :]

    def names_to(self, edge: str) -> tuple[str, ...]:
        """Return the edges of the road from the first to one of them."""
        return self.names[: self.names.index(edge) + 1]

    @cached_property
    def entries(self) -> list[list[Connection]]:
        """The connections onto the road, in the order of x, together where they come from the same edge."""
        return self._groups(lambda link: link.to in self.names and link.edge not in self.names)

    @cached_property
    def exits(self) -> list[list[Connection]]:
        """The connections off the road, in the order of x, together where they lead from one edge to one other."""
        return self._groups(lambda link: link.edge in self.names and link.to not in self.names)

    def _groups(self, wanted: Callable[[Connection], bool]) -> list[list[Connection]]:
        groups: dict[tuple[str, str], list[Connection]] = {}
        for link in filter(wanted, self.net.connections):
            groups.setdefault((link.edge, link.to), []).append(link)

        def place(key: tuple[str, str]) -> int:
            return next(self.names.index(edge) for edge in key if edge in self.names)

        return [groups[key] for key in sorted(groups, key=place)]

    def leaving(self, edge: str) -> list[Connection]:
        """Return the connections that come from an edge."""
        return [link for link in self.net.connections if link.edge == edge]

    def straight(self, number: int) -> list[Connection]:
        """Return the connections from an edge of the road, by its place along x, to the next one."""
        return [link for link in self.leaving(self.names[number]) if link.to == self.names[number + 1]]

    def chain(self, edge: str, *, forward: bool) -> tuple[str, ...]:
        """Return an edge beside the road and, in driving order, those that it alone leads to, or comes from."""
        found = [edge]
        while True:
            last = found[-1]
            links = self.net.connections
            near = {link.to for link in links if link.edge == last} if forward else set()
            near |= set() if forward else {link.edge for link in links if link.to == last}
            if len(near) != 1 or not near.isdisjoint((*found, *self.names)):
                return tuple(found if forward else reversed(found))
            found += near


def layout_of(net: Net, road: Road) -> Layout:
    """Return a network's layout: the road is every edge with a lane that begins and ends within the road's width.

    An only edge is taken for the road wherever it is.
    """
    half = 0.5 * road.lane_count * (road.lane_width + ROUNDING) + SAME

    def along(edge: Edge) -> bool:
        return any(
            lane.is_open and abs(lane.shape[0][1]) <= half and abs(lane.shape[-1][1]) <= half for lane in edge.lanes
        )

    main = [edge for edge in net.edges.values() if len(net.edges) == 1 or along(edge)]
    return Layout(net, road, tuple(sorted(main, key=lambda edge: edge.reach)))
