"""The road network of a world: where which lane exists, ramps, signals, and the ways onto the road and off it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from itertools import pairwise, takewhile
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.road_rules import RoadRules
from sumo_hmdp.errors import InputError, Problem
from sumo_hmdp.sim.net_layout import ROUNDING, SAME, Layout, layout_of
from sumo_hmdp.sim.net_notes import notes_of
from sumo_hmdp.sim.net_shape import left_hand_mistakes, shape_mistake
from sumo_hmdp.sim.net_xml import Connection, Lane, parse_net, read_root
from sumo_hmdp.sim.network_checks import layout_mistakes, road_mistakes
from sumo_hmdp.sim.network_parts import LanePart, Place, Ramp, SideEntry, Signal, Stretch, Turn
from sumo_hmdp.sim.network_rules import lane_notes, rules_of

__all__ = ["LanePart", "Network", "Place", "Ramp", "SideEntry", "Signal", "Stretch", "Turn", "read_network"]

_Value = TypeVar("_Value")


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
        side_limits: speed limits of the lanes that lead onto the road or off it, by SUMO's names [m/s].
        notes: what the network says that changes how all drive, or that is not used; a line each.
    """

    road: Road
    stretches: tuple[Stretch, ...]
    on_ramps: tuple[Ramp, ...] = ()
    off_ramps: tuple[Ramp, ...] = ()
    signals: tuple[Signal, ...] = ()
    side_entries: tuple[SideEntry, ...] = ()
    side_limits: Mapping[str, float] = field(default_factory=dict, hash=False)
    notes: tuple[str, ...] = ()

    @cached_property
    def rules(self) -> RoadRules:
        """What the network forbids on the road: speeds, and lane changes."""
        return rules_of(self.stretches)

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
        part = edges[number].lane_parts[lane - 1]
        return Place(number, 0 if part is None else part.index, max(0.0, x - edges[number].x_begin))

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
        """Return SUMO's index of a lane at x [m].

        Raises:
            InputError: the lane does not exist there.
        """
        part = next((s.lane_parts[lane - 1] for s in self.stretches if s.x_begin <= x < s.x_end), None)
        if part is None:
            raise InputError([f"lane {lane} must exist at x = {x} m. See networks/README.md"])
        return part.index

    def lane_exists(self, x: ArrayLike) -> NDArray[np.bool_]:
        """Return which lanes cars may use at positions x [m], shape (n,): boolean, shape (n, lanes), lane 1 first.

        One that is closed to passenger cars is as good as none. Beside the road's ends, and where x is no number, there
        is none.
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

    def is_closed(self, x: float, lane: int) -> bool:
        """Tell whether there is a lane at x [m] that passenger cars may not use."""
        part = next((s.lane_parts[lane - 1] for s in self.stretches if s.x_begin <= x < s.x_end), None)
        return part is not None and not part.is_open

    def holds(self, x: float, y: float) -> bool:
        """Tell whether a front centre at (x, y) [m] is on the road, in a lane that cars may use there."""
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
    root = read_root(net_file)
    net = parse_net(root, str(net_file))
    problems = list(left_hand_mistakes(net))
    layout = layout_of(net, road)
    # What leads where can be told only once every lane is in its place.
    problems = problems or list(road_mistakes(layout)) or list(layout_mistakes(layout))
    if problems and not net.left_hand and (shape := shape_mistake(net)) is not None:
        # What is no road at all has a mistake in every lane, none of which helps.
        problems = [shape]
    problems += [Problem("network", text) for text in net.dangling]
    if problems:
        raise InputError(problems, str(net_file))
    stretches = tuple(_stretches(layout))
    ramps = [_on_ramp(layout, stretches, group[0]) for group in layout.entries if group[0].signal is None]
    exits = [_off_ramp(layout, stretches, group[0]) for group in layout.exits if group[0].signal is None]
    entries = [_side_entry(layout, group) for group in layout.entries if group[0].signal is not None]
    beside = [edge for name, edge in net.edges.items() if name not in layout.names]
    return Network(
        road,
        stretches,
        tuple(ramps),
        tuple(exits),
        tuple(_signals(layout)),
        tuple(entries),
        side_limits={lane.id: lane.speed for edge in beside for lane in edge.lanes},
        notes=(*lane_notes(stretches, layout), *notes_of(root)),
    )


def _stretches(layout: Layout) -> Iterator[Stretch]:
    for number, edge in enumerate(layout.main):
        x_begin, x_end = edge.reach
        yield Stretch(
            edge.id, x_begin, x_end, _by_lane(layout, {lane.id: _part(lane) for lane in layout.lanes_of(edge)})
        )
        if number + 1 < len(layout.main) and layout.main[number + 1].reach[0] > x_end + 2 * ROUNDING + SAME:
            straight = {link.lane: _inner_part(layout, link) for link in layout.straight(number)}
            yield Stretch(None, x_end, layout.main[number + 1].reach[0], _by_lane(layout, straight))


def _part(lane: Lane) -> LanePart:
    return LanePart(lane.id, lane.index, lane.speed, lane.is_open, lane.left, lane.right)


def _inner_part(layout: Layout, link: Connection) -> LanePart | None:
    """Return the lane inside a junction by which a connection leads."""
    lane = None if link.via is None else layout.net.inner.get(link.via)
    return None if lane is None else _part(lane)


def _by_lane(layout: Layout, values: Mapping[str, _Value | None]) -> tuple[_Value | None, ...]:
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
