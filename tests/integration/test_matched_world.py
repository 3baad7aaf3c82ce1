"""A world of vehicles drawn from the model: SUMO moves them by their paths, and only the planner's eyes are noisy."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom, norm

from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.prediction.branches import PredictedVehicle, PredictionSettings, predict
from sumo_hmdp.prediction.dynamics import Noise
from sumo_hmdp.prediction.lateral import LaneFollowing, forecast
from sumo_hmdp.prediction.policy import Policy, ScheduledPolicy
from sumo_hmdp.scenario.load import RunOptions, load_scenario
from sumo_hmdp.study.run import execute
from sumo_hmdp.traffic.matched import MatchedModel, draw_path

SCENARIOS = Path(__file__).parents[2] / "scenarios"
SEED = 3


@pytest.fixture
def matched(tmp_path):
    """Write a case of the paper, short, with vehicles drawn from the model; return its file."""

    def write(name, extra="", duration=6.0):
        text = (SCENARIOS / f"{name}.yaml").read_text(encoding="utf-8")
        line = next(line for line in text.splitlines() if line.startswith("duration_s:"))
        file = tmp_path / f"{name}.yaml"
        file.write_text(text.replace(line, f"duration_s: {duration}\nnoise: true\n{extra}", 1), encoding="utf-8")
        return file

    return write


def paths_of(ready):
    return ready.episode.paths


@pytest.mark.parametrize("name", ["case1", "case2"])
def test_the_world_moves_the_vehicles_by_their_paths_whoever_the_planner_is(matched, name):
    file = matched(name)
    runs = {}
    for planner in ("hmdp_mpc", "constant"):
        ready = load_scenario(file, RunOptions(planner=planner, solver="search", seed=SEED))
        record = execute(ready)
        assert record.status == "completed", record.reason
        others = record.steps[record.steps.vehicle_id != "ego"]
        assert set(others.vehicle_id) == set(paths_of(ready))
        for row in others.itertuples():
            drawn = paths_of(ready)[row.vehicle_id].at(row.time_s)
            assert (row.x_m, row.y_m, row.speed_mps) == pytest.approx((drawn.x, drawn.y, drawn.speed), abs=1e-9)
            assert (row.mode, row.intended_lane) == (drawn.mode.label, drawn.lane)
        runs[planner] = others.drop(columns="run_id").reset_index(drop=True)
    assert runs["hmdp_mpc"].equals(runs["constant"])


def test_another_seed_is_another_world_and_the_same_seed_the_same(matched):
    file = matched("case2")
    first, again, other = (load_scenario(file, RunOptions("constant", seed=seed)) for seed in (1, 1, 2))
    assert paths_of(first) == paths_of(again) != paths_of(other)


def test_noise_scale_multiplies_the_deviations_behind_the_planners_back(matched):
    once = load_scenario(matched("case2"), RunOptions("hmdp_mpc", seed=SEED))
    twice = load_scenario(matched("case2", "noise_scale: 2.0\n"), RunOptions("hmdp_mpc", seed=SEED))
    for name, path in paths_of(once).items():
        ratio = [(then.noise_x, then.noise_speed) for then in paths_of(twice)[name].periods]
        assert ratio == [(2 * now.noise_x, 2 * now.noise_speed) for now in path.periods]
        assert any(now.noise_x for now in path.periods)
    assert once.planner.beliefs == twice.planner.beliefs


def test_measurement_noise_is_in_the_planners_eyes_alone(matched):
    file = matched("case2")
    ready = load_scenario(file, RunOptions("hmdp_mpc", solver="search", seed=SEED))
    seen = []
    noise = {name: belief.noise for name, belief in ready.planner.beliefs.items()}
    assert all(one.position_var > 0.0 for one in noise.values())

    class Watching:
        """The planner, with what it sees written down."""

        period = ready.planner.period

        def initial_memory(self):
            return ready.planner.initial_memory()

        def decide(self, scene, memory):
            seen.append(scene)
            return ready.planner.decide(scene, memory)

    record = execute(replace(ready, planner=Watching()))
    assert record.status == "completed"
    errors = []
    for scene in seen:
        # The ego knows itself.
        at = record.steps[np.isclose(record.steps.time_s, scene.time)].set_index("vehicle_id")
        assert (at.x_m["ego"], at.y_m["ego"]) == (scene.ego.x, scene.ego.y)
        for other in scene.others:
            std = math.sqrt(noise[other.id].position_var)
            errors += [(other.x - at.x_m[other.id]) / std, (other.y - at.y_m[other.id]) / std]
    # The trace is the path, without the noise (above); what is seen deviates from it by unit variance.
    assert len(errors) == 2 * 4 * 10
    assert 0.0 not in errors
    assert np.mean(errors) == pytest.approx(0.0, abs=4 / math.sqrt(len(errors)))
    assert np.var(errors) == pytest.approx(1.0, abs=4 * math.sqrt(2 / len(errors)))


ROAD = Road(3, 4.0)
START = VehicleState("a", x=0.0, y=0.0, speed=25.0, lane=2)
POLICY = Policy(((0.0, 1.0, 0.0),) * 3, (0.2, 0.5, 0.3))
NOISE = Noise(process_position_var=0.09, process_speed_var=0.04)
PERIOD, STEPS, DRAWS = 0.5, 4, 300


def covered(scale):
    """Return how many of 300 drawn paths are in the predicted central 90 % interval, by step."""
    prediction = predict(
        [PredictedVehicle(START, POLICY, NOISE)],
        PredictionSettings(horizon_steps=STEPS, period=PERIOD, accel=2.0, sequence_threshold=1e-12),
    )
    assert prediction.probability.sum() == pytest.approx(1.0)
    noise = Noise(
        process_position_var=NOISE.process_position_var * scale**2, process_speed_var=NOISE.process_speed_var * scale**2
    )
    model = MatchedModel(ScheduledPolicy(((0.0, POLICY),)), noise, PERIOD, accel=2.0, following=LaneFollowing())
    counts = np.zeros(STEPS, dtype=int)
    for seed in range(DRAWS):
        path = draw_path(START, model, ROAD, STEPS * PERIOD, seed)
        for k in range(STEPS):
            x = path.at((k + 1) * PERIOD).x
            below = float(prediction.probability @ norm.cdf((x - prediction.x[:, k]) / prediction.x_std[0, k]))
            counts[k] += abs(below - 0.5) <= 0.45
    return counts


def test_what_is_predicted_is_what_comes_and_more_noise_is_noticed():
    low, high = binom.interval(0.9999, DRAWS, 0.9)
    right, doubled = covered(1.0), covered(2.0)
    assert (right >= low).all()
    assert (right <= high).all()
    # One step of one mode would leave 2 Phi(1.645 / 2) - 1 = 59 %; the modes' own spread is as it was.
    assert doubled[0] == pytest.approx(0.589 * DRAWS, abs=4 * math.sqrt(DRAWS * 0.589 * 0.411))
    assert (doubled < low).all()


SIDEWAYS = Noise(process_lateral_var=0.02)
CHANGER = Policy(((0.0, 1.0, 0.0), (0.3, 0.7, 0.0), (0.0, 1.0, 0.0)), (0.0, 1.0, 0.0))


def test_across_the_road_it_moves_as_it_is_predicted():
    following, steps, draws = LaneFollowing(change_time=3.0, keeping_time=1.5), 8, 400
    model = MatchedModel(ScheduledPolicy(((0.0, CHANGER),)), SIDEWAYS, PERIOD, accel=2.0, following=following)
    errors = []
    for seed in range(draws):
        path = draw_path(START, model, ROAD, steps * PERIOD, seed)
        lanes = [START.lane, *(period.successor.lane for period in path.periods[:steps])]
        foreseen = forecast(START, SIDEWAYS, following, ROAD, np.diff(lanes)[None], PERIOD)
        driven = np.array([path.at(k * PERIOD).y for k in range(steps + 1)])
        assert driven[0] == foreseen.y[0, 0] == 0.0
        errors.append((driven - foreseen.y[0])[1:] / foreseen.std[1:])
    # Nearly all have changed lanes by the end. Four standard errors of mean and variance.
    assert np.mean(errors, axis=0) == pytest.approx(np.zeros(steps), abs=4 / math.sqrt(draws))
    assert np.var(errors, axis=0) == pytest.approx(np.ones(steps), abs=4 * math.sqrt(2 / draws))


LEADER_LEAVES = """
name: leader_leaves
description: A slow leader certainly leaves the ego's lane, and takes its time.
network: highway_3x4m
lanes: {count: 3, width_m: 4.0}
duration_s: 8.0
dt_s: 0.2
noise: true
ego: {x_m: 0.0, lane: 2, speed_mps: 20.0, motion: point_mass, lane_change_time_s: 4.0}
vehicles:
- id: leader
  x_m: 31.0
  lane: 2
  speed_mps: 8.0
  driver: {kind: constant_speed}
  policy:
  - lateral_probs:
      1: {left: 0.0, keep: 1.0, right: 0.0}
      2: {left: 1.0, keep: 0.0, right: 0.0}
      3: {left: 0.0, keep: 1.0, right: 0.0}
    longitudinal_probs: {accelerate: 0.0, cruise: 1.0, decelerate: 0.0}
  process_position_var_m2: 0.01
planner: hmdp_mpc
planners:
  hmdp_mpc:
    period_s: PERIOD
    horizon_steps: 3
    accel_mps2: 2.0
    speed_min_mps: 0.0
    speed_max_mps: 40.0
    safe_distance_m: 10.0
    risk_level: 0.05
    risk_allocation: uniform
    account_pruned: true
    sequence_threshold: 1.0e-5
    maneuver_cost: [[0, 0, 0], [0, 0, 0], [0, 0, 0]]
    speed_weight: 1.0
    desired_speed_mps: 40.0
    speed_deadband_mps: 1.3
    forbidden_lanes: [1, 3]
    stopping: true
"""


@pytest.mark.parametrize("period", ["0.8", "1.0", "1.2"])
def test_the_body_of_a_leader_that_leaves_is_heeded_until_it_has_left(tmp_path, period):
    file = tmp_path / "leader_leaves.yaml"
    file.write_text(LEADER_LEAVES.replace("PERIOD", period), encoding="utf-8")
    record = execute(load_scenario(file, RunOptions(solver="search", seed=1)))
    assert record.status == "completed", record.reason
    assert record.row["contact_count"] == 0
    assert "fallback" not in set(record.decisions.status)
    rows = record.steps.pivot(index="time_s", columns="vehicle_id", values=["x_m", "y_m"])
    # 1.8 m wide, it is over the line between lanes 1 and 2 up to y = 2.9 m: so long its 4.5 m are ahead of the ego.
    over = rows["y_m"]["leader"] < 2.9 - 1e-6
    assert over.sum() * 0.2 > 2.5
    assert (rows["x_m"]["leader"] - 4.5 > rows["x_m"]["ego"])[over].all()
