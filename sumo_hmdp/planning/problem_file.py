"""The file form of a decision: reading and checking a problem, and writing problems and answers."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag

from sumo_hmdp.documents import read_json
from sumo_hmdp.domain.maneuver import LATERAL_BY_LABEL, MODE_BY_LABEL, Lateral, ManeuverState, Mode
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import EGO_ID, VehicleState
from sumo_hmdp.errors import InputError, Problem
from sumo_hmdp.hmdp.branches import PredictedVehicle
from sumo_hmdp.hmdp.dynamics import LateralGains, Noise
from sumo_hmdp.hmdp.policy import Policy, Probabilities, dead_end, sums_to_one
from sumo_hmdp.planning.decide import Answer
from sumo_hmdp.planning.problem import (
    DecisionProblem,
    DistanceRule,
    ManeuverSequence,
    Occupancy,
    PlannerSettings,
    Preferences,
    RiskAllocation,
    RssParameters,
)
from sumo_hmdp.validation import FileModel, parse, shown

# Beyond these no road, car or price is meant, and the arithmetic of a decision would overflow.
Number = Annotated[float, Field(ge=-1e6, le=1e6)]
Positive = Annotated[float, Field(gt=0, le=1e6)]
NonNegative = Annotated[float, Field(ge=0, le=1e6)]
Speed = Annotated[float, Field(ge=0, le=1e3)]
Step = Annotated[float, Field(ge=1e-2, le=1e3)]
Probability = Annotated[float, Field(ge=0, le=1)]
ModeName = Literal["accelerate", "cruise", "decelerate"]
CostRow = Annotated[list[NonNegative], Field(min_length=3, max_length=3)]


class LanesFile(FileModel):
    """`lanes`: the road."""

    count: Annotated[int, Field(ge=1, le=12)]
    width_m: Positive


class PlannerFile(FileModel):
    """`planner`: how to decide. Keys with a default may be left out."""

    period_s: Step
    horizon_steps: Annotated[int, Field(ge=1, le=20)]
    accel_mps2: Step
    speed_min_mps: Speed
    speed_max_mps: Annotated[float, Field(gt=0, le=1e3)]
    safe_distance_m: NonNegative
    risk_level: Annotated[float, Field(gt=0, le=0.5)]
    risk_allocation: Literal["individual", "uniform", "mixture"]
    sequence_threshold: Annotated[float, Field(gt=0, le=1)]
    action_threshold: Annotated[float, Field(ge=0, lt=1)] = 0.0
    maneuver_cost: Annotated[list[CostRow], Field(min_length=3, max_length=3)]
    speed_weight: NonNegative = 0.0
    desired_speed_mps: Speed = 0.0
    speed_deadband_mps: NonNegative = 0.0
    lane_weight: NonNegative = 0.0
    goal_lane: int | None = None
    terminal_weight: NonNegative = 0.0
    forbidden_lanes: list[int] = Field(default_factory=list)
    lateral_gain_k1_ps2: NonNegative = 3.0
    lateral_gain_k2_ps: NonNegative = 1.0
    account_pruned: bool = False
    occupancy: Literal["target", "swept"] = "target"
    lane_change_time_s: Positive = 4.0
    distance_rule: Literal["fixed", "time_headway", "rss"] = "fixed"
    time_headway_s: NonNegative = 1.5
    rss_response_time_s: NonNegative = 0.5
    rss_accel_max_mps2: NonNegative = 2.0
    rss_brake_min_mps2: Positive = 4.0
    rss_brake_max_mps2: Positive = 8.0
    stopping: bool = False
    enforce_deadline: bool = False

    def settings(self) -> PlannerSettings:
        """Return the settings as the planner uses them."""
        cost = tuple((row[0], row[1], row[2]) for row in self.maneuver_cost)
        return PlannerSettings(
            period=self.period_s,
            horizon_steps=self.horizon_steps,
            accel=self.accel_mps2,
            speed_min=self.speed_min_mps,
            speed_max=self.speed_max_mps,
            safe_distance=self.safe_distance_m,
            risk_level=self.risk_level,
            risk_allocation=RiskAllocation(self.risk_allocation),
            sequence_threshold=self.sequence_threshold,
            action_threshold=self.action_threshold,
            forbidden_lanes=frozenset(self.forbidden_lanes),
            preferences=Preferences(
                maneuver_cost=cost,
                speed_weight=self.speed_weight,
                desired_speed=self.desired_speed_mps,
                speed_deadband=self.speed_deadband_mps,
                lane_weight=self.lane_weight,
                goal_lane=self.goal_lane,
                terminal_weight=self.terminal_weight,
            ),
            gains=LateralGains(self.lateral_gain_k1_ps2, self.lateral_gain_k2_ps),
            account_pruned=self.account_pruned,
            occupancy=Occupancy(self.occupancy),
            lane_change_time=self.lane_change_time_s,
            distance_rule=DistanceRule(self.distance_rule),
            time_headway=self.time_headway_s,
            rss=RssParameters(
                self.rss_response_time_s, self.rss_accel_max_mps2, self.rss_brake_min_mps2, self.rss_brake_max_mps2
            ),
            stopping=self.stopping,
            enforce_deadline=self.enforce_deadline,
        )


class LateralFile(FileModel):
    """A distribution over the lateral action."""

    left: Probability
    keep: Probability
    right: Probability

    def probabilities(self) -> Probabilities:
        """Return left, keep, right."""
        return self.left, self.keep, self.right


class LongitudinalFile(FileModel):
    """A distribution over the next mode."""

    accelerate: Probability
    cruise: Probability
    decelerate: Probability

    def probabilities(self) -> Probabilities:
        """Return decelerate, cruise, accelerate."""
        return self.decelerate, self.cruise, self.accelerate


LATERAL_KEYS = ("left", "keep", "right")


def _lateral_form(value: Any) -> str:  # noqa: ANN401 - anything may stand in a file
    """Tell a table for every lane from one table a lane, also where it has mistakes."""
    if isinstance(value, Mapping):
        rows = any(isinstance(row, (Mapping, LateralFile)) for row in value.values())
        one_for_all = not {*LATERAL_KEYS}.isdisjoint(value) or (len(value) > 0 and not rows)
    else:
        one_for_all = isinstance(value, LateralFile)
    return "one" if one_for_all else "by_lane"


LateralTables = Annotated[
    Annotated[LateralFile, Tag("one")] | Annotated[dict[str, LateralFile], Tag("by_lane")],
    Discriminator(_lateral_form),
]


class PolicyFile(FileModel):
    """The policy keys of a vehicle: one lateral table for every lane, or one per lane keyed by its number."""

    lateral_probs: LateralTables
    longitudinal_probs: LongitudinalFile

    def policy(self, lane_count: int) -> Policy:
        """Return the policy with one lateral row a lane."""
        if isinstance(self.lateral_probs, LateralFile):
            rows = (self.lateral_probs.probabilities(),) * lane_count
        else:
            rows = tuple(self.lateral_probs[str(lane)].probabilities() for lane in range(1, lane_count + 1))
        return Policy(rows, self.longitudinal_probs.probabilities())


class NoiseFile(FileModel):
    """The uncertainty keys of a vehicle."""

    position_var_m2: NonNegative = 0.0
    speed_var_m2ps2: NonNegative = 0.0
    process_position_var_m2: NonNegative = 0.0
    process_speed_var_m2ps2: NonNegative = 0.0

    def noise(self) -> Noise:
        """Return the noise."""
        return Noise(
            self.position_var_m2,
            self.speed_var_m2ps2,
            self.process_position_var_m2,
            self.process_speed_var_m2ps2,
        )


class StateFile(FileModel):
    """The state keys of a vehicle; (x, y) is the centre of its front bumper."""

    x_m: Number
    y_m: Number
    speed_mps: Speed
    lane: int
    mode: ModeName
    length_m: Positive = 4.5
    width_m: Positive = 1.8
    lateral_speed_mps: Number = 0.0

    def state(self, vehicle_id: str) -> VehicleState:
        """Return the state."""
        return VehicleState(
            id=vehicle_id,
            x=self.x_m,
            y=self.y_m,
            speed=self.speed_mps,
            lane=self.lane,
            mode=MODE_BY_LABEL[self.mode],
            length=self.length_m,
            width=self.width_m,
            lateral_speed=self.lateral_speed_mps,
        )


class VehicleFile(StateFile, PolicyFile, NoiseFile):
    """One surrounding vehicle."""

    id: Annotated[str, Field(min_length=1)]


class ManeuverFile(FileModel):
    """One step of a starting plan."""

    lateral: Literal["left", "keep", "right"]
    mode: ModeName


class ProblemFile(FileModel):
    """A decision problem."""

    lanes: LanesFile
    planner: PlannerFile
    ego: StateFile
    vehicles: list[VehicleFile]
    start_plan: list[ManeuverFile] | None = None

    def problem(self) -> DecisionProblem:
        """Return the problem as the planner uses it."""
        steps = self.start_plan
        start = (
            None
            if steps is None
            else ManeuverSequence(
                tuple(LATERAL_BY_LABEL[step.lateral] for step in steps),
                tuple(MODE_BY_LABEL[step.mode] for step in steps),
            )
        )
        return DecisionProblem(
            road=Road(self.lanes.count, self.lanes.width_m),
            settings=self.planner.settings(),
            ego=self.ego.state(EGO_ID),
            vehicles=tuple(
                PredictedVehicle(vehicle.state(vehicle.id), vehicle.policy(self.lanes.count), vehicle.noise())
                for vehicle in self.vehicles
            ),
            start=start,
        )


@dataclass(frozen=True)
class _Raw:
    """What a file holds before it is known to be valid: looks values up and answers None where they do not fit."""

    content: Any

    def get(self, *path: str | int) -> Any:  # noqa: ANN401 - anything may stand in a file
        current = self.content
        for part in path:
            if isinstance(part, int):
                current = current[part] if isinstance(current, list) and part < len(current) else None
            else:
                current = current.get(part) if isinstance(current, Mapping) else None
        return current

    def number(self, *path: str | int) -> float | None:
        value = self.get(*path)
        if not isinstance(value, (int, float)) or isinstance(value, bool):
            return None
        try:
            return float(value) if math.isfinite(value) else None
        except OverflowError:
            return None

    def integer(self, *path: str | int) -> int | None:
        value = self.get(*path)
        return value if isinstance(value, int) and not isinstance(value, bool) else None

    def lane_count(self) -> int | None:
        count = self.integer("lanes", "count")
        return count if count is not None and count >= 1 else None


def parse_problem(
    content: Any,  # noqa: ANN401 - anything may stand in a file
    source: str = "",
    known: Iterable[Problem] = (),
) -> DecisionProblem:
    """Check what was read from a file and return the problem.

    Args:
        content: a decoded JSON document: a problem, or an object with a `problem`.
        source: the file's name, for the messages.
        known: mistakes that reading it has found already.

    Raises:
        InputError: with every mistake and its path.
    """
    problems = list(known)
    if isinstance(content, Mapping) and "problem" in content:
        content = content["problem"]
        problems = [Problem(p.path.removeprefix("problem."), p.message) for p in problems]
    parsed: ProblemFile | None = None
    try:
        parsed = parse(ProblemFile, content)
    except InputError as error:
        problems.extend(error.problems)
    problems.extend(_cross_checks(_Raw(content)))
    if parsed is not None and not problems:
        problems.extend(_dead_ends(parsed))
    if problems or parsed is None:
        raise InputError(problems, source)
    return parsed.problem()


def _cross_checks(raw: _Raw) -> Iterator[Problem]:
    """Check what takes more than one field; values of a wrong type have been reported already."""
    yield from _lane_checks(raw)
    yield from planner_checks(raw.get("planner"), "planner")
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


def _lane_checks(raw: _Raw) -> Iterator[Problem]:
    count = raw.lane_count()
    if count is None:
        return
    places: list[tuple[str | int, ...]] = [("ego", "lane"), ("planner", "goal_lane")]
    places += [("vehicles", index, "lane") for index in range(_length(raw.get("vehicles")))]
    forbidden = raw.get("planner", "forbidden_lanes")
    places += [("planner", "forbidden_lanes", index) for index in range(_length(forbidden))]
    for place in places:
        lane = raw.integer(*place)
        if lane is not None and not 1 <= lane <= count:
            text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place)[1:]
            yield Problem(text, f"must be 1..{count}, got {lane}")
    if isinstance(forbidden, list) and set(range(1, count + 1)) <= {x for x in forbidden if isinstance(x, int)}:
        yield Problem("planner.forbidden_lanes", "must leave the ego at least one lane; take one out")


def planner_checks(planner: Any, path: str) -> Iterator[Problem]:  # noqa: ANN401 - anything may stand in a file
    """Check the relations between the planner's keys."""
    raw = _Raw(planner)
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
    raw = _Raw(vehicle)
    lateral = raw.get("lateral_probs")
    if isinstance(lateral, Mapping):
        if _lateral_form(lateral) == "one":
            yield from _sum_check(lateral, f"{path}.lateral_probs", LATERAL_KEYS)
        else:
            for lane, row in lateral.items():
                if lane_count is not None and lane not in {str(n) for n in range(1, lane_count + 1)}:
                    yield Problem(
                        f"{path}.lateral_probs.{lane}",
                        f"must be keyed by a lane 1..{lane_count}, got {shown(lane)}",
                    )
                yield from _sum_check(row, f"{path}.lateral_probs.{lane}", LATERAL_KEYS)
            missing = [str(n) for n in range(1, (lane_count or 0) + 1) if str(n) not in lateral]
            if missing:
                yield Problem(f"{path}.lateral_probs", f"must have a table for every lane; add {', '.join(missing)}")
    yield from _sum_check(
        raw.get("longitudinal_probs"), f"{path}.longitudinal_probs", ("accelerate", "cruise", "decelerate")
    )


def _sum_check(table: Any, path: str, keys: tuple[str, ...]) -> Iterator[Problem]:  # noqa: ANN401
    raw = _Raw(table)
    values = [number for key in keys if (number := raw.number(key)) is not None]
    # A value outside [0, 1], or NaN, is a mistake of its own and has been reported.
    usable = len(values) == len(keys) and all(0 <= value <= 1 for value in values)
    if usable and not sums_to_one(values):
        yield Problem(path, f"must sum to 1, got {sum(values):g}")


def _dead_ends(file: ProblemFile) -> Iterator[Problem]:
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


def read_problem(path: Path) -> DecisionProblem:
    """Read a decision problem from a JSON file.

    Raises:
        InputError: if the file cannot be read, is not JSON or holds mistakes; all of them are listed.
    """
    document = read_json(path)
    return parse_problem(document.content, str(path), document.problems)


def problem_document(problem: DecisionProblem) -> dict[str, Any]:
    """Return the file form of a problem, ready for JSON; `parse_problem` of it gives the problem back."""
    settings, preferences = problem.settings, problem.settings.preferences
    return {
        "lanes": {"count": problem.road.lane_count, "width_m": problem.road.lane_width},
        "planner": {
            "period_s": settings.period,
            "horizon_steps": settings.horizon_steps,
            "accel_mps2": settings.accel,
            "speed_min_mps": settings.speed_min,
            "speed_max_mps": settings.speed_max,
            "safe_distance_m": settings.safe_distance,
            "risk_level": settings.risk_level,
            "risk_allocation": str(settings.risk_allocation),
            "sequence_threshold": settings.sequence_threshold,
            "action_threshold": settings.action_threshold,
            "maneuver_cost": [list(row) for row in preferences.maneuver_cost],
            "speed_weight": preferences.speed_weight,
            "desired_speed_mps": preferences.desired_speed,
            "speed_deadband_mps": preferences.speed_deadband,
            "lane_weight": preferences.lane_weight,
            "goal_lane": preferences.goal_lane,
            "terminal_weight": preferences.terminal_weight,
            "forbidden_lanes": sorted(settings.forbidden_lanes),
            "lateral_gain_k1_ps2": settings.gains.k1,
            "lateral_gain_k2_ps": settings.gains.k2,
            "account_pruned": settings.account_pruned,
            "occupancy": str(settings.occupancy),
            "lane_change_time_s": settings.lane_change_time,
            "distance_rule": str(settings.distance_rule),
            "time_headway_s": settings.time_headway,
            "rss_response_time_s": settings.rss.response_time,
            "rss_accel_max_mps2": settings.rss.accel_max,
            "rss_brake_min_mps2": settings.rss.brake_min,
            "rss_brake_max_mps2": settings.rss.brake_max,
            "stopping": settings.stopping,
            "enforce_deadline": settings.enforce_deadline,
        },
        "ego": _state_document(problem.ego),
        "vehicles": [_vehicle_document(vehicle) for vehicle in problem.vehicles],
        "start_plan": None
        if problem.start is None
        else [
            {"lateral": lateral.label, "mode": mode.label}
            for lateral, mode in zip(problem.start.laterals, problem.start.modes, strict=True)
        ],
    }


def _state_document(state: VehicleState) -> dict[str, Any]:
    return {
        "x_m": state.x,
        "y_m": state.y,
        "speed_mps": state.speed,
        "lane": state.lane,
        "mode": state.mode.label,
        "length_m": state.length,
        "width_m": state.width,
        "lateral_speed_mps": state.lateral_speed,
    }


def _vehicle_document(vehicle: PredictedVehicle) -> dict[str, Any]:
    def row(probabilities: Probabilities) -> dict[str, float]:
        return {lateral.label: probabilities[lateral + 1] for lateral in Lateral}

    return {
        "id": vehicle.state.id,
        **_state_document(vehicle.state),
        "lateral_probs": {str(lane): row(p) for lane, p in enumerate(vehicle.policy.lateral, start=1)},
        "longitudinal_probs": {mode.label: vehicle.policy.longitudinal[mode + 1] for mode in Mode},
        "position_var_m2": vehicle.noise.position_var,
        "speed_var_m2ps2": vehicle.noise.speed_var,
        "process_position_var_m2": vehicle.noise.process_position_var,
        "process_speed_var_m2ps2": vehicle.noise.process_speed_var,
    }


def answer_document(answer: Answer) -> dict[str, Any]:
    """Return the file form of an answer, ready for JSON."""
    return {
        "status": str(answer.status),
        "objective": answer.objective,
        "violation_m": answer.violation,
        "reason": answer.reason,
        "solver": answer.solver,
        "solve_time_ms": round(1000 * answer.solve_time, 3),
        "action": {"lateral": answer.lateral.label, "mode": answer.mode.label},
        "brake_mps2": answer.brake,
        "plan": [
            {
                "step": step.step,
                "lateral": step.lateral.label,
                "mode": step.mode.label,
                "lane": step.lane,
                "x_m": step.x,
                "speed_mps": step.speed,
            }
            for step in answer.plan
        ],
        "prediction": {
            "branches": len(answer.branches.vehicle),
            "pruned_prob": float(answer.branches.pruned.max(initial=0.0)),
        },
    }
