"""The road network of a world: where which lane exists, ramps, signals, and the ways onto the road and off it."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise, takewhile
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sumo_hmdp.domain.road import Road
from sumo_hmdp.errors import InputError
from sumo_hmdp.sim.net_layout import Layout, layout_of
from sumo_hmdp.sim.net_xml import Connection, read_net
from sumo_hmdp.sim.network_checks import layout_mistakes, road_mistakes

_Value = TypeVar("_Value")


@dataclass(frozen=True)
class Stretch:
    """A part of the road on which the same lanes exist all along: an edge, or the inside of a junction.

    Attributes:
        edge: the name of SUMO's edge, None inside a junction.
        x_begin: where it begins [m].
        x_end: where the next one begins, or the road ends [m].
        lane_ids: SUMO's names of lanes 1..n, None where the lane does not exist.
    """

    edge: str | None
    x_begin: float
    x_end: float
    lane_ids: tuple[str | None, ...]

    @property
    def lanes(self) -> tuple[bool, ...]:
        """Whether lanes 1..n exist."""
        return tuple(lane is not None for lane in self.lane_ids)


@dataclass(frozen=True)
class Ramp:
    """A way onto the road, or off it, by a lane of its own and without a signal.

    Attributes:
        name: the edge that meets the road.
        edges: the ramp's edges, in driving order.
        lane: the auxiliary lane that an on-ramp becomes, or an off-ramp comes from.
        x_begin: where the auxiliary lane begins [m].
        x_end: where it ends [m].
        route: edges from the ramp to the end of the road, or from the beginning of the road to the ramp.
    """

    name: str
    edges: tuple[str, ...]
    lane: int
    x_begin: float
    x_end: float
    route: tuple[str, ...]


@dataclass(frozen=True)
class Turn:
    """A way off the road at a signal.

    Attributes:
        name: the edge that it leads to.
        side: to which side of the road.
        lanes: from which lanes it may be taken, from the left.
        links: its places in the signal's state, one for each of these lanes.
        route: edges from the beginning of the road to the end of the side street.
    """

    name: str
    side: Literal["left", "right"]
    lanes: tuple[int, ...]
    links: tuple[int, ...]
    route: tuple[str, ...]


@dataclass(frozen=True)
class Signal:
    """A junction with a traffic light.

    Attributes:
        name: of the traffic light.
        x_stop: where the stop line is [m].
        x_exit: where the junction ends [m].
        straight: for lanes 1..n the place in the light's state, None where the lane does not go straight.
        turns: the ways off the road.
    """

    name: str
    x_stop: float
    x_exit: float
    straight: tuple[int | None, ...]
    turns: tuple[Turn, ...]


@dataclass(frozen=True)
class SideEntry:
    """A way onto the road at a signal.

    Attributes:
        name: the edge of the side street that meets the road.
        signal: name of the traffic light.
        x: where its vehicles are on the road, the end of the junction [m].
        lanes: the lanes it may lead into, from the left.
        links: its places in the signal's state, one for each of these lanes.
        route: edges from the side street to the end of the road.
    """

    name: str
    signal: str
    x: float
    lanes: tuple[int, ...]
    links: tuple[int, ...]
    route: tuple[str, ...]


@dataclass(frozen=True)
class Place:
    """A place on the road as SUMO has it.

    Attributes:
        number: of the edge, along the road.
        lane_index: of the lane, from the right.
        position: of the front bumper on the edge [m].
    """

    number: int
    lane_index: int
    position: float


@dataclass(frozen=True)
class Network:
    """A straight road as SUMO has it.

    Attributes:
        road: its lanes; not each of them need exist everywhere.
        stretches: the road from its beginning to its end, without a gap.
        on_ramps: along x.
        off_ramps: along x.
        signals: along x.
        side_entries: along x.
    """

    road: Road
    stretches: tuple[Stretch, ...]
    on_ramps: tuple[Ramp, ...] = ()
    off_ramps: tuple[Ramp, ...] = ()
    signals: tuple[Signal, ...] = ()
    side_entries: tuple[SideEntry, ...] = ()

    @property
    def x_begin(self) -> float:
        """Where the road begins [m]."""
        return self.stretches[0].x_begin

    @property
    def x_end(self) -> float:
        """Where the road ends, and vehicles leave it [m]."""
        return self.stretches[-1].x_end

    @cached_property
    def route(self) -> tuple[str, ...]:
        """The edges of the road from its beginning to its end."""
        return tuple(stretch.edge for stretch in self.stretches if stretch.edge is not None)

    @cached_property
    def lane_of(self) -> dict[str, int]:
        """The lane number of each of SUMO's lanes that belong to the road, by its name, inside junctions too."""
        numbered = (lane for stretch in self.stretches for lane in enumerate(stretch.lane_ids, 1))
        return {name: number for number, name in numbered if name is not None}

    def place(self, x: float, lane: int) -> "Place":
        """Return where SUMO has a place on the road; inside a junction, the beginning of the edge after it.

        Raises:
            InputError: the lane does not exist there.
        """
        edges = [stretch for stretch in self.stretches if stretch.edge is not None]
        number = next((n for n, edge in enumerate(edges) if x < edge.x_end), None)
        if number is None or x < self.x_begin or not edges[number].lanes[lane - 1]:
            raise InputError([f"lane {lane} must exist at x = {x} m. See networks/README.md"])
        return Place(number, sum(edges[number].lanes[lane:]), max(0.0, x - edges[number].x_begin))

    def in_junction(self, x: ArrayLike) -> NDArray[np.bool_]:
        """Tell which positions x [m] are inside a junction, any shape."""
        positions = np.asarray(x, dtype=float)
        begins, ends = self._junctions
        if not len(begins):
            return np.zeros(positions.shape, dtype=bool)
        positions = positions[..., None]
        return np.asarray(((begins <= positions) & (positions < ends)).any(axis=-1))

    @cached_property
    def _junctions(self) -> NDArray[np.float64]:
        """Where junctions begin and end [m], shape (2, number)."""
        inner = [(stretch.x_begin, stretch.x_end) for stretch in self.stretches if stretch.edge is None]
        return np.array(inner, dtype=float).reshape(-1, 2).T

    def lane_index(self, x: float, lane: int) -> int:
        """Return SUMO's index of a lane at x [m]: how many lanes lie to its right there."""
        return int(self.lane_exists(x)[lane:].sum())

    def lane_exists(self, x: ArrayLike) -> NDArray[np.bool_]:
        """Return which lanes exist at positions x [m], shape (n,): boolean, shape (n, lanes), lane 1 first.

        Beside the road's ends, and where x is not a number, none does.
        """
        positions = np.asarray(x, dtype=float)
        table, edges = self._table
        # NaN is sorted behind every number: it is beside the road.
        return table[np.searchsorted(edges, positions, side="right")]

    @cached_property
    def _table(self) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
        nowhere = [False] * self.road.lane_count
        table = np.array([nowhere, *(stretch.lanes for stretch in self.stretches), nowhere])
        return table, np.array([*(stretch.x_begin for stretch in self.stretches), self.x_end])

    def holds(self, x: float, y: float) -> bool:
        """Tell whether a front centre at (x, y) [m] is on the road, in a lane that exists there."""
        half = 0.5 * self.road.lane_width
        there = next((stretch for stretch in self.stretches if stretch.x_begin <= x < stretch.x_end), None)
        return there is not None and any(
            exists and abs(y - self.road.center_y(lane)) <= half for lane, exists in enumerate(there.lanes, 1)
        )


def read_network(net_file: Path, road: Road) -> Network:
    """Read a built network and check that it is the road; a file that has not changed is read once.

    Raises:
        InputError: it cannot be read, its lanes are not the road's, or an edge has nothing to do with the road.
    """
    try:
        state = net_file.stat()
    except OSError as error:
        raise InputError([f"the network must be readable XML, got: {error}."], str(net_file)) from error
    return _read_network(net_file, road, (state.st_ino, state.st_mtime_ns, state.st_size))


# A run asks for its network five times, and the next run of a study for the same one.
@lru_cache(maxsize=16)
def _read_network(net_file: Path, road: Road, version: tuple[int, ...]) -> Network:
    del version
    layout = layout_of(read_net(net_file), road)
    # What leads where can be told only once every lane is in its place.
    problems = list(road_mistakes(layout)) or list(layout_mistakes(layout))
    if problems:
        raise InputError(problems, str(net_file))
    stretches = tuple(_stretches(layout))
    ramps = [_on_ramp(layout, stretches, group[0]) for group in layout.entries if group[0].signal is None]
    exits = [_off_ramp(layout, stretches, group[0]) for group in layout.exits if group[0].signal is None]
    entries = [_side_entry(layout, group) for group in layout.entries if group[0].signal is not None]
    return Network(road, stretches, tuple(ramps), tuple(exits), tuple(_signals(layout)), tuple(entries))


def _stretches(layout: Layout) -> Iterator[Stretch]:
    for number, edge in enumerate(layout.main):
        x_begin, x_end = edge.reach
        yield Stretch(edge.id, x_begin, x_end, _by_lane(layout, {lane.id: lane.id for lane in edge.lanes}))
        if number + 1 < len(layout.main) and layout.main[number + 1].reach[0] > x_end:
            straight = {link.lane: link.via for link in layout.straight(number)}
            yield Stretch(None, x_end, layout.main[number + 1].reach[0], _by_lane(layout, straight))


def _by_lane(layout: Layout, values: dict[str, _Value]) -> tuple[_Value | None, ...]:
    """Return what belongs to lanes 1..n, given by SUMO's name of the lane."""
    by_number = {layout.numbers[name]: value for name, value in values.items()}
    return tuple(by_number.get(lane) for lane in range(1, layout.road.lane_count + 1))


def _on_ramp(layout: Layout, stretches: tuple[Stretch, ...], link: Connection) -> Ramp:
    edges = layout.chain(link.edge, forward=False)
    lane = layout.numbers[link.to_lane]
    ahead = [stretch for stretch in stretches if stretch.x_begin >= layout.net.edges[link.to].reach[0]]
    own = list(takewhile(lambda stretch: stretch.lanes[lane - 1], ahead))
    return Ramp(link.edge, edges, lane, own[0].x_begin, own[-1].x_end, edges + layout.names_from(link.to))


def _off_ramp(layout: Layout, stretches: tuple[Stretch, ...], link: Connection) -> Ramp:
    edges = layout.chain(link.to, forward=True)
    lane = layout.numbers[link.lane]
    behind = [stretch for stretch in reversed(stretches) if stretch.x_end <= layout.net.edges[link.edge].reach[1]]
    own = list(takewhile(lambda stretch: stretch.lanes[lane - 1], behind))
    return Ramp(link.to, edges, lane, own[-1].x_begin, own[0].x_end, layout.names_to(link.edge) + edges)


def _signals(layout: Layout) -> Iterator[Signal]:
    for number, (edge, following) in enumerate(pairwise(layout.main)):
        name = next((link.signal for link in layout.leaving(edge.id) if link.signal is not None), None)
        if name is not None:
            straight = _by_lane(layout, {link.lane: link.link for link in layout.straight(number)})
            turns = tuple(_turn(layout, group) for group in layout.exits if group[0].edge == edge.id)
            yield Signal(name, edge.reach[1], following.reach[0], straight, turns)


def _turn(layout: Layout, group: list[Connection]) -> Turn:
    edges = layout.chain(group[0].to, forward=True)
    side: Literal["left", "right"] = "left" if layout.net.edges[edges[0]].lanes[0].shape[-1][1] > 0.0 else "right"
    lanes, links = _lanes_and_links({layout.numbers[link.lane]: link.link for link in group})
    return Turn(edges[0], side, lanes, links, layout.names_to(group[0].edge) + edges)


def _side_entry(layout: Layout, group: list[Connection]) -> SideEntry:
    first = group[0]
    edges = layout.chain(first.edge, forward=False)
    lanes, links = _lanes_and_links({layout.numbers[link.to_lane]: link.link for link in group})
    x = layout.net.edges[first.to].reach[0]
    return SideEntry(first.edge, str(first.signal), x, lanes, links, edges + layout.names_from(first.to))


def _lanes_and_links(links: dict[int, int | None]) -> tuple[tuple[int, ...], tuple[int, ...]]:
    known = sorted((lane, link) for lane, link in links.items() if link is not None)
    return tuple(lane for lane, _ in known), tuple(link for _, link in known)
