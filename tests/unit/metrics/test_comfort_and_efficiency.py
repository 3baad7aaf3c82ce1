"""Comfort of motions known in closed form; efficiency and aborted lane changes by hand."""

import math

import numpy as np
import pytest

from sumo_hmdp.metrics.catalogue import METRICS


def value(name, run):
    return METRICS.get(name).compute(run)


TIME = np.arange(0, 20.0001, 0.01)


def test_a_sine_of_acceleration(run_of):
    # a = 3 sin t over thirty periods: root mean square 3 / sqrt 2; above 2.4 for acos(0.8) / pi of the time, never
    # below -4.05. The mean of the jerk 3 cos t over a second is 2 sin(1 / 2) of it, within its bounds.
    time = np.arange(0, 60 * math.pi, 0.01)
    run = run_of(time, ego={"x": 10 * time, "accel": 3 * np.sin(time)})
    assert value("accel_rms_mps2", run) == pytest.approx(3 / math.sqrt(2), rel=5e-3)
    assert value("accel_outside_share", run) == pytest.approx(math.acos(0.8) / math.pi, abs=5e-3)
    assert value("jerk_rms_mps3", run) == pytest.approx(3 * 2 * math.sin(0.5) / math.sqrt(2), rel=5e-3)
    assert value("jerk_outside_share", run) == 0.0
    rough = run_of(time, ego={"x": 10 * time, "accel": 4.13 / math.sin(0.5) * np.sin(time)})
    # The means of its jerk have twice 4.13 as amplitude: beyond it for two thirds of the time.
    assert value("jerk_outside_share", rough) == pytest.approx(2 / 3, abs=2e-2)


def test_a_circle(run_of):
    # 12 m/s at 0.5 rad/s through the cut at pi: 6 m/s2, above 4.89.
    heading = np.angle(np.exp(0.5j * TIME))
    run = run_of(TIME, ego={"x": TIME, "speed": 12.0, "heading": heading})
    assert value("yaw_rate_rms_radps", run) == pytest.approx(0.5)
    assert value("lateral_accel_rms_mps2", run) == pytest.approx(6.0)
    assert value("yaw_accel_rms_radps2", run) == pytest.approx(0.0, abs=1e-6)
    assert value("lateral_accel_outside_share", run) == 1.0
    assert value("yaw_rate_outside_share", run) == 0.0


def test_a_spin_that_winds_up(run_of):
    # Yaw acceleration 2 rad/s2: outside all the time. The yaw rate is beyond 0.95 from 0.475 s on.
    time = np.arange(0, 10.0001, 0.01)
    run = run_of(time, ego={"x": time, "heading": time**2})
    assert (value("yaw_accel_outside_share", run), value("yaw_rate_outside_share", run)) == (1.0, 1.0)
    # At 0.2 rad/s2 it is from 4.75 s on; the means are those of 0.5 to 9.5 s.
    run = run_of(time, ego={"x": time, "heading": 0.1 * time**2})
    assert value("yaw_accel_outside_share", run) == 0.0
    assert value("yaw_rate_outside_share", run) == pytest.approx(4.75 / 9, abs=0.02)


def test_distance_speed_and_time_loss_by_hand(run_of):
    run = run_of([0.0, 1.0, 2.0, 4.0], 20.0, ego={"x": [5.0, 15.0, 35.0, 75.0], "speed": [10.0, 20.0, 25.0, 0.0]})
    # Half a second is lost in the first; driving faster wins nothing back.
    assert value("time_loss_s", run) == 0.5
    assert (value("distance_m", run), value("duration_s", run), value("speed_mean_mps", run)) == (70.0, 4.0, 13.75)
    assert math.isnan(value("time_loss_s", run_of([0.0], None, ego={"x": 1.0})))
    assert math.isnan(value("time_loss_s", run_of([0.0], 0.0, ego={"x": 1.0})))


@pytest.mark.parametrize(
    ("intended", "lane", "aborted"),
    [
        ("222111", "222211", 0),  # a lane change
        ("221122", "222222", 1),  # given up before the line
        ("221122", "221122", 0),  # there and back again
        ("2211221122", "2222222222", 2),
        ("332211", "332222", 0),  # two lanes in one go
        ("3322113", "3333333", 0),  # to the far lane and back: neither is the lane before
        ("3322112", "3333333", 1),  # the second of two is given up
        ("2222", "2222", 0),
    ],
)
def test_aborted_lane_changes(run_of, intended, lane, aborted):
    lanes = [int(c) for c in lane]
    ego = {"x": np.arange(len(lane)) * 10.0, "lane": lanes, "intended": [int(c) for c in intended]}
    run = run_of(range(len(lane)), ego=ego)
    assert value("lane_change_abort_count", run) == aborted
    assert value("overtaking_lane_share", run) == lanes.count(1) / len(lanes)
