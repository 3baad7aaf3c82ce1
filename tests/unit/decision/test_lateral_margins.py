"""Uncertain places across the road: bodies are heeded where they may be, out of the same budget."""

import copy

import numpy as np
import pytest

from sumo_hmdp.decision.decide import Status, answer
from sumo_hmdp.decision.occupancy import lanes_now, occupied_lanes
from sumo_hmdp.decision.problem_file import parse_problem, problem_document
from sumo_hmdp.decision.risk import tail_probabilities
from sumo_hmdp.errors import InputError
from sumo_hmdp.prediction.branches import predict
from sumo_hmdp.prediction.lateral import forecast

# A body in lane 1, 5 cm from the line to the ego's lane; measured with 0.5 m, it is over it with probability 0.46.
NEAR_THE_LINE = {
    "lanes": {"count": 2, "width_m": 4.0},
    "planner": {
        "period_s": 0.8,
        "horizon_steps": 3,
        "accel_mps2": 2.0,
        "speed_min_mps": 0.0,
        "speed_max_mps": 40.0,
        "safe_distance_m": 10.0,
        "risk_level": 0.05,
        "risk_allocation": "mixture",
        "sequence_threshold": 1e-5,
        "maneuver_cost": [[0, 0, 0], [0, 0, 0], [0, 0, 0]],
        "speed_weight": 1.0,
        "desired_speed_mps": 30.0,
        "speed_deadband_mps": 0.8,
        "forbidden_lanes": [1],
        "occupancy": "swept",
    },
    "ego": {"x_m": 0.0, "y_m": -2.0, "speed_mps": 25.0, "lane": 2, "mode": "cruise"},
    "vehicles": [
        {
            "id": "a",
            "x_m": 25.0,
            "y_m": 0.95,
            "speed_mps": 15.0,
            "lane": 1,
            "mode": "cruise",
            "lateral_probs": {"left": 0.0, "keep": 1.0, "right": 0.0},
            "longitudinal_probs": {"accelerate": 0.0, "cruise": 1.0, "decelerate": 0.0},
            "position_var_m2": 0.25,
        }
    ],
}


def scene(*, planner=None, **vehicle):
    changed = copy.deepcopy(NEAR_THE_LINE)
    changed["planner"] |= planner or {}
    changed["vehicles"][0] |= vehicle
    return parse_problem(changed)


def lanes_of(problem):
    branches = predict(problem.vehicles, problem.settings.prediction())
    assert len(branches.vehicle) == 1
    return lanes_now(problem, branches)[0].tolist(), occupied_lanes(problem, branches)[0].tolist()


def test_a_body_that_may_be_over_the_line_takes_up_both_lanes():
    now, later = lanes_of(scene())
    assert now == [True, True]
    # z = 2.13 for a third of 0.05. After a step its edge is 0.40 m from the line, with 0.34 m; then 0.63, with 0.22.
    assert later == [[True, True], [True, False], [True, False]]
    assert lanes_of(scene(lateral_var_m2=0.0)) == ([True, False], [[True, False]] * 3)


def test_the_distance_to_it_is_kept():
    # 12 m ahead and 10 m/s slower it is 4 m ahead after a step; braking gains 0.64 m.
    missing = answer(scene(x_m=12.0, position_var_m2=0.0, lateral_var_m2=0.25), "search")
    assert missing.status is not Status.OPTIMAL
    assert answer(scene(x_m=12.0, position_var_m2=0.0), "search").status is Status.OPTIMAL
    far = answer(scene(), "search")
    assert far.status is Status.OPTIMAL
    assert far.plan[0].x <= 25.0 + 12.0 - 10.0


def test_the_ego_does_not_pass_it_within_the_step_in_which_it_may_be_over_the_line():
    # From 2 m behind its front to 6 m before it: no distance is missing at the end of a step that is long enough.
    close = answer(scene(x_m=2.0, planner={"safe_distance_m": 1.0}, lateral_var_m2=0.25, position_var_m2=0.0), "search")
    assert close.status is not Status.OPTIMAL
    free = answer(scene(x_m=2.0, planner={"safe_distance_m": 1.0}, position_var_m2=0.0), "search")
    assert free.status is Status.OPTIMAL


def test_by_the_papers_law_there_is_no_margin():
    assert lanes_of(scene(planner={"lateral_model": "pd"})) == ([True, False], [[True, False]] * 3)


@pytest.mark.parametrize("rule", ["individual", "uniform", "mixture"])
def test_lanes_that_count_as_free_are_entered_with_less_than_the_share(rule):
    rng, seen = np.random.default_rng(5), 0
    lateral_probs = {"left": 0.2, "keep": 0.6, "right": 0.2}
    for _ in range(150):
        problem = scene(
            planner={"risk_allocation": rule, "horizon_steps": 4, "sequence_threshold": 1e-4},
            y_m=float(rng.uniform(-3.5, 3.5)),
            lane=int(rng.integers(1, 3)),
            lateral_probs=lateral_probs,
            lateral_speed_mps=float(rng.uniform(-1.5, 1.5)),
            lateral_var_m2=float(rng.uniform(0.0, 0.5)),
            process_lateral_var_m2=float(rng.uniform(0.0, 0.1)),
        )
        branches = predict(problem.vehicles, problem.settings.prediction())
        occupied, tails = occupied_lanes(problem, branches), tail_probabilities(branches, problem.settings)
        vehicle = problem.vehicles[0]
        across = forecast(vehicle.state, vehicle.noise, vehicle.following, problem.road, branches.laterals, 0.8)
        taken = across.taken()[:, 1:]
        free = ~occupied
        assert (taken[free] <= np.broadcast_to(tails[:, None, None], taken.shape)[free] + 1e-9).all()
        seen += int((free & (taken > 0.2 * tails[:, None, None])).sum())
    # Not because the margin is huge.
    assert seen > 50


def test_a_body_that_is_over_the_line_on_average_is_heeded_at_any_risk_level():
    # At a risk of one half there is no margin.
    problem = scene(planner={"risk_level": 0.5, "risk_allocation": "individual"}, y_m=0.85, lateral_speed_mps=0.0)
    now, later = lanes_of(problem)
    assert now == [True, True]
    assert later[0] == [True, False]


@pytest.mark.parametrize(
    ("change", "path"),
    [
        ({"ego": {"y_m": 400.0}}, "ego.y_m"),
        ({"ego": {"y_m": -5.0}}, "ego.y_m"),
        ({"vehicles": {"y_m": 60.0}}, "vehicles[0].y_m"),
        ({"vehicles": {"y_m": -20.0}}, "vehicles[0].y_m"),
        ({"planner": {"lateral_model": "pd", "period_s": 1.0}}, "planner.lateral_gain_k1_ps2"),
        ({"planner": {"lateral_gain_k1_ps2": 3.2}}, "planner.lateral_gain_k1_ps2"),
        ({"planner": {"lateral_gain_k2_ps": 1.0, "period_s": 1.2}}, "planner.lateral_gain_k1_ps2"),
        ({"planner": {"lateral_model": "lane_change", "lateral_gain_k2_ps": 1.0}}, "planner.lateral_gain_k2_ps"),
        ({"planner": {"lateral_model": "quintic"}}, "planner.lateral_model"),
        ({"vehicles": {"lane_change_time_s": 0.0}}, "vehicles[0].lane_change_time_s"),
        ({"vehicles": {"lane_keeping_time_s": -1.0}}, "vehicles[0].lane_keeping_time_s"),
        ({"vehicles": {"process_lateral_var_m2": -0.1}}, "vehicles[0].process_lateral_var_m2"),
    ],
)
def test_what_cannot_be_followed_is_refused(change, path):
    content = copy.deepcopy(NEAR_THE_LINE)
    for section, values in change.items():
        (content[section][0] if section == "vehicles" else content[section]).update(values)
    with pytest.raises(InputError) as caught:
        parse_problem(content)
    assert [problem.path for problem in caught.value.problems] == [path]


@pytest.mark.parametrize(
    "planner", [{"lateral_model": "pd"}, {"lateral_gain_k1_ps2": 3.125}, {"period_s": 1.2}, {"occupancy": "target"}]
)
def test_a_stable_law_or_none_that_counts_is_taken_and_comes_back_from_its_file(planner):
    problem = scene(planner=planner, lane_change_time_s=3.0, lane_keeping_time_s=1.0, process_lateral_var_m2=0.02)
    assert (problem.settings.gains is not None) == ({"lateral_model", "lateral_gain_k1_ps2"} & set(planner) != set())
    assert parse_problem(problem_document(problem)) == problem


def test_the_law_counts_only_where_bodies_do():
    assert (
        scene(planner={"occupancy": "target", "lateral_gain_k1_ps2": 3.0, "period_s": 1.2}).settings.gains is not None
    )
