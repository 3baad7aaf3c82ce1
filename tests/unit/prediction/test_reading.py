"""Maneuvers read from motion: dead bands, hysteresis, and lanes headed for."""

import pytest

from sumo_hmdp.domain.maneuver import ManeuverState, Mode
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.prediction.reading import read_maneuver

ROAD = Road(3, 4.0)


def seen(accel=0.0, y=0.0, lateral_speed=0.0):
    # Lane and mode of a measured vehicle say nothing, so they are wrong here.
    return VehicleState(
        "a", x=0.0, y=y, speed=20.0, lane=3, mode=Mode.DECELERATE, accel=accel, lateral_speed=lateral_speed
    )


@pytest.mark.parametrize(
    ("accel", "last", "mode"),
    [
        # The modes have 2 m/s2: one begins beyond 1.2 and holds down to 0.8.
        (1.1, None, Mode.CRUISE),
        (1.3, None, Mode.ACCELERATE),
        (-1.3, None, Mode.DECELERATE),
        (1.1, Mode.ACCELERATE, Mode.ACCELERATE),
        (0.7, Mode.ACCELERATE, Mode.CRUISE),
        (-0.9, Mode.DECELERATE, Mode.DECELERATE),
        (-0.9, Mode.ACCELERATE, Mode.CRUISE),
        (-1.3, Mode.ACCELERATE, Mode.DECELERATE),
    ],
)
def test_a_mode_is_held_within_its_band(accel, last, mode):
    before = None if last is None else ManeuverState(2, last)
    assert read_maneuver(seen(accel), ROAD, 2.0, before) == ManeuverState(2, mode)


@pytest.mark.parametrize(
    ("y", "lateral_speed", "last_lane", "lane"),
    [
        (0.2, 0.2, None, 2),
        (0.2, 0.4, None, 1),
        (-0.2, -0.4, None, 3),
        # Beyond the line it is in the new lane, and still on its way to it.
        (2.5, 0.4, None, 1),
        (1.0, 0.2, 1, 1),
        (1.0, 0.1, 1, 2),
        (1.0, 0.2, 3, 2),
        # It returns.
        (1.0, -0.4, 1, 2),
        # There is no lane beyond the leftmost.
        (4.0, 0.4, None, 1),
    ],
)
def test_a_lane_change_is_read_from_lateral_motion(y, lateral_speed, last_lane, lane):
    last = None if last_lane is None else ManeuverState(last_lane, Mode.CRUISE)
    assert read_maneuver(seen(y=y, lateral_speed=lateral_speed), ROAD, 2.0, last).lane == lane
