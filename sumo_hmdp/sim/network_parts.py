"""The parts of a road network: stretches of the road, ramps, side streets and signals."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class LanePart:
    """A lane on one stretch of the road.

    Attributes:
        id: SUMO's name.
        index: SUMO's number of it, from the right.
        speed_limit: for passenger cars [m/s].
        is_open: whether passenger cars may use it.
        left: whether they may change to the left.
        right: whether they may change to the right.
    """

    id: str
    index: int
    speed_limit: float
    is_open: bool
    left: bool
    right: bool


@dataclass(frozen=True)
class Stretch:
    """A part of the road on which the same lanes exist all along: an edge, or the inside of a junction.

    Attributes:
        edge: the name of SUMO's edge, None inside a junction.
        x_begin: where it begins [m].
        x_end: where the next one begins, or the road ends [m].
        lane_parts: lanes 1..n, None where the lane does not exist.
    """

    edge: str | None
    x_begin: float
    x_end: float
    lane_parts: tuple[LanePart | None, ...]

    @property
    def lane_ids(self) -> tuple[str | None, ...]:
        """SUMO's names of lanes 1..n, None where the lane does not exist."""
        return tuple(None if lane is None else lane.id for lane in self.lane_parts)

    @property
    def lanes(self) -> tuple[bool, ...]:
        """Whether lanes 1..n exist and passenger cars may use them."""
        return tuple(lane is not None and lane.is_open for lane in self.lane_parts)


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
