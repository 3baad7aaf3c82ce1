"""Where vehicles come from and go to: their edges, and the lanes that take them there."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.sim.network import Network, Ramp, SideEntry

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Exit:
    """A way off the road before its end.

    Attributes:
        name: the edge it leads to.
        x: where the road has to be left [m].
        lanes: from which lanes it can be taken.
        route: edges from the beginning of the road to beyond the exit.
    """

    name: str
    x: float
    lanes: tuple[int, ...]
    route: tuple[str, ...]


@dataclass(frozen=True)
class Routes:
    """The routes of a network.

    Attributes:
        network: the network.
    """

    network: Network

    @cached_property
    def exits(self) -> Mapping[str, Exit]:
        """Every way off the road by its name, along x."""
        found = [Exit(ramp.name, ramp.x_end, (ramp.lane,), ramp.route) for ramp in self.network.off_ramps]
        for signal in self.network.signals:
            found += [Exit(turn.name, signal.x_stop, turn.lanes, turn.route) for turn in signal.turns]
        return {way.name: way for way in sorted(found, key=lambda way: (way.x, way.name))}

    @cached_property
    def entries(self) -> Mapping[str, Ramp | SideEntry]:
        """Every way onto the road by its name."""
        ways: list[Ramp | SideEntry] = [*self.network.on_ramps, *self.network.side_entries]
        return {way.name: way for way in ways}

    @cached_property
    def needed(self) -> bool:
        """Tell whether a lane ends anywhere, or somebody may want to leave."""
        return bool(self.exits) or bool(np.isfinite(self._ends[None]).any())

    @cached_property
    def lines(self) -> bool:
        """Tell whether a stop line may ever be closed: a lane ends or is closed, somebody turns off, or a signal."""
        lanes = (lane for stretch in self.network.stretches for lane in stretch.lane_parts)
        return self.needed or bool(self.network.signals) or any(lane is not None and not lane.is_open for lane in lanes)

    @cached_property
    def crossed(self) -> bool:
        """Tell whether vehicles may come near the road without driving along it."""
        return self.needed or bool(self.entries)

    def edges(self, number: int, exit_name: str | None) -> tuple[str, ...]:
        """Return the edges from the main edge with a number to an exit, or to the end of the road."""
        route = self.network.route if exit_name is None else self.exits[exit_name].route
        return route[number:]

    def entry_edges(self, entry: str, exit_name: str | None) -> tuple[str, ...]:
        """Return the edges from a way onto the road to an exit, or to the end of the road."""
        main = self.network.route
        own = [edge for edge in self.entries[entry].route if edge not in main]
        return (*own, *self.edges(main.index(self.entries[entry].route[len(own)]), exit_name))

    def turn_of(self, x_stop: float, lane: int) -> str | None:
        """Return the exit that a lane serves where the road ends for it at x_stop [m], None where there is none."""
        return next((way.name for way in self.exits.values() if way.x == x_stop and lane in way.lanes), None)

    def lane_ends(self, exit_name: str | None, x: FloatArray) -> FloatArray:
        """Return where each lane ends for vehicles with one exit.

        Args:
            exit_name: None goes to the end of the road.
            x: front bumpers [m], shape (n,).

        Returns:
            x of the ends [m], shape (n, lanes); infinite where a lane goes on, or does not exist here.
        """
        table = self._ends[exit_name]
        return table[np.searchsorted(self._borders, x, side="right")]

    @cached_property
    def _borders(self) -> FloatArray:
        return np.array([stretch.x_begin for stretch in self.network.stretches])

    @cached_property
    def _ends(self) -> dict[str | None, FloatArray]:
        return {name: self._table(name) for name in (None, *self.exits)}

    def _table(self, exit_name: str | None) -> FloatArray:
        """Return the ends by stretch, from the back: a lane ends where the next stretch does not go on with it."""
        network = self.network
        way = None if exit_name is None else self.exits[exit_name]
        no_straight = {signal.x_stop: [link is None for link in signal.straight] for signal in network.signals}
        rows = []
        onward = np.full(network.road.lane_count, np.inf)
        following: tuple[bool, ...] = (True,) * network.road.lane_count
        for stretch in reversed(network.stretches):
            blocked = np.array(no_straight.get(stretch.x_end, [False] * len(following)))
            stops = ~np.array(following) | blocked
            ends = np.where(stops, stretch.x_end, onward)
            if way is not None and stretch.x_end == way.x:
                serves = np.isin(np.arange(1, len(ends) + 1), way.lanes)
                ends = np.where(serves, np.inf, way.x)
            elif way is not None and stretch.x_begin >= way.x:
                ends = np.full_like(ends, np.inf)
            rows.append(np.where(stretch.lanes, ends, np.inf))
            # A lane that is not here ends where it is not: whoever could go on in it has to be beside it first.
            onward = np.where(stretch.lanes, ends, np.inf)
            following = stretch.lanes
        return np.array([np.full(network.road.lane_count, np.inf), *reversed(rows)])
