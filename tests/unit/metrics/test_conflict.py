"""Conflicts across the path: oriented bodies against shapely, RSS and lane changes by hand."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import Polygon

from sumo_hmdp.metrics.catalogue import METRICS
from sumo_hmdp.metrics.conflict import entries, rss_unsafe, ttc2d

INF, NAN = math.inf, math.nan


def value(name, run):
    return METRICS.get(name).compute(run)


def body(vehicle, time):
    """Return the rectangle of a vehicle that goes on straight ahead."""
    cos, sin = math.cos(vehicle["heading"]), math.sin(vehicle["heading"])
    x, y = vehicle["x"] + vehicle["speed"] * time * cos, vehicle["y"] + vehicle["speed"] * time * sin
    corners = [(0, 1), (0, -1), (-vehicle["length"], -1), (-vehicle["length"], 1)]
    return Polygon(
        [
            (x + a * cos - b * vehicle["width"] / 2 * sin, y + a * sin + b * vehicle["width"] / 2 * cos)
            for a, b in corners
        ]
    )


vehicles = st.fixed_dictionaries(
    {
        "x": st.floats(-40, 40),
        "y": st.floats(-10, 10),
        "heading": st.floats(-1.5, 1.5),
        "speed": st.floats(0, 30),
        "length": st.floats(3, 12),
        "width": st.floats(1.5, 3),
    }
)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(ego=vehicles, other=vehicles)
def test_bodies_meet_when_moved_polygons_do(run_of, ego, other):
    found = ttc2d(run_of([0.0], ego=ego, car=other).trace)[0, 0]
    step = 0.02
    # Overlap by less than this may begin and end between two instants.
    meeting = [t for t in np.arange(0, 3 + step / 2, step) if body(ego, t).intersection(body(other, t)).area > 1e-6]
    if meeting:
        assert meeting[0] - step - 1e-9 <= found <= meeting[0] + 1e-9
    elif math.isfinite(found):
        # So short a touch that sampling missed it.
        after = body(ego, found + 1e-6).intersection(body(other, found + 1e-6)).area
        assert body(ego, found).distance(body(other, found)) < 1e-6
        assert after < 0.5


def test_meeting_times_by_hand(run_of):
    # A car in the next lane, level with the ego, drifts in at 1 m/s. Its foremost right corner is cos(heading) * 1 m
    # to the right of its front, at y = 4 - cos, and meets the ego's side at y = 1.
    drift = {"x": 100.0, "y": 4.0, "heading": -math.asin(0.1), "speed": 10.0}
    run = run_of([0.0], ego={"x": 100.0}, car=drift)
    assert value("ttc2d_min_s", run) == pytest.approx(3.0 - math.sqrt(0.99))
    # Ahead in the same lane: as `ttc_min_s`; beyond the horizon, or never: inf.
    assert value("ttc2d_min_s", run_of([0.0], ego={"x": 100.0}, car={"x": 124.0, "speed": 0.0})) == 2.0
    assert value("ttc2d_min_s", run_of([0.0], ego={"x": 100.0}, car={"x": 135.0, "speed": 0.0})) == INF
    assert value("ttc2d_min_s", run_of([0.0], ego={"x": 100.0}, car={"x": 100.0, "y": 2.5})) == INF
    assert value("ttc2d_min_s", run_of([0.0], ego={"x": 100.0}, car={"x": 102.0})) == 0.0
    assert math.isnan(value("ttc2d_min_s", run_of([0.0], ego={"x": 100.0})))


def test_near_misses_are_counted_by_episode_and_vehicle(run_of):
    # Times to collision with the car ahead: 0.9, 0.5, 1.5, 0.8 s: two episodes; the one behind: one.
    gaps = np.array([9.0, 5.0, 15.0, 8.0])
    car = {"x": 104.0 + gaps, "speed": 0.0}
    behind = {"x": 96.0 - np.array([50.0, 5.0, 5.0, 50.0]), "speed": 20.0}
    assert value("near_miss_count", run_of(range(4), ego={"x": [100.0] * 4}, car=car)) == 2
    assert value("near_miss_count", run_of(range(4), ego={"x": [100.0] * 4}, car=car, van=behind)) == 3
    assert value("near_miss_count", run_of(range(4), ego={"x": [100.0] * 4})) == 0


# At 10 m/s each: 10 * 0.5 + 2 * 0.25 / 2 + 11^2 / 8 - 10^2 / 16 = 14.125 m along. Across, without sideways speed, each
# drifts 0.025 + 0.1^2 / 1.6 = 0.03125 m: 0.1625 m with the margin.
@pytest.mark.parametrize(
    ("gap", "side", "unsafe"), [(14.12, 0.0, True), (14.13, 0.0, False), (14.12, 2.162, True), (14.12, 2.163, False)]
)
@pytest.mark.parametrize("sign", [1, -1])
def test_rss_by_hand(run_of, gap, side, unsafe, sign):
    assert rss_unsafe(run_of([0.0], ego={"x": 100.0}, car={"x": 104.0 + gap, "y": sign * side}).trace)[0, 0] == unsafe
    assert rss_unsafe(run_of([0.0], ego={"x": 100.0}, car={"x": 96.0 - gap, "y": sign * side}).trace)[0, 0] == unsafe


def test_rss_across_looks_at_who_drifts_where(run_of):
    # Drifting in at 1 m/s: (1 + 1.1) / 2 * 0.5 + 1.1^2 / 1.6 = 1.28125 m, in all 1.4125 m.
    for y, sign in ((4.0, -1), (-4.0, 1)):
        toward = {"x": 100.0, "y": y, "speed": 10.0, "heading": sign * math.asin(0.1)}
        away = toward | {"heading": -sign * math.asin(0.1)}
        for gap, unsafe in ((1.40, True), (1.42, False)):
            near = {"y": math.copysign(2.0 + gap, y)}
            assert rss_unsafe(run_of([0.0], ego={"x": 100.0}, car=toward | near).trace)[0, 0] == unsafe
        # The ego that drifts toward the other is as bad; two that part are not.
        ego = {"x": 100.0, "heading": -sign * math.asin(0.1)}
        assert rss_unsafe(run_of([0.0], ego=ego, car={"x": 100.0, "y": math.copysign(3.4, y)}).trace)[0, 0]
        assert not rss_unsafe(run_of([0.0], ego={"x": 100.0}, car=away | {"y": math.copysign(2.1, y)}).trace)[0, 0]


def test_the_share_below_rss_is_of_instants(run_of):
    car = {"x": [114.0, 114.0, 204.0, NAN]}
    run = run_of(range(4), ego={"x": [100.0] * 4}, car=car)
    assert value("rss_violation_share", run) == 0.5
    assert value("rss_violation_share", run_of([0.0], ego={"x": 1.0})) == 0.0


LANES = [2, 2, 1, 1, 1, 1, 1, 1]
CHANGE = {"x": np.arange(8) * 10.0 + 100.0, "lane": LANES}


def test_a_lane_change_and_its_new_follower(run_of):
    # The front enters lane 1 at t = 2 with the rear at 116; the follower's front is at 90 + 10 t: there at t = 2.6.
    follower = {"x": 90.0 + 10.0 * np.arange(8), "lane": 1, "accel": [0, -9, -1, 0, -2.5, 0, 0, -3]}
    further = {"x": 50.0 + 10.0 * np.arange(8), "lane": 1, "accel": -9.0}
    beside = {"x": 95.0 + 10.0 * np.arange(8), "lane": 2, "accel": -9.0}
    run = run_of(range(8), ego=CHANGE, far=further, near=follower, other=beside)
    assert entries(run.trace) == [(2, 1)]
    assert value("pet_min_s", run) == pytest.approx(0.6)
    # Braking before the change does not count; t = 7 is 5 s after it, just within.
    assert value("braking_imposed_max_mps2", run) == 3.0


def test_a_follower_that_never_comes_or_is_there_already(run_of):
    slow = {"x": [50.0] * 8, "lane": 1}
    assert value("pet_min_s", run_of(range(8), ego=CHANGE, slow=slow)) == INF
    level = {"x": 98.0 + 10.0 * np.arange(8), "lane": 1, "y": 4.0}
    assert value("pet_min_s", run_of(range(8), ego=CHANGE, level=level)) == 0.0
    accelerating = level | {"accel": 1.0}
    assert value("braking_imposed_max_mps2", run_of(range(8), ego=CHANGE, level=accelerating)) == 0.0


def test_without_a_lane_change_or_a_follower_there_is_nothing_to_tell(run_of):
    ahead = {"x": 150.0 + 10.0 * np.arange(8), "lane": 1}
    for run in (run_of(range(8), ego=CHANGE, car=ahead), run_of(range(8), ego=CHANGE | {"lane": 2}, car=ahead)):
        assert math.isnan(value("pet_min_s", run))
        assert math.isnan(value("braking_imposed_max_mps2", run))


def test_a_follower_that_is_lost_and_seen_again(run_of):
    lost = {"x": [90.0, 100.0, 110.0, NAN, 130.0, 140.0, 150.0, 160.0], "lane": 1}
    # It is past the point when it is seen again, at t = 4.
    assert value("pet_min_s", run_of(range(8), ego=CHANGE, car=lost)) == 2.0
