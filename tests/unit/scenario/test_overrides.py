"""Values put in place of a scenario's: where they land, what they leave alone, and which paths are refused."""

from pathlib import Path

import pytest

from sumo_hmdp.documents import Document, read_yaml
from sumo_hmdp.errors import InputError
from sumo_hmdp.scenario.load import RunOptions, assemble_scenario, load_scenario, scenario_names
from sumo_hmdp.scenario.overrides import with_overrides
from sumo_hmdp.study.design import document_of
from sumo_hmdp.study.identity import cell_id_of


def test_values_land_where_their_paths_say():
    content = {"a": {"b": 1, "c": 2}, "d": [{"e": 3}, {"e": 4}]}
    changed = with_overrides(content, {"a.b": 10, "d[1].e": 40, "new.section": 5, "a.f": [6]})
    assert changed == {"a": {"b": 10, "c": 2, "f": [6]}, "d": [{"e": 3}, {"e": 40}], "new": {"section": 5}}
    assert content == {"a": {"b": 1, "c": 2}, "d": [{"e": 3}, {"e": 4}]}


def test_an_alias_is_changed_in_one_place_alone():
    shared = {"x": 1}
    assert with_overrides({"a": shared, "b": shared}, {"a.x": 2}) == {"a": {"x": 2}, "b": {"x": 1}}
    content = read_yaml(scenario_names()["case2"]).content
    one = "vehicles[0].policy[0].lateral_probs"
    changed = with_overrides(content, {f"{one}.keep": 0.5})
    assert changed["vehicles"][0]["policy"][0]["lateral_probs"]["keep"] == 0.5
    assert changed["vehicles"][1]["policy"][0]["lateral_probs"]["keep"] == 1.0


@pytest.mark.parametrize(
    ("path", "complaint"),
    [
        ("a..b", "must be a path such as"),
        ("", "must be a path such as"),
        ("a[x]", "must be a path such as"),
        ("d[2].e", r"got \[2\] of a list of 2"),
        ("a[0]", r"got \[0\] of {'b': 1}"),
        ("a.b.c", "got `c` inside 1"),
        ("d.e", "got `e` inside"),
    ],
)
def test_paths_that_lead_nowhere_are_all_named(path, complaint):
    with pytest.raises(InputError, match=complaint) as caught:
        with_overrides({"a": {"b": 1}, "d": [{}, {}]}, {path: 1, "a.b.d": 2})
    assert len(caught.value.problems) == 2


def test_a_scenario_is_checked_with_its_overrides():
    case2 = scenario_names()["case2"]
    ready = load_scenario(case2, RunOptions(overrides={"ego.speed_mps": 29, "planners.hmdp_mpc.horizon_steps": 2}))
    assert (ready.episode.ego.speed, ready.parameters["horizon_steps"]) == (29.0, 2)
    for overrides in ({"ego.sped_mps": 29, "ego.lane": 7}, {"duration_s.x": 1, "ego..lane": 2}):
        with pytest.raises(InputError) as caught:
            load_scenario(case2, RunOptions(overrides=overrides))
        assert {problem.path for problem in caught.value.problems} == set(overrides)


@pytest.mark.parametrize("name", scenario_names())
def test_a_scenario_comes_back_from_what_a_run_says_of_itself(name):
    ready = load_scenario(scenario_names()[name])
    again = assemble_scenario(Document(document_of(ready)), RunOptions(), Path())
    assert again.configuration == ready.configuration
    assert (again.episode, again.spawns, again.world) == (ready.episode, ready.spawns, ready.world)
    assert (again.planner, again.parameters) == (ready.planner, ready.parameters)
    assert cell_id_of(again) == cell_id_of(ready)
