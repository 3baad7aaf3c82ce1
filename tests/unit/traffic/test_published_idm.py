"""The published variant of the Intelligent Driver Model against values worked by hand."""

from dataclasses import replace

import numpy as np
import pytest

from sumo_hmdp.traffic.car_following import PUBLISHED_IDM, SUMO_IDM, Drivers, accel_behind, own_terms
from sumo_hmdp.traffic.spawn import IdmParameters

# 2 sqrt(a b) = 4, so s* = 2 + 1.5 v + v closing_speed / 4.
SIMPLE = IdmParameters(accel=2.0, decel=2.0, exponent=4.0)
PUBLISHED = IdmParameters(accel=8.0, decel=4.0, exponent=6.0)


def behind(gap, speed, lead_speed, idm=SIMPLE, variant=PUBLISHED_IDM):
    own = own_terms(Drivers.of([(idm, 30.0)]), np.array([speed]))
    return float(accel_behind(own, np.array([gap]), lead_speed, variant)[0])


@pytest.mark.parametrize(
    ("speed", "accel"),
    [
        (0.0, 2.0),  # full acceleration from standstill
        (15.0, 1.875),  # 2 (1 - 1/16)
        (30.0, 0.0),  # at the desired speed
        (36.0, -2.1472),  # 2 (1 - 1.2^4) = 2 (1 - 2.0736)
    ],
)
def test_free_road(speed, accel):
    assert behind(np.inf, speed, 0.0) == pytest.approx(accel)


@pytest.mark.parametrize(
    ("gap", "speed", "lead_speed", "accel"),
    [
        (4.0, 0.0, 0.0, 1.5),  # standing: s* = 2, 2 (1 - 1/4)
        (2.0, 0.0, 0.0, 0.0),  # standing at the smallest gap: stays
        (49.0, 15.0, 15.0, 1.375),  # following: s* = 24.5, 2 (15/16 - 1/4)
        (79.0, 15.0, 11.0, 1.375),  # approaching: s* = 24.5 + 15 = 39.5, 2 (15/16 - 1/4)
        (39.5, 15.0, 11.0, -0.125),  # the same at s*: 2 (15/16 - 1)
        (9.5, 15.0, 19.0, -0.125),  # a leader that draws away: s* = 24.5 - 15 = 9.5
    ],
)
def test_behind_a_leader(gap, speed, lead_speed, accel):
    assert behind(gap, speed, lead_speed) == pytest.approx(accel)


def test_published_parameters():
    # s* = 2 + 45 + 30 * 5 / (2 sqrt(32)) = 60.2583; 8 (1 - 1 - (60.2583 / 110.5)^2) = -2.3790.
    assert behind(110.5, 30.0, 25.0, PUBLISHED) == pytest.approx(-2.3790, abs=1e-4)


def test_output_is_clipped():
    assert behind(1.0, 0.0, 0.0) == -5.0  # 2 (1 - 4) = -6
    assert behind(1.0, 0.0, 0.0, variant=replace(PUBLISHED_IDM, decel_max=9.0)) == pytest.approx(-6.0)
    assert behind(np.inf, 0.0, 0.0, PUBLISHED) == 8.0


def test_vehicles_that_overlap_brake_hardest():
    assert behind(-3.0, 5.0, 5.0) == -5.0


def test_what_the_variants_differ_in():
    # Behind a leader 20 m/s faster s* = 2 + 22.5 - 75 = -50.5 as published, whose square counts; SUMO bounds it by 2 m.
    assert behind(40.0, 15.0, 35.0) == pytest.approx(2.0 * (15.0 / 16.0 - (50.5 / 40.0) ** 2))
    assert behind(40.0, 15.0, 35.0, variant=SUMO_IDM) == pytest.approx(2.0 * (15.0 / 16.0 - (2.0 / 40.0) ** 2))
    assert behind(1.0, 15.0, 15.0, variant=SUMO_IDM) == -9.0
