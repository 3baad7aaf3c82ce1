"""What the planner measures: exact by default, else noise of a stream of its own for every vehicle and step."""

import math

import numpy as np
import pytest

from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import Scene, VehicleState
from sumo_hmdp.sim.measurement import Measurement, MeasurementNoise, measurement_noise

EGO = VehicleState("ego", x=0.0, y=0.0, speed=20.0, lane=2)
A, B = (VehicleState(name, x=50.0, y=4.0, speed=0.1, lane=1) for name in ("a", "b"))
SCENE = Scene(0.0, Road(3, 4.0), EGO, (A, B))


def test_without_noise_the_scene_is_the_scene():
    assert Measurement().perceive(SCENE, 0) is SCENE
    assert measurement_noise(0.0, 0.0, 0.0).exact


def test_one_vehicle_can_be_measured_with_noise():
    seen = Measurement(seed=1, by_vehicle={"a": measurement_noise(4.0, 1.0, 4.0)}).perceive(SCENE, 0)
    assert seen.ego is EGO
    assert seen.others[1] is B
    assert seen.others[0] != A


def test_deviations_are_those_asked_for_and_nobody_is_seen_driving_backwards():
    noise = Measurement(seed=2, otherwise=MeasurementNoise(position_std=2.0, speed_std=1.0))
    seen = [noise.perceive(SCENE, step).others[0] for step in range(2000)]
    for values in ([v.x - 50.0 for v in seen], [v.y - 4.0 for v in seen]):
        assert np.mean(values) == pytest.approx(0.0, abs=4 * 2.0 / math.sqrt(2000))
        assert np.std(values) == pytest.approx(2.0, rel=4 / math.sqrt(4000))
    assert min(v.speed for v in seen) == 0.0


def test_what_is_measured_of_one_does_not_hang_on_who_else_is_there():
    noise = Measurement(seed=3, otherwise=MeasurementNoise(1.0, 1.0))
    alone = noise.perceive(Scene(0.0, SCENE.road, EGO, (B,)), 7).others[0]
    assert alone == noise.perceive(SCENE, 7).others[1]
    assert alone != noise.perceive(SCENE, 8).others[1]
