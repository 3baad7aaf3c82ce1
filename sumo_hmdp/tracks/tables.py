"""Recorded tracks in tables: highD-like and NGSIM-like CSV, and a plain table whose column names end in their units."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sumo_hmdp.errors import InputError
from sumo_hmdp.tracks.record import FloatArray, Track
from sumo_hmdp.validation import nearest

FOOT = 0.3048
METRES_PER = {"metres": 1.0, "feet": FOOT}
PLAIN_COLUMNS = ("id", "time_s", "x_m", "y_m", "speed_mps", "length_m", "width_m")
HIGHD_COLUMNS = ("frame", "id", "x", "y", "width", "height", "xVelocity", "yVelocity")
HIGHD_META = ("frameRate", "upperLaneMarkings", "lowerLaneMarkings")
NGSIM_COLUMNS = ("Vehicle_ID", "Frame_ID", "Local_X", "Local_Y", "v_length", "v_Width", "v_Vel")
# NGSIM's cameras took ten frames a second.
_NGSIM_STEP = 0.1
_ID_COLUMNS = frozenset({"id", "Vehicle_ID"})


@dataclass(frozen=True)
class TableRecord:
    """What a table holds: the record's step [s], its tracks, and its lane lines [m], None where it has none."""

    dt: float
    tracks: list[Track]
    lines: tuple[float, ...] | None = None


def read_columns(path: Path, required: Sequence[str], optional: Sequence[str] = ()) -> dict[str, list[str]]:
    """Return columns of a CSV or Parquet file as texts.

    Raises:
        InputError: it cannot be read, or a column is missing.
    """
    try:
        columns = _parquet(path) if path.suffix == ".parquet" else _csv(path)
    except (OSError, UnicodeDecodeError, csv.Error, ValueError) as error:
        raise InputError([f"must be a readable table, got: {error}. Check the file"], str(path)) from error
    missing = [name for name in required if name not in columns]
    if missing:
        message = f"must have the columns {', '.join(required)}, got none named {missing[0]}"
        raise InputError([f"{message}; {nearest(missing[0], columns)}"], str(path))
    if not columns[required[0]]:
        raise InputError(["must have at least one row, got none. Check the file"], str(path))
    return {name: columns[name] for name in (*required, *optional) if name in columns}


def _csv(path: Path) -> dict[str, list[str]]:
    with path.open(newline="", encoding="utf-8-sig") as file:
        rows = csv.reader(file)
        header = [name.strip() for name in next(rows, [])]
        if len(set(header)) < len(header):
            twice = next(name for name in header if header.count(name) > 1)
            raise ValueError(f"two columns named {twice!r}")
        values: list[list[str]] = []
        for row in rows:
            if row and len(row) != len(header):
                raise ValueError(f"line {rows.line_num} has {len(row)} values for {len(header)} columns")
            if row:
                values.append(row)
    columns = list(zip(*values, strict=True)) if values else [()] * len(header)
    return {name: [text.strip() for text in column] for name, column in zip(header, columns, strict=True)}


def _parquet(path: Path) -> dict[str, list[str]]:
    import pyarrow as pa  # noqa: PLC0415 - a scenario without Parquet files needs no Parquet
    import pyarrow.parquet as pq  # noqa: PLC0415

    try:
        table = pq.read_table(path)
    except pa.ArrowException as error:
        raise ValueError(str(error)) from error
    return {name: ["" if v is None else str(v) for v in table[name].to_pylist()] for name in table.column_names}


def numbers(columns: Mapping[str, Sequence[str]], path: Path) -> dict[str, FloatArray]:
    """Return the columns as numbers, but for those of names.

    Raises:
        InputError: for the first value that is no finite number.
    """
    result = {}
    for name, texts in columns.items():
        if name in _ID_COLUMNS:
            continue
        try:
            values = np.array(texts, dtype=float)
            bad = ~np.isfinite(values)
        except ValueError:
            bad = np.array([not _is_number(text) for text in texts])
        if bad.any():
            row = int(np.argmax(bad))
            message = f"column {name} must hold finite numbers, got {texts[row][:40]!r} in row {row + 1}"
            raise InputError([f"{message}. Correct it"], str(path))
        result[name] = values
    return result


def _is_number(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False


def read_plain(path: Path) -> TableRecord:
    """Read a plain table; (x, y) is the centre of the body, x forward along the road and y to the left.

    Raises:
        InputError: it cannot be read.
    """
    texts = read_columns(path, PLAIN_COLUMNS)
    columns = numbers(texts, path)
    tracks = list(_tracks(texts["id"], columns["time_s"], columns, ("x_m", "y_m", "speed_mps", "length_m", "width_m")))
    return TableRecord(_step_of(tracks, path), tracks)


def _step_of(tracks: Sequence[Track], path: Path) -> float:
    """Return the time step of most instants."""
    steps = np.concatenate([np.diff(track.time) for track in tracks])
    if not (steps > 0.0).any():
        raise InputError(["must have two instants or more of some vehicle, got one: it is too short"], str(path))
    return float(np.median(steps[steps > 0.0]))


def read_ngsim(path: Path, metres: float) -> TableRecord:
    """Read a table of NGSIM's vehicle trajectories; Local_Y is that of the front bumper, Local_X grows to the right.

    Args:
        path: the CSV file.
        metres: in one unit of the table.

    Raises:
        InputError: it cannot be read.
    """
    texts = read_columns(path, NGSIM_COLUMNS)
    columns = numbers(texts, path)
    scaled = {name: values * metres for name, values in columns.items() if name != "Frame_ID"}
    scaled["x"] = scaled["Local_Y"] - 0.5 * scaled["v_length"]
    scaled["y"] = -scaled["Local_X"]
    time = columns["Frame_ID"] * _NGSIM_STEP
    names = ("x", "y", "v_Vel", "v_length", "v_Width")
    return TableRecord(_NGSIM_STEP, list(_tracks(texts["Vehicle_ID"], time, scaled, names)))


def read_highd(path: Path, meta: Path, carriageway: str, metres: float) -> TableRecord:
    """Read a table of tracks like highD's, of all vehicles on the road; y points down, as in images.

    Args:
        path: the tracks; x and y are those of the bounding box's upper left corner.
        meta: the recording's: frame rate and lane markings.
        carriageway: `upper`, on which traffic drives towards smaller x, or `lower`.
        metres: in one unit of the table.

    Raises:
        InputError: one cannot be read.
    """
    found = read_columns(meta, HIGHD_META)
    rate = numbers({"frameRate": found["frameRate"]}, meta)["frameRate"][0]
    if not rate > 0.0:
        raise InputError([f"frameRate must be above 0, got {rate:g}. Correct it"], str(meta))
    markings = found[f"{carriageway}LaneMarkings"][0]
    try:
        lines = tuple(sorted(float(text) * metres for text in markings.split(";") if text.strip()))
    except ValueError:
        lines = ()
    if len(lines) < 2:
        message = f"{carriageway}LaneMarkings must be two numbers or more with ; between them, got {markings[:60]!r}"
        raise InputError([f"{message}. Correct it, or choose the other tracks.carriageway"], str(meta))
    texts = read_columns(path, HIGHD_COLUMNS)
    columns = numbers(texts, path)
    scaled = {name: values * metres for name, values in columns.items() if name != "frame"}
    scaled["x"] = scaled["x"] + 0.5 * scaled["width"]
    scaled["y"] = scaled["y"] + 0.5 * scaled["height"]
    scaled["speed"] = np.hypot(scaled["xVelocity"], scaled["yVelocity"])
    names = ("x", "y", "speed", "width", "height")
    return TableRecord(1.0 / rate, list(_tracks(texts["id"], columns["frame"] / rate, scaled, names)), lines)


def _tracks(
    ids: Sequence[str], time: FloatArray, columns: Mapping[str, FloatArray], names: Sequence[str]
) -> Iterator[Track]:
    """Yield the rows of each vehicle by time.

    Args:
        ids: of the rows' vehicles.
        time: of the rows [s].
        columns: with one value a row.
        names: of the columns of x, y, speed, length and width.
    """
    owners, inverse = np.unique(np.asarray(ids), return_inverse=True)
    order = np.lexsort((time, inverse))
    for owner, rows in zip(owners, np.split(order, np.cumsum(np.bincount(inverse))[:-1]), strict=True):
        x, y, speed, length, width = (columns[name][rows] for name in names)
        # Boxes of images differ from frame to frame; a body does not.
        yield Track(str(owner), float(np.median(length)), float(np.median(width)), time[rows], x, y, None, speed)
