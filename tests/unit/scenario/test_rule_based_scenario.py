"""What a scenario may say of the rule-based planner and of the ego's motion."""

import pytest
import yaml

from sumo_hmdp.decision.baselines import ConstantPlanner
from sumo_hmdp.decision.published_rules import PublishedPlanner
from sumo_hmdp.errors import InputError
from sumo_hmdp.scenario.load import RunOptions, find_scenario, load_scenario
from sumo_hmdp.sim.motion import MotionKind


@pytest.fixture
def load_changed(tmp_path):
    """Load case2_rule_based with some of its values changed."""

    def load(change, **options):
        content = yaml.safe_load(find_scenario("case2_rule_based").read_text())
        change(content)
        path = tmp_path / "changed.yaml"
        path.write_text(yaml.safe_dump(content))
        return load_scenario(path, RunOptions(**options))

    return load


def mistakes(load, change):
    with pytest.raises(InputError) as caught:
        load(change)
    return str(caught.value)


def test_the_scenario_says_what_it_is():
    ready = load_scenario(find_scenario("case2_rule_based"))
    assert ready.episode.motion is MotionKind.POINT_MASS_PUBLISHED
    assert ready.planner == PublishedPlanner(0.15, 8.0, rules=ready.planner.rules)
    assert ready.planner.rules.forbidden_lanes == {3}
    assert (ready.episode.ego.length, ready.spawns[-1].length) == (4.5, 9.0)


def test_the_motion_is_a_bicycle_by_default(load_changed):
    assert load_changed(lambda s: s["ego"].pop("motion")).episode.motion is MotionKind.BICYCLE
    assert "ego.motion" in mistakes(load_changed, lambda s: s["ego"].update(motion="train"))


def test_planners_need_no_section(load_changed):
    assert load_changed(lambda s: s["planners"].clear()).planner == PublishedPlanner(0.15, 8.0)
    assert load_changed(lambda s: None, planner="constant").planner == ConstantPlanner(0.15)


def test_mistakes_are_named_by_their_path(load_changed):
    def change(scenario):
        scenario["planners"]["idm_mobil_published"].update(accel_mps2=0.0, forbidden_lanes=[4], politness=0.2)

    text = mistakes(load_changed, change)
    assert "planners.idm_mobil_published.accel_mps2" in text
    assert "planners.idm_mobil_published.forbidden_lanes[0]" in text
    assert "did you mean `politeness`" in text


def test_the_lateral_period_must_fit_the_step(load_changed):
    text = mistakes(load_changed, lambda s: s["planners"]["idm_mobil_published"].update(lateral_period_s=0.5))
    assert "planners.idm_mobil_published.lateral_period_s: must be a multiple of dt_s (0.15 s), got 0.5 s" in text


def test_keys_of_the_former_idm_mobil_are_told_where_they_went(load_changed):
    def change(scenario):
        scenario["planners"]["idm_mobil"].update(leader_range_m=95.0, occupancy="swept", polite=0.2)

    text = mistakes(load_changed, change)
    assert "planners.idm_mobil.leader_range_m: is a key of `idm_mobil_published`" in text
    assert "planners.idm_mobil.occupancy: is no choice any more" in text
    assert "planners.idm_mobil.polite: unknown key; did you mean `politeness`?" in text
