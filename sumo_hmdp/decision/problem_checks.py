"""Checks of a decision problem that take more than one key, on what a file holds before it is known to be valid."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from sumo_hmdp.decision.problem_schema import LANES_MAX, LATERAL_KEYS, ProblemFile, StateFile, lateral_form
from sumo_hmdp.domain.maneuver import MODE_BY_LABEL, ManeuverState
from sumo_hmdp.domain.scene import EGO_ID
from sumo_hmdp.errors import Problem
from sumo_hmdp.prediction.dynamics import LateralGains
from sumo_hmdp.prediction.policy import dead_end, sums_to_one
from sumo_hmdp.validation import shown

GAIN_KEYS = ("lateral_gain_k1_ps2", "lateral_gain_k2_ps")
VEHICLE_WIDTH: float = StateFile.model_fields["width_m"].default
# Ramps and side streets that lead onto the road are within this [m]; who is farther away is not meant.
BESIDE = 15.0


@dataclass(frozen=True)
class RawDocument:
    """What a file holds before it is known to be valid: looks values up and answers None where they do not fit."""

    content: Any

    def get(self, *path: str | int) -> Any:  # noqa: ANN401 - anything may stand in a file
        """Return what stands at a path, None where there is no such place."""
        current = self.content
        for part in path:
            if isinstance(part, int):
                current = current[part] if isinstance(current, list) and part < len(current) else None
            else:
                current = current.get(part) if isinstance(current, Mapping) else None
        return current

    def number(self, *path: str | int) -> float | None:
        """Return the finite number at a path, None where there is none."""
        value = self.get(*path)
        if not isinstance(value, (int, float)) or isinstance(value, bool):
            return None
        try:
            return float(value) if math.isfinite(value) else None
        except OverflowError:
            return None

    def integer(self, *path: str | int) -> int | None:
        """Return the whole number at a path, None where there is none."""
        value = self.get(*path)
        return value if isinstance(value, int) and not isinstance(value, bool) else None

    def lane_count(self) -> int | None:
        """Return the number of lanes, None where it is not usable."""
        count = self.integer("lanes", "count")
        return count if count is not None and 1 <= count <= LANES_MAX else None


def cross_checks(raw: RawDocument) -> Iterator[Problem]:
    """Check what takes more than one field; values of a wrong type have been reported already."""
    yield from _lane_checks(raw)
    yield from _line_checks(raw)
    yield from _place_checks(raw)
    # Under `target` no decision hangs on y.
    yield from planner_checks(raw.get("planner"), "planner", y_counts=raw.get("planner", "occupancy") == "swept")
    start, horizon = raw.get("start_plan"), raw.integer("planner", "horizon_steps")
    if isinstance(start, list) and horizon is not None and len(start) != horizon:
        yield Problem(
            "start_plan", f"must have horizon_steps ({horizon}) steps, got {len(start)}; leave it out if unsure"
        )
    ids: set[str] = set()
    for index in range(_length(raw.get("vehicles"))):
        path = f"vehicles[{index}]"
        vehicle_id = raw.get("vehicles", index, "id")
        if isinstance(vehicle_id, str):
            if vehicle_id in ids or vehicle_id == EGO_ID:
                yield Problem(f"{path}.id", f"must be unique and not `{EGO_ID}`, got {shown(vehicle_id)}")
            ids.add(vehicle_id)
        yield from table_checks(raw.get("vehicles", index), path, raw.lane_count())
        yield from _drift_checks(raw, index, horizon)


def _drift_checks(raw: RawDocument, index: int, horizon: int | None) -> Iterator[Problem]:
    drift, path = raw.get("vehicles", index, "drift"), f"vehicles[{index}].drift"
    if not isinstance(drift, list) or not drift or horizon is None:
        return
    if len(drift) != horizon:
        yield Problem(path, f"must have horizon_steps ({horizon}) steps, got {len(drift)}; leave it out for none")
    speed, accel = raw.number("vehicles", index, "speed_mps"), raw.number("planner", "accel_mps2")
    period = raw.number("planner", "period_s")
    if speed is not None and accel is not None and period is not None and speed < horizon * accel * period:
        message = "must go with a vehicle that cannot come to rest within the horizon (speed_mps of at least "
        yield Problem(path, f"{message}{horizon * accel * period:g} m/s), got {speed:g} m/s; leave it out")


def _lane_checks(raw: RawDocument) -> Iterator[Problem]:
    count = raw.lane_count()
    if count is None:
        return
    places: list[tuple[str | int, ...]] = [("ego", "lane"), ("planner", "goal_lane")]
    places += [("vehicles", index, "lane") for index in range(_length(raw.get("vehicles")))]
    forbidden = raw.get("planner", "forbidden_lanes")
    places += [("planner", "forbidden_lanes", index) for index in range(_length(forbidden))]
    for index in range(_length(raw.get("stop_lines"))):
        lanes = raw.get("stop_lines", index, "lanes")
        places += [("stop_lines", index, "lanes", number) for number in range(_length(lanes))]
    for key in ("speed_zones", "no_change"):
        places += [(key, index, "lane") for index in range(_length(raw.get(key)))]
    for place in places:
        lane = raw.integer(*place)
        if lane is not None and not 1 <= lane <= count:
            text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place)[1:]
            yield Problem(text, f"must be 1..{count}, got {lane}")
    if isinstance(forbidden, list) and set(range(1, count + 1)) <= {x for x in forbidden if isinstance(x, int)}:
        yield Problem("planner.forbidden_lanes", "must leave the ego at least one lane; take one out")


def _line_checks(raw: RawDocument) -> Iterator[Problem]:
    for key in ("speed_zones", "no_change"):
        for index in range(_length(raw.get(key))):
            begin, end = raw.number(key, index, "x_begin_m"), raw.number(key, index, "x_end_m")
            if begin is not None and end is not None and not begin < end:
                message = f"must be above x_begin_m ({begin:g} m), got {end:g} m; swap them"
                yield Problem(f"{key}[{index}].x_end_m", message)
    for index in range(_length(raw.get("stop_lines"))):
        x, leaving = raw.number("stop_lines", index, "x_m"), raw.number("stop_lines", index, "leaving_x_m")
        if x is not None and leaving is not None and leaving < x:
            yield Problem(
                f"stop_lines[{index}].leaving_x_m",
                f"must be at least x_m ({x:g} m), got {leaving:g} m; leave it out if equal",
            )


def _place_checks(raw: RawDocument) -> Iterator[Problem]:
    """Check that the ego's body is on the road, and that nobody is far beside it."""
    count, width = raw.lane_count(), raw.number("lanes", "width_m")
    if count is None or width is None or width <= 0:
        return
    holders: list[tuple[tuple[str | int, ...], str, float]] = [(("ego",), "ego", 0.0)]
    holders += [(("vehicles", i), f"vehicles[{i}]", BESIDE) for i in range(_length(raw.get("vehicles")))]
    for place, path, beside in holders:
        y, body = raw.number(*place, "y_m"), raw.number(*place, "width_m")
        reach = (count * width + (VEHICLE_WIDTH if body is None else body)) / 2 + beside
        if y is not None and abs(y) > reach:
            near = f" or within {beside:g} m of it" if beside else ""
            message = f"must be within {-reach:g}..{reach:g} m, where a body is on the road{near}, got {y:g} m"
            yield Problem(f"{path}.y_m", f"{message}; y is 0 in the middle of the road and grows to the left")


def _lateral_checks(raw: RawDocument, path: str, *, y_counts: bool) -> Iterator[Problem]:
    """Check how others move across the road: which law, and that the paper's does not overshoot."""
    model, named = raw.get("lateral_model"), [key for key in GAIN_KEYS if raw.get(key) is not None]
    if model == "lane_change" and named:
        message = f"must go with lateral_model pd, got lane_change; leave {named[0]} out, or take pd"
        yield Problem(f"{path}.{named[0]}", message)
    k1, period = raw.number("lateral_gain_k1_ps2"), raw.number("period_s")
    if period is None or not (model == "pd" or (named and model is None and y_counts)):
        return
    gain = LateralGains().k1 if k1 is None else k1
    # At the limit itself a step leads to the centre of the lane.
    if not LateralGains(gain).stable(period):
        share = gain * period**2 / 2
        message = (
            f"must be at most 2 / period_s^2 = {2 / period**2:g} 1/s2 with lateral_model pd, got {gain:g} "
            f"(K1 T^2 / 2 = {share:g} > 1: each step of a lane change overshoots); lower it or period_s, or take "
            "lateral_model lane_change"
        )
        yield Problem(f"{path}.lateral_gain_k1_ps2", message)


def planner_checks(planner: Any, path: str, *, y_counts: bool = True) -> Iterator[Problem]:  # noqa: ANN401
    """Check the relations between the planner's keys.

    Args:
        planner: what the file holds; anything may stand in it.
        path: of it.
        y_counts: whether anything follows from where others are across the road.
    """
    raw = RawDocument(planner)
    yield from _lateral_checks(raw, path, y_counts=y_counts)
    low, high = raw.number("speed_min_mps"), raw.number("speed_max_mps")
    if low is not None and high is not None and low > high:
        yield Problem(f"{path}.speed_min_mps", f"must be at most speed_max_mps ({high} m/s), got {low} m/s")
    accel, period = raw.number("accel_mps2"), raw.number("period_s")
    deadband = raw.number("speed_deadband_mps") or 0.0
    if accel is not None and period is not None and (raw.number("terminal_weight") or 0.0) > 0:
        least = accel * period / 2
        # 0.6 * 2 / 2 is not quite 0.6 in binary.
        if deadband < least - 1e-12:
            yield Problem(
                f"{path}.speed_deadband_mps",
                f"must be at least half a speed step, accel_mps2 * period_s / 2 = {least:g} m/s, with a terminal "
                f"weight, got {deadband:g} m/s; widen it or set terminal_weight to 0",
            )


def table_checks(vehicle: Any, path: str, lane_count: int | None) -> Iterator[Problem]:  # noqa: ANN401
    """Check that the probability tables of a vehicle are distributions and cover every lane."""
    raw = RawDocument(vehicle)
    yield from _lateral_table_checks(raw.get("lateral_probs"), f"{path}.lateral_probs", lane_count)
    later = raw.get("lateral_probs_later")
    for index in range(_length(later)):
        yield from _lateral_table_checks(later[index], f"{path}.lateral_probs_later[{index}]", lane_count)
    yield from _sum_check(
        raw.get("longitudinal_probs"), f"{path}.longitudinal_probs", ("accelerate", "cruise", "decelerate")
    )


def _lateral_table_checks(lateral: Any, path: str, lane_count: int | None) -> Iterator[Problem]:  # noqa: ANN401
    if not isinstance(lateral, Mapping):
        return
    if lateral_form(lateral) == "one":
        yield from _sum_check(lateral, path, LATERAL_KEYS)
        return
    for lane, row in lateral.items():
        if lane_count is not None and lane not in {str(n) for n in range(1, lane_count + 1)}:
            yield Problem(f"{path}.{lane}", f"must be keyed by a lane 1..{lane_count}, got {shown(lane)}")
        yield from _sum_check(row, f"{path}.{lane}", LATERAL_KEYS)
    missing = [str(n) for n in range(1, (lane_count or 0) + 1) if str(n) not in lateral]
    if missing:
        yield Problem(path, f"must have a table for every lane; add {', '.join(missing)}")


def _sum_check(table: Any, path: str, keys: tuple[str, ...]) -> Iterator[Problem]:  # noqa: ANN401
    raw = RawDocument(table)
    values = [number for key in keys if (number := raw.number(key)) is not None]
    # A value outside [0, 1], or NaN, is a mistake of its own and has been reported.
    usable = len(values) == len(keys) and all(0 <= value <= 1 for value in values)
    if usable and not sums_to_one(values):
        yield Problem(path, f"must sum to 1, got {sum(values):g}")


def dead_ends(file: ProblemFile) -> Iterator[Problem]:
    """Find policies that leave a vehicle nothing to do in a state that it can reach within the horizon."""
    for index, vehicle in enumerate(file.vehicles):
        start = ManeuverState(vehicle.lane, MODE_BY_LABEL[vehicle.mode])
        stuck = dead_end(vehicle.policy(file.lanes.count), start, file.planner.horizon_steps)
        if stuck is not None:
            yield dead_end_problem(f"vehicles[{index}]", stuck)


def dead_end_problem(path: str, stuck: ManeuverState) -> Problem:
    """Describe a policy that has nothing admissible to do in some state."""
    return Problem(
        f"{path}.lateral_probs, {path}.longitudinal_probs",
        f"must give an admissible action some probability in every state that is reached, got none in lane "
        f"{stuck.lane}, mode {stuck.mode.label} (the mode moves by one level a step); give `keep` or `cruise` some",
    )


def _length(value: Any) -> int:  # noqa: ANN401 - anything may stand in a file
    return len(value) if isinstance(value, list) else 0
