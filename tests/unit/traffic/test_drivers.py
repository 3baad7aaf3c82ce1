"""Drivers are drawn as their distributions say: against scipy's, and shares counted."""

import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import truncnorm

from sumo_hmdp.errors import InputError
from sumo_hmdp.traffic.drivers import (
    HIGHWAY_CLASSES,
    URBAN_CLASSES,
    TruncatedNormal,
    VehicleClass,
    class_problems,
    draw_traits,
    limited,
    mean_traits,
)

CAR, TRUCK = HIGHWAY_CLASSES


def of_scipy(normal):
    low, high = (normal.low - normal.mean) / normal.std, (normal.high - normal.mean) / normal.std
    return truncnorm(low, high, loc=normal.mean, scale=normal.std)


NORMALS = [CAR.desired_speed, TRUCK.time_gap, TruncatedNormal(0.0, 1.0, 0.0, 9.0), TruncatedNormal(2.0, 5.0, 1.0, 2.5)]


@pytest.mark.parametrize("normal", NORMALS)
def test_quantiles_and_mean_are_those_of_scipy(normal):
    u = np.linspace(0.0, 1.0, 21)
    assert [normal.quantile(share) for share in u] == pytest.approx(of_scipy(normal).ppf(u), abs=1e-9)
    assert normal.expected == pytest.approx(of_scipy(normal).mean(), abs=1e-9)


def test_the_half_normal_by_hand():
    # Its mean is sqrt(2 / pi), its median 0.67449.
    half = TruncatedNormal(0.0, 1.0, 0.0, 40.0)
    assert half.expected == pytest.approx(math.sqrt(2.0 / math.pi))
    assert half.quantile(0.5) == pytest.approx(0.6744897501960817)


@settings(deadline=None)
@given(st.floats(0.0, 1.0))
def test_without_spread_there_is_one_value(u):
    assert TruncatedNormal(3.0, 0.0, 1.0, 4.0).quantile(u) == 3.0
    assert TruncatedNormal(3.0, 1.0, 3.0, 3.0).quantile(u) == 3.0
    assert TruncatedNormal(3.0, 1.0, 3.0, 3.0).expected == 3.0
    assert 1.0 <= TruncatedNormal(3.0, 1.0, 1.0, 4.0).quantile(u) <= 4.0


@pytest.mark.parametrize(
    "numbers", [(3.0, -1.0, 1.0, 4.0), (0.0, 1.0, 1.0, 4.0), (3.0, 1.0, 4.0, 1.0), (3.0, 1.0, 1.0, math.inf)]
)
def test_limits_must_hold_the_mean(numbers):
    with pytest.raises(InputError, match="low <= mean <= high"):
        TruncatedNormal(*numbers)


def test_each_number_of_a_vehicle_class_is_checked():
    good = {**vars(CAR)}
    bad = {
        "share": 1.5,
        "length": 0.0,
        "width": -1.0,
        "min_gap": math.inf,
        "accel": 0.0,
        "decel": math.nan,
        "exponent": 0.0,
    }
    bad |= {"desired_speed": TruncatedNormal(1.0, 1.0, 0.0, 2.0), "time_gap": TruncatedNormal(1.0, 1.0, 0.0, 2.0)}
    bad |= {"politeness": TruncatedNormal(0.0, 1.0, -0.1, 2.0)}
    with pytest.raises(InputError) as caught:
        VehicleClass(**(good | bad))
    paths = {problem.path for problem in caught.value.problems}
    assert paths == set(bad) - {"desired_speed", "time_gap", "politeness"} | {
        "desired_speed.low", "time_gap.low", "politeness.low",
    }  # fmt: skip


def test_a_speed_limit_slows_those_who_would_go_faster():
    # 100 km/h: the cars' 120 becomes 100, their 12 becomes 10, their limits 95 and 150 become 79.17 and 125.
    slow = limited(CAR, 100 / 3.6)
    speed = slow.desired_speed
    assert [3.6 * v for v in (speed.mean, speed.std, speed.low, speed.high)] == pytest.approx([100, 10, 79.1667, 125])
    assert replace(slow, desired_speed=CAR.desired_speed) == CAR
    assert limited(TRUCK, 100 / 3.6) is TRUCK
    assert limited(CAR, CAR.desired_speed.mean) is CAR


def test_classes_must_share_everything():
    assert list(class_problems(HIGHWAY_CLASSES)) == list(class_problems(URBAN_CLASSES)) == []
    (short,) = class_problems([CAR])
    assert "got 0.85 (car)" in short.message
    (twice,) = class_problems([replace(CAR, share=0.5), replace(CAR, share=0.5)])
    assert "names must differ" in twice.message
    (none,) = class_problems([])
    assert "no class" in none.message


def test_a_draw_by_hand():
    # 0.84 is below the cars' share of 0.85, 0.86 is not; 0 and 1 give the limits, 0.5 the middle of an even cut.
    car = draw_traits(HIGHWAY_CLASSES, (0.84, 0.0, 1.0, 0.5))
    assert (car.class_name, car.length, car.desired_speed) == ("car", 4.5, pytest.approx(95 / 3.6))
    assert car.idm.time_gap == pytest.approx(2.4)
    truck = draw_traits(HIGHWAY_CLASSES, (0.86, 0.0, 0.0, 0.5))
    assert (truck.class_name, truck.idm.accel, truck.politeness) == ("truck", 0.7, pytest.approx(0.25))
    assert (truck.desired_speed, truck.idm.time_gap) == pytest.approx((78 / 3.6, 1.1))


def test_no_draw_falls_through():
    thirds = [
        replace(CAR, name=name, share=share) for name, share in (("a", 0.1), ("b", 0.2), ("c", 0.7 - 1e-10), ("d", 0.0))
    ]
    names = [
        draw_traits(thirds, (u, 0.5, 0.5, 0.5)).class_name for u in (0.0, 0.0999, 0.1, 0.2999, 0.3001, 1.0 - 1e-12)
    ]
    assert names == ["a", "a", "b", "b", "c", "c"]
    none_of_the_first = [replace(CAR, share=0.0), replace(TRUCK, share=1.0)]
    assert draw_traits(none_of_the_first, (0.0, 0.5, 0.5, 0.5)).class_name == "truck"


def test_the_mean_driver_is_the_mean_of_many():
    rng = np.random.default_rng(5)
    many = [draw_traits(HIGHWAY_CLASSES, rng.random(4)) for _ in range(8000)]
    mean = mean_traits(HIGHWAY_CLASSES)
    assert Counter(one.class_name for one in many)["truck"] / len(many) == pytest.approx(0.15, abs=0.015)
    for get, tolerance in (
        (lambda one: one.length, 0.1),
        (lambda one: one.width, 0.02),
        (lambda one: one.desired_speed, 0.2),
        (lambda one: one.politeness, 0.005),
        (lambda one: one.idm.time_gap, 0.01),
        (lambda one: one.idm.accel, 0.01),
    ):
        assert get(mean) == pytest.approx(np.mean([get(one) for one in many]), abs=tolerance)
    # 0.85 * 4.5 + 0.15 * 12.
    assert mean.length == pytest.approx(5.625)
