"""Rates of change hang on the motion, not on the step with which it was recorded."""

import numpy as np
import pytest

from sumo_hmdp.metrics.catalogue import METRICS
from sumo_hmdp.metrics.comfort import rate_of_change

# Halving the step changes a root mean square by no more (docs/metrics.md).
TOLERANCE = 0.05
RATES = ("accel_rms_mps2", "jerk_rms_mps3", "lateral_accel_rms_mps2", "yaw_rate_rms_radps", "yaw_accel_rms_radps2")


def drive(run_of, dt):
    """30 s in which the acceleration changes within 0.1 s, as between modes, and the ego changes lanes in 4 s."""
    time = np.arange(round(30.0 / dt) + 1) * dt
    accel = np.interp(time, [5.0, 5.1, 9.0, 9.1, 14.0, 14.1, 20.0, 20.4], [0.0, 2.0, 2.0, 0.0, 0.0, -2.0, -2.0, 0.0])
    share = np.clip((time - 12.0) / 4.0, 0.0, 1.0)
    slope = (30 * share**2 - 60 * share**3 + 30 * share**4) / 4.0 * 4.0
    return run_of(time, ego={"x": 20.0 * time, "speed": 20.0, "accel": accel, "heading": np.arctan2(slope, 20.0)})


@pytest.mark.parametrize("dt", [0.2, 0.15, 0.1])
@pytest.mark.parametrize("name", RATES)
def test_halving_the_step_changes_nothing_within_the_tolerance(run_of, name, dt):
    whole, half = (METRICS.get(name).compute(drive(run_of, step)) for step in (dt, dt / 2))
    assert whole > 0.0
    assert half == pytest.approx(whole, rel=TOLERANCE)


@pytest.mark.parametrize("dt", [0.05, 0.2, 0.5])
def test_a_jump_of_the_acceleration_is_the_same_jerk_at_any_step(run_of, dt):
    # 2 m/s2 more at 5 s: for a second the mean jerk is 2 m/s3 at most, and the integral of the jerk is the jump.
    time = np.arange(round(10.0 / dt) + 1) * dt
    run = run_of(time, ego={"x": 10.0 * time, "accel": np.where(time < 5.0, 0.0, 2.0)})
    jerk = rate_of_change(run.trace.ego.accel[:, 0], run.trace.time, 1.0)
    assert jerk.value.max() == pytest.approx(2.0)
    assert 0.1 * jerk.value.sum() == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("end", [0.2, 1.0, 1.7, 3.0])
def test_a_steady_rate_is_found_in_runs_of_any_length(run_of, end):
    time = np.arange(round(end / 0.1) + 1) * 0.1
    run = run_of(time, ego={"x": 10.0 * time, "accel": 3.0 * time, "heading": 0.1 * time**2})
    assert METRICS.get("jerk_rms_mps3").compute(run) == pytest.approx(3.0)
    assert METRICS.get("yaw_accel_rms_radps2").compute(run) == pytest.approx(0.2)
