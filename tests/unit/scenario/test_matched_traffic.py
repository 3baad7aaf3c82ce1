"""Traffic drawn from the model: how many, where, how often they change lanes, and which mistakes are told."""

from pathlib import Path

import numpy as np
import pytest

from sumo_hmdp.errors import InputError
from sumo_hmdp.scenario.load import RunOptions, load_scenario

SCENARIO = Path(__file__).parents[3] / "scenarios" / "matched_highway.yaml"
DENSITY = "matched_traffic.density_vpkm_per_lane"


def at_density(density, seed=0):
    return load_scenario(SCENARIO, RunOptions("constant", seed=seed, overrides={DENSITY: density}))


@pytest.mark.parametrize("density", [7.0, 16.0, 60.0])
def test_every_lane_has_its_density_and_nobody_is_in_anybodys_way(density):
    spacing = 1000.0 / density
    run = at_density(density)
    for lane, speed in ((1, 28.0), (2, 26.0), (3, 24.0)):
        there = [spawn for spawn in run.spawns if spawn.lane == lane]
        # 800 m; the ego has one of the places of its lane.
        assert len(there) + (lane == 2) == pytest.approx(0.8 * density, abs=1.0)
        assert {spawn.speed for spawn in there} == {speed}
        places = sorted([spawn.x for spawn in there] + [0.0] * (lane == 2))
        assert -300.0 - 0.15 * spacing <= places[0] < places[-1] <= 500.0 + 0.15 * spacing
        assert np.diff(places).min() >= 0.7 * spacing - 1e-9
    assert len({round(spawn.x % spacing, 6) for spawn in run.spawns}) == len(run.spawns)


def test_a_seed_is_a_world_and_the_file_stays_as_it_is():
    first, again, other = at_density(16.0, 1), at_density(16.0, 1), at_density(16.0, 2)
    assert first.spawns == again.spawns
    assert first.episode.paths == again.episode.paths
    assert {spawn.x for spawn in first.spawns}.isdisjoint(spawn.x for spawn in other.spawns)
    assert first.configuration["vehicles"] == []
    assert set(first.episode.paths) == {spawn.id for spawn in first.spawns}


def test_lanes_are_changed_as_often_as_on_motorways():
    changes, kilometres, per_lane = 0, 0.0, []
    for seed in range(12):
        paths = at_density(16.0, seed).episode.paths.values()
        for path in paths:
            lanes = [path.start.lane, *(period.successor.lane for period in path.periods[:75])]
            changes += np.count_nonzero(np.diff(lanes))
            kilometres += (path.at(60.0).x - path.start.x) / 1000.0
            per_lane.append(lanes[-1])
    # highD: 0.12 a vehicle and km; four standard deviations of a Poisson count.
    assert changes == pytest.approx(0.12 * kilometres, abs=4 * (0.12 * kilometres) ** 0.5)
    # As many come into a lane as leave it.
    shares = np.bincount(per_lane)[1:] / len(per_lane)
    assert shares == pytest.approx([1 / 3] * 3, abs=0.05)


MISTAKES = {
    "no noise": ({"noise": False}, ["matched_traffic: must go with `noise: true`"]),
    "backwards": ({"matched_traffic.stretch_m": [5.0, -5.0]}, ["matched_traffic.stretch_m: must be [from, to]"]),
    "off the road": (
        {"matched_traffic.stretch_m": [-1200.0, 0.0]},
        ["matched_traffic.stretch_m: must be within -981.864..8986.36 m, where whole vehicles"],
    ),
    "a lane without a speed": (
        {"matched_traffic.lane_speeds_mps": [28.0, 26.0]},
        ["matched_traffic.lane_speeds_mps: must have a speed for each of 3 lanes, got 2"],
    ),
    "too many": ({DENSITY: 90.0}, [f"{DENSITY}: must be at most 77.8 vehicles/km for vehicles of 4.5 m, got 90"]),
    "no density": ({DENSITY: -1.0}, [f"{DENSITY}: "]),
    "no distribution": (
        {"matched_traffic.policy[0].longitudinal_probs.cruise": 0.5},
        ["matched_traffic.policy[0].longitudinal_probs: must sum to 1"],
    ),
    "a dead end": (
        {
            "matched_traffic.policy[0].longitudinal_probs": {"accelerate": 0.0, "cruise": 0.0, "decelerate": 1.0},
        },
        ["matched_traffic.policy[0].lateral_probs, matched_traffic.policy[0].longitudinal_probs: must give"],
    ),
    "a name that is taken": (
        {
            "vehicles": [
                {
                    "id": "m2.1",
                    "x_m": 900.0,
                    "lane": 2,
                    "speed_mps": 20.0,
                    "driver": {"kind": "constant_speed"},
                    "policy": [
                        {
                            "lateral_probs": {"left": 0, "keep": 1, "right": 0},
                            "longitudinal_probs": {"accelerate": 0, "cruise": 1, "decelerate": 0},
                        }
                    ],
                }
            ]
        },
        ["vehicles[0].id: must not be as those of matched_traffic"],
    ),
    "two at once": (
        {"noise": False, DENSITY: 90.0},
        ["matched_traffic: must go with", f"{DENSITY}: must be at most"],
    ),
}


@pytest.mark.parametrize(("overrides", "lines"), MISTAKES.values(), ids=MISTAKES)
def test_mistakes_are_told(overrides, lines):
    with pytest.raises(InputError) as caught:
        load_scenario(SCENARIO, RunOptions("constant", overrides=overrides))
    told = [str(problem) for problem in caught.value.problems]
    assert len(told) == len(lines)
    for line in lines:
        assert any(text.startswith(line) for text in told), told
