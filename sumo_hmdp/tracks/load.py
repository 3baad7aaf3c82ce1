"""From a file of recorded tracks to traffic along a road."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np

from sumo_hmdp.domain.road import Road
from sumo_hmdp.errors import InputError, Problem
from sumo_hmdp.tracks.along import RoadTrack, along_road, instants_on
from sumo_hmdp.tracks.commonroad import CommonRoadFile, Start, read_commonroad
from sumo_hmdp.tracks.lanelets import Section, lane_lines, road_of, roads, section_of
from sumo_hmdp.tracks.record import Track, record_problems
from sumo_hmdp.tracks.shape import RoadShape, road_along, straight_road
from sumo_hmdp.tracks.tables import METRES_PER, TableRecord, read_highd, read_ngsim, read_plain
from sumo_hmdp.validation import nearest

Format = Literal["commonroad", "highd", "ngsim", "plain"]
# A record that is shorter shows nobody's motion [s].
_SHORTEST = 0.5
_TRACKS_FILE, _META_FILE = "_tracks.csv", "_recordingMeta.csv"


@dataclass(frozen=True)
class Source:
    """Where recorded tracks come from, and how they are read.

    Attributes:
        file: of the tracks.
        format: how it is written.
        units: of lengths, in files that do not say: a key of `METRES_PER`; None where it is not stated.
        lane_lines: across the road, in the record's lateral axis [m]; None takes those of the file.
        carriageway: which one of a highD-like file.
        meta: recording meta of a highD-like file; None takes the one beside the tracks.
        lanelet: one of the road's, in a CommonRoad file; None takes the road with most of the record.
        leave_out: ids of vehicles that are left out.
        off_road: whether vehicles beside the road are refused or left out.
    """

    file: Path
    format: Format
    units: str | None = None
    lane_lines: tuple[float, ...] | None = None
    carriageway: Literal["upper", "lower"] | None = None
    meta: Path | None = None
    lanelet: str | None = None
    leave_out: tuple[str, ...] = ()
    off_road: Literal["refuse", "leave_out"] = "refuse"


@dataclass(frozen=True)
class RecordedTraffic:
    """Recorded traffic along its road.

    Attributes:
        shape: the road in the record's frame.
        dt: the record's step [s].
        span: how long the record is [s].
        tracks: along the road, by id.
        starts: of planning problems by id, their times since the record began.
        notes: what a reader should know, a line each.
        digest: SHA-256 of the files.
    """

    shape: RoadShape
    dt: float
    span: float
    tracks: Mapping[str, RoadTrack]
    starts: Mapping[str, Start]
    notes: tuple[str, ...]
    digest: str

    @property
    def road(self) -> Road:
        """Lanes of one width."""
        return self.shape.road


def read_tracks(source: Source) -> RecordedTraffic:
    """Read recorded traffic; files that have not changed are read once.

    Raises:
        InputError: a file cannot be used, with every mistake.
    """
    files = [source.file] if source.format != "highd" else [source.file, meta_file(source)]
    digest = hashlib.sha256()
    for file in files:
        try:
            digest.update(file.read_bytes())
        except OSError as error:
            raise InputError([f"must be a readable file, got: {error.strerror}. Check the path"], str(file)) from error
    try:
        return _read(source, digest.hexdigest())
    except InputError as error:
        raise InputError(error.problems, error.source or str(source.file)) from None


def meta_file(source: Source) -> Path:
    """Return the recording's meta file of highD-like tracks."""
    if source.meta is not None:
        return source.meta
    return source.file.with_name(source.file.name.replace(_TRACKS_FILE, _META_FILE))


@lru_cache(maxsize=4)
def _read(source: Source, digest: str) -> RecordedTraffic:
    found = _READERS[source.format](source)
    is_metric = source.format == "commonroad"
    tracks = found.tracks if is_metric else _kept(found.tracks, source.leave_out)
    problems = list(record_problems(tracks, found.dt, is_metric=is_metric))
    moving = [track for track in tracks if not track.is_static]
    begin = min((float(track.time[0]) for track in moving), default=0.0)
    span = max((float(track.time[-1]) for track in moving), default=0.0) - begin
    if not problems and span < _SHORTEST:
        problems.append(
            Problem("", f"the record must be at least {_SHORTEST:g} s long, got {span:g} s: it is too short")
        )
    if problems:
        raise InputError(problems)
    shape = _lanelet_road(found, source) if isinstance(found, CommonRoadFile) else _table_road(found, source)
    along, notes = _along(tracks, shape, found.dt, begin, span, source)
    starts = getattr(found, "problems", {})
    return RecordedTraffic(
        shape,
        found.dt,
        span,
        along,
        {name: replace(start, time=start.time - begin) for name, start in starts.items()},
        (*getattr(found, "notes", ()), *notes),
        digest,
    )


def _kept(tracks: Sequence[Track], leave_out: Sequence[str]) -> list[Track]:
    known = {track.id for track in tracks}
    for index, name in enumerate(leave_out):
        if name not in known:
            message = f"must be a vehicle of the record, got {name!r}; {nearest(name, sorted(known))}"
            raise InputError([Problem(f"tracks.leave_out[{index}]", message)])
    return [track for track in tracks if track.id not in leave_out]


def _along(
    tracks: Sequence[Track], shape: RoadShape, dt: float, begin: float, span: float, source: Source
) -> tuple[dict[str, RoadTrack], list[str]]:
    """Return the tracks along the road and what was left out; several roads are usual only in some formats."""
    found: dict[str, RoadTrack] = {}
    beside: list[str] = []
    partly: list[str] = []
    for track in tracks:
        along, remark = along_road(track, shape, dt, begin, span)
        if isinstance(remark, Problem):
            raise InputError([remark])
        if along is not None:
            found[track.id] = along
        if remark is not None:
            (beside if along is None else partly).append(remark)
    if source.format in {"ngsim", "plain"} and source.off_road == "refuse" and (beside or partly):
        message = f"vehicles must be on the road, got {(beside + partly)[0]} off it ({len(beside + partly)} in all)"
        raise InputError([f"{message}. Check the lane lines and units, or set tracks.off_road: leave_out"])
    if not any(track.id in found and not track.is_static for track in tracks):
        raise InputError([f"a vehicle must be on the road, got {beside[0]}. Check the lane lines and units"])
    notes = [f"{len(beside)} vehicles of the record are never on the road, and left out"] if beside else []
    notes += [f"{len(partly)} vehicles are on the road for a part of their record only, the rest is left out"] * bool(
        partly
    )
    return found, notes


def _lanelet_road(found: CommonRoadFile, source: Source) -> RoadShape:
    """Return the road that was asked for, or the one on which most of the record is."""
    lanelets = found.lanelets
    if source.lanelet is not None:
        if source.lanelet not in lanelets:
            message = f"must be a lanelet of the file, got {source.lanelet!r}; {nearest(source.lanelet, lanelets)}"
            raise InputError([Problem("tracks.lanelet", message)])
        return road_along(lane_lines(lanelets, road_of(lanelets, section_of(lanelets, source.lanelet))))
    best: tuple[int, RoadShape] | None = None
    refusal: InputError | None = None
    moving = [track for track in found.tracks if not track.is_static]
    for road in roads(lanelets):
        try:
            shape = road_along(lane_lines(lanelets, road))
        except InputError as error:
            refusal = refusal or _of_road(error, road)
            continue
        count = instants_on(moving, shape)
        if best is None or count > best[0]:
            best = count, shape
    if best is None or best[0] == 0:
        raise refusal or InputError(["the file must have lanelets with traffic on them, got none"])
    return best[1]


def _of_road(error: InputError, road: tuple[Section, ...]) -> InputError:
    return InputError([f"{problem.message} (lanelets {', '.join(road[0])})" for problem in error.problems])


def _table_road(found: TableRecord, source: Source) -> RoadShape:
    lines = source.lane_lines if found.lines is None else found.lines
    if source.format == "ngsim":
        # Local_X grows to the right.
        lines = None if lines is None else tuple(-line for line in lines)
    if lines is None:
        message = "is missing; add the lane lines across the road [m], since the table has none"
        raise InputError([Problem("tracks.lane_lines_m", message)])
    x = np.concatenate([track.x for track in found.tracks])
    begin, end = float(x.min()), float(x.max())
    if not end > begin:
        raise InputError(["a vehicle of the record must move, got none that does"])
    is_highd = source.format == "highd"
    return straight_road(lines, begin, end, forward=source.carriageway != "upper", mirrored=is_highd)


def _metres(source: Source, otherwise: str | None = None) -> float:
    units = source.units or otherwise
    if units is None:
        raise InputError([Problem("tracks.units", f"is missing; add one of {', '.join(METRES_PER)}")])
    return METRES_PER[units]


def _highd(source: Source) -> TableRecord:
    if source.carriageway is None:
        raise InputError([Problem("tracks.carriageway", "is missing; add `upper` or `lower`")])
    return read_highd(source.file, meta_file(source), source.carriageway, _metres(source, "metres"))


_READERS: Mapping[str, Callable[[Source], CommonRoadFile | TableRecord]] = {
    "commonroad": lambda source: read_commonroad(source.file, source.leave_out),
    "highd": _highd,
    "ngsim": lambda source: read_ngsim(source.file, _metres(source)),
    "plain": lambda source: read_plain(source.file),
}
