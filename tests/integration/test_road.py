"""A road that a scenario describes itself: SUMO drives on it, and what is wrong with it is said."""

from pathlib import Path

import pytest

import sumo_hmdp
from sumo_hmdp.documents import Document
from sumo_hmdp.errors import InputError
from sumo_hmdp.scenario.load import RunOptions, assemble_scenario
from sumo_hmdp.sim.network import read_network
from sumo_hmdp.study.identity import cell_id_of

TEXT = """
name: own_road
description: Two cars on a road of its own.
road: {lanes: LANES, width_m: 3.25, length_m: 1500, speed_limit_mps: 27.8}
duration_s: 4.0
dt_s: 0.2
ego: {x_m: 100.0, lane: 1, speed_mps: 25.0}
vehicles:
  - id: ahead
    x_m: 150.0
    lane: LANES
    speed_mps: 20.0
    driver: {kind: idm, desired_speed_mps: 35.0}
    policy:
      - lateral_probs: {left: 0.0, keep: 1.0, right: 0.0}
        longitudinal_probs: {accelerate: 0.1, cruise: 0.8, decelerate: 0.1}
    position_var_m2: 0.02
    process_position_var_m2: 0.02
planner: constant
planners:
  constant: {}
"""


def scenario(tmp_path, text):
    path = tmp_path / "own.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("count", [1, 2, 6])
def test_sumo_drives_on_roads_of_one_to_six_lanes(tmp_path, count):
    ready = sumo_hmdp.scenario(scenario(tmp_path, TEXT.replace("LANES", str(count))))
    network = read_network(ready.world.net_file, ready.episode.road)
    assert (network.x_begin, network.x_end, network.notes) == (0.0, 1500.0, ())
    assert {zone.speed for zone in network.rules.speed_zones} == {27.8}
    record = sumo_hmdp.run(ready)
    assert record.row["status"] == ("completed" if count > 1 else record.row["status"])
    ahead = record.steps[record.steps["vehicle_id"] == "ahead"]
    # y of the rightmost of n lanes is -(n - 1) / 2 widths; the limit binds a driver that wants 35 m/s.
    assert ahead["y_m"].iloc[-1] == pytest.approx(-(count - 1) / 2 * 3.25, abs=1e-6)
    assert ahead["speed_mps"].max() <= 27.8


def test_a_configuration_is_a_scenario_with_the_same_cell(tmp_path):
    first = sumo_hmdp.scenario(scenario(tmp_path, TEXT.replace("LANES", "2")))
    again = assemble_scenario(Document(dict(first.configuration), ()), RunOptions(), Path("manifest.json"))
    assert cell_id_of(first) == cell_id_of(again)
    others = [{"road.length_m": 1600.0}, {"road.speed_limit_mps": 30.0}, {"road.width_m": 3.5}, {"road.lanes": 3}]
    cells = {cell_id_of(sumo_hmdp.scenario(tmp_path / "own.yaml", keys=keys)) for keys in ({}, *others)}
    assert len(cells) == 5


@pytest.mark.parametrize(
    ("keys", "path"),
    [
        ({"road.lanes": 7}, "road.lanes"),
        ({"road.length_m": "long"}, "road.length_m"),
        ({"road.width_m": 0.5}, "road.width_m"),
        ({"road.speed_limit_mps": -1}, "road.speed_limit_mps"),
        ({"road.ramps": [{"x_m": 500}]}, "road.ramps"),
        ({"road.lenght_m": 500}, "road.lenght_m"),
        ({"network": "urban"}, "network"),
        ({"lanes": {"count": 3, "width_m": 4.0}}, "lanes"),
        ({"road": 3}, "road"),
        ({"ego.lane": 3}, "ego.lane"),
    ],
)
def test_one_mistake_is_one_line(tmp_path, keys, path):
    scenario(tmp_path, TEXT.replace("LANES", "2"))
    with pytest.raises(InputError) as caught:
        sumo_hmdp.scenario(tmp_path / "own.yaml", keys=keys)
    assert [problem.path for problem in caught.value.problems] == [path]


def test_check_and_a_study_take_it(shell, tmp_path):
    path = scenario(tmp_path, TEXT.replace("LANES", "2"))
    assert shell("check", path).code == 0
    study = tmp_path / "study.yaml"
    study.write_text(f"name: own\ndescription: one run\nscenarios: [{path}]\nseeds: {{first: 0, count: 1}}\n")
    done = shell("study", study, "--out", tmp_path / "out", "--workers", "1")
    assert done.code == 0, done.err
    runs = sumo_hmdp.load(tmp_path / "out").runs
    assert runs["trace_hash"].tolist() == [sumo_hmdp.run(sumo_hmdp.scenario(path)).row["trace_hash"]]
