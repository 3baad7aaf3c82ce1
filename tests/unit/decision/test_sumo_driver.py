"""The planner `sumo`: what it reads off a scene, and what its section in a scenario becomes."""

import math
from dataclasses import replace

import pytest

from sumo_hmdp.decision.sumo_driver import SumoDriver, SumoFile, SumoPlanner
from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.domain.plan import Status
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import Scene, VehicleState

ROAD = Road(lane_count=3, lane_width=4.0)
EGO = VehicleState("ego", x=0.0, y=0.0, speed=30.0, lane=2)
PLANNER = SumoPlanner(0.15)


def report(**ego):
    decision, memory = PLANNER.decide(Scene(3.0, ROAD, replace(EGO, **ego), ()), PLANNER.initial_memory())
    assert memory is None
    return decision


@pytest.mark.parametrize(
    ("y", "lateral_speed", "lane"),
    [
        (0.0, 0.0, 2),
        (0.075, 0.5, 1),  # the first step of a change to the left
        (2.0, 0.5, 1),
        (3.9, 0.5, 1),
        (4.0, 0.5, 1),  # its last
        (4.0 + 1e-9, 0.5, 1),
        (4.0 - 1e-9, 0.5, 1),
        (-0.075, -0.5, 3),
        (3.9, -0.5, 2),
        (1.0, -0.5, 2),  # back to where it came from
        (0.0, -0.5, 2),
        (1e-9, -0.5, 2),
        (-1e-9, -0.5, 2),
        (4.0, 26.7, 1),  # a whole lane in a step
        (5.0, 0.5, 1),  # beside the outermost centres
        (-5.0, -0.5, 3),
        (2.1, 0.0, 1),
    ],
)
def test_the_lane_that_the_ego_is_headed_for(y, lateral_speed, lane):
    assert ROAD.lane_headed_for(y, lateral_speed) == lane


def test_a_change_is_reported_once():
    begins = report(y=0.075, lateral_speed=0.5)
    assert (begins.lateral, begins.command.lane, begins.time) == (Lateral.LEFT, 1, 3.0)
    goes_on = report(y=0.15, lateral_speed=0.5, lane=1)
    assert (goes_on.lateral, goes_on.command.lane) == (Lateral.KEEP, 1)
    ends = report(y=4.0, lateral_speed=0.0, lane=1)
    assert (ends.lateral, ends.command.lane) == (Lateral.KEEP, 1)
    back = report(y=3.0, lateral_speed=-0.5, lane=1)
    assert (back.lateral, back.command.lane) == (Lateral.RIGHT, 2)


def test_a_report_is_a_rules_decision_without_a_known_time():
    decision = report(accel=-0.7)
    assert (decision.status, decision.mode, decision.command.accel) == (Status.RULE, Mode.DECELERATE, -0.7)
    assert (decision.plan, decision.objective, decision.violation, decision.solver) == ((), None, None, "sumo")
    assert math.isnan(decision.solve_time)
    assert (PLANNER.period, PLANNER.name) == (0.15, "sumo")


def test_file_defaults_are_those_of_the_driver():
    assert SumoFile().driver(8.0) == SumoDriver(8.0)


def test_every_key_reaches_the_driver():
    keys = {
        "desired_speed_mps": 1.0, "min_gap_m": 2.1, "time_gap_s": 3.0, "accel_mps2": 4.1, "decel_mps2": 5.0,
        "exponent": 6.1, "speed_gain_weight": 7.0, "keep_right_weight": 8.0, "assertive_weight": 9.0,
        "forbidden_lanes": [3],
    }  # fmt: skip
    assert set(keys) == set(SumoFile.model_fields)
    expected = SumoDriver(0.5, 1.0, 2.1, 3.0, 4.1, 5.0, 6.1, 7.0, 8.0, 9.0, frozenset({3}))
    assert SumoFile(**keys).driver(0.5) == expected
