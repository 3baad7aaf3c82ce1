"""The oracle of the rule `joint`: against arithmetic by hand, and its bound against sampled worlds."""

import importlib.util
import math
import sys
from pathlib import Path

import numpy as np
import pytest

KEEP, LEFT, RIGHT = 0, -1, 1
CRUISE, FASTER, SLOWER = 0, 1, -1
ON = (KEEP, CRUISE)
COST = [[6.0, 5.0, 6.0], [2.0, 0.0, 2.0], [11.0, 9.0, 11.0]]


def _load(name):
    spec = importlib.util.spec_from_file_location(f"oracle_tested_{name}", Path(__file__).with_name(f"{name}.py"))
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


sampler, joint_problems = _load("joint_sampler"), _load("joint_problems")
joint = sampler.joint


def scene(vehicles=(), *, horizon=1, lanes=2, ego=None, **planner):
    """A road of 4 m wide lanes, steps of 1 s, 2 m/s2; the ego at 0 m and 10 m/s in the rightmost lane."""
    y = (1 - lanes) / 2.0 * 4.0
    return {
        "lanes": {"count": lanes, "width_m": 4.0},
        "planner": {
            "period_s": 1.0,
            "horizon_steps": horizon,
            "accel_mps2": 2.0,
            "speed_min_mps": 0.0,
            "speed_max_mps": 40.0,
            "safe_distance_m": 5.0,
            "risk_level": 0.05,
            "risk_allocation": "joint",
            "sequence_threshold": 0.3,
            "lateral_model": "pd",
            "maneuver_cost": COST,
            "speed_weight": 0.0,
            "desired_speed_mps": 10.0,
            "speed_deadband_mps": 1.0,
            "lane_weight": 0.0,
            "goal_lane": None,
            "terminal_weight": 0.0,
            "forbidden_lanes": [],
        }
        | planner,
        "ego": {"x_m": 0.0, "y_m": y, "speed_mps": 10.0, "lane": lanes, "mode": "cruise"} | (ego or {}),
        "vehicles": [vehicle | {"id": f"sv{number}"} for number, vehicle in enumerate(vehicles, start=1)],
    }


def vehicle(x, speed, *, lane=1, y=0.0, left=0.0, right=0.0, **entries):
    """A vehicle that cruises and keeps its lane, unless told otherwise."""
    return {
        "x_m": x,
        "y_m": y,
        "speed_mps": speed,
        "lane": lane,
        "mode": "cruise",
        "lateral_probs": {"left": left, "keep": 1.0 - left - right, "right": right},
        "longitudinal_probs": {"accelerate": 0.0, "cruise": 1.0, "decelerate": 0.0},
    } | entries


def test_a_standing_leader_that_is_known_exactly():
    # Cruising, the ego is at 10 and 20 m. Braking at once it is at 9 and 16 m, braking once at 9 and 17 m.
    problem = scene([vehicle(22.0, 0.0)], horizon=2, lanes=1)
    assert joint.plan_risk(problem, (ON, ON))["by_step"] == [0.0, 1.0]
    assert joint.plan_risk(problem, (ON, (KEEP, SLOWER)))["risk"] == 1.0
    assert joint.plan_risk(problem, ((KEEP, SLOWER), ON))["risk"] == 0.0  # 5 m apart, as asked for
    answer = joint.solve(problem, everything=True)
    assert answer["status"] == "optimal"
    assert answer["sequence"] == ((KEEP, SLOWER), ON)
    assert (answer["objective"], answer["risk_taken"], answer["risk_least"]) == (9.0, 0.0, 0.0)
    assert answer["by_vehicle"] == {"sv1": 0.0}
    assert len(answer["plans"]) == 2 + 2 + 3


def test_a_failure_that_lasts_counts_once():
    # 2 m apart at the speed of the ego, for three steps.
    assert joint.plan_risk(scene([vehicle(2.0, 10.0)], horizon=3, lanes=1), (ON, ON, ON))["by_step"] == [1.0, 0.0, 0.0]


def test_one_uncertain_leader():
    # sigma is 2 m at both steps: the ego is 2.5 sigma from its limit at the first, and 1 sigma at the second.
    problem = scene([vehicle(15.0, 5.0, position_var_m2=4.0)], horizon=2, lanes=1)
    # The leader is at 20 and 25 m, the ego at 10 and 20 m: limits at 15 and 25 m.
    first, second = 0.0062096653, 0.5  # Phi(-2.5), Phi(0), both from tables
    by_step = joint.plan_risk(problem, (ON, ON))["by_step"]
    assert by_step[0] == pytest.approx(first, abs=2e-6)
    # (5 m + 5 m) / 2 m = 5 sigma: what is ahead by then is under 1e-6.
    assert by_step[1] == pytest.approx(second - first * second, abs=3e-6)


def test_the_uncertainty_grows():
    # Q_xx after one step of 1 s: 1 + 2 + 0.5 + ... = position + T^2 speed + process = 1 + 2 + 1 = 4.
    grown = {"position_var_m2": 1.0, "speed_var_m2ps2": 2.0, "process_position_var_m2": 1.0}
    risk = joint.plan_risk(scene([vehicle(17.0, 0.0, **grown)], lanes=1), (ON,))["risk"]
    assert risk == pytest.approx(0.1586552539, abs=2e-6)  # Phi(-1)


def test_the_modes_of_a_leader():
    # It brakes with probability 0.2 after the first step and loses 1 m in the second; its first mode is the present.
    table = {"accelerate": 0.0, "cruise": 0.8, "decelerate": 0.2}
    problem = scene([vehicle(5.5, 10.0, longitudinal_probs=table)], horizon=2, lanes=1)
    assert joint.plan_risk(problem, (ON, ON))["by_step"] == [0.0, pytest.approx(0.2)]


def test_a_vehicle_that_may_change_lanes():
    # Beside the ego; it comes over with probability 0.3 in each step, and stays.
    rows = {
        "1": {"left": 0.5, "keep": 0.35, "right": 0.15},  # there is no lane on its left: 0.7 and 0.3
        "2": {"left": 0.0, "keep": 1.0, "right": 0.0},
    }
    problem = scene([vehicle(0.0, 10.0, y=2.0) | {"lateral_probs": rows}], horizon=2)
    assert joint.plan_risk(problem, (ON, ON))["by_step"] == [pytest.approx(0.3), pytest.approx(0.51 - 0.3)]
    sampled, error = sampler.sampled_risk(problem, (ON, ON), np.random.default_rng(1), 20_000)["any"]
    assert abs(sampled - 0.51) < 4.5 * error


def test_passing_through():
    # Behind at 0 m, ahead at 20 m: a leader 5 m away was passed, although the distance is kept at both.
    problem = scene([vehicle(6.0, 0.0)], lanes=1, ego={"speed_mps": 20.0})
    assert joint.plan_risk(problem, (ON,))["risk"] == 1.0
    # In the lane on the left it was overtaken, and coming over just then is no passing through either.
    problem = scene([vehicle(6.0, 0.0, y=2.0)], ego={"speed_mps": 20.0})
    assert joint.plan_risk(problem, (ON,))["risk"] == 0.0
    assert joint.plan_risk(problem, ((LEFT, CRUISE),))["risk"] == 0.0
    # Where the ego takes up the lane that it enters only, that is; where bodies count, its own is in its old lane.
    wide = problem | {"planner": problem["planner"] | {"occupancy": "swept"}}
    wide["vehicles"] = [vehicle(6.0, 0.0, y=1.0, width_m=2.2) | {"id": "sv1"}]  # reaches 0.1 m into lane 2
    assert joint.plan_risk(wide, (ON,))["risk"] == 1.0


def test_a_body_that_may_reach_into_a_lane():
    # The edge of a 2 m wide body in the middle of lane 1 is 1 m = 2 sigma from lane 2; y does not spread by itself.
    entries = {"width_m": 2.0, "position_var_m2": 0.25}
    problem = scene([vehicle(10.0, 0.0, y=2.0, **entries)], occupancy="swept")
    assert joint.plan_risk(problem, (ON,))["risk"] == pytest.approx(0.0227501319, abs=1e-9)
    problem["planner"]["occupancy"] = "target"
    assert joint.plan_risk(problem, (ON,))["risk"] == 0.0


def test_a_lane_change_shrinks_a_deviation():
    problem = scene([vehicle(10.0, 0.0, y=2.0, right=1.0)], lanes=3, occupancy="swept")
    problem["planner"] |= {"lateral_gain_k1_ps2": 1.0, "lateral_gain_k2_ps": 0.0}
    problem["vehicles"][0] |= {"y_m": 4.0, "position_var_m2": 1.0, "process_position_var_m2": 0.5, "width_m": 2.0}
    # gain 1 - 1/2; y goes half the way from 4 to 0 m; var = 1/4 + 1/2.
    [after] = joint.lateral_sequences(problem, problem["vehicles"][0])[1]
    assert (after.y, after.gain, after.var) == (2.0, 0.5, 0.75)
    # The ego is in lane 3, whose edge is at -2 m: the body's edge is at 1 m, 3 m away.
    expected = math.erfc(3.0 / math.sqrt(2.0 * 0.75)) / 2.0
    # Along x the ego is where the vehicle is, with 5 m = 4.08 sigma to either limit: all but 4.4e-5 is too near.
    assert joint.plan_risk(problem, (ON,))["risk"] == pytest.approx(expected * (1.0 - 4.456e-5), rel=1e-6)


def test_lanes_that_are_not_side_by_side():
    problem = scene(lanes=3)
    assert joint.lane_intervals(problem, frozenset({1, 2}), 2.0) == [[-3.0, 7.0]]
    assert joint.lane_intervals(problem, frozenset({1, 3}), 2.0) == [[-7.0, -1.0], [1.0, 7.0]]


def test_what_decides_between_equals():
    nothing = {"maneuver_cost": [[0.0] * 3] * 3}
    answer = joint.solve(scene(horizon=2, lanes=3, ego={"lane": 2, "y_m": 0.0}, **nothing))
    assert answer["sequence"] == (ON, ON)
    # Lane 2 is blocked for sure, and so is keeping: left comes before right.
    blocked = scene([vehicle(10.0, 0.0, lane=2)], lanes=3, ego={"lane": 2, "y_m": 0.0}, **nothing)
    assert joint.solve(blocked)["sequence"] == ((LEFT, CRUISE),)
    # A risk of 0.02 on the left: it is within the level, but as right costs the same, the least risk decides.
    beside = vehicle(10.0, 0.0, lane=1, y=4.0, position_var_m2=1.0)
    beside["x_m"] = 15.0 + 2.0
    blocked["vehicles"].append(beside | {"id": "sv2"})
    answer = joint.solve(blocked, everything=True)
    assert answer["sequence"] == ((RIGHT, CRUISE),)
    assert answer["risk_taken"] == 0.0
    assert any(0.0 < risk < 0.05 and cost == answer["objective"] for cost, risk, _ in answer["plans"])


def test_the_level_decides():
    # Keeping on costs 0 and risks 0.02275; slowing down costs 9 and risks Phi(-3) = 0.00135.
    problem = scene([vehicle(17.0, 0.0, position_var_m2=1.0)], lanes=1)
    assert joint.solve(problem)["sequence"] == (ON,)
    problem["planner"]["risk_level"] = 0.01
    assert joint.solve(problem)["sequence"] == ((KEEP, SLOWER),)
    problem["planner"]["risk_level"] = 0.001
    answer = joint.solve(problem)
    assert (answer["status"], answer["sequence"]) == ("relaxed", None)
    assert answer["risk_least"] == pytest.approx(0.0013498980, abs=1e-6)


def test_no_plan_at_all():
    problem = scene() | {"stop_lines": [{"lanes": [1, 2], "x_m": 12.0}]}
    assert joint.solve(problem)["status"] == "none"
    problem["stop_lines"][0]["x_m"] = 9.0 + 16.0  # where it stands that brakes from the start: 8 m/s at 9 m
    answer = joint.solve(problem, everything=True)
    assert [plan for _, _, plan in answer["plans"]] == [((KEEP, SLOWER),), ((LEFT, SLOWER),)]
    # Cruising, it is at 10 m, at 10 m/s: it needs 25 m more.
    problem["stop_lines"][0]["x_m"] = 35.0
    assert joint.solve(problem)["sequence"] == (ON,)


def test_thresholds_count_nothing():
    problem = scene([vehicle(0.0, 10.0, y=2.0, right=0.1)], sequence_threshold=0.5, action_threshold=0.4)
    assert joint.plan_risk(problem, (ON,))["risk"] == pytest.approx(0.1)


def test_a_distance_of_nothing_is_refused():
    with pytest.raises(ValueError, match="distance of 0"):
        joint.solve(scene([vehicle(20.0, 0.0)], lanes=1, safe_distance_m=0.0))


def test_every_problem_can_be_solved():
    seen = {"optimal": 0, "relaxed": 0, "none": 0, "binds": 0}
    for number in range(200):
        problem = joint_problems.random_joint_problem(np.random.default_rng([61, number]), 1 + number % 3)
        answer = joint.solve(problem, everything=True)
        seen[answer["status"]] += 1
        if answer["status"] == "optimal":
            parts = joint.plan_risk(problem, answer["sequence"])
            assert parts["risk"] == pytest.approx(answer["risk_taken"], abs=1e-12)
            assert sum(parts["by_vehicle"].values()) == pytest.approx(answer["risk_taken"], abs=1e-12)
            seen["binds"] += min(answer["plans"])[1] > problem["planner"]["risk_level"] + 1e-9
    assert min(seen["optimal"], seen["relaxed"]) >= 40
    assert seen["binds"] >= 10


def _plans_to_sample(answer, rng):
    """The plan that is taken, and one whose risk is between 0 and 1, if there is one."""
    uncertain = [plan for _, risk, plan in answer["plans"] if 0.003 < risk < 0.9]
    chosen = [] if answer["sequence"] is None else [answer["sequence"]]
    return chosen + ([uncertain[int(rng.integers(len(uncertain)))]] if uncertain else [])


def test_the_risk_bounds_what_happens():
    ratios, samples, problems = [], 20_000, 0
    for number in range(1000):
        rng = np.random.default_rng([62, number])
        problem = joint_problems.random_joint_problem(rng, 1 + number % 4)
        plans = _plans_to_sample(joint.solve(problem, everything=True), rng)
        for plan in plans:
            bound, sampled = joint.plan_risk(problem, plan), sampler.sampled_risk(problem, plan, rng, samples)
            pairs = [(bound["risk"], sampled["any"])]
            pairs += [(bound["by_vehicle"][name], told) for name, told in sampled["by_vehicle"].items()]
            for risk, (estimate, error) in pairs:
                # Where the bound is next to nothing, one world in which the plan fails is believable still.
                doubt = 4.5 * max(error, math.sqrt(min(risk, 0.25) / samples)) + 1.0 / samples
                assert estimate <= risk + doubt, f"problem [62, {number}], plan {plan}: {estimate} > {risk}"
                if 0.01 < estimate < 0.99:
                    ratios.append(risk / estimate)
        problems += bool(plans)
        if problems == 60:
            break
    assert problems == 60
    assert len(ratios) >= 40
    assert 0.98 < np.median(ratios) < 1.1
    assert np.mean(ratios) < 1.3
