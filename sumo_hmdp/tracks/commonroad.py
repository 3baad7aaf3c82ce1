"""CommonRoad XML, editions 2018b and 2020a: lanelets, obstacles with trajectories, and planning problems."""

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree as ET
from xml.parsers import expat

import numpy as np

from sumo_hmdp.errors import InputError, Problem
from sumo_hmdp.tracks.lanelets import Lanelet
from sumo_hmdp.tracks.record import Track
from sumo_hmdp.validation import nearest

VERSIONS = ("2018b", "2020a")
# Obstacles of this edition that are no vehicles and have no shape on the road.
_NO_VEHICLES = ("phantomObstacle", "environmentObstacle")
_OBSTACLES = ("obstacle", "dynamicObstacle", "staticObstacle")
_PIECE = 1 << 16
# A body whose reference point is nearer to its centre counts as centred [m], [rad].
_CENTERED = 1e-3


@dataclass(frozen=True)
class Start:
    """Where a planning problem starts: centre of the vehicle [m], heading [rad] and speed [m/s]."""

    x: float
    y: float
    heading: float
    speed: float
    time: float


@dataclass(frozen=True)
class CommonRoadFile:
    """What a file holds.

    Attributes:
        dt: its time step [s].
        lanelets: by id.
        tracks: of dynamic and static obstacles.
        problems: starts of its planning problems by id.
        notes: what was read with a simplification, a line each.
    """

    dt: float
    lanelets: dict[str, Lanelet]
    tracks: list[Track]
    problems: dict[str, Start] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def read_commonroad(path: Path, leave_out: Collection[str] = ()) -> CommonRoadFile:
    """Read a file.

    Args:
        path: the file.
        leave_out: ids of obstacles that are not read, whatever they are.

    Raises:
        InputError: it is no such file, or holds something that is not understood.
    """
    root = read_xml(path)
    if root.tag != "commonRoad":
        raise InputError([f"a CommonRoad file must have the root <commonRoad>, got <{root.tag}>. Check the file"])
    version = root.get("commonRoadVersion", "")
    if version not in VERSIONS:
        message = f"commonRoadVersion must be one of {', '.join(VERSIONS)}, got {version!r}"
        raise InputError([f"{message}. Convert the file with CommonRoad's own tools"])
    dt = _float(root.get("timeStepSize"), "timeStepSize of <commonRoad>")
    if not dt > 0.0:
        raise InputError([f"timeStepSize must be above 0, got {dt:g}. Correct it"])
    reader = _Reader(dt)
    present = {entry.get("id", "") for entry in root if entry.tag in _OBSTACLES}
    for index, name in enumerate(leave_out):
        if name not in present:
            message = f"must be a vehicle of the record, got {name!r}; {nearest(name, sorted(present))}"
            raise InputError([Problem(f"tracks.leave_out[{index}]", message)])
    tracks = list(reader.tracks(root, leave_out))
    lanelets = {lanelet.id: lanelet for lanelet in map(_lanelet, root.iter("lanelet")) if lanelet is not None}
    problems = {
        _id(problem): reader.start(problem.find("initialState"), _id(problem))
        for problem in root.findall("planningProblem")
    }
    return CommonRoadFile(dt, lanelets, tracks, problems, tuple(reader.notes()))


def read_xml(path: Path) -> ET.Element:
    """Return the root of an XML file; a document type is refused, since entities in it can grow without bounds.

    Raises:
        InputError: it cannot be read.
    """
    builder, parser = ET.TreeBuilder(), expat.ParserCreate()

    def refuse(*_: object) -> None:
        raise InputError(["the XML must have no document type, got <!DOCTYPE ...>. Remove it"])

    parser.StartDoctypeDeclHandler = refuse
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    try:
        with path.open("rb") as file:
            while piece := file.read(_PIECE):
                parser.Parse(piece, False)  # noqa: FBT003 - expat takes no keywords
            parser.Parse(b"", True)  # noqa: FBT003
        return builder.close()
    except (OSError, expat.ExpatError, ValueError, LookupError, AssertionError) as error:
        raise InputError([f"must be readable XML, got: {error}. Check the file"]) from error


class _Reader:
    """Obstacles of one file, and how many of their values were read with a simplification."""

    def __init__(self, dt: float) -> None:
        self._dt = dt
        self._regions = self._intervals = 0
        self._ignored: dict[str, int] = {}

    def notes(self) -> Iterator[str]:
        if self._regions:
            yield f"{self._regions} recorded positions are regions; their centres are used"
        if self._intervals:
            yield f"{self._intervals} recorded values are intervals; their middles are used"
        for tag, count in self._ignored.items():
            yield f"{count} {tag} of the file are left out: they are no recorded vehicles"

    def tracks(self, root: ET.Element, leave_out: Collection[str]) -> Iterator[Track]:
        for entry in root:
            if entry.tag in _NO_VEHICLES:
                self._ignored[entry.tag] = self._ignored.get(entry.tag, 0) + 1
            elif entry.tag in _OBSTACLES and entry.get("id") not in leave_out:
                yield self._track(entry)

    def start(self, state: ET.Element | None, name: str) -> Start:
        what = f"planning problem {name}"
        x, y = self._position(state, what)
        values = [self._value(state, key, what) for key in ("orientation", "velocity", "time")]
        heading, speed, time = (0.0 if value is None else value for value in values)
        return Start(x, y, heading, speed, time * self._dt)

    def _track(self, entry: ET.Element) -> Track:
        name = _id(entry)
        what = f"obstacle {name}"
        is_static = entry.tag == "staticObstacle" or (entry.findtext("role") or "").strip() == "static"
        if entry.find("occupancySet") is not None:
            message = f"{what} must have a trajectory, got an occupancySet"
            raise InputError([f"{message}, which is no record. List it in tracks.leave_out"])
        length, width = self._shape(entry.find("shape"), what)
        states = [entry.find("initialState"), *entry.iterfind("trajectory/state")]
        places = np.array([self._position(state, what) for state in states])
        keys = ("time", "orientation", "velocity")
        columns = [[self._value(state, key, what) for state in states] for key in keys]
        if any(value is None for value in columns[0]):
            raise InputError([f"{what} must have a time in every state, got one without. Add it"])
        time, heading, speed = (
            None if any(value is None for value in column) else np.array(column, dtype=float) for column in columns
        )
        assert time is not None  # noqa: S101 - no time is missing
        if is_static:
            # It has one state, and stands there for all time.
            speed = np.zeros(len(time))
        order = np.argsort(time, kind="stable")
        x, y = places[order].T
        return Track(
            id=name,
            length=length,
            width=width,
            time=time[order] * self._dt,
            x=x,
            y=y,
            heading=None if heading is None else heading[order],
            speed=None if speed is None else speed[order],
            is_static=is_static,
        )

    def _shape(self, shape: ET.Element | None, what: str) -> tuple[float, float]:
        """Return length and width of the box around the body."""
        parts = [] if shape is None else list(shape)
        if len(parts) != 1:
            message = f"{what} must have one shape, got {len(parts)}"
            raise InputError([f"{message}. List it in tracks.leave_out"])
        part = parts[0]
        center, turn = part.find("center"), part.findtext("orientation")
        offset = (0.0, 0.0) if center is None else _point(center, what)
        if max(map(abs, (*offset, 0.0 if turn is None else _float(turn, f"{what}: orientation")))) > _CENTERED:
            message = f"{what} must have a shape around its position, got one at {offset} that is turned or moved"
            raise InputError([f"{message}. List it in tracks.leave_out"])
        if part.tag == "rectangle":
            return _float(part.findtext("length"), f"{what}: length"), _float(part.findtext("width"), f"{what}: width")
        if part.tag == "circle":
            diameter = 2.0 * _float(part.findtext("radius"), f"{what}: radius")
            return diameter, diameter
        if part.tag == "polygon":
            corners = np.array([_point(point, what) for point in part.iterfind("point")])
            if len(corners) >= 3:
                # The body is taken to reach as far on both sides of its reference point.
                length, width = 2.0 * np.abs(corners).max(axis=0)
                return float(length), float(width)
        message = f"{what} must be a rectangle, circle or polygon, got <{part.tag}>"
        raise InputError([f"{message}. List it in tracks.leave_out"])

    def _position(self, state: ET.Element | None, what: str) -> tuple[float, float]:
        position = None if state is None else state.find("position")
        parts = [] if position is None else list(position)
        if len(parts) != 1:
            raise InputError([f"{what} must have one position in every state, got {len(parts)}. Correct it"])
        part = parts[0]
        if part.tag == "point":
            return _point(part, what)
        self._regions += 1
        center = part.find("center")
        if part.tag in {"rectangle", "circle"}:
            # A centre that is left out is the origin.
            return (0.0, 0.0) if center is None else _point(center, what)
        if part.tag == "polygon":
            corners = [_point(point, what) for point in part.iterfind("point")]
            if corners:
                x, y = np.mean(corners, axis=0)
                return float(x), float(y)
        message = f"{what} must have a position of a point, rectangle, circle or polygon, got <{part.tag}>"
        raise InputError([f"{message}. List it in tracks.leave_out"])

    def _value(self, state: ET.Element | None, key: str, what: str) -> float | None:
        entry = None if state is None else state.find(key)
        if entry is None:
            return None
        exact = entry.find("exact")
        if exact is not None:
            return _float(exact.text, f"{what}: {key}")
        ends = [_float(entry.findtext(end), f"{what}: {key}") for end in ("intervalStart", "intervalEnd")]
        if key == "time":
            raise InputError([f"{what} must have exact times, got the interval {ends}. It is no record"])
        self._intervals += 1
        return 0.5 * (ends[0] + ends[1])


def _lanelet(entry: ET.Element) -> Lanelet | None:
    """Return a lanelet; None for a reference to one, which has no bounds."""
    if entry.find("leftBound") is None and entry.find("rightBound") is None:
        return None
    name = _id(entry)
    bounds = []
    for side in ("leftBound", "rightBound"):
        points = [_point(point, f"lanelet {name}") for point in entry.iterfind(f"{side}/point")]
        if len(points) < 2:
            raise InputError([f"lanelet {name} must have two points or more in its {side}, got {len(points)}"])
        bounds.append(np.array(points))
    neighbours = {}
    for side in ("adjacentLeft", "adjacentRight"):
        beside = entry.find(side)
        same = beside is not None and beside.get("drivingDir") == "same"
        neighbours[side] = beside.get("ref") if same and beside is not None else None
    return Lanelet(
        name,
        bounds[0],
        bounds[1],
        neighbours["adjacentLeft"],
        neighbours["adjacentRight"],
        tuple(ref for after in entry.iterfind("successor") if (ref := after.get("ref")) is not None),
        tuple(ref for before in entry.iterfind("predecessor") if (ref := before.get("ref")) is not None),
    )


def _id(entry: ET.Element) -> str:
    name = entry.get("id")
    if not name:
        raise InputError([f"each <{entry.tag}> must have an id, got one without. Add it"])
    return name


def _point(point: ET.Element, what: str) -> tuple[float, float]:
    return _float(point.findtext("x"), f"{what}: x"), _float(point.findtext("y"), f"{what}: y")


def _float(text: str | None, what: str) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError([f"{what} must be a finite number, got {'nothing' if text is None else repr(text[:40])}"])
    return value
