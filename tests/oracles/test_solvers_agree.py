"""Both solvers against the oracle, on problems that ask for everything a problem may ask for.

The full comparison, 10,000 problems, is analysis/02_solvers_agree.py; this is its quick part.
"""

from collections import Counter

import numpy as np
import pytest

CHUNKS = 8


def compare(brute_force, general_problems, agreement, seed, count, solvers, **given):
    """Compare a number of problems; return what they were."""
    seen = Counter()
    for number in range(count):
        document = general_problems.random_general_problem(np.random.default_rng([seed, number]), **given)
        status, said = agreement.disagreements(brute_force, document, solvers)
        assert not said, f"problem [{seed}, {number}]: {said}"
        planner = document["planner"]
        seen[status] += 1
        seen[planner["risk_allocation"]] += 1
        seen[planner.get("occupancy", "target")] += 1
        seen[planner.get("distance_rule", "fixed")] += 1
        seen["stopping"] += planner.get("stopping", False)
    return seen


@pytest.mark.parametrize("chunk", range(CHUNKS))
def test_search_against_the_oracle(brute_force, general_problems, agreement, chunk):
    seen = compare(brute_force, general_problems, agreement, 1000 + chunk, 150, ["search"])
    # A generator that stops making hard problems would make this test say nothing.
    features = ["individual", "uniform", "mixture", "target", "swept", "fixed", "time_headway", "rss", "stopping"]
    assert min(seen[feature] for feature in features) >= 15
    assert min(seen[status] for status in ("optimal", "relaxed", "fallback", "error")) >= 4


@pytest.mark.parametrize(("horizon", "count"), [(2, 200), (3, 100), (4, 20)])
def test_both_solvers_against_the_oracle(brute_force, general_problems, agreement, horizon, count):
    seen = compare(brute_force, general_problems, agreement, 2000, count, ["milp", "search"], horizon=horizon)
    assert seen["optimal"] >= 5
    assert seen["relaxed"] + seen["fallback"] >= 3


def test_presolve_does_not_cost_the_optimum(brute_force, agreement):
    # HiGHS took 300.58 for the optimum of this empty road while its tolerance was as small as what presolve moves.
    planner = {
        "period_s": 1.0,
        "horizon_steps": 4,
        "accel_mps2": 2.0,
        "speed_min_mps": 0.0,
        "speed_max_mps": 40.0,
        "safe_distance_m": 6.0,
        "risk_level": 0.3,
        "risk_allocation": "individual",
        "sequence_threshold": 0.001,
        "maneuver_cost": [[6, 5, 6], [2, 0, 2], [11, 9, 11]],
        "speed_weight": 3.1,
        "desired_speed_mps": 28.76,
        "speed_deadband_mps": 0.1,
        "lane_weight": 4.0,
        "goal_lane": 3,
        "terminal_weight": 0.0,
        "forbidden_lanes": [],
        "occupancy": "swept",
        "lane_change_time_s": 6.0,
        "distance_rule": "rss",
    }
    document = {
        "lanes": {"count": 4, "width_m": 4.0},
        "planner": planner,
        "ego": {"x_m": 35.0, "y_m": -6.0, "speed_mps": 1.21, "lane": 4, "mode": "accelerate"},
        "vehicles": [],
    }
    assert brute_force.solve(document)["objective"] == pytest.approx(299.38)
    assert agreement.disagreements(brute_force, document, ["milp", "search"]) == ("optimal", [])
