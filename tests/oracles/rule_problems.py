"""Random decision problems with rules of the road: solid lines and speed limits where they may bind."""

import importlib.util
from pathlib import Path

_SPEC = importlib.util.spec_from_file_location("oracle_rule_base", Path(__file__).with_name("line_problems.py"))
lines = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(lines)


def random_rule_problem(rng, *, horizon=None):
    """Draw a problem from a numpy Generator; a horizon that is given is not drawn."""
    pick, uniform, chance = (
        lines.general.problems._pick,
        lines.general.problems._uniform,
        lines.general.problems._chance,
    )
    problem = lines.random_line_problem(rng, horizon=horizon)
    if chance(rng, 0.7):
        problem["stop_lines"] = []
    ego, planner = problem["ego"], problem["planner"]
    x, speed = ego["x_m"], ego["speed_mps"]
    reach = (speed + 5.0) * planner["period_s"] * planner["horizon_steps"] + 20.0
    lanes = list(range(1, problem["lanes"]["count"] + 1))

    def lane():
        return ego["lane"] if chance(rng, 0.7) else pick(rng, lanes)

    def stretch():
        begin = x + uniform(rng, -40.0, 0.6 * reach)
        return {"x_begin_m": begin, "x_end_m": begin + uniform(rng, 1.0, reach)}

    for _ in range(pick(rng, [0, 1, 2, 3], [0.1, 0.3, 0.3, 0.3])):
        rule = {"lane": lane(), "to": pick(rng, ["left", "right"])} | stretch()
        problem.setdefault("no_change", []).append(rule)
    for _ in range(pick(rng, [0, 1, 2, 3], [0.1, 0.3, 0.3, 0.3])):
        step = planner["accel_mps2"] * planner["period_s"]
        # A speed of the lattice is a limit that is met exactly.
        limits = [speed + step * int(rng.integers(-3, 3)), speed + uniform(rng, -8.0, 4.0)]
        limit = max(0.5, pick(rng, limits))
        problem.setdefault("speed_zones", []).append({"lane": lane(), "speed_mps": limit} | stretch())
    return problem
