"""The file form of a decision: reading a problem, and writing problems and answers."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from sumo_hmdp.decision.decide import Answer
from sumo_hmdp.decision.joint import RiskTaken
from sumo_hmdp.decision.problem import DecisionProblem, PlannerSettings
from sumo_hmdp.decision.problem_checks import RawDocument, cross_checks, dead_ends
from sumo_hmdp.decision.problem_schema import ProblemFile
from sumo_hmdp.documents import read_json
from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.domain.scene import StopLine, VehicleState
from sumo_hmdp.errors import InputError, Problem
from sumo_hmdp.prediction.branches import PredictedVehicle, PredictionTooLargeError, predict
from sumo_hmdp.prediction.policy import Probabilities
from sumo_hmdp.validation import parse


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
    problems.extend(cross_checks(RawDocument(content)))
    if parsed is not None and not problems:
        problems.extend(dead_ends(parsed))
    if problems or parsed is None:
        raise InputError(problems, source)
    problem = parsed.problem()
    try:
        predict(problem.vehicles, problem.settings.prediction())
    except PredictionTooLargeError as error:
        message = str(error).removeprefix("sequence_threshold ")
        raise InputError([Problem("planner.sequence_threshold", message)], source) from None
    return problem


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
    document: dict[str, Any] = {
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
            **_lateral_document(settings),
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
            "way_out": str(settings.way_out),
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
    if problem.stop_lines:
        document["stop_lines"] = [_line_document(line) for line in problem.stop_lines]
    rules = problem.rules
    if rules.speed_zones:
        document["speed_zones"] = [
            {"lane": z.lane, "x_begin_m": z.x_begin, "x_end_m": z.x_end, "speed_mps": z.speed}
            for z in rules.speed_zones
        ]
    if rules.no_change:
        document["no_change"] = [
            {"lane": r.lane, "to": r.lateral.label, "x_begin_m": r.x_begin, "x_end_m": r.x_end} for r in rules.no_change
        ]
    return document


def _lateral_document(settings: PlannerSettings) -> dict[str, Any]:
    if settings.gains is None:
        return {"lateral_model": "lane_change"}
    gains = settings.gains
    return {"lateral_model": "pd", "lateral_gain_k1_ps2": gains.k1, "lateral_gain_k2_ps": gains.k2}


def _line_document(line: StopLine) -> dict[str, Any]:
    leaving = {} if line.leaving_x is None else {"leaving_x_m": line.leaving_x}
    return {"lanes": sorted(line.lanes), "x_m": line.x, **leaving}


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

    def tables(rows: Iterable[Probabilities]) -> dict[str, dict[str, float]]:
        return {str(lane): row(p) for lane, p in enumerate(rows, start=1)}

    return {
        "id": vehicle.state.id,
        **_state_document(vehicle.state),
        "lateral_probs": tables(vehicle.policy.lateral),
        **({} if not vehicle.policy.later else {"lateral_probs_later": [tables(t) for t in vehicle.policy.later]}),
        "longitudinal_probs": {mode.label: vehicle.policy.longitudinal[mode + 1] for mode in Mode},
        "position_var_m2": vehicle.noise.position_var,
        "speed_var_m2ps2": vehicle.noise.speed_var,
        "process_position_var_m2": vehicle.noise.process_position_var,
        "process_speed_var_m2ps2": vehicle.noise.process_speed_var,
        "lateral_var_m2": vehicle.noise.lateral_var,
        "process_lateral_var_m2": vehicle.noise.process_lateral_var,
        "lane_change_time_s": vehicle.following.change_time,
        "lane_keeping_time_s": vehicle.following.keeping_time,
        **({} if not vehicle.drift else {"drift": [{"x_m": x, "speed_mps": v} for x, v in vehicle.drift]}),
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
            "branches": answer.branch_count,
            "pruned_prob": answer.pruned,
        },
        **({} if answer.risk is None else {"risk": _risk_document(answer.risk)}),
    }


def _risk_document(risk: RiskTaken) -> dict[str, Any]:
    """Return the risk of an answer: in all, the least of any plan, of contact, and from whom it comes."""
    return {
        "taken": risk.taken,
        "least": risk.least,
        "contact": risk.contact,
        "dropped": risk.dropped,
        "by_vehicle": risk.by_vehicle,
    }
