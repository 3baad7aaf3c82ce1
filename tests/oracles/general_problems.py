"""Random decision problems with everything that a problem may ask for; all of them valid.

Each starts as a problem of problems.py (its scenes make distances bind, plans fail and limits meet exactly) and is
then given a risk rule, an occupancy, a distance rule, low speeds with stopping, lane changes under way, action
thresholds, and up to twelve vehicles.
"""

import importlib.util
from pathlib import Path

_SPEC = importlib.util.spec_from_file_location("oracle_base_problems", Path(__file__).with_name("problems.py"))
problems = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(problems)

KEEP = {"left": 0.0, "keep": 1.0, "right": 0.0}
CRUISE = {"accelerate": 0.0, "cruise": 1.0, "decelerate": 0.0}

# An enumeration must stay quick: the longer the horizon, the fewer vehicles.
MOST_VEHICLES = {1: 12, 2: 12, 3: 8, 4: 5, 5: 4, 6: 3}
HORIZONS = {2: 0.3, 3: 0.3, 4: 0.2, 5: 0.12, 6: 0.08}


def random_general_problem(rng, *, horizon=None, vehicles=None, risk_allocation=None):
    """Draw a problem from a numpy Generator; what is given is not drawn."""
    while True:
        problem = _draw(rng, horizon, vehicles, risk_allocation)
        if problems.dead_state(problem) is None:
            return problem


def _draw(rng, horizon, vehicles, risk_allocation):
    pick, chance = problems._pick, problems._chance
    horizon = horizon or pick(rng, list(HORIZONS), list(HORIZONS.values()))
    if vehicles is None:
        vehicles = int(rng.integers(0, MOST_VEHICLES[horizon] + 1))
    lanes = pick(rng, [1, 2, 3, 4], [0.1, 0.3, 0.45, 0.15]) if horizon < 5 else pick(rng, [1, 2, 3], [0.2, 0.5, 0.3])
    problem = problems.random_problem(rng, horizon=horizon, vehicles=vehicles, lanes=lanes)
    planner = problem["planner"]
    planner["risk_allocation"] = risk_allocation or pick(rng, ["individual", "uniform", "mixture"])
    planner["account_pruned"] = chance(rng, 0.4)
    planner["action_threshold"] = pick(rng, [0.0, 0.01, 0.05, 0.1, 0.4], [0.7, 0.08, 0.09, 0.08, 0.05])
    # The scene `edge` has a sequence threshold of its own, which is to be met exactly.
    edge = planner["sequence_threshold"] in problems.EDGE_THRESHOLDS
    if horizon >= 4 and not edge:
        planner["sequence_threshold"] = max(planner["sequence_threshold"], 0.01)
    if chance(rng, 0.5):
        _sweep(rng, problem)
    if chance(rng, 0.6):
        _space(rng, planner)
    if chance(rng, 0.35):
        _slow(rng, problem)
    if planner["risk_allocation"] == "mixture" or planner["account_pruned"]:
        _leave_a_budget(rng, problem, edge=edge)
    return problem


def _sweep(rng, problem):
    """Let bodies take up lanes, some of them in the middle of a lane change."""
    planner = problem["planner"]
    planner["occupancy"] = "swept"
    planner["lane_change_time_s"] = problems._pick(rng, [0.7, 1.5, 2.0, 3.1, 4.0, 6.0])
    if problems._chance(rng, 0.3):
        # The paper's law is refused where K1 T^2 / 2 exceeds 1.
        strongest = 2.0 / planner["period_s"] ** 2
        planner["lateral_gain_k1_ps2"] = problems._pick(rng, [k1 for k1 in (0.0, 0.6, 1.3, 3.0) if k1 <= strongest])
        planner["lateral_gain_k2_ps"] = problems._pick(rng, [0.0, 0.5, 1.0, 2.0])
    else:
        planner["lateral_model"] = "lane_change"
        for vehicle in problem["vehicles"]:
            # Not round, so that no edge of a body comes to lie on a line.
            vehicle["lane_change_time_s"] = problems._pick(rng, [1.513, 3.017, 4.013, 6.029])
            vehicle["lane_keeping_time_s"] = problems._pick(rng, [0.5, 2.0, 10.0])
            vehicle["process_lateral_var_m2"] = problems._pick(rng, [0.0, 0.01, 0.05])
            if problems._chance(rng, 0.5):
                vehicle["lateral_var_m2"] = problems._pick(rng, [0.0, 0.02, 0.1])
    for body in [problem["ego"], *problem["vehicles"]]:
        if problems._chance(rng, 0.3):
            body["width_m"] = problems._pick(rng, [0.8, 2.1, 2.6])
        if problems._chance(rng, 0.4):
            # A body whose edge is on a lane's line is in that lane or not by rounding alone; these numbers avoid it.
            reach = problem["lanes"]["width_m"] * problems._pick(rng, [0.6, 1.1, 1.7], [0.6, 0.35, 0.05])
            body["y_m"] += problems._uniform(rng, -reach, reach) + 0.003137
            body["lateral_speed_mps"] = problems._uniform(rng, -1.5, 1.5)
    # The ego's body is on the road.
    edge = problem["lanes"]["count"] * problem["lanes"]["width_m"] / 2
    problem["ego"]["y_m"] = min(max(problem["ego"]["y_m"], -edge), edge)


def _space(rng, planner):
    """Ask for distances that depend on speed."""
    planner["distance_rule"] = problems._pick(rng, ["time_headway", "rss"])
    planner["safe_distance_m"] = problems._pick(rng, [0.0, 2.0, 6.0])
    planner["time_headway_s"] = problems._pick(rng, [0.0, 0.4, 0.8, 1.5])
    planner["rss_response_time_s"] = problems._pick(rng, [0.0, 0.3, 0.5])
    planner["rss_accel_max_mps2"] = problems._pick(rng, [0.0, 2.0, 3.0])
    planner["rss_brake_min_mps2"] = problems._pick(rng, [3.0, 4.0, 6.0])
    planner["rss_brake_max_mps2"] = problems._pick(rng, [6.0, 8.0, 9.5])


def _slow(rng, problem):
    """Bring everybody near standstill, with or without the rule of stopping."""
    planner, ego = problem["planner"], problem["ego"]
    planner["stopping"] = problems._chance(rng, 0.85)
    if problems._chance(rng, 0.95):
        planner["speed_min_mps"] = 0.0
    step = planner["accel_mps2"] * planner["period_s"]
    for body in [ego, *problem["vehicles"]]:
        if body is ego and planner["speed_min_mps"] > 0.0:
            continue
        speeds = [
            0.0,
            step * int(rng.integers(1, 5)),
            problems._uniform(rng, 0.0, 1.0),
            problems._uniform(rng, 0.0, 4.0),
        ]
        if body is ego or problems._chance(rng, 0.8):
            body["speed_mps"] = problems._pick(rng, speeds)
        if problems._chance(rng, 0.5):
            body["mode"] = problems._pick(rng, ["cruise", "decelerate"])
        if body is not ego and problems._chance(rng, 0.5):
            body["x_m"] = round(ego["x_m"] + problems._uniform(rng, -25.0, 25.0), 2)
    if problems._chance(rng, 0.5):
        low = planner["speed_min_mps"]
        planner["desired_speed_mps"] = problems._uniform(rng, low, low + 5.0)


def _leave_a_budget(rng, problem, *, edge):
    """Make it likely, but not sure, that pruning leaves something of the risk level."""
    planner, vehicles = problem["planner"], problem["vehicles"]
    if problems._chance(rng, 0.1):
        return
    planner["risk_level"] = problems._pick(rng, [0.01, 0.05, 0.1, 0.3, 0.5])
    if problems._chance(rng, 0.8):
        planner["action_threshold"] = 0.0
    if not edge:
        planner["sequence_threshold"] = problems._pick(rng, [1e-7, 1e-5, 1e-4, 1e-3])
    # Nearly nothing is pruned then, so few vehicles may have much of a choice.
    free = {2: 4, 3: 2}.get(planner["horizon_steps"], 1)
    for number, vehicle in enumerate(vehicles):
        if number >= free or planner["horizon_steps"] > 3:
            kept = problems._pick(rng, ["lateral", "longitudinal", "both"], [0.4, 0.2, 0.4])
            if kept in {"lateral", "both"}:
                vehicle["lateral_probs"] = dict(KEEP)
            if kept in {"longitudinal", "both"} or planner["horizon_steps"] > 5:
                vehicle["longitudinal_probs"] = dict(CRUISE)
