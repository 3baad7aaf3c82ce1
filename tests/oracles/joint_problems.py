"""Random decision problems under the rule `joint`; all of them valid.

Each starts as a problem of problems.py and is given what general_problems.py and line_problems.py can give it. An
enumeration must stay quick, so the longer the horizon, the fewer vehicles, and the more of their policies are
certain.
"""

import importlib.util
import sys
from pathlib import Path

_SPEC = importlib.util.spec_from_file_location("oracle_joint_lines", Path(__file__).with_name("line_problems.py"))
lines = importlib.util.module_from_spec(_SPEC)
sys.modules[_SPEC.name] = lines
_SPEC.loader.exec_module(lines)
general = lines.general
problems = general.problems

HORIZONS = {1: 0.2, 2: 0.25, 3: 0.3, 4: 0.13, 5: 0.07, 6: 0.05}
MOST_VEHICLES = {1: 8, 2: 6, 3: 5, 4: 4, 5: 4, 6: 3}
CERTAIN = {1: 0.1, 2: 0.1, 3: 0.15, 4: 0.25, 5: 0.3, 6: 0.35}
LANES = {1: 0.1, 2: 0.22, 3: 0.3, 4: 0.18, 5: 0.1, 6: 0.1}
SCENES = {"open": 0.32, "dense": 0.38, "packed": 0.08, "closing": 0.12, "edge": 0.1}
RISK_LEVELS = [0.001, 0.003, 0.01, 0.03, 0.05, 0.1, 0.2, 0.5]
VARIANCES = ("position_var_m2", "speed_var_m2ps2", "process_position_var_m2", "process_speed_var_m2ps2")


def random_joint_problem(rng, horizon=None):
    """Draw a problem from a numpy Generator; a horizon that is given is not drawn."""
    while True:
        problem = _draw(rng, horizon)
        if problems.dead_state(problem) is None:
            return problem


def _draw(rng, horizon):
    pick, chance = problems._pick, problems._chance
    horizon = horizon or pick(rng, list(HORIZONS), list(HORIZONS.values()))
    most = MOST_VEHICLES[horizon] if chance(rng, 0.5) else 2
    vehicles = int(rng.integers(0 if chance(rng, 0.1) else 1, most + 1))
    scene = pick(rng, list(SCENES), list(SCENES.values()))
    lanes = pick(rng, list(LANES), list(LANES.values()))
    problem = problems.random_problem(rng, scene=scene, horizon=horizon, vehicles=vehicles, lanes=lanes)
    planner = problem["planner"]
    planner["risk_allocation"] = "joint"
    planner["risk_level"] = pick(rng, RISK_LEVELS)
    # What a threshold says counts nothing under this rule.
    planner["action_threshold"] = pick(rng, [0.0, 0.05, 0.4], [0.7, 0.15, 0.15])
    if chance(rng, 0.55):
        general._sweep(rng, problem)
    if chance(rng, 0.6):
        general._space(rng, planner)
    if chance(rng, 0.3):
        general._slow(rng, problem)
    _steady(rng, planner)
    _drivers(rng, problem)
    _gather(rng, problem)
    _doubt(rng, problem)
    _settle(rng, problem)
    if chance(rng, 1.0 / 3.0):
        _draw_lines(rng, problem)
    return problem


def _steady(rng, planner):
    """Keep to the lateral gains for which a lane change does not overshoot further with each step."""
    most = 2.0 / planner["period_s"] ** 2
    if planner.get("lateral_gain_k1_ps2", 0.0) > most:
        planner["lateral_gain_k1_ps2"] = problems._pick(rng, [gain for gain in (0.6, 1.3, 2.0) if gain <= most])


def _drivers(rng, problem):
    """Let drivers change and keep lanes each in its own way, unless the paper's law holds."""
    for vehicle in problem["vehicles"]:
        if problems._chance(rng, 0.5):
            vehicle["lane_change_time_s"] = problems._pick(rng, [2.0, 3.3, 5.0])
            vehicle["lane_keeping_time_s"] = problems._pick(rng, [0.7, 2.0, 5.0])
            vehicle["lateral_var_m2"] = problems._pick(rng, [0.0, 0.01, 0.2])
            vehicle["process_lateral_var_m2"] = problems._pick(rng, [0.0, 0.01, 0.1])


def _gather(rng, problem):
    """Bring some vehicles to where the ego may be, so that risks are neither 0 nor 1."""
    ego, planner = problem["ego"], problem["planner"]
    for vehicle in problem["vehicles"]:
        if problems._chance(rng, 0.25):
            gap = planner["safe_distance_m"] + problems._uniform(rng, 0.0, 20.0)
            vehicle["x_m"] = round(ego["x_m"] + problems._pick(rng, [-1.0, 1.0]) * gap, 2)
            vehicle["speed_mps"] = max(0.0, round(ego["speed_mps"] + problems._uniform(rng, -2.0, 2.0), 2))


def _doubt(rng, problem):
    """Give some vehicles a small probability of what is not expected, which the risk level may or may not allow."""
    for vehicle in problem["vehicles"]:
        if problems._chance(rng, 0.4):
            vehicle["lateral_probs"] = _lateral_table(rng)
        if problems._chance(rng, 0.3):
            tables = [_lateral_table(rng) for _ in range(int(rng.integers(1, problem["planner"]["horizon_steps"] + 1)))]
            vehicle["lateral_probs_later"] = tables[:19]
        planner = problem["planner"]
        moving = vehicle["speed_mps"] >= planner["horizon_steps"] * planner["accel_mps2"] * planner["period_s"]
        if moving and problems._chance(rng, 0.4):
            vehicle["drift"] = [
                {"x_m": round(problems._uniform(rng, -6.0, 6.0), 2), "speed_mps": problems._uniform(rng, -2.0, 2.0)}
                for _ in range(planner["horizon_steps"])
            ]
        if problems._chance(rng, 0.3):
            fast, slow = (problems._pick(rng, [0.0, 0.002, 0.01, 0.05]) for _ in range(2))
            vehicle["longitudinal_probs"] = {"accelerate": fast, "cruise": 1.0 - fast - slow, "decelerate": slow}


def _lateral_table(rng):
    left, right = (problems._pick(rng, [0.0, 0.001, 0.004, 0.02, 0.06]) for _ in range(2))
    return {"left": left, "keep": 1.0 - left - right, "right": right}


def _settle(rng, problem):
    """Make some vehicles certain: of what they do, of where they are, or of both."""
    certain = CERTAIN[problem["planner"]["horizon_steps"]]
    exact = problems._chance(rng, 0.1)
    for vehicle in problem["vehicles"]:
        if problems._chance(rng, certain):
            vehicle["lateral_probs"] = dict(general.KEEP)
            vehicle.pop("lateral_probs_later", None)
        if problems._chance(rng, certain):
            vehicle["longitudinal_probs"] = dict(general.CRUISE)
        if exact or problems._chance(rng, 0.1):
            vehicle.update(dict.fromkeys(VARIANCES, 0.0))


def _draw_lines(rng, problem):
    """Put one or two stop lines where they may bind, some of them with a second place."""
    planner = problem["planner"]
    if planner["speed_min_mps"] == 0.0:
        planner["stopping"] = problems._chance(rng, 0.8)
    problem["stop_lines"] = [lines._line(rng, problem) for _ in range(int(rng.integers(1, 3)))]
    for line in problem["stop_lines"]:
        if problems._chance(rng, 0.5):
            line["leaving_x_m"] = max(line["x_m"], lines._line(rng, problem)["x_m"])
