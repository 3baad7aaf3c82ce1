"""SUMO's built network as plain records: edges, lanes, connections, rights of way and signal programs.

What is read here is all that this package understands of a network. What else stands in the file is named by
`sim/net_notes.py`.
"""

import gzip
import math
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree as ET

from sumo_hmdp.errors import InputError

# What every vehicle of a run is to SUMO, trucks too.
VEHICLE_CLASS = "passenger"
_GZIP = b"\x1f\x8b"


@dataclass(frozen=True)
class Lane:
    """A lane of an edge.

    Attributes:
        id: SUMO's name.
        index: SUMO's number, from the right.
        shape: its centre line, points (x, y) or (x, y, z) in driving direction [m].
        width: [m].
        length: what SUMO takes for its length [m].
        speed: its speed limit for a passenger car [m/s].
        is_open: whether passenger cars may use it.
        left: whether they may change to the left.
        right: whether they may change to the right.
        stop_offset: how far before its end they have to stop [m].
    """

    id: str
    index: int
    shape: tuple[tuple[float, ...], ...]
    width: float
    length: float
    speed: float
    is_open: bool = True
    left: bool = True
    right: bool = True
    stop_offset: float = 0.0


@dataclass(frozen=True)
class Edge:
    """An edge with its lanes by SUMO's index: from the right.

    Attributes:
        id: SUMO's name.
        lanes: all of them.
        end: the junction where it ends.
        opposite: SUMO's name of a lane of the opposite direction by which one may overtake, or of an edge that is the
            same road in the other direction; None where there is neither.
    """

    id: str
    lanes: tuple[Lane, ...]
    end: str = ""
    opposite: str | None = None

    @property
    def reach(self) -> tuple[float, float]:
        """Where it begins and ends along x [m], taken from its rightmost lane."""
        return self.lanes[0].shape[0][0], self.lanes[0].shape[-1][0]

    @property
    def is_open(self) -> bool:
        """Whether passenger cars may use any of its lanes."""
        return any(lane.is_open for lane in self.lanes)


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
        is_open: whether passenger cars may take it.
        turns_back: whether it turns around.
    """

    edge: str
    to: str
    lane: str
    to_lane: str
    via: str | None
    signal: str | None
    link: int | None
    is_open: bool = True
    turns_back: bool = False


@dataclass(frozen=True)
class Junction:
    """The right of way at a junction.

    Attributes:
        incoming: names of the lanes that lead to it.
        inner: names of the lanes inside, one for each of its links; empty where there are none.
        yields: for each link, the numbers of those that it gives way to.
    """

    incoming: tuple[str, ...]
    inner: tuple[str, ...]
    yields: tuple[frozenset[int], ...]


@dataclass(frozen=True)
class Net:
    """A network: the edges outside of its junctions by their names, and what connects them.

    Attributes:
        edges: those that passenger cars may use.
        connections: between them, those that passenger cars may use.
        inner: the lanes inside junctions by their names.
        junctions: by their names.
        programs: for each traffic light, the states of all phases of all its programs.
        left_hand: whether it is for left-hand traffic.
        roundabouts: the edges that are part of one.
        closed: the edges that passenger cars may not use.
        dangling: what is wrong with connections that name lanes which are not there.
    """

    edges: dict[str, Edge]
    connections: tuple[Connection, ...]
    inner: dict[str, Lane] = field(default_factory=dict)
    junctions: dict[str, Junction] = field(default_factory=dict)
    programs: dict[str, tuple[str, ...]] = field(default_factory=dict)
    left_hand: bool = False
    roundabouts: frozenset[str] = frozenset()
    closed: tuple[Edge, ...] = ()
    dangling: tuple[str, ...] = ()


def read_root(net_file: Path) -> ET.Element:
    """Read the XML of a built network, also a compressed one.

    Raises:
        InputError: the file cannot be read, or is no network.
    """
    try:
        data = net_file.read_bytes()
        if data[:2] == _GZIP:
            data = gzip.decompress(data)
        root = ET.fromstring(data)  # noqa: S314 (a network is the user's own file)
    except (OSError, EOFError, zlib.error, ValueError, ET.ParseError) as error:
        raise InputError([f"the network must be readable XML, got: {error}."], str(net_file)) from error
    if root.tag != "net":
        message = f"the network must be a built one, with the root <net>, got <{root.tag}>. Build it with netconvert."
        raise InputError([message], str(net_file))
    return root


def parse_net(root: ET.Element, source: str) -> Net:
    """Return the records of a network.

    Args:
        root: its XML.
        source: the file's name, for the messages.

    Raises:
        InputError: it has no edge, or an edge no lane, or a number is none, or a name is unknown.
    """
    limits = _type_limits(root)
    try:
        edges = [_edge(edge, limits) for edge in root.iter("edge") if edge.get("function", "normal") == "normal"]
        inner = {lane.id: lane for lane in _inner_lanes(root, limits)}
    except (KeyError, ValueError) as error:
        raise InputError(
            [f"the lanes must have limits and shapes of numbers, got: {error}. Build it with netconvert"],
            source,
        ) from error
    try:
        entries = [_connection(entry) for entry in root.iter("connection") if entry.attrib["from"][:1] != ":"]
    except (KeyError, ValueError) as error:
        raise InputError([f"the connections must have edges and lanes, got: {error}."], source) from error
    try:
        junctions = {entry.attrib["id"]: _junction(entry) for entry in root.iter("junction")}
        programs = _programs(root)
    except (KeyError, ValueError) as error:
        raise InputError([f"junctions and signals must be complete, got: {error}."], source) from error
    lanes = {lane.id for edge in edges for lane in edge.lanes}
    problems = [f"edge {edge.id} must have lanes, got none." for edge in edges if not edge.lanes]
    dangling = [
        f"connection from {entry.lane} to {entry.to_lane} must name lanes of the network, got {name}."
        for entry in entries
        for name in (entry.lane, entry.to_lane)
        if name not in lanes and not name.startswith(":")
    ]
    if len({edge.id for edge in edges}) < len(edges):
        problems.append("edges must have names of their own, got one twice.")
    used = [edge for edge in edges if edge.is_open]
    if not edges:
        problems = ["the network must have an edge, got none."]
    elif not used and not problems:
        problems = ["the network must have a lane that passenger cars may use, got none."]
    if problems:
        raise InputError(problems, source)
    open_lanes = {lane.id for edge in used for lane in edge.lanes if lane.is_open}
    roundabouts = " ".join(entry.get("edges", "") for entry in root.iter("roundabout"))
    return Net(
        edges={edge.id: edge for edge in used},
        connections=tuple(
            entry
            for entry in entries
            if entry.is_open and {entry.lane, entry.to_lane} <= open_lanes and inner_is_open(inner, entry.via)
        ),
        inner=inner,
        junctions=junctions,
        programs=programs,
        left_hand=_is_true(root.get("lefthand", "false")),
        roundabouts=frozenset(roundabouts.split()),
        closed=tuple(edge for edge in edges if not edge.is_open),
        dangling=tuple(dangling),
    )


def read_net(net_file: Path) -> Net:
    """Read a built network.

    Raises:
        InputError: the file cannot be read or has no edge, or an edge no lane, or a number is none.
    """
    return parse_net(read_root(net_file), str(net_file))


def inner_is_open(inner: dict[str, Lane], via: str | None) -> bool:
    """Tell whether passenger cars may use the lane inside a junction that a connection goes by."""
    return via is None or via not in inner or inner[via].is_open


def permits(allow: str | None, disallow: str | None) -> bool:
    """Tell whether a passenger car is among the permitted, as SUMO reads it: `allow` goes before `disallow`."""
    if allow:
        return not {"all", VEHICLE_CLASS}.isdisjoint(allow.split())
    return {"all", VEHICLE_CLASS}.isdisjoint((disallow or "").split())


def _is_true(text: str) -> bool:
    return text.strip().lower() in {"true", "1", "yes", "on", "x", "t"}


def _type_limits(root: ET.Element) -> dict[str, float]:
    """Return the speed limits that a type of edges has for passenger cars [m/s]."""
    found = {}
    for entry in root.iter("type"):
        for limit in entry.findall("restriction"):
            if limit.get("vClass") == VEHICLE_CLASS and "id" in entry.attrib:
                found[entry.attrib["id"]] = float(limit.get("speed", "nan"))
    return found


def _edge(edge: ET.Element, limits: dict[str, float]) -> Edge:
    offset = _stop_offset(edge, 0.0)
    lanes = tuple(_lane(lane, limits.get(edge.get("type", "")), offset) for lane in edge.findall("lane"))
    neighbours = [neigh.get("lane", "?") for lane in edge.findall("lane") for neigh in lane.findall("neigh")]
    return Edge(edge.attrib["id"], lanes, edge.get("to", ""), next(iter(neighbours), edge.get("bidi")))


def _inner_lanes(root: ET.Element, limits: dict[str, float]) -> list[Lane]:
    edges = (edge for edge in root.iter("edge") if edge.get("function") == "internal")
    return [_lane(lane, limits.get(edge.get("type", "")), 0.0) for edge in edges for lane in edge.findall("lane")]


def _lane(lane: ET.Element, limit: float | None, offset: float) -> Lane:
    shape = tuple(tuple(map(float, point.split(","))) for point in lane.attrib["shape"].split())
    if len(shape) < 2 or not all(len(point) > 1 and all(map(math.isfinite, point)) for point in shape):
        raise ValueError(f"shape={lane.attrib['shape']!r}")
    name, change = lane.attrib["id"], [lane.get(key) for key in ("changeLeft", "changeRight")]
    # SUMO's default width and speed, which a network may leave out.
    width, speed = float(lane.get("width", "3.2")), float(lane.get("speed", "13.89")) if limit is None else limit
    for key, value in (("width", width), ("speed", speed), ("length", float(lane.attrib["length"]))):
        if not 0.0 < value < math.inf:
            raise ValueError(f"{key}={value:g} of lane {name}, which must be above 0")
    return Lane(
        id=name,
        index=int(lane.get("index", name.rpartition("_")[2])),
        shape=shape,
        width=width,
        length=float(lane.attrib["length"]),
        speed=speed,
        is_open=permits(lane.get("allow"), lane.get("disallow")),
        left=permits(change[0], None),
        right=permits(change[1], None),
        stop_offset=_stop_offset(lane, offset),
    )


def _stop_offset(element: ET.Element, default: float) -> float:
    """Return how far before a lane's end passenger cars have to stop [m]."""
    for entry in element.findall("stopOffset"):
        excluded = entry.get("exceptions")
        applies = permits(entry.get("vClasses"), None) if excluded is None else permits(None, excluded)
        if applies:
            return float(entry.get("value", "0"))
    return default


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
        is_open=permits(entry.get("allow"), entry.get("disallow")),
        turns_back=entry.get("dir") in {"t", "T"},
    )


def _junction(entry: ET.Element) -> Junction:
    requests = sorted(entry.findall("request"), key=lambda request: int(request.attrib["index"]))
    # The last letter is that of link 0.
    yields = (
        frozenset(number for number, bit in enumerate(reversed(request.get("response", ""))) if bit == "1")
        for request in requests
    )
    return Junction(tuple(entry.get("incLanes", "").split()), tuple(entry.get("intLanes", "").split()), tuple(yields))


def _programs(root: ET.Element) -> dict[str, tuple[str, ...]]:
    found: dict[str, tuple[str, ...]] = {}
    for entry in root.iter("tlLogic"):
        states = tuple(phase.attrib["state"] for phase in entry.findall("phase"))
        found[entry.attrib["id"]] = found.get(entry.attrib["id"], ()) + states
    return found
