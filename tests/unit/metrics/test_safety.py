"""Gaps, times and decelerations to others in the path, against numbers worked by hand."""

import math

import numpy as np
import pytest

from sumo_hmdp.metrics.catalogue import METRICS
from sumo_hmdp.metrics.safety import mttc

INF, NAN = math.inf, math.nan


def value(name, run):
    return METRICS.get(name).compute(run)


# The ego's body is [96, 100]; 4 m long all of them.
@pytest.mark.parametrize(
    ("other", "expected"),
    [
        # 20 m ahead, closing at 5 m/s.
        ({"x": 124.0, "speed": 5.0}, {"gap": 20.0, "time_gap": 2.0, "ttc": 4.0, "leader": 4.0, "drac": 25 / 40}),
        # 10 m behind, closing at 10 m/s; nobody is ahead.
        ({"x": 86.0, "speed": 20.0}, {"gap": 10.0, "time_gap": NAN, "ttc": 1.0, "leader": NAN, "drac": 100 / 20}),
        # Ahead and faster: never.
        ({"x": 124.0, "speed": 15.0}, {"gap": 20.0, "time_gap": 2.0, "ttc": INF, "leader": INF, "drac": 0.0}),
        # Bodies overlap along and across the road, and close.
        ({"x": 102.0, "y": 1.0, "speed": 5.0}, {"gap": -2.0, "time_gap": 0.0, "ttc": 0.0, "leader": 0.0, "drac": INF}),
        # Beside: no body in the path.
        ({"x": 124.0, "y": 2.0, "speed": 5.0}, {"gap": NAN, "time_gap": NAN, "ttc": NAN, "leader": NAN, "drac": NAN}),
        (
            {"x": 124.0, "y": -1.9, "speed": 5.0},
            {"gap": 20.0, "time_gap": 2.0, "ttc": 4.0, "leader": 4.0, "drac": 0.625},
        ),
    ],
)
def test_one_instant_by_hand(run_of, other, expected):
    run = run_of([0.0], ego={"x": 100.0}, car=other)
    names = {"gap": "gap_min_m", "time_gap": "time_gap_min_s", "ttc": "ttc_min_s", "leader": "ttc_leader_min_s"}
    names["drac"] = "drac_max_mps2"
    found = {key: value(name, run) for key, name in names.items()}
    assert found == pytest.approx(expected, nan_ok=True)


def test_a_standing_ego_has_infinite_time(run_of):
    run = run_of([0.0], ego={"x": 100.0, "speed": 0.0}, car={"x": 124.0, "speed": 0.0})
    assert value("time_gap_min_s", run) == INF


@pytest.mark.parametrize("dv", [-6.0, -1.0, 0.0, 1.0, 6.0])
@pytest.mark.parametrize("da", [-2.0, -0.5, 0.0, 0.5, 2.0])
@pytest.mark.parametrize("gap", [0.5, 20.0])
def test_modified_time_to_collision_is_the_least_positive_root(run_of, dv, da, gap):
    run = run_of([0.0], ego={"x": 100.0, "speed": 10.0 + dv, "accel": da}, car={"x": 104.0 + gap})
    roots = np.roots(np.trim_zeros([da / 2, dv, -gap], "f"))
    positive = [root.real for root in roots if abs(root.imag) < 1e-9 and root.real > 0]
    assert mttc(run.trace)[0, 0] == pytest.approx(min(positive, default=INF))


def test_bodies_that_touch_have_no_time_left(run_of):
    run = run_of([0.0], ego={"x": 100.0, "speed": 12.0}, car={"x": 104.0})
    assert mttc(run.trace)[0, 0] == 0.0
    assert value("mttc_min_s", run_of([0.0], ego={"x": 100.0}, car={"x": 104.0})) == INF


def test_exposure_by_hand(run_of):
    # Closing at 10 m/s: times to collision 2.5, 2.0, 1.5, 1.0 s at instants 0.5 s apart; the last stands for no time.
    x = np.array([125.0, 120.0, 115.0, 110.0]) + 4.0
    run = run_of([0.0, 0.5, 1.0, 1.5], ego={"x": [100.0] * 4}, car={"x": x, "speed": 0.0})
    assert value("tet_s", run) == 1.0
    assert value("tit_s2", run) == pytest.approx(0.5 * (0.0 + 0.5))
    assert math.isnan(value("tet_spkm", run))
    moving = run_of(
        [0.0, 0.5, 1.0, 1.5], ego={"x": [0.0, 5.0, 10.0, 20.0]}, car={"x": x - [100, 95, 90, 80], "speed": 0.0}
    )
    assert value("tet_spkm", moving) == pytest.approx(1.0 / 0.02)
    assert value("tit_s2pkm", moving) == pytest.approx(0.25 / 0.02)


def test_a_vehicle_counts_only_while_it_is_there(run_of):
    run = run_of([0.0, 1.0], ego={"x": [0.0, 10.0]}, car={"x": [NAN, 34.0], "speed": 5.0}, bus={"x": [14.0, NAN]})
    assert value("gap_min_m", run) == 10.0
    assert value("ttc_min_s", run) == 4.0
    assert run.trace.ids == ("bus", "car")
