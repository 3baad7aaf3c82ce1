"""The Intelligent Driver Model against values worked by hand."""

import pytest

from sumo_hmdp.decision.idm import Idm, gap
from sumo_hmdp.domain.scene import VehicleState

# 2 sqrt(a b) = 4, so s* = 2 + 1.5 v + v closing_speed / 4.
SIMPLE = Idm(accel=2.0, decel=2.0, exponent=4.0)


def vehicle(x=0.0, speed=15.0, length=4.5):
    return VehicleState(id=f"at{x}", x=x, y=0.0, speed=speed, lane=2, length=length)


def behind(gap, speed, lead_speed, length=4.5, idm=SIMPLE):
    return idm.follow(vehicle(speed=speed), vehicle(x=gap + length, speed=lead_speed, length=length))


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
    assert SIMPLE.follow(vehicle(speed=speed), None) == pytest.approx(accel)


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


def test_the_gap_ends_at_the_leaders_rear():
    assert gap(vehicle(), vehicle(x=58.0, length=9.0)) == 49.0
    assert behind(49.0, 15.0, 15.0, length=9.0) == pytest.approx(1.375)


def test_published_parameters():
    # s* = 2 + 45 + 30 * 5 / (2 sqrt(32)) = 60.2583; 8 (1 - 1 - (60.2583 / 110.5)^2) = -2.3790.
    assert behind(110.5, 30.0, 25.0, idm=Idm()) == pytest.approx(-2.3790, abs=1e-4)


def test_output_is_clipped():
    assert behind(1.0, 0.0, 0.0) == -5.0  # 2 (1 - 4) = -6
    assert behind(1.0, 0.0, 0.0, idm=Idm(accel=2.0, decel=2.0, decel_max=9.0)) == pytest.approx(-6.0)
    assert Idm().follow(vehicle(speed=0.0), None) == 8.0


def test_vehicles_that_overlap_brake_hardest():
    assert behind(-3.0, 5.0, 5.0) == -5.0
    assert gap(vehicle(), vehicle(x=1.0)) == 0.1
