"""Random decision problems with stop lines: general ones, with up to two lines where they may bind.

A line is drawn where some plan of the ego has its front bumper at a step, or would come to rest: exactly there, so
that rounding must not turn it into a violation, or a little before or beyond.
"""

import importlib.util
from pathlib import Path

_SPEC = importlib.util.spec_from_file_location("oracle_line_base", Path(__file__).with_name("general_problems.py"))
general = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(general)

MODES = general.problems.MODE_LEVEL


def random_line_problem(rng, *, horizon=None):
    """Draw a problem from a numpy Generator; a horizon that is given is not drawn."""
    pick, chance = general.problems._pick, general.problems._chance
    horizon = horizon or pick(rng, [2, 3, 4], [0.45, 0.4, 0.15])
    problem = general.random_general_problem(rng, horizon=horizon, vehicles=int(rng.integers(0, 4)))
    planner = problem["planner"]
    if planner["speed_min_mps"] == 0.0:
        planner["stopping"] = chance(rng, 0.8)
    count = pick(rng, [0, 1, 2], [0.05, 0.55, 0.4])
    problem["stop_lines"] = [_line(rng, problem) for _ in range(count)]
    for line in problem["stop_lines"]:
        if chance(rng, 0.5):
            line["leaving_x_m"] = max(line["x_m"], _line(rng, problem)["x_m"])
    return problem


def _line(rng, problem):
    pick, uniform = general.problems._pick, general.problems._uniform
    all_lanes = list(range(1, problem["lanes"]["count"] + 1))
    lanes = [lane for lane in all_lanes if rng.random() < 0.6] or [problem["ego"]["lane"]]
    x, speed = problem["ego"]["x_m"], problem["ego"]["speed_mps"]
    T, accel = problem["planner"]["period_s"], problem["planner"]["accel_mps2"]
    mode = MODES[problem["ego"]["mode"]]
    for _ in range(int(rng.integers(1, problem["planner"]["horizon_steps"] + 1))):
        mode = min(max(mode + int(rng.integers(-1, 2)), -1), 1)
        if mode == -1 and speed < accel * T:
            x, speed = x + speed**2 / (2.0 * accel), 0.0
        else:
            x, speed = x + speed * T + mode * accel * T**2 / 2.0, speed + mode * accel * T
    stop = x + speed**2 / (2.0 * accel) + (speed * T if mode == 1 else 0.0)
    kind = pick(rng, ["at", "stop", "between", "near", "behind"], [0.15, 0.35, 0.2, 0.25, 0.05])
    place = {
        "at": x,
        "stop": stop,
        "between": uniform(rng, x, stop),
        "near": stop + uniform(rng, -3.0, 3.0),
        "behind": problem["ego"]["x_m"] - uniform(rng, 0.0, 2.0),
    }[kind]
    return {"lanes": lanes, "x_m": place}
