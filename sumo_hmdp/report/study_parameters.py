"""What a study was run with: factors, parameters, the traffic's drivers, versions."""

import json
from collections.abc import Iterator, Mapping
from typing import Any

import pandas as pd

from sumo_hmdp.report.study_data import StudyCell, StudyData
from sumo_hmdp.report.study_table import StudyTable, listed
from sumo_hmdp.scenario.traffic import TrafficFile
from sumo_hmdp.traffic.drivers import TruncatedNormal, VehicleClass

# Of the manifest; what the rest holds is in these.
_PARTS = ("scenario", "planner", "solver", "dt_s", "period_s", "duration_s", "motion", "parameters", "configuration")
# Of the configuration; other planners' parameters do not drive, and texts are no parameters.
_LEFT_OUT = ("planners", "planner", "name", "description", "published", "duration_s", "dt_s")


def parameter_table(data: StudyData) -> StudyTable:
    """Return every parameter and which cells have which value of it."""
    flat = {cell.label: dict(_flat(_parameters(cell))) for cell in data.cells}
    return _by_value("parameters", "Parameters", flat)


def traffic_table(data: StudyData) -> StudyTable:
    """Return how the traffic drives: IDM parameters of each class of vehicles, and MOBIL's."""
    flat = {cell.label: dict(_flat(_drivers(cell.manifest["configuration"].get("traffic")))) for cell in data.cells}
    return _by_value("traffic", "Drivers of the traffic: IDM along the road, MOBIL across it", flat)


def version_table(data: StudyData) -> StudyTable:
    """Return the versions of the software; where a cell was begun with others, those too."""
    flat = {}
    for cell in data.cells:
        before = cell.manifest.get("versions_before", [])
        named = {f"{key} (before)": value for one in before for key, value in one.items()}
        flat[cell.label] = dict(_flat(dict(cell.manifest["versions"]) | named))
    return _by_value("versions", "Versions", flat)


def _parameters(cell: StudyCell) -> dict[str, Any]:
    found = {key: cell.manifest[key] for key in _PARTS if key in cell.manifest}
    found["configuration"] = {k: v for k, v in found["configuration"].items() if k not in _LEFT_OUT}
    return found


def _drivers(traffic: Mapping[str, Any] | None) -> dict[str, Any]:
    if traffic is None:
        return {}
    # The manifest may name the population only; its classes are part of the package, and a speed limit slows them.
    traffic_file = TrafficFile.model_validate(traffic)
    kinds = {kind.name: _class(kind) for kind in traffic_file.vehicle_classes()}
    return {"idm": kinds, "mobil": traffic_file.lane_changes.model_dump()}


def _class(kind: VehicleClass) -> dict[str, Any]:
    return {
        "share": kind.share,
        "length_m": kind.length,
        "width_m": kind.width,
        "desired_speed_mps": _spread(kind.desired_speed),
        "time_gap_s": _spread(kind.time_gap),
        "politeness": _spread(kind.politeness),
        "min_gap_m": kind.min_gap,
        "accel_mps2": kind.accel,
        "decel_mps2": kind.decel,
        "exponent": kind.exponent,
    }


def _spread(law: TruncatedNormal) -> dict[str, float]:
    return {"mean": law.mean, "std": law.std, "min": law.low, "max": law.high}


def _flat(value: object, path: str = "") -> Iterator[tuple[str, str]]:
    """Yield every leaf with its dotted path; lists of numbers and the numbers of a distribution stay together."""
    if isinstance(value, Mapping):
        if set(value) == {"mean", "std", "min", "max"}:
            yield path, ", ".join(f"{key} {inner:.6g}" for key, inner in value.items())
            return
        for key, inner in value.items():
            yield from _flat(inner, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list) and any(isinstance(inner, Mapping) for inner in value):
        for place, inner in enumerate(value):
            yield from _flat(inner, f"{path}[{place}]")
    else:
        yield path, value if isinstance(value, str) else json.dumps(value, default=str)


def _by_value(name: str, caption: str, flat: Mapping[str, Mapping[str, str]]) -> StudyTable:
    """Return one row for each value of each parameter, with the cells that have it."""
    records = []
    for key in dict.fromkeys(key for values in flat.values() for key in values):
        cells: dict[str, list[str]] = {}
        for label, values in flat.items():
            if key in values:
                cells.setdefault(values[key], []).append(label)
        records += [(key, value, labels) for value, labels in cells.items()]
    headings = ("name", "value", "cells")
    told = [(key, value, "all" if len(labels) == len(flat) else listed(labels, 4)) for key, value, labels in records]
    everything = [(key, value, "; ".join(labels)) for key, value, labels in records]
    return StudyTable(name, caption, pd.DataFrame(everything, columns=list(headings)), headings, tuple(told))
