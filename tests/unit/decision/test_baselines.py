"""The published rule-based planner and the constant one: when they decide, and what a decision says."""

from dataclasses import replace

import pytest

from sumo_hmdp.decision.baselines import ConstantPlanner, LaneChangeMemory
from sumo_hmdp.decision.published_rules import PublishedFile, PublishedPlanner
from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.domain.plan import Status
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import Scene, VehicleState

ROAD = Road(lane_count=3, lane_width=4.0)
DT = 0.15
PLANNER = PublishedPlanner(DT, lane_change_time=8.0)


def vehicle(name, x, lane, speed=30.0):
    return VehicleState(id=name, x=x, y=ROAD.center_y(lane), speed=speed, lane=lane)


def scene(step, ego_lane=2, *others):
    """The ego at its desired speed behind a slow leader in every lane that `others` do not name."""
    return Scene(step * DT, ROAD, vehicle("ego", 0.0, ego_lane), others)


SLOW = vehicle("slow", 80.0, 2, speed=25.0)


def decide(step, memory=None, ego_lane=2, others=(SLOW,)):
    return PLANNER.decide(scene(step, ego_lane, *others), memory or PLANNER.initial_memory())


def test_changes_begin_in_steps_that_end_at_a_multiple_of_the_lateral_period():
    begins = [step for step in range(16) if decide(step)[0].lateral is not Lateral.KEEP]
    assert begins == [3, 7, 11, 15]  # they end at 0.6, 1.2, 1.8 and 2.4 s


def test_a_change_heads_for_the_target_lane_at_once():
    decision, memory = decide(3)
    assert (decision.lateral, decision.command.lane) == (Lateral.LEFT, 1)
    assert decision.command.accel == 0.0  # free road there, at the desired speed
    assert memory == LaneChangeMemory(free_from=57)  # 8 s take 54 steps
    before, _ = decide(2)
    # s* = 60.2583 as in the test of the IDM, gap 75.5: 8 (60.2583 / 75.5)^2 = 5.096, clipped.
    assert (before.command.lane, before.command.accel) == (2, -5.0)


def test_no_second_change_before_the_first_is_over():
    slow_there = vehicle("slow", 80.0, 1, speed=25.0)
    memory = LaneChangeMemory(free_from=57)
    begins = [step for step in range(4, 64) if decide(step, memory, 1, (slow_there,))[0].lateral is not Lateral.KEEP]
    assert begins == [59, 63]


@pytest.mark.parametrize(("change_time", "steps"), [(4.2, 7), (4.3, 8), (0.6, 1)])
def test_a_change_takes_whole_steps(change_time, steps):
    planner = PublishedPlanner(0.6, lane_change_time=change_time)
    _, memory = planner.decide(scene(0, 2, SLOW), planner.initial_memory())
    assert memory.free_from == steps


@pytest.mark.parametrize(("speed", "mode"), [(20.0, Mode.ACCELERATE), (30.0, Mode.CRUISE), (33.0, Mode.DECELERATE)])
def test_a_decision_of_a_rule(speed, mode):
    now = replace(scene(0), ego=vehicle("ego", 0.0, 2, speed))
    decision, memory = PLANNER.decide(now, PLANNER.initial_memory())
    assert (decision.status, decision.lateral, decision.mode) == (Status.RULE, Lateral.KEEP, mode)
    assert (decision.objective, decision.violation, decision.plan, decision.evidence) == (None, None, (), None)
    assert memory == PLANNER.initial_memory()


def test_constant_keeps_lane_and_speed():
    planner = ConstantPlanner(DT)
    decision, memory = planner.decide(scene(3, 2, SLOW), planner.initial_memory())
    assert (decision.command.lane, decision.command.accel, decision.mode) == (2, 0.0, Mode.CRUISE)
    assert (decision.status, memory, planner.period) == (Status.RULE, None, DT)


def test_every_key_reaches_its_model():
    keys = {
        "desired_speed_mps": 1.0, "min_gap_m": 2.1, "time_gap_s": 3.0, "accel_mps2": 4.1, "decel_mps2": 5.0,
        "exponent": 6.1, "decel_max_mps2": 7.0, "politeness": 8.0, "threshold_mps2": 9.0, "safe_decel_mps2": 10.0,
        "forbidden_lanes": [3],
    }  # fmt: skip
    rules = PublishedFile(**keys).rules()
    idm, rule = rules.idm, rules.rule
    numbers = (rules.desired_speed, idm.min_gap, idm.time_gap, idm.accel, idm.decel, idm.exponent, rule.idm.decel_max)
    assert (*numbers, rules.politeness, rule.threshold, rule.safe_decel, [*rules.forbidden_lanes]) == (*keys.values(),)
    assert rule.published
    assert PublishedPlanner(DT, 8.0).rules == PublishedFile().rules()
