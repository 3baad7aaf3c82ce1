"""How others move across the road, as a scenario says it."""

from pathlib import Path

import pytest

from sumo_hmdp.errors import InputError
from sumo_hmdp.prediction.dynamics import LateralGains
from sumo_hmdp.prediction.lateral import LaneFollowing
from sumo_hmdp.scenario.load import RunOptions, load_scenario

SCENARIOS = Path(__file__).parents[3] / "scenarios"


def ready(name, **overrides):
    changes = {path.replace("__", "."): value for path, value in overrides.items()}
    return load_scenario(SCENARIOS / f"{name}.yaml", RunOptions(planner="hmdp_mpc", overrides=changes))


def test_the_papers_law_is_for_the_papers_cases():
    for name in ("case1", "case1_literal", "case2", "case3"):
        assert ready(name, duration_s=2.4).planner.settings.gains == LateralGains(3.0, 1.0)
    for name in ("highway", "matched", "matched_highway", "matched_tight", "urban"):
        assert ready(name, duration_s=2.4).planner.settings.gains is None


def test_it_is_refused_where_it_overshoots():
    with pytest.raises(InputError) as caught:
        ready("case1", planners__hmdp_mpc__period_s=1.0, planners__hmdp_mpc__speed_deadband_mps=1.0)
    assert [problem.path for problem in caught.value.problems] == ["planners.hmdp_mpc.lateral_gain_k1_ps2"]
    with pytest.raises(InputError) as caught:
        ready("highway", planners__hmdp_mpc__period_s=1.0, planners__hmdp_mpc__lateral_model="pd")
    assert [problem.path for problem in caught.value.problems] == ["planners.hmdp_mpc.lateral_gain_k1_ps2"]


def test_the_background_changes_lanes_in_its_own_time():
    assert ready("highway", duration_s=2.4).planner.default_belief.following == LaneFollowing(4.0, 2.0)
    slow = ready("highway", duration_s=2.4, traffic__lane_changes={"duration_s": 5.0})
    assert slow.planner.default_belief.following == LaneFollowing(5.0, 2.0)
    believed = {"lane_change_time_s": 3.0, "lane_keeping_time_s": 1.0, "process_lateral_var_m2": 0.01}
    changes = {f"traffic__belief__{key}": value for key, value in believed.items()}
    belief = ready("highway", duration_s=2.4, **changes).planner.default_belief
    assert belief.following == LaneFollowing(3.0, 1.0)
    assert belief.noise.process_lateral_var == 0.01


def test_drawn_vehicles_move_as_they_are_predicted_in_the_egos_time_unless_they_have_their_own():
    keys = {"matched_traffic__process_lateral_var_m2": 0.01, "ego__lane_change_time_s": 5.0}
    found = ready("matched_highway", duration_s=2.4, noise_scale=2.0, **keys)
    assert found.episode.paths
    for name, path in found.episode.paths.items():
        belief = found.planner.beliefs[name]
        assert path.model.following == belief.following == LaneFollowing(5.0, 2.0)
        assert (belief.noise.process_lateral_var, path.model.noise.process_lateral_var) == (0.01, 0.04)
    own = ready("matched_highway", duration_s=2.4, matched_traffic__lane_change_time_s=3.0, **keys)
    assert {path.model.following.change_time for path in own.episode.paths.values()} == {3.0}
