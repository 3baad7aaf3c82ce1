"""The IDM against numbers worked by hand, and its equilibrium against its own acceleration."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sumo_hmdp.traffic.car_following import (
    EMERGENCY_DECEL,
    Drivers,
    equilibrium_gap,
    equilibrium_speed,
    idm_accel,
)
from sumo_hmdp.traffic.spawn import IdmParameters

# s0 = 2, T = 1.5, a = 2, b = 2, delta = 4, v0 = 40: 2 sqrt(a b) = 4.
HAND = IdmParameters(min_gap=2.0, time_gap=1.5, accel=2.0, decel=2.0, exponent=4.0)


def one(idm=HAND, desired_speed=40.0):
    return Drivers.of([(idm, desired_speed)])


@pytest.mark.parametrize(
    ("speed", "gap", "lead_speed", "expected"),
    [
        # Free road at half the desired speed: 2 (1 - 1/16).
        (20.0, np.inf, 0.0, 1.875),
        # s* = 2 + 30 = 32 at equal speeds; gap 64: 2 (1 - 1/16 - 1/4).
        (20.0, 64.0, 20.0, 1.375),
        # Closing with 4: s* = 2 + 30 + 20 * 4 / 4 = 52; gap 104: the same ratio.
        (20.0, 104.0, 16.0, 1.375),
        # Leader faster by 10: 30 - 20 * 10 / 4 = -20 is no less than 0, s* = s0 = 2; gap 4: 2 (15/16 - 1/4).
        (20.0, 4.0, 30.0, 1.375),
        # Standing still at the gap at standstill: 2 (1 - 1).
        (0.0, 2.0, 0.0, 0.0),
        # At the desired speed on a free road.
        (40.0, np.inf, 0.0, 0.0),
        # Touching, and overlapping: as hard as anybody brakes.
        (20.0, 0.0, 20.0, -EMERGENCY_DECEL),
        (20.0, -3.0, 20.0, -EMERGENCY_DECEL),
    ],
)
def test_accelerations_by_hand(speed, gap, lead_speed, expected):
    accel = idm_accel(one(), np.array([speed]), np.array([gap]), np.array([lead_speed]))
    assert accel == pytest.approx([expected], abs=1e-12)


def test_equilibrium_by_hand():
    # (2 + 1.5 * 20) / sqrt(1 - 1/16).
    assert equilibrium_gap(one(), 20.0) == pytest.approx(32.0 / np.sqrt(15 / 16))
    assert equilibrium_gap(one(), 0.0) == pytest.approx(2.0)
    assert np.isinf(equilibrium_gap(one(), [40.0, 41.0])).all()


def test_speeds_at_the_ends():
    three = Drivers.of([(HAND, 40.0)] * 3)
    assert equilibrium_speed(three, np.array([1.0, 2.0, np.inf])).tolist() == [0.0, 0.0, 40.0]


drivers = st.builds(
    lambda min_gap, time_gap, accel, exponent, desired: (
        (IdmParameters(min_gap, time_gap, accel, 2.0, exponent)),
        desired,
    ),
    st.floats(0.5, 5.0),
    st.floats(0.5, 3.0),
    st.floats(0.3, 3.0),
    st.floats(1.0, 8.0),
    st.floats(5.0, 40.0),
)


@settings(deadline=None)
@given(drivers, st.floats(2.0, 500.0))
def test_nobody_accelerates_in_equilibrium(driver, surplus):
    gap = np.array([driver[0].min_gap + surplus])
    alone = Drivers.of([driver])
    speed = equilibrium_speed(alone, gap)
    assert 0.0 < speed[0] < driver[1] or speed[0] == pytest.approx(driver[1])
    assert idm_accel(alone, speed, gap, speed) == pytest.approx(0.0, abs=1e-9)


@settings(deadline=None)
@given(st.lists(drivers, min_size=1, max_size=5))
def test_a_group_is_its_members(group):
    speed, gap = np.linspace(1.0, 20.0, len(group)), np.linspace(3.0, 80.0, len(group))
    together = idm_accel(Drivers.of(group), speed, gap, 10.0)
    alone = [idm_accel(Drivers.of([one]), speed[i : i + 1], gap[i : i + 1], 10.0)[0] for i, one in enumerate(group)]
    assert together == pytest.approx(alone, abs=1e-12)
