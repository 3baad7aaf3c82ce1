"""The tables of one run as the compact JSON that the replay page draws from.

Rows become columns per vehicle, positions are rounded to the millimetre, and what is not finite becomes null.
"""

import json
import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from sumo_hmdp.domain.maneuver import MODE_BY_LABEL
from sumo_hmdp.domain.scene import EGO_ID
from sumo_hmdp.errors import InputError, Problem
from sumo_hmdp.report.replay_events import conflicts
from sumo_hmdp.report.replay_notes import NOTES, notes_of

if TYPE_CHECKING:
    import pandas as pd

STEP_COLUMNS = (
    "time_s",
    "vehicle_id",
    "x_m",
    "y_m",
    "heading_rad",
    "speed_mps",
    "accel_mps2",
    "lane",
    "intended_lane",
    "mode",
    "length_m",
    "width_m",
)
DECISION_COLUMNS = (
    "decision_index",
    "time_s",
    "status",
    "reason",
    "lateral",
    "mode",
    "lane",
    "objective",
    "violation_m",
    "solver",
    "solve_time_ms",
    "pruned_prob",
    "branch_count",
    "plan_json",
    "branches_json",
    "forbidden_json",
)
BOUNDS, ACTIONS, RISK = "bounds_json", "actions_json", "risk_json"
_KEY_OF = {BOUNDS: "bounds", ACTIONS: "actions", RISK: "risk"}
# Only where the planner bounds the risk of whole plans; null elsewhere, and in results of earlier versions.
_RISK_DECIMALS = {"risk_taken": 10, "risk_least": 10, "contact_risk": 10}
# Decimals kept: millimetres for lengths, finer where a display derives from the number.
_DECIMALS = {"x_m": 3, "y_m": 3, "heading_rad": 5, "speed_mps": 4, "accel_mps2": 4}
_DECISION_DECIMALS = {"objective": 6, "violation_m": 6, "solve_time_ms": 3, "pruned_prob": 8}
_TIME_DECIMALS = 6
# No road is this long: a bound beyond it stands for "unbounded".
_UNBOUNDED_M = 1e6


def replay_data(manifest: Mapping[str, Any], steps: "pd.DataFrame", decisions: "pd.DataFrame") -> dict[str, Any]:
    """Collect what the page draws.

    Args:
        manifest: the run's manifest; `lanes` must hold `count` and `width_m` [m].
        steps: one row per recorded instant and vehicle, in any order.
        decisions: one row per decision, in any order; may be empty.

    Returns:
        JSON-ready data: `times_s`, `lanes`, `vehicles` with their columns, `conflicts`, and `decisions` with plan,
        branches and forbidden intervals.

    Raises:
        InputError: a column or the road is missing, or a JSON column cannot be read.
    """
    _check(manifest, steps, decisions)
    times = sorted({_number(time, _TIME_DECIMALS) for time in _column(steps, "time_s")})
    return {
        "ego_id": EGO_ID,
        "lanes": {"count": int(manifest["lanes"]["count"]), "width_m": float(manifest["lanes"]["width_m"])},
        "period_s": _number(manifest.get("period_s"), _TIME_DECIMALS),
        "risk_level": _number(manifest.get("risk_level"), 10),
        "times_s": times,
        "vehicles": _vehicles(steps, times),
        "conflicts": conflicts(steps),
        "decisions": decision_records(decisions),
    }


def _check(manifest: Mapping[str, Any], steps: "pd.DataFrame", decisions: "pd.DataFrame") -> None:
    """Raise one error that lists every missing column and every missing key of the road."""
    problems = []
    for name, table, columns in (("steps", steps, STEP_COLUMNS), ("decisions", decisions, DECISION_COLUMNS)):
        # A table without rows may also lack columns: that is what an empty DataFrame is.
        missing = [column for column in columns if column not in table.columns] if len(table) else []
        problems += [
            Problem(f"{name}.{column}", "column must exist, got none. Pass the table as the run wrote it.")
            for column in missing
        ]
    lanes = manifest.get("lanes")
    for key in ("count", "width_m"):
        value = lanes.get(key) if isinstance(lanes, Mapping) else None
        if not isinstance(value, int | float) or not value > 0:
            problems.append(
                Problem(f"manifest.lanes.{key}", f"must be a number > 0, got {value!r}. Pass the run's manifest.")
            )
    if problems:
        raise InputError(problems, source="replay")


def _vehicles(steps: "pd.DataFrame", times: list[float]) -> list[dict[str, Any]]:
    """Turn rows into columns per vehicle, the ego first and the others ordered by id."""
    if not len(steps):
        return []
    frame_of = {time: frame for frame, time in enumerate(times)}
    by_id: dict[str, dict[int, dict[str, Any]]] = {}
    for row in _rows(steps, STEP_COLUMNS):
        frame = frame_of[_number(row["time_s"], _TIME_DECIMALS)]
        by_id.setdefault(str(row["vehicle_id"]), {})[frame] = row
    ordered = sorted(by_id, key=lambda vehicle_id: (vehicle_id != EGO_ID, vehicle_id))
    return [_vehicle(vehicle_id, by_id[vehicle_id]) for vehicle_id in ordered]


def _vehicle(vehicle_id: str, rows: dict[int, dict[str, Any]]) -> dict[str, Any]:
    """Return one vehicle's columns from its first to its last frame, null where it is not recorded."""
    first, last = min(rows), max(rows)
    absent: dict[str, Any] = {}
    span = [rows.get(frame, absent) for frame in range(first, last + 1)]
    columns: dict[str, list[Any]] = {
        name: [_number(row.get(name), decimals) for row in span] for name, decimals in _DECIMALS.items()
    }
    for name in ("lane", "intended_lane"):
        columns[name] = [_number(row.get(name), 0) for row in span]
    columns["mode"] = [_mode(row.get("mode")) for row in span]
    return {
        "id": vehicle_id,
        "length_m": _number(rows[first]["length_m"], 3),
        "width_m": _number(rows[first]["width_m"], 3),
        "first": first,
        **columns,
    }


def decision_records(decisions: "pd.DataFrame") -> list[dict[str, Any]]:
    """Return the decisions in the order of their times, their JSON columns opened."""
    if not len(decisions):
        return []
    problems: list[Problem] = []
    # Results of before the bounds were written say nothing of them; the other first actions stand in no results.
    unknown = [name for name in (*_KEY_OF, *_RISK_DECIMALS) if name not in decisions.columns]
    decisions = decisions.assign(**dict.fromkeys([*unknown, *({NOTES} - set(decisions.columns))]))
    records = [
        _decision(row, f"decisions[{position}]", problems)
        for position, row in enumerate(_rows(decisions, (*DECISION_COLUMNS, *_KEY_OF, *_RISK_DECIMALS, NOTES)))
    ]
    if problems:
        raise InputError(problems, source="replay")
    missing = {_KEY_OF[name]: None for name in unknown if name in _KEY_OF}
    records = [record | missing for record in records]
    return sorted(records, key=lambda record: (record["time_s"], record["decision_index"]))


def _decision(row: Mapping[str, Any], path: str, problems: list[Problem]) -> dict[str, Any]:
    record: dict[str, Any] = {
        "decision_index": int(row["decision_index"]),
        "time_s": _number(row["time_s"], _TIME_DECIMALS),
        "lane": _number(row["lane"], 0),
        "branch_count": _number(row["branch_count"], 0),
    }
    record |= {name: _text(row[name]) for name in ("status", "reason", "lateral", "mode", "solver")}
    numbers = _DECISION_DECIMALS | _RISK_DECIMALS
    record |= {name: _number(row[name], decimals) for name, decimals in numbers.items()}
    opened = {}
    for name in ("plan_json", "branches_json", "forbidden_json", *_KEY_OF):
        opened[name], problem = _opened(row[name])
        if problem:
            problems.append(Problem(f"{path}.{name}", problem))
    record["plan"] = [
        _rounded(entry, {"x_m": 3, "speed_mps": 4}, ("step", "lateral", "mode", "lane"))
        for entry in opened["plan_json"]
    ]
    record["bounds"] = [
        _rounded(entry, {"room_m": 3, "probability": 6, "x_m": 3, "distance_m": 3}, ("step", "side", "vehicle_id"))
        for entry in opened[BOUNDS]
    ]
    record["actions"] = [
        _rounded(
            entry, {"objective": 6, "violation_m": 3, "risk": 10}, ("lateral", "mode", "chosen", "verdict", "reason")
        )
        for entry in opened[ACTIONS]
    ]
    record["notes"], problem = notes_of(row[NOTES])
    if problem:
        problems.append(Problem(f"{path}.{NOTES}", problem))
    record["risk"] = [
        _rounded(entry, {"total": 10}, ("vehicle_id", "step", "cause", "reason"))
        | {"parts": [_number(part, 10) for part in entry.get("parts", ())]}
        for entry in opened[RISK]
    ]
    record["branches"] = [_branch(entry) for entry in opened["branches_json"]]
    record["forbidden"] = [
        {
            "step": entry.get("step"),
            "lane": entry.get("lane"),
            "x_from_m": _bound(entry.get("x_from_m")),
            "x_to_m": _bound(entry.get("x_to_m")),
        }
        | ({"leaving_x_m": _bound(entry["leaving_x_m"])} if "leaving_x_m" in entry else {})
        for entry in opened["forbidden_json"]
    ]
    return record


def _branch(entry: Mapping[str, Any]) -> dict[str, Any]:
    branch: dict[str, Any] = {
        "vehicle_id": str(entry.get("vehicle_id")),
        "probability": _number(entry.get("probability"), 6),
    }
    for name in ("x_m", "y_m", "x_std_m", "y_std_m"):
        branch[name] = [_number(value, 3) for value in entry.get(name, ())]
    return branch


def _rounded(entry: Mapping[str, Any], decimals: Mapping[str, int], kept: Iterable[str]) -> dict[str, Any]:
    numbers = {name: _number(entry.get(name), places) for name, places in decimals.items()}
    return {name: entry.get(name) for name in kept} | numbers


def _opened(text: object) -> tuple[list[dict[str, Any]], str]:
    """Return the list in a JSON column and what is wrong with it, if anything; no text is an empty list."""
    if not isinstance(text, str) or not text.strip():
        return [], ""
    try:
        value = json.loads(text)
    except json.JSONDecodeError as error:
        return [], f"must hold JSON, got {text[:40]!r} ({error}). Pass the table as the run wrote it."
    if value is None:
        return [], ""
    if not isinstance(value, list) or not all(isinstance(entry, dict) for entry in value):
        return [], f"must hold a list of objects, got {text[:40]!r}. Pass the table as the run wrote it."
    return value, ""


def _rows(table: "pd.DataFrame", columns: Iterable[str]) -> list[dict[str, Any]]:
    names = list(columns)
    lists = [_column(table, name) for name in names]
    return [dict(zip(names, values, strict=True)) for values in zip(*lists, strict=True)]


def _column(table: "pd.DataFrame", name: str) -> list[Any]:
    return list(table[name].tolist()) if name in table.columns else []


def _number(value: object, decimals: int) -> Any:  # noqa: ANN401 - an int, a float or None, as JSON wants it
    """Round; whole numbers become ints, which are shorter in JSON, and what is not finite None."""
    if not isinstance(value, int | float) or not math.isfinite(value):
        return None
    rounded = round(float(value), decimals)
    return int(rounded) if rounded.is_integer() else rounded


def _bound(value: object) -> float | None:
    number = _number(value, 3)
    return None if number is None or abs(number) >= _UNBOUNDED_M else number


def _mode(value: object) -> int | None:
    return int(MODE_BY_LABEL[value]) if isinstance(value, str) and value in MODE_BY_LABEL else None


def _text(value: object) -> str:
    return value if isinstance(value, str) else ""
