"""Solid lines and speed limits: both solvers against the oracle, and the speeds of an ego that drives on by itself."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from sumo_hmdp.decision.decide import answer
from sumo_hmdp.decision.problem_file import parse_problem, problem_document
from sumo_hmdp.domain.plan import Status


def differ(one, other):
    return any(one[key] != other[key] for key in ("status", "objective", "violation_m"))


def compare(brute_force, rule_problems, agreement, seed, count, solvers, **given):
    """Compare a number of problems; return how often lines and limits made a difference, of every third."""
    seen = Counter()
    for number in range(count):
        document = rule_problems.random_rule_problem(np.random.default_rng([seed, number]), **given)
        status, said = agreement.disagreements(brute_force, document, solvers)
        assert not said, f"problem [{seed}, {number}]: {said}"
        if number % 3:
            continue
        bound = brute_force.solve(document)
        for key in ("no_change", "speed_zones"):
            free = brute_force.solve({name: value for name, value in document.items() if name != key})
            seen.update([key, f"{key} {status}"] if differ(free, bound) else [])
    return seen


@pytest.mark.parametrize("chunk", range(2))
def test_search_against_the_oracle(brute_force, rule_problems, agreement, chunk):
    seen = compare(brute_force, rule_problems, agreement, 7000 + chunk, 150, ["search"])
    assert min(seen["no_change"], seen["speed_zones"]) >= 2
    assert min(seen["no_change optimal"], seen["speed_zones optimal"]) >= 1


@pytest.mark.parametrize(("horizon", "count"), [(2, 90), (3, 18), (4, 3)])
def test_milp_against_the_oracle(brute_force, rule_problems, agreement, horizon, count):
    seen = compare(brute_force, rule_problems, agreement, 7100, count, ["milp"], horizon=horizon)
    assert count < 50 or seen["no_change"] + seen["speed_zones"] >= 1


def test_the_file_form_gives_the_rules_back(rule_problems):
    for number in range(50):
        problem = parse_problem(rule_problems.random_rule_problem(np.random.default_rng([7200, number])))
        assert parse_problem(problem_document(problem)) == problem


PLANNER = {
    "period_s": 0.6, "horizon_steps": 5, "accel_mps2": 3.0, "speed_min_mps": 0.0, "speed_max_mps": 40.0,
    "safe_distance_m": 8.0, "risk_level": 0.05, "risk_allocation": "individual", "sequence_threshold": 0.001,
    "maneuver_cost": [[6, 5, 6], [2, 0, 2], [11, 9, 11]], "speed_weight": 6.0, "desired_speed_mps": 33.0,
    "speed_deadband_mps": 0.9, "stopping": True,
}  # fmt: skip


@pytest.mark.parametrize(("speed", "limit"), [(30.0, 2.0), (33.0, 13.89), (20.0, 19.5), (13.0, 13.89), (9.1, 5.0)])
@pytest.mark.parametrize("mode", ["accelerate", "cruise"])
def test_an_ego_brakes_in_time_for_a_limit_ahead_and_comes_down_where_it_is_too_fast(speed, limit, mode):
    zones = [{"lane": 2, "x_begin_m": 500.0, "x_end_m": 900.0, "speed_mps": limit}]
    ego = {"x_m": 0.0, "y_m": 0.0, "speed_mps": speed, "lane": 2, "mode": mode}
    document = {"lanes": {"count": 3, "width_m": 4.0}, "planner": PLANNER | {"forbidden_lanes": [1, 3]}, "ego": ego}
    problem = parse_problem(document | {"vehicles": [], "speed_zones": zones})
    left = 0
    for _ in range(900):
        found = answer(problem, "search")
        assert found.status is Status.OPTIMAL
        first = found.plan[0]
        if 500.0 <= first.x < 900.0:
            assert first.speed <= limit + 1e-9
            left += 1
        problem = replace(problem, ego=replace(problem.ego, x=first.x, speed=first.speed, mode=first.mode))
        if first.x > 1100.0:
            break
    assert left
    # Beyond the zone it is as fast as it likes again.
    assert problem.ego.speed > max(limit, 12.0)
    # One that is inside and too fast comes down at once.
    inside = replace(problem, ego=replace(problem.ego, x=510.0, speed=limit + 5.0, mode=0))
    down = answer(inside, "search")
    assert down.status is Status.OPTIMAL
    assert [step.mode for step in down.plan[:2]] == [-1, -1]
