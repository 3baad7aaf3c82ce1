"""The `tracks` section of a scenario: recorded traffic in place of a network and its vehicles."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from sumo_hmdp.decision.problem_schema import ENTRIES_MAX, Exponent, NonNegative, Number, Positive
from sumo_hmdp.documents import is_file
from sumo_hmdp.domain.scene import EGO_ID, VehicleState
from sumo_hmdp.errors import InputError, Problem
from sumo_hmdp.scenario.traffic import BeliefFile, MeasurementFile
from sumo_hmdp.sim.recorded_world import RecordedSettings
from sumo_hmdp.tracks.along import SOON
from sumo_hmdp.tracks.commonroad import Start
from sumo_hmdp.tracks.load import Format, RecordedTraffic, Source, read_tracks
from sumo_hmdp.traffic.spawn import IdmParameters
from sumo_hmdp.validation import FileModel, nearest, parse, shown
from sumo_hmdp.vehicle.bicycle import BicycleParameters

_FORMATS = {".xml": "commonroad", ".parquet": "plain"}
# What is given by the record, and what needs SUMO.
_INSTEAD = ("network", "vehicles", "traffic", "matched_traffic", "road")
# Numbers that were filled in, and come back from a stored run.
_EQUAL = 1e-6


class ReactiveIdmFile(FileModel):
    """`tracks.idm`: the Intelligent Driver Model of vehicles that have left their records."""

    min_gap_m: Positive = 2.0
    time_gap_s: Positive = 1.5
    accel_mps2: Positive = 1.5
    decel_mps2: Positive = 2.0
    exponent: Exponent = 4.0

    def parameters(self) -> IdmParameters:
        """Return the parameters."""
        return IdmParameters(self.min_gap_m, self.time_gap_s, self.accel_mps2, self.decel_mps2, self.exponent)


class TracksFile(FileModel):
    """`tracks`: a file of recorded vehicles, and how its traffic takes part in a run."""

    file: str
    format: Format | None = None
    units: Literal["metres", "feet"] | None = None
    lane_lines_m: Annotated[list[Number], Field(min_length=2, max_length=ENTRIES_MAX)] | None = None
    carriageway: Literal["upper", "lower"] | None = None
    recording_meta: str | None = None
    lanelet: str | int | None = None
    leave_out: Annotated[list[str | int], Field(max_length=ENTRIES_MAX)] = Field(default_factory=list)
    off_road: Literal["refuse", "leave_out"] = "refuse"
    start_s: NonNegative = 0.0
    reactive: Literal["none", "idm"]
    idm: ReactiveIdmFile = Field(default_factory=ReactiveIdmFile)
    measurement: MeasurementFile = Field(default_factory=MeasurementFile)
    belief: BeliefFile

    def source(self, folder: Path) -> Source:
        """Return how the file is read.

        Args:
            folder: the scenario's.

        Raises:
            InputError: a file is missing, or its format is not clear.
        """
        file = _found(self.file, folder, "tracks.file")
        meta = None if self.recording_meta is None else _found(self.recording_meta, folder, "tracks.recording_meta")
        kind = self.format or _FORMATS.get(file.suffix.lower())
        if kind is None:
            message = "is missing; add one of commonroad, highd, ngsim and plain, which the file's name does not tell"
            raise InputError([Problem("tracks.format", message)])
        used = {
            "units": {"highd", "ngsim"},
            "lane_lines_m": {"ngsim", "plain"},
            "carriageway": {"highd"},
            "recording_meta": {"highd"},
            "lanelet": {"commonroad"},
        }
        problems = [
            Problem(f"tracks.{key}", f"must be left out with the format {kind}, got {shown(getattr(self, key))}")
            for key, formats in used.items()
            if getattr(self, key) is not None and kind not in formats
        ]
        if problems:
            raise InputError(problems)
        return Source(
            file,
            kind,  # type: ignore[arg-type] # one of the formats
            self.units,
            None if self.lane_lines_m is None else tuple(self.lane_lines_m),
            self.carriageway,
            meta,
            None if self.lanelet is None else str(self.lanelet),
            tuple(map(str, self.leave_out)),
            self.off_road,
        )


@dataclass(frozen=True)
class Record:
    """A scenario's recorded traffic and where the ego starts in it: front bumper [m], heading [rad], speed [m/s]."""

    traffic: RecordedTraffic
    ego_track: str | None = None
    ego: VehicleState | None = None


def with_record(content: Mapping[str, Any], folder: Path) -> tuple[dict[str, Any], Record]:
    """Read the recorded traffic of a scenario, and fill in the lanes and the ego's start that follow from it.

    Args:
        content: a scenario with `tracks`.
        folder: of its file.

    Raises:
        InputError: with every mistake.
    """
    problems = [
        Problem(key, "must be left out where there are `tracks`, which take its place; remove one of them")
        for key in _INSTEAD
        if content.get(key)
    ]
    if content.get("noise"):
        problems.append(Problem("noise", "must be false where there are `tracks`: recorded vehicles are not drawn"))
    try:
        section = parse(TracksFile, content["tracks"])
        source = section.source(folder)
    except InputError as error:
        named = [p if p.path.startswith("tracks") else Problem(_below(p.path), p.message) for p in error.problems]
        raise InputError([*problems, *named]) from None
    try:
        traffic = read_tracks(source)
    except InputError as error:
        where = Path(error.source).name
        problems += [p if p.path else Problem("tracks.file", f"{p.message} ({where})") for p in error.problems]
        raise InputError(problems) from None
    lanes = {"count": traffic.road.lane_count, "width_m": traffic.road.lane_width}
    problems += _differences("lanes", content.get("lanes"), lanes)
    ego = content.get("ego")
    record, start = Record(traffic), {}
    if isinstance(ego, Mapping):
        try:
            record = _ego_in(ego, section, traffic)
        except InputError as error:
            problems += error.problems
        if record.ego is not None:
            start = {"x_m": record.ego.x, "lane": record.ego.lane, "speed_mps": record.ego.speed}
            problems += _differences("ego", ego, start)
    if problems:
        raise InputError(problems)
    files = {"file": str(source.file.resolve())}
    if source.meta is not None:
        files["recording_meta"] = str(source.meta.resolve())
    filled = {**content, "lanes": lanes, "tracks": {**content["tracks"], **files}}
    if isinstance(ego, Mapping):
        filled["ego"] = {**ego, **start}
    return filled, record


def recorded_settings(section: TracksFile, record: Record, dt: float, duration: float) -> RecordedSettings:
    """Return the world of a scenario's recorded traffic.

    Args:
        section: of the scenario.
        record: as read.
        dt: step [s].
        duration: of the run [s].
    """
    return RecordedSettings(
        record.traffic,
        dt,
        section.start_s,
        duration,
        section.reactive == "idm",
        section.idm.parameters(),
        record.ego_track,
    )


def time_problems(section: TracksFile, traffic: RecordedTraffic, duration: float) -> Iterator[Problem]:
    """Yield that a run would last longer than its record."""
    if section.start_s + duration > traffic.span + SOON:
        message = f"must end within the record's {traffic.span:g} s, got {section.start_s:g} s + {duration:g} s"
        yield Problem("duration_s", f"{message}: the record is too short. Shorten it, or lower tracks.start_s")


def _found(name: str, folder: Path, path: str) -> Path:
    file = folder / name if is_file(folder / name) else Path(name)
    if not is_file(file):
        raise InputError([Problem(path, f"must be a file that exists, got {shown(name)}; check the path")])
    return file


def _below(path: str) -> str:
    return f"tracks.{path}" if path else "tracks"


def _differences(path: str, given: object, wanted: Mapping[str, float]) -> Iterator[Problem]:
    """Yield what a scenario says otherwise than its record."""
    for key, value in wanted.items():
        found = given.get(key) if isinstance(given, Mapping) else None
        if isinstance(found, int | float) and abs(found - value) > _EQUAL:
            message = f"must be left out or that of the record, {value:g}, got {found:g}; remove it"
            yield Problem(f"{path}.{key}", message)


def _ego_in(ego: Mapping[str, Any], section: TracksFile, traffic: RecordedTraffic) -> Record:
    """Return where the ego starts: in place of a vehicle, at a planning problem's start, or where the scenario says."""
    vehicle, problem = ego.get("vehicle"), ego.get("planning_problem")
    if vehicle is not None and problem is not None:
        raise InputError([Problem("ego", "must have one of vehicle and planning_problem, got both; remove one")])
    if vehicle is not None:
        name = str(vehicle)
        if name not in traffic.tracks:
            message = f"must be a vehicle of the record on its road, got {name!r}; {nearest(name, traffic.tracks)}"
            raise InputError([Problem("ego.vehicle", message)])
        track = traffic.tracks[name]
        if not track.holds(section.start_s):
            there = f"it is there from {track.time[0]:g} to {track.time[-1]:g} s"
            message = f"must be on the road when the run begins, at {section.start_s:g} s of the record, got {name}"
            raise InputError([Problem("ego.vehicle", f"{message}; {there}. Set tracks.start_s")])
        return Record(traffic, name, track.at(section.start_s, traffic.road))
    if problem is not None:
        name = str(problem)
        if name not in traffic.starts:
            message = f"must be a planning problem of the file, got {name!r}; {nearest(name, traffic.starts)}"
            raise InputError([Problem("ego.planning_problem", message)])
        start = traffic.starts[name]
        if abs(start.time - section.start_s) > SOON:
            message = f"must be {start.time:g} s, where planning problem {name} starts, got {section.start_s:g} s"
            raise InputError([Problem("tracks.start_s", message)])
        return Record(traffic, None, _state_of(traffic, start))
    return Record(traffic)


def _state_of(traffic: RecordedTraffic, start: Start) -> VehicleState:
    """Return the ego's body with its centre at a planning problem's start."""
    body = BicycleParameters()
    s, d = traffic.shape.locate(np.array([start.x]), np.array([start.y]))
    turned = start.heading - traffic.shape.heading_at(s)
    heading = float(np.arctan2(np.sin(turned), np.cos(turned))[0])
    x = float(s[0]) + 0.5 * body.length * float(np.cos(heading))
    y = float(traffic.shape.across(s, d)[0]) + 0.5 * body.length * float(np.sin(heading))
    lane = traffic.road.lane_at(y)
    return VehicleState(EGO_ID, x, y, start.speed, lane, heading=heading, length=body.length, width=body.width)
