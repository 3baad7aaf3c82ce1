"""Scores of predictors against closed forms and an enumeration."""

import itertools
import math

import numpy as np
import pytest

from sumo_hmdp.decision.predictors import PredictorContext
from sumo_hmdp.domain.maneuver import Mode
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.prediction.branches import PredictedVehicle
from sumo_hmdp.prediction.dynamics import Noise
from sumo_hmdp.prediction.policy import Policy
from sumo_hmdp.report.predictor_scores import lane_distribution, vehicle_scores

CONTEXT = PredictorContext({}, None, 2.0, 1.0, 2)
KEEPING = Policy(((0.0, 1.0, 0.0),) * 3, (0.0, 1.0, 0.0))


def state(x, lane=2, speed=20.0):
    return VehicleState("v", x, 4.0 * (2 - lane), speed, lane, Mode.CRUISE)


def test_lanes_by_step_are_those_of_an_enumeration():
    tables = [((0.0, 0.9, 0.1), (0.2, 0.5, 0.3), (0.4, 0.6, 0.0)), ((0.0, 0.3, 0.7), (0.1, 0.8, 0.1), (0.5, 0.5, 0.0))]
    policy = Policy(tables[0], (0.0, 1.0, 0.0), (tables[1],))
    expected = np.zeros(3)
    for actions in itertools.product((-1, 0, 1), repeat=3):
        lane, probability = 1, 1.0
        for k, action in enumerate(actions):
            probability *= tables[min(k, 1)][lane][action + 1]
            lane = min(max(lane + action, 0), 2)
        expected[lane] += probability
    assert expected.sum() == pytest.approx(1.0)
    found = lane_distribution(PredictedVehicle(state(0.0), policy, Noise()), 3)
    assert found == pytest.approx(expected, abs=1e-12)


def test_scores_of_one_normal_distribution():
    # Variances of x after 1 and 2 s: 1 + 0.25, and 1 + 4 * 0.25.
    vehicle = PredictedVehicle(state(100.0), KEEPING, Noise(position_var=1.0, speed_var=0.25))
    found = vehicle_scores(vehicle, [state(120.0), state(140.0 + 1.7 * math.sqrt(2.0), lane=1)], CONTEXT)
    assert found["nees"] == pytest.approx(1.7**2)
    assert found["x_log_loss"] == pytest.approx(1.7**2 / 2 + math.log(2.0 * math.sqrt(math.pi)))
    assert found["fde_m"] == pytest.approx(1.7 * math.sqrt(2.0))
    assert found["ade_m"] == pytest.approx(found["fde_m"] / 2)
    # 1.7 deviations are outside the 90 % interval (1.645) and inside the 95 % one (1.96).
    assert [found[f"coverage_{level}_share"] for level in (50, 90, 95)] == [0.5, 0.5, 1.0]
    # A lane that the prediction calls impossible costs the log of one in a million, and 2 in Brier's score.
    assert found["lane_log_loss"] == pytest.approx(math.log(1e6))
    assert found["lane_brier"] == 2.0
