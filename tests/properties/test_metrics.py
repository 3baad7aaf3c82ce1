"""What must not change a metric: where the road begins, what vehicles are called, left and right, the time step."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sumo_hmdp.metrics.catalogue import METRICS
from sumo_hmdp.metrics.registry import RunData
from sumo_hmdp.metrics.trace import trace_of

SETTINGS = settings(max_examples=25, deadline=None, derandomize=True)
WIDTH = 4.0


def smooth(rng, time, size):
    """Return a smooth random function of time with its derivative."""
    frequency, phase = rng.uniform(0.2, 0.6), rng.uniform(0, 2 * np.pi)
    value = size * np.sin(frequency * time + phase)
    return value, size * frequency * np.cos(frequency * time + phase)


def scene(seed, dt=0.1, duration=12.0):
    """Return the steps table of a random, smooth scene of four vehicles on three lanes."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(duration / dt) + 1) * dt
    parts = []
    for name in ("ego", "a", "b", "c"):
        wobble, speed_wobble = smooth(rng, time, 8.0)
        speed = rng.uniform(15, 25)
        y, side_speed = smooth(rng, time, 4.0)
        along = speed + speed_wobble
        accel = np.gradient(np.hypot(along, side_speed), time)
        lane = np.clip(np.round(2 - y / WIDTH), 1, 3).astype(int)
        parts.append(
            pd.DataFrame(
                {
                    "time_s": time,
                    "vehicle_id": name,
                    "x_m": rng.uniform(-60, 60) * (name != "ego") + speed * time + wobble,
                    "y_m": y,
                    "heading_rad": np.arctan2(side_speed, along),
                    "speed_mps": np.hypot(along, side_speed),
                    "accel_mps2": accel,
                    "lane": lane,
                    "intended_lane": lane,
                    "length_m": rng.uniform(4, 10),
                    "width_m": rng.uniform(1.6, 2.5),
                }
            )
        )
    return pd.concat(parts, ignore_index=True)


def measured(steps, leave_out=()):
    """Return all metrics of a trace but those of its decisions."""
    run = RunData(trace_of(steps), pd.DataFrame(), 22.0)
    chosen = [m for m in METRICS.all.values() if m.compute and not m.of_decisions and m.name not in leave_out]
    return {metric.name: metric.compute(run) for metric in chosen}


def same(found, expected, **tolerance):
    assert found == pytest.approx(expected, nan_ok=True, **tolerance)


@SETTINGS
@given(seed=st.integers(0, 10**6), shift=st.integers(-5000, 5000))
def test_moving_the_scene_along_the_road(seed, shift):
    steps = scene(seed)
    same(measured(steps.assign(x_m=steps["x_m"] + shift)), measured(steps), rel=1e-6, abs=1e-6)


@SETTINGS
@given(seed=st.integers(0, 10**6))
def test_other_names_and_another_order(seed):
    steps = scene(seed)
    renamed = steps.assign(vehicle_id=steps["vehicle_id"].replace({"a": "z", "c": "y"}))
    same(measured(renamed.sample(frac=1, random_state=seed)), measured(steps), rel=1e-12)


@SETTINGS
@given(seed=st.integers(0, 10**6))
def test_mirrored_left_and_right(seed):
    steps = scene(seed)
    mirrored = steps.assign(
        y_m=-steps["y_m"],
        heading_rad=-steps["heading_rad"],
        lane=4 - steps["lane"],
        intended_lane=4 - steps["intended_lane"],
    )
    # The leftmost lane is the one thing that knows left from right.
    same(measured(mirrored, {"overtaking_lane_share"}), measured(steps, {"overtaking_lane_share"}), rel=1e-9, abs=1e-12)


# Not continuous in time: a vehicle enters the path, or a lane, between two instants.
JUMPS = {
    "gap_min_m", "time_gap_min_s", "ttc_min_s", "ttc_leader_min_s", "mttc_min_s", "drac_max_mps2", "ttc2d_min_s",
    "near_miss_count", "pet_min_s", "braking_imposed_max_mps2", "tet_s", "tit_s2", "tet_spkm", "tit_s2pkm",
}  # fmt: skip


@SETTINGS
@given(seed=st.integers(0, 10**6))
def test_half_the_time_step(seed):
    coarse, fine = measured(scene(seed, 0.05), JUMPS), measured(scene(seed, 0.025), JUMPS)
    same(fine, coarse, rel=0.03, abs=0.03)


@pytest.mark.parametrize("closing", [2.0, 6.0])
def test_half_the_time_step_while_following(closing):
    """A leader in the path from the first instant to the last: even the minima settle."""

    def follow(dt):
        time = np.arange(round(8 / dt) + 1) * dt
        x = {"ego": 20 * time, "a": 4.0 + 5.0 + 8 * closing + (20 - closing) * time}
        speed = {"ego": 20.0, "a": 20.0 - closing}
        parts = [
            pd.DataFrame({"time_s": time, "vehicle_id": name, "x_m": x[name], "speed_mps": speed[name]}) for name in x
        ]
        rest = {"y_m": 0.0, "heading_rad": 0.0, "accel_mps2": 0.0, "lane": 2, "intended_lane": 2}
        return pd.concat(parts).assign(length_m=4.0, width_m=2.0, **rest)

    same(measured(follow(0.05)), measured(follow(0.1)), rel=0.05, abs=0.06)
    # In closed form: 5 m are left; ttc falls from 8 + 5 / closing to 5 / closing.
    found = measured(follow(0.01))
    least = 5 / closing
    assert found["ttc_min_s"] == pytest.approx(least)
    assert found["drac_max_mps2"] == pytest.approx(closing**2 / 10)
    exposed = max(2.0 - least, 0.0)
    assert found["tet_s"] == pytest.approx(exposed, abs=0.02)
    assert found["tit_s2"] == pytest.approx(exposed**2 / 2, abs=0.02)
    assert found["tet_spkm"] == pytest.approx(exposed / 0.16, abs=0.15)


@SETTINGS
@given(seed=st.integers(0, 10**6), shift=st.floats(-50, 50))
def test_moving_the_scene_across_the_road(seed, shift):
    """Lanes are columns of their own: what is shifted with the scene is the axis from which y counts."""
    steps = scene(seed)
    same(measured(steps.assign(y_m=steps["y_m"] + shift)), measured(steps), rel=1e-6, abs=1e-6)


# What knows no road: bodies where they are, and how the ego moves along and across its own heading.
FREE = {"ttc2d_min_s", "near_miss_count"} | {
    name for name in METRICS.all if name.startswith(("accel_", "lateral_accel_", "jerk_", "yaw_", "speed_mean"))
}


@SETTINGS
@given(seed=st.integers(0, 10**6), turn=st.floats(-3.0, 3.0))
def test_turning_the_scene(seed, turn):
    steps = scene(seed)
    cos, sin = np.cos(turn), np.sin(turn)
    turned = steps.assign(
        x_m=cos * steps["x_m"] - sin * steps["y_m"],
        y_m=sin * steps["x_m"] + cos * steps["y_m"],
        heading_rad=steps["heading_rad"] + turn,
    )
    others = set(METRICS.all) - FREE
    found, expected = measured(turned, others), measured(steps, others)
    assert len(found) == len(FREE)
    same(found, expected, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("behind", [1.0, 6.0])
def test_half_the_time_step_in_a_lane_change(behind):
    """The front enters lane 1 at 2 s; its new follower, as fast, reaches the point `behind` / 20 s later."""

    def change(dt):
        time = np.arange(round(8 / dt) + 1) * dt
        lane = {"ego": np.where(time < 2.0 - 1e-9, 2, 1), "a": 1}
        x = {"ego": 20 * time, "a": 20 * time - 4.0 - behind}
        # Braking rises to 3 m/s2 at 5 s, within the 5 s that count, and to 9 m/s2 after them.
        accel = {"ego": 0.0, "a": np.where(time < 7.5, -3.0 * np.sin(np.pi * time / 10) ** 2, -9.0)}
        parts = [
            pd.DataFrame({"time_s": time, "vehicle_id": name, "x_m": x[name], "accel_mps2": accel[name]}).assign(
                lane=lane[name], intended_lane=lane[name]
            )
            for name in x
        ]
        rest = {"y_m": 0.0, "heading_rad": 0.0, "speed_mps": 20.0, "length_m": 4.0, "width_m": 2.0}
        return measured(pd.concat(parts).assign(**rest), set(METRICS.all) - {"pet_min_s", "braking_imposed_max_mps2"})

    for dt in (0.1, 0.05, 0.025):
        assert change(dt) == {"pet_min_s": pytest.approx(behind / 20), "braking_imposed_max_mps2": pytest.approx(3.0)}
