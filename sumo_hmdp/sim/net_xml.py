"""SUMO's built network as plain records: edges, their lanes, and the connections between them."""

import math
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

from sumo_hmdp.errors import InputError


@dataclass(frozen=True)
class Lane:
    """A lane of an edge.

    Attributes:
        id: SUMO's name.
        shape: its centre line, points (x, y) in driving direction [m].
        width: [m].
        length: what SUMO takes for its length [m].
    """

    id: str
    shape: tuple[tuple[float, ...], ...]
    width: float
    length: float


@dataclass(frozen=True)
class Edge:
    """An edge outside of junctions, with its lanes by SUMO's index: from the right."""

    id: str
    lanes: tuple[Lane, ...]

    @property
    def reach(self) -> tuple[float, float]:
        """Where it begins and ends along x [m], taken from its rightmost lane."""
        return self.lanes[0].shape[0][0], self.lanes[0].shape[-1][0]


@dataclass(frozen=True)
class Connection:
    """A way from a lane over a junction into a lane.

    Attributes:
        edge: where it comes from.
        to: where it leads.
        lane: name of the lane it comes from.
        to_lane: name of the lane it leads to.
        via: name of the lane inside the junction, None where there is none.
        signal: name of the traffic light, None where there is none.
        link: its place in the traffic light's state.
    """

    edge: str
    to: str
    lane: str
    to_lane: str
    via: str | None
    signal: str | None
    link: int | None


@dataclass(frozen=True)
class Net:
    """A network outside of its junctions: the edges by their names, and the connections between them."""

    edges: dict[str, Edge]
    connections: tuple[Connection, ...]


def read_net(net_file: Path) -> Net:
    """Read a built network.

    Raises:
        InputError: the file cannot be read or has no edge, or an edge no lane, or a number is none.
    """
    try:
        root = ET.parse(net_file).getroot()  # noqa: S314 (a network is the user's own file)
    except (OSError, ET.ParseError) as error:
        raise InputError([f"the network must be readable XML, got: {error}."], str(net_file)) from error
    try:
        edges = [_edge(edge) for edge in root.iter("edge") if edge.get("function", "normal") == "normal"]
    except (KeyError, ValueError) as error:
        raise InputError([f"the lanes must have shapes of numbers, got: {error}."], str(net_file)) from error
    try:
        connections = [_connection(entry) for entry in root.iter("connection") if entry.attrib["from"][:1] != ":"]
    except (KeyError, ValueError) as error:
        raise InputError([f"the connections must have edges and lanes, got: {error}."], str(net_file)) from error
    problems = [f"edge {edge.id} must have lanes, got none." for edge in edges if not edge.lanes]
    if not edges:
        problems = ["the network must have an edge, got none."]
    if problems:
        raise InputError(problems, str(net_file))
    return Net({edge.id: edge for edge in edges}, tuple(connections))


def _edge(edge: ET.Element) -> Edge:
    return Edge(edge.attrib["id"], tuple(_lane(lane) for lane in edge.findall("lane")))


def _lane(lane: ET.Element) -> Lane:
    shape = tuple(tuple(map(float, point.split(","))) for point in lane.attrib["shape"].split())
    if len(shape) < 2 or not all(len(point) > 1 and all(map(math.isfinite, point)) for point in shape):
        raise ValueError(f"shape={lane.attrib['shape']!r}")
    # SUMO's default width, which netconvert leaves out.
    return Lane(lane.attrib["id"], shape, float(lane.get("width", "3.2")), float(lane.attrib["length"]))


def _connection(entry: ET.Element) -> Connection:
    edge, to = entry.attrib["from"], entry.attrib["to"]
    link = entry.get("linkIndex")
    return Connection(
        edge=edge,
        to=to,
        lane=f"{edge}_{int(entry.attrib['fromLane'])}",
        to_lane=f"{to}_{int(entry.attrib['toLane'])}",
        via=entry.get("via"),
        signal=entry.get("tl"),
        link=None if link is None else int(link),
    )
