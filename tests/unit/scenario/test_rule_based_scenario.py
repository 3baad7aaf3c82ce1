"""What a scenario may say of the rule-based planner and of the ego's motion."""

import pytest
import yaml

from sumo_hmdp.decision.baselines import ConstantPlanner, IdmMobilPlanner
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
    assert ready.planner == IdmMobilPlanner(0.15, 8.0, mobil=ready.planner.mobil)
    assert ready.planner.mobil.forbidden_lanes == {3}
    assert (ready.episode.ego.length, ready.spawns[-1].length) == (4.5, 9.0)


def test_the_motion_is_a_bicycle_by_default(load_changed):
    assert load_changed(lambda s: s["ego"].pop("motion")).episode.motion is MotionKind.BICYCLE
    assert "ego.motion" in mistakes(load_changed, lambda s: s["ego"].update(motion="train"))


def test_planners_need_no_section(load_changed):
    assert load_changed(lambda s: s["planners"].clear()).planner == IdmMobilPlanner(0.15, 8.0)
    assert load_changed(lambda s: None, planner="constant").planner == ConstantPlanner(0.15)


def test_mistakes_are_named_by_their_path(load_changed):
    def change(scenario):
        scenario["planners"]["idm_mobil"].update(accel_mps2=0.0, forbidden_lanes=[4], politness=0.2)

    text = mistakes(load_changed, change)
    assert "planners.idm_mobil.accel_mps2" in text
    assert "planners.idm_mobil.forbidden_lanes[0]" in text
    assert "did you mean `politeness`" in text


def test_the_lateral_period_must_fit_the_step(load_changed):
    text = mistakes(load_changed, lambda s: s["planners"]["idm_mobil"].update(lateral_period_s=0.5))
    assert "planners.idm_mobil.lateral_period_s: must be a multiple of dt_s (0.15 s), got 0.5 s" in text
