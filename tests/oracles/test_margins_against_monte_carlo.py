"""Margins against samples of the motion they are meant for."""

import numpy as np
import pytest
from scipy.stats import binom

from sumo_hmdp.decision.problem import PlannerSettings, RiskAllocation
from sumo_hmdp.decision.risk import margins
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.prediction.branches import PredictedVehicle, PredictionSettings, predict
from sumo_hmdp.prediction.dynamics import Noise
from sumo_hmdp.prediction.policy import Policy

SAMPLES = 200_000


def planner(allocation, risk_level, H=4):
    return PlannerSettings(0.6, H, 2.0, 0.0, 40.0, 20.0, risk_level, allocation, 1e-6)


def cars(count, noise):
    keep = Policy(((0.0, 1.0, 0.0),) * 3, (0.0, 1.0, 0.0))
    return [PredictedVehicle(VehicleState(f"sv{i}", 50.0 * i, 0.0, 20.0, 2), keep, noise) for i in range(count)]


def sample_paths(rng, noise, H, T, count):
    """Simulate x of a cruising vehicle, step by step, from the noise's meaning alone."""
    x = rng.normal(0.0, np.sqrt(noise.position_var), count)
    v = 20.0 + rng.normal(0.0, np.sqrt(noise.speed_var), count)
    paths = np.empty((H, count))
    for k in range(H):
        x = x + v * T + rng.normal(0.0, np.sqrt(noise.process_position_var), count)
        v = v + rng.normal(0.0, np.sqrt(noise.process_speed_var), count)
        paths[k] = x
    return paths


@pytest.mark.parametrize("risk_level", [0.01, 0.05, 0.3, 0.5])
@pytest.mark.parametrize("noise", [Noise(0.5), Noise(0.1, 0.04, 0.02, 0.01), Noise(0.0, 0.0, 0.1, 0.3)])
def test_each_constraint_is_violated_as_often_as_asked(noise, risk_level):
    rng = np.random.default_rng(7)
    vehicles = cars(1, noise)
    settings = planner(RiskAllocation.INDIVIDUAL, risk_level)
    branches = predict(vehicles, settings.prediction())
    margin = margins(branches, settings)[0]
    paths = sample_paths(rng, noise, 4, 0.6, SAMPLES)
    for k in range(4):
        # The ego sits exactly on the constraint behind the vehicle: a violation is x below mean - margin.
        violations = int((paths[k] < branches.x[0, k] - margin[k]).sum())
        low, high = binom.ppf([1e-6, 1 - 1e-6], SAMPLES, risk_level)
        assert low <= violations <= high


@pytest.mark.parametrize("risk_level", [0.2, 0.05])
def test_uniform_keeps_the_joint_probability_and_individual_does_not(risk_level):
    rng = np.random.default_rng(11)
    noise, H, count = Noise(0.3, 0.04, 0.3, 0.05), 4, 3
    joint = {}
    for allocation in RiskAllocation:
        settings = planner(allocation, risk_level)
        branches = predict(cars(count, noise), settings.prediction())
        margin = margins(branches, settings)
        violated = np.zeros(SAMPLES, dtype=bool)
        for i in range(count):
            paths = sample_paths(rng, noise, H, 0.6, SAMPLES) + 50.0 * i
            violated |= (paths < (branches.x[i] - margin[i])[:, None]).any(axis=0)
        joint[allocation] = violated.sum()
    assert joint[RiskAllocation.UNIFORM] <= binom.ppf(1 - 1e-6, SAMPLES, risk_level)
    # What the single quantile gives for all constraints together is far above what was asked.
    assert joint[RiskAllocation.INDIVIDUAL] > 2 * risk_level * SAMPLES


def test_margins_fall_with_the_risk_level_and_vanish_at_one_half():
    vehicles = cars(2, Noise(0.5))
    values = []
    for risk_level in (0.001, 0.05, 0.5):
        settings = planner(RiskAllocation.INDIVIDUAL, risk_level)
        values.append(margins(predict(vehicles, settings.prediction()), settings)[0, 0])
    assert values[0] > values[1] > values[2] == pytest.approx(0.0, abs=1e-12)


def test_prediction_settings_of_a_planner():
    assert planner(RiskAllocation.UNIFORM, 0.1).prediction() == PredictionSettings(4, 0.6, 2.0, 1e-6)
