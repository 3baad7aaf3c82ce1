"""The rule `joint`, search and MILP, against an enumeration of every plan and of all that others may do.

The larger run is analysis/15_joint_decisions.py.
"""

from collections import Counter

import numpy as np
import pytest

from sumo_hmdp.decision.decide import answer
from sumo_hmdp.decision.problem_file import parse_problem
from sumo_hmdp.domain.plan import Status

PROBLEMS = 150
ONE_STEP_OF = {"lateral_probs": {"left": 0.0, "keep": 1.0, "right": 0.0}}


def test_random_problems(brute_joint, joint_problems, joint_agreement):
    seen = Counter()
    for number in range(PROBLEMS):
        rng = np.random.default_rng([91, number])
        problem = joint_problems.random_joint_problem(rng, 1 + number % 4)
        expected = brute_joint.solve(problem, everything=True)
        choices, said = joint_agreement.disagreements(problem, expected)
        assert said == [], f"problem [91, {number}]"
        seen[expected["status"]] += 1
        if expected["status"] == "optimal":
            cheapest = min(expected["plans"])
            # The level binds where the cheapest plan of all is too risky.
            seen["binds"] += cheapest[1] > problem["planner"]["risk_level"] + 1e-9
            seen["ties"] += sum(cost <= expected["objective"] + 1e-6 for cost, _, _ in expected["plans"]) > 1
            seen["risky"] += choices["search"].risk.taken > 1e-4
    # A generator that stops making hard problems would make this test say nothing.
    assert min(seen["optimal"], seen["relaxed"]) >= 40
    assert min(seen["binds"], seen["risky"]) >= 8
    assert seen["ties"] >= 10
    assert seen["none"] >= 2


@pytest.mark.parametrize("rule", ["fixed", "time_headway", "rss"])
def test_long_horizons_and_wide_roads(brute_joint, joint_problems, joint_agreement, rule):
    compared = 0
    for number in range(200):
        problem = joint_problems.random_joint_problem(np.random.default_rng([92, number]), 5)
        if problem["planner"].get("distance_rule", "fixed") != rule or len(problem["vehicles"]) > 2:
            continue
        expected = brute_joint.solve(problem)
        _, said = joint_agreement.disagreements(problem, expected, ("search", "milp"))
        assert said == [], f"problem [92, {number}]"
        compared += expected["status"] == "optimal"
        if compared == 4:
            return
    raise AssertionError("too few problems were optimal")


def free_road(**planner):
    """Three lanes, the ego in the middle; what its maneuvers cost is left open."""
    return {
        "lanes": {"count": 3, "width_m": 4.0},
        "planner": {
            "period_s": 1.0,
            "horizon_steps": 3,
            "accel_mps2": 2.0,
            "speed_min_mps": 0.0,
            "speed_max_mps": 40.0,
            "safe_distance_m": 10.0,
            "risk_level": 0.05,
            "risk_allocation": "joint",
            "sequence_threshold": 1e-4,
            "maneuver_cost": [[0, 0, 0], [0, 0, 0], [0, 0, 0]],
        }
        | planner,
        "ego": {"x_m": 0.0, "y_m": 0.0, "speed_mps": 20.0, "lane": 2, "mode": "cruise"},
        "vehicles": [],
    }


def blocking(lane, x, speed=20.0, **entries):
    return {
        "id": f"in {lane} at {x:g}",
        "x_m": x,
        "y_m": 4.0 * (2 - lane),
        "speed_mps": speed,
        "lane": lane,
        "mode": "cruise",
        "longitudinal_probs": {"accelerate": 0.0, "cruise": 1.0, "decelerate": 0.0},
        **ONE_STEP_OF,
        "position_var_m2": 0.0,
        "speed_var_m2ps2": 0.0,
        "process_position_var_m2": 0.0,
        "process_speed_var_m2ps2": 0.0,
        **entries,
    }


@pytest.mark.parametrize(
    ("vehicles", "first"),
    [
        ([], (0, 0)),
        # Both neighbours are free and the own lane is not: left comes before right.
        ([blocking(2, 5.0)], (-1, 0)),
        ([blocking(2, 5.0), blocking(1, 5.0)], (1, 0)),
        # All plans that keep the lane are free of risk here but the cruising one: it accelerates before it brakes.
        ([blocking(1, 0.0), blocking(3, 0.0), blocking(2, -10.0, 19.9), blocking(2, 100.0)], (0, 0)),
        ([blocking(1, 0.0), blocking(3, 0.0), blocking(2, -9.5, 20.0), blocking(2, 100.0)], (0, 1)),
    ],
)
def test_of_equal_plans_both_solvers_take_the_first_in_order(vehicles, first, joint_agreement):
    problem = free_road() | {"vehicles": vehicles}
    plans = {way: joint_agreement.chosen(problem, way) for way in joint_agreement.WAYS}
    assert {choice.status for choice in plans.values()} == {Status.OPTIMAL}
    assert {joint_agreement.plan_of(choice)[0] for choice in plans.values()} == {first}
    assert len({joint_agreement.plan_of(choice) for choice in plans.values()}) == 1


def test_both_solvers_answer_as_one(joint_problems):
    for number in range(20):
        problem = parse_problem(joint_problems.random_joint_problem(np.random.default_rng([93, number]), 3))
        one, other = answer(problem, "search"), answer(problem, "milp")
        assert (one.status, one.plan, one.brake) == (other.status, other.plan, other.brake)
        assert answer(problem, "both").plan == one.plan
