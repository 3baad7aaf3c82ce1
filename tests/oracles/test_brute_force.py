"""The oracle against worked decisions and against problems small enough for arithmetic by hand."""

import json
from pathlib import Path

import numpy as np
import pytest

DECISIONS = sorted((Path(__file__).parents[1] / "fixtures" / "decisions").glob("*.json"))


def tiny(*vehicles, lanes=1, speed=20.0, lane=1, mode="cruise", **planner):
    """One step of 1 s, 2 m/s2, 10 m of distance, z = 0 (a risk of one half), an ego at 0; no preferences."""
    return {
        "lanes": {"count": lanes, "width_m": 4.0},
        "planner": {
            "period_s": 1.0,
            "horizon_steps": 1,
            "accel_mps2": 2.0,
            "speed_min_mps": 0.0,
            "speed_max_mps": 40.0,
            "safe_distance_m": 10.0,
            "risk_level": 0.5,
            "risk_allocation": "individual",
            "sequence_threshold": 0.01,
            "maneuver_cost": [[6, 5, 6], [2, 0, 2], [11, 9, 11]],
            "speed_weight": 0.0,
            "desired_speed_mps": 20.0,
            "speed_deadband_mps": 1.0,
            "lane_weight": 0.0,
            "goal_lane": None,
            "terminal_weight": 0.0,
            "forbidden_lanes": [],
        }
        | planner,
        "ego": {"x_m": 0.0, "y_m": 0.0, "speed_mps": speed, "lane": lane, "mode": mode},
        "vehicles": [{"id": f"sv{n}"} | vehicle for n, vehicle in enumerate(vehicles, start=1)],
    }


def car(x, speed=20.0, lane=1, mode="cruise", **other):
    """A vehicle that keeps its lane and cruises next, known exactly, where nothing else is said."""
    return {
        "x_m": x,
        "y_m": 0.0,
        "speed_mps": speed,
        "lane": lane,
        "mode": mode,
        "lateral_probs": {"left": 0.0, "keep": 1.0, "right": 0.0},
        "longitudinal_probs": {"accelerate": 0.0, "cruise": 1.0, "decelerate": 0.0},
        "position_var_m2": 0.0,
        "speed_var_m2ps2": 0.0,
        "process_position_var_m2": 0.0,
        "process_speed_var_m2ps2": 0.0,
    } | other


def brief(answer):
    """Return what the tests below compare: status, objective, violation, plan."""
    objective = answer["objective"]
    return (
        answer["status"],
        None if objective is None else round(objective, 6),
        round(answer["violation_m"], 6),
        answer["lateral"],
        answer["longitudinal"],
    )


@pytest.mark.parametrize("path", DECISIONS, ids=lambda path: path.stem)
def test_worked_decisions(brute_force, path):
    case = json.loads(path.read_text(encoding="utf-8"))
    answer = brute_force.solve(case["problem"])
    if case["answer"] is None:
        assert answer["status"] != "optimal"
        return
    assert answer["status"] == "optimal"
    assert answer["violation_m"] == 0.0
    assert answer["objective"] == pytest.approx(case["answer"]["objective"], abs=1e-6)
    judged = brute_force.evaluate(case["problem"], case["answer"]["lateral"], case["answer"]["longitudinal"])
    assert judged["violation_m"] == 0.0
    assert judged["objective"] == pytest.approx(case["answer"]["objective"], abs=1e-6)


def test_ten_worked_decisions_are_there():
    assert len(DECISIONS) == 10


# Cost ------------------------------------------------------------------------------------------------------


def test_stage_cost_against_speed_preference(brute_force):
    # The desired speed is 22, the band 1, the weight 3. To accelerate costs 5 + 0, since 22 is in the band,
    # to cruise 0 + 3 (2 - 1) = 3, and to decelerate 9 + 3 (4 - 1) = 18.
    problem = tiny(desired_speed_mps=22.0, speed_weight=3.0)
    assert brief(brute_force.solve(problem)) == ("optimal", 3.0, 0.0, [0], [0])


def test_terminal_cost_makes_the_ego_accelerate(brute_force):
    # accelerate: 5, then from (22, accelerate) the mode falls back to cruise for 0: 5 in all.
    # cruise: 3, then from (20, cruise) accelerate for 5 and back to cruise for 0: 8 in all.
    problem = tiny(desired_speed_mps=22.0, speed_weight=3.0, terminal_weight=1.0)
    assert brief(brute_force.solve(problem)) == ("optimal", 5.0, 0.0, [0], [1])
    assert brute_force.evaluate(problem, [0], [0])["objective"] == 8.0


def test_terminal_cost_without_the_dead_bands_edge(brute_force):
    # v_des 21, band 1: 20 is in the band, though only just; nothing is left to do.
    problem = tiny(desired_speed_mps=21.0, speed_weight=3.0, terminal_weight=1.0)
    assert brief(brute_force.solve(problem)) == ("optimal", 0.0, 0.0, [0], [0])


def test_terminal_cost_changes_mode_and_lane_at_once(brute_force):
    # Ego in lane 3 of 3, goal lane 1 at 0.5 per lane; mode decelerate, v 24, v_des 20, band 1, 1 per m/s.
    # Baseline from (lane 3, 24, decelerate): decelerate and left: 11 + 1 (22 - 21) + 0.5 * 1 = 12.5;
    # decelerate and left: 11 + 0 (20 is in the band) + 0 = 11; the mode back to cruise: 0. 23.5.
    planner = tiny(
        lanes=3,
        goal_lane=1,
        lane_weight=0.5,
        speed_weight=1.0,
        desired_speed_mps=20.0,
        speed_deadband_mps=1.0,
    )["planner"]
    assert brute_force.cost_to_go(planner, 3, 24.0, -1) == pytest.approx(23.5)
    # The mode needs two steps from accelerate to decelerate, in which the lanes are changed already:
    # cruise, left: 2 + 3 + 0.5 = 5.5; decelerate, left: 11 + 1 + 0 = 12; decelerate, keep: 9 + 0 + 0;
    # cruise: 0. In all 26.5.
    assert brute_force.cost_to_go(planner, 3, 24.0, 1) == pytest.approx(26.5)


def test_terminal_weight_and_lane_preference(brute_force):
    # To stay costs 0.5 + 1.5 (2 + 0) = 3.5, to go right at once 2 + 0 + 0 = 2.
    problem = tiny(lanes=2, goal_lane=2, lane_weight=0.5, terminal_weight=1.5)
    assert brief(brute_force.solve(problem)) == ("optimal", 2.0, 0.0, [1], [0])
    assert brute_force.evaluate(problem, [0], [0])["objective"] == 3.5


# Ego -------------------------------------------------------------------------------------------------------


def test_mode_changes_by_one_level_a_step(brute_force):
    # From accelerate the ego cannot brake at once: cruise first.
    assert brute_force.evaluate(tiny(mode="accelerate"), [0], [-1]) is None
    assert brute_force.evaluate(tiny(mode="accelerate"), [0], [0])["objective"] == 0.0


def test_speed_limits(brute_force):
    # 20 + 2 = 22 is over 21.9 and not over 22; 1 - 2 is under 0, so an ego at 1 m/s cannot brake.
    assert brute_force.evaluate(tiny(speed_max_mps=21.9), [0], [1]) is None
    assert brute_force.evaluate(tiny(speed_max_mps=22.0), [0], [1]) is not None
    assert brute_force.evaluate(tiny(speed=1.0), [0], [-1]) is None


def test_forbidden_lane_must_be_left(brute_force):
    problem = tiny(lanes=2, forbidden_lanes=[1])
    assert brief(brute_force.solve(problem)) == ("optimal", 2.0, 0.0, [1], [0])
    assert brief(brute_force.solve(tiny(lanes=2, forbidden_lanes=[1, 2]))) == ("fallback", None, 0.0, [], [])


# Policy and pruning ----------------------------------------------------------------------------------------


def branching_car(**other):
    return car(
        500.0,
        lateral_probs={"left": 0.5, "keep": 0.25, "right": 0.25},
        longitudinal_probs={"accelerate": 0.2, "cruise": 0.6, "decelerate": 0.2},
        **other,
    )


def test_policy_is_masked_and_renormalised(brute_force):
    # Lane 1 of 2: left is not there, so keep and right have 0.5 each.
    problem = tiny(branching_car(), lanes=2)
    probs = brute_force.action_probabilities(problem, problem["vehicles"][0], lane=1, mode=0)
    assert probs == pytest.approx({(0, 0): 0.3, (0, 1): 0.1, (0, -1): 0.1, (1, 0): 0.3, (1, 1): 0.1, (1, -1): 0.1})
    # From accelerate the mode can only stay (0.2 of 0.8) or become cruise (0.6 of 0.8).
    probs = brute_force.action_probabilities(problem, problem["vehicles"][0], lane=2, mode=1)
    assert probs == pytest.approx({(0, 0): 1 / 12, (0, -1): 1 / 4, (-1, 0): 1 / 6, (-1, -1): 1 / 2})


def test_lateral_table_of_the_lane(brute_force):
    vehicle = car(
        500.0,
        lateral_probs={
            "1": {"left": 0.0, "keep": 0.9, "right": 0.1},
            "2": {"left": 0.0, "keep": 1.0, "right": 0.0},
        },
    )
    problem = tiny(vehicle, lanes=2, horizon_steps=3, sequence_threshold=0.001)
    # right at step 1 (0.1), at step 2 (0.09), at step 3 (0.081) or never (0.729).
    answer = brute_force.solve(problem)
    assert answer["branches"] == {"sv1": 4}
    assert answer["pruned_prob"]["sv1"] == pytest.approx(0.0)
    # With a threshold of 0.09 the second is still in, though 0.9 * 0.1 may round below it.
    problem["planner"]["sequence_threshold"] = 0.09
    answer = brute_force.solve(problem)
    assert answer["branches"] == {"sv1": 3}
    assert answer["pruned_prob"]["sv1"] == pytest.approx(0.081)


def test_the_likeliest_sequence_is_always_kept(brute_force):
    # Probabilities 0.3, 0.1, 0.1 for keep and for right: at 0.3 two are kept; at 0.5 none reaches the
    # threshold, and of the two likeliest the paper's order puts keep first.
    problem = tiny(branching_car(), lanes=2, sequence_threshold=0.3)
    assert brute_force.solve(problem)["branches"] == {"sv1": 2}
    assert brute_force.solve(problem)["pruned_prob"]["sv1"] == pytest.approx(0.4)
    problem["planner"]["sequence_threshold"] = 0.5
    assert brute_force.solve(problem)["branches"] == {"sv1": 1}
    assert brute_force.solve(problem)["pruned_prob"]["sv1"] == pytest.approx(0.7)
    assert brute_force.retained_sequences(problem, problem["vehicles"][0])[0][1] == [(0, 0)]


# Prediction and risk ---------------------------------------------------------------------------------------


def test_a_braking_vehicle_stops_and_stands(brute_force):
    planner = tiny()["planner"]
    # 3 m/s is more than a step's 2 m/s: 3 - 1 = 2 m on, 1 m/s left; then 1^2 / (2 * 2) = 0.25 m, and it
    # stands.
    assert brute_force.vehicle_motion(planner, 0.0, 3.0, -1) == (2.0, 1.0)
    assert brute_force.vehicle_motion(planner, 2.0, 1.0, -1) == (2.25, 0.0)
    assert brute_force.vehicle_motion(planner, 2.25, 0.0, -1) == (2.25, 0.0)
    assert brute_force.vehicle_motion(planner, 2.25, 0.0, 1) == (3.25, 2.0)


def test_position_variance_by_hand(brute_force):
    # With T = 1, xv is 0, 0.5, 1.2 and vv is 0.5, 0.7, 0.9 before the three steps; so xx is
    # 1 + 0 + 0.5 + 0.1 = 1.6, then 1.6 + 2 * 0.5 + 0.7 + 0.1 = 3.4, then 3.4 + 2 * 1.2 + 0.9 + 0.1 = 6.8.
    vehicle = car(
        0.0,
        position_var_m2=1.0,
        speed_var_m2ps2=0.5,
        process_position_var_m2=0.1,
        process_speed_var_m2ps2=0.2,
    )
    sigmas = brute_force.position_sigmas(tiny(horizon_steps=3), vehicle)
    assert [sigma**2 for sigma in sigmas] == pytest.approx([1.6, 3.4, 6.8])


def test_risk_is_shared_between_steps_and_vehicles(brute_force):
    # 0.2 / (2 steps * 2 vehicles) = 0.05; individual gives each constraint all of it.
    problem = tiny(car(100.0), car(200.0), horizon_steps=2, risk_level=0.2, risk_allocation="uniform")
    sequences = brute_force.retained_sequences(problem, problem["vehicles"][0])
    assert brute_force.branch_risks(problem, sequences) == pytest.approx([0.05])
    problem["planner"]["risk_allocation"] = "individual"
    assert brute_force.branch_risks(problem, sequences) == pytest.approx([0.2])


def test_chance_constraint(brute_force):
    # sigma 1, eps 0.05: 10 + 1.64485 m are needed. At 11.65 m cruising will do; at 11.64 m the ego must
    # brake (9), which leaves 12.64 m.
    planner = {"risk_level": 0.05}
    near = tiny(car(11.64, position_var_m2=1.0), **planner)
    far = tiny(car(11.65, position_var_m2=1.0), **planner)
    assert brief(brute_force.solve(far)) == ("optimal", 0.0, 0.0, [0], [0])
    assert brief(brute_force.solve(near)) == ("optimal", 9.0, 0.0, [0], [-1])
    assert brute_force.evaluate(near, [0], [0])["violation_m"] == pytest.approx(0.004854, abs=1e-6)


def test_vehicle_moves_with_the_mode_before_its_action_and_the_ego_with_the_one_after(brute_force):
    # The leader will cruise, but brakes now, so it falls back by 1 m within the step: from 10.5 m to 9.5 m.
    # Only an ego that brakes, and so falls back by 1 m as well, keeps 10 m.
    problem = tiny(car(10.5, mode="decelerate"))
    assert brief(brute_force.solve(problem)) == ("optimal", 9.0, 0.0, [0], [-1])
    assert brute_force.evaluate(problem, [0], [0])["violation_m"] == pytest.approx(0.5)


def test_every_kept_branch_binds(brute_force):
    # The neighbour 5 m behind may move over (0.1) or stay, so neither lane is free of it. In either lane
    # accelerating makes it 6 m: 4 m are missing, and keeping the lane is cheaper. Where the branch is pruned,
    # nothing is missing.
    neighbour = car(-5.0, lane=2, lateral_probs={"left": 0.1, "keep": 0.9, "right": 0.0})
    problem = tiny(neighbour, lanes=2)
    assert brief(brute_force.solve(problem)) == ("relaxed", 5.0, 4.0, [0], [1])
    problem["planner"]["sequence_threshold"] = 0.2
    assert brief(brute_force.solve(problem)) == ("optimal", 0.0, 0.0, [0], [0])


# Sides, contact, relaxation --------------------------------------------------------------------------------


def test_no_passing_through_a_vehicle(brute_force):
    # 10 m ahead stands a car. One step on, the ego would be 10 m beyond it: far enough, but only through it.
    assert brief(brute_force.solve(tiny(car(10.0, speed=0.0)))) == ("fallback", None, 0.0, [], [])
    # From the other lane the ego may come out ahead of it: 2 for the change, against 5 for staying in lane 2.
    problem = tiny(car(10.0, speed=0.0), lanes=2, lane=2, goal_lane=1, lane_weight=5.0)
    assert brief(brute_force.solve(problem)) == ("optimal", 2.0, 0.0, [-1], [0])
    # And over two steps by way of the other lane: 2 + 5 for step 1 in lane 2, then 2.
    problem = tiny(car(10.0, speed=0.0), lanes=2, goal_lane=1, lane_weight=5.0, horizon_steps=2)
    assert brief(brute_force.solve(problem)) == ("optimal", 9.0, 0.0, [1, -1], [0, 0])


def test_violation_is_the_largest_shortfall_on_each_side(brute_force):
    # Leaders at 8 m and 9.5 m, a follower at 9 m. cruise: 2 (the larger of 2 and 0.5) + 1; accelerate: 3 + 0;
    # decelerate: 1 + 2. All 3 m, so the least cost decides: cruise.
    problem = tiny(car(8.0), car(9.5), car(-9.0))
    assert brief(brute_force.solve(problem)) == ("relaxed", 0.0, 3.0, [0], [0])
    assert brute_force.evaluate(problem, [0], [1]) == {"violation_m": 3.0, "objective": 5.0}
    assert brute_force.evaluate(problem, [0], [-1]) == {"violation_m": 3.0, "objective": 9.0}


def test_violation_adds_up_over_the_steps(brute_force):
    # The leader is at 8 m. Braking twice: 9 m and then 12 m of distance, 1 m missing. Braking once: 9 m and
    # then, at 2 m/s less, 11 m: 1 m missing as well, and cheaper (9 + 0). Cruising twice: 2 + 2.
    problem = tiny(car(8.0), horizon_steps=2)
    assert brief(brute_force.solve(problem)) == ("relaxed", 9.0, 1.0, [0, 0], [-1, 0])
    assert brute_force.evaluate(problem, [0, 0], [0, 0])["violation_m"] == pytest.approx(4.0)
    assert brute_force.evaluate(problem, [0, 0], [-1, -1])["objective"] == 18.0


def test_contact_is_never_planned(brute_force):
    # Braking leaves one metre more. At 4 m that is 5 m, clear of a car of 4.5 m, 5 m short of the distance;
    # at 3 m it is 4 m: contact.
    assert brief(brute_force.solve(tiny(car(4.0)))) == ("relaxed", 9.0, 5.0, [0], [-1])
    assert brief(brute_force.solve(tiny(car(3.0)))) == ("fallback", None, 0.0, [], [])
    # A truck of 9 m whose front is at 8 m: bumper to bumper after braking, which is no contact yet.
    assert brief(brute_force.solve(tiny(car(8.0, length_m=9.0)))) == ("relaxed", 9.0, 1.0, [0], [-1])
    assert brute_force.evaluate(tiny(car(8.0, length_m=9.0)), [0], [0]) is None
    # Behind the ego its own length counts: a follower at 4.6 m is clear of a car, not of a coach of 12 m.
    problem = tiny(car(-4.6))
    assert brute_force.evaluate(problem, [0], [0])["violation_m"] == pytest.approx(5.4)
    problem["ego"]["length_m"] = 12.0
    assert brute_force.evaluate(problem, [0], [0]) is None
    # Not even then where the distance asked for is shorter than a vehicle.
    problem["planner"]["safe_distance_m"] = 4.6
    assert brief(brute_force.solve(problem)) == ("optimal", 0.0, 0.0, [0], [0])


def test_unknown_rules_are_refused(brute_force):
    with pytest.raises(ValueError, match="courtesy"):
        brute_force.solve(tiny(courtesy=1.0))
    with pytest.raises(ValueError, match="fair"):
        brute_force.solve(tiny(car(100.0), risk_allocation="fair"))
    with pytest.raises(ValueError, match="two_second"):
        brute_force.solve(tiny(car(100.0), distance_rule="two_second"))


# Random problems -------------------------------------------------------------------------------------------


def test_random_problems_are_valid_and_reach_every_status(brute_force, problems):
    rng = np.random.default_rng(1)
    statuses = []
    for _ in range(300):
        problem = problems.random_problem(rng)
        assert json.loads(json.dumps(problem)) == problem
        assert problems.dead_state(problem) is None
        for vehicle in problem["vehicles"]:
            lateral = vehicle["lateral_probs"]
            tables = [lateral] if "keep" in lateral else list(lateral.values())
            for table in [*tables, vehicle["longitudinal_probs"]]:
                assert min(table.values()) >= 0.0
                assert sum(table.values()) == pytest.approx(1.0, abs=1e-9)
        answer = brute_force.solve(problem)
        statuses.append(answer["status"])
        if answer["status"] != "fallback":
            judged = brute_force.evaluate(problem, answer["lateral"], answer["longitudinal"])
            assert judged["objective"] == pytest.approx(answer["objective"])
            assert judged["violation_m"] == pytest.approx(answer["violation_m"])
            assert (judged["violation_m"] == 0.0) == (answer["status"] == "optimal")
    for status in ("optimal", "relaxed", "fallback"):
        assert statuses.count(status) >= 15


def test_random_problems_repeat_with_the_seed(problems):
    first, again = (problems.random_problem(np.random.default_rng(7)) for _ in range(2))
    assert first == again
