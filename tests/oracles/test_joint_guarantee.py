"""The joint chance constraint of `uniform` (accounted) and `mixture`, counted in sampled worlds.

The larger run is analysis/03_joint_risk.py.
"""

import numpy as np
import pytest

PROBLEMS, SAMPLES = 120, 4000


@pytest.mark.parametrize("rule", ["uniform", "mixture"])
def test_no_plan_is_violated_more_often_than_asked(brute_force, general_problems, agreement, joint_risk, rule):
    judged = at_limit = happened = 0
    for number in range(PROBLEMS):
        rng = np.random.default_rng([77, number])
        problem = joint_risk.with_rule(joint_risk.draw_problem(general_problems, rng), rule)
        measured = joint_risk.measure(brute_force, agreement, problem, rng, SAMPLES)
        if measured is None:
            continue
        violations, limit = measured
        risk_level = problem["planner"]["risk_level"]
        assert joint_risk.within_bound(violations, SAMPLES, risk_level, 1e-6 / PROBLEMS), number
        judged, at_limit, happened = judged + 1, at_limit + limit, happened + (violations > 0)
    # Plans that keep clear of everybody would prove nothing.
    assert judged >= 30
    assert at_limit >= 10
    assert happened >= 10


def crowd(rule, count, *, spread):
    """One step of 1 s; the ego in lane 1 of n, behind a vehicle that may be in any of its branches."""
    vehicle = {
        "speed_mps": 20.0,
        "lane": 1,
        "mode": "cruise",
        "y_m": 0.0,
        "lateral_probs": {"left": 0.0, "keep": 1.0, "right": 0.0},
        "longitudinal_probs": {"accelerate": spread, "cruise": 1 - 2 * spread, "decelerate": spread},
        "position_var_m2": 1.0,
        "speed_var_m2ps2": 0.0,
        "process_position_var_m2": 0.0,
        "process_speed_var_m2ps2": 0.0,
    }
    planner = {
        "period_s": 1.0,
        "horizon_steps": 1,
        "accel_mps2": 2.0,
        "speed_min_mps": 0.0,
        "speed_max_mps": 40.0,
        "safe_distance_m": 10.0,
        "risk_level": 0.1,
        "risk_allocation": rule,
        "account_pruned": True,
        "sequence_threshold": 1e-6,
        "maneuver_cost": [[6, 5, 6], [2, 0, 2], [11, 9, 11]],
    }
    return {
        "lanes": {"count": 1, "width_m": 4.0},
        "planner": planner
        | {"goal_lane": None, "speed_weight": 0.0, "desired_speed_mps": 20.0}
        | {"speed_deadband_mps": 1.0, "lane_weight": 0.0, "terminal_weight": 0.0, "forbidden_lanes": []},
        "ego": {"x_m": 0.0, "y_m": 0.0, "speed_mps": 20.0, "lane": 1, "mode": "cruise"},
        "vehicles": [vehicle | {"id": f"sv{n}", "x_m": 40.0} for n in range(count)],
    }


@pytest.mark.parametrize("rule", ["uniform", "mixture", "individual"])
@pytest.mark.parametrize("count", [1, 4])
def test_the_bound_is_met_where_everybody_is_at_the_limit(brute_force, agreement, joint_risk, rule, count):
    # Independent vehicles, one step: P = 1 - (1 - eps / I)^I for uniform and mixture, 1 - (1 - eps)^I for individual.
    # With one branch each, water filling is the even share.
    samples, eps = 200_000, 0.1
    problem = crowd(rule, count, spread=0.0)
    violations, at_limit = joint_risk.measure(brute_force, agreement, problem, np.random.default_rng(5), samples)
    each = eps if rule == "individual" else eps / count
    probability = 1 - (1 - each) ** count
    assert at_limit
    assert violations == pytest.approx(samples * probability, abs=5 * (samples * probability) ** 0.5)
    assert joint_risk.within_bound(violations, samples, eps, 1e-6) == (rule != "individual" or count == 1)


def test_the_sampler_sees_a_plan_that_is_too_near(brute_force, agreement, joint_risk):
    problem = crowd("mixture", 2, spread=0.2)
    states = joint_risk.planned(brute_force, agreement, problem)
    for vehicle in problem["vehicles"]:
        vehicle["x_m"] = 11.0
    violations = joint_risk.count_violations(brute_force, problem, states, np.random.default_rng(5), 20_000)
    assert not joint_risk.within_bound(violations, 20_000, 0.1, 1e-6)
