"""An ego outside its speed limits: both solvers against the enumeration, and what the way back looks like."""

import numpy as np
import pytest


def outside(rng, document):
    """Return a problem with an ego that is too fast, or too slow for its least speed."""
    planner = dict(document["planner"])
    step = planner["accel_mps2"] * planner["period_s"]
    more = float(np.round(rng.choice([0.3, 1.0, 1.7, 3.0]) * step, 2))
    if rng.random() < 0.3:
        planner["speed_min_mps"] = 10.0
        planner["speed_max_mps"] = max(planner["speed_max_mps"], 25.0)
        speed = max(0.0, 10.0 - more)
    else:
        speed = planner["speed_max_mps"] + more
    mode = str(rng.choice(["accelerate", "cruise", "decelerate"]))
    return {**document, "planner": planner, "ego": {**document["ego"], "speed_mps": speed, "mode": mode}}


@pytest.mark.parametrize("seed", range(3))
def test_solvers_and_enumeration_agree(brute_force, general_problems, agreement, seed):
    rng = np.random.default_rng([2036, seed])
    statuses = {"optimal": 0, "relaxed": 0, "fallback": 0, "error": 0}
    for _ in range(60):
        document = outside(rng, general_problems.random_general_problem(rng))
        status, said = agreement.disagreements(brute_force, document, ("milp", "search"))
        assert said == []
        statuses[status] += 1
    assert statuses["optimal"] >= 15
    assert statuses["relaxed"] + statuses["fallback"] >= 5
