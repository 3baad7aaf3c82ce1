"""The rule-based planner of random traffic: a careful driver by the traffic's own models.

Everybody drives 15 m/s; the ego wants 30. With exponent 1, a = b = 2 m/s2, T = 1.2 s and s0 = 2 m the wanted gap behind
an equally fast leader is 20 m, and the ego's acceleration is 2 (0.5 - (20 / gap)^2). The others want the speed that
they have: 2 (0 - (20 / gap)^2).
"""

import json
from dataclasses import replace

import pytest

from sumo_hmdp.decision.baselines import IdmMobilFile, IdmMobilPlanner, LaneChangeMemory
from sumo_hmdp.decision.lane_rules import Goal
from sumo_hmdp.domain.maneuver import Lateral
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import Scene, StopLine, VehicleState
from sumo_hmdp.scenario.load import RunOptions, find_scenario, load_scenario
from sumo_hmdp.study.run import execute
from sumo_hmdp.traffic.drivers import HIGHWAY_CLASSES
from sumo_hmdp.traffic.lane_change import LaneChangeRule
from sumo_hmdp.traffic.spawn import IdmParameters

ROAD = Road(3, 4.0)
KEYS = {"accel_mps2": 2.0, "decel_mps2": 2.0, "exponent": 1.0, "time_gap_s": 1.2, "desired_speed_mps": 30.0}
LENGTH, DT = 4.5, 0.2


def vehicle(name, x, lane, speed=15.0, length=LENGTH):
    return VehicleState(name, x=x, y=ROAD.center_y(lane), speed=speed, lane=lane, length=length)


def scene(*others, lane=2, speed=15.0, lines=()):
    return Scene(0.0, ROAD, vehicle("ego", 0.0, lane, speed), others, lines)


def ahead(gap, lane=2, speed=15.0, length=LENGTH):
    return vehicle(f"ahead{lane}", gap + length, lane, speed, length)


def behind(gap, lane=1, speed=15.0):
    return vehicle(f"behind{lane}", -LENGTH - gap, lane, speed)


def decide(now, memory=None, goal=None, **keys):
    planner = IdmMobilPlanner(DT, 4.0, IdmMobilFile(**KEYS | keys).rules(), goal)
    return planner.decide(now, memory or planner.initial_memory())


def test_the_defaults_are_the_mean_cars():
    rules, car = IdmMobilFile().rules(), HIGHWAY_CLASSES[0]
    assert rules.idm == IdmParameters(car.min_gap, car.time_gap.mean, car.accel, car.decel, car.exponent)
    assert (rules.rule, rules.politeness, rules.desired_speed) == (LaneChangeRule(), 0.25, car.desired_speed.mean)


def test_incentive_and_notes():
    decision, memory = decide(scene(ahead(40.0), ahead(80.0, lane=1), behind(40.0)), forbidden_lanes=[3])
    assert decision.lateral is Lateral.LEFT
    notes = decision.notes
    assert notes["lane_2_accel_mps2"] == pytest.approx(0.5)
    assert notes["lane_1_accel_mps2"] == pytest.approx(0.875)
    # The follower falls from 2 (0 - (20 / 124.5)^2) to 2 (0 - (20 / 40)^2); nobody is left behind in lane 2.
    loss = 2 * (20 / 124.5) ** 2 - 2 * 0.25
    assert notes["lane_1_incentive_mps2"] == pytest.approx(0.375 + 0.25 * loss)
    assert (notes["lane_1_safe"], notes["lane_3_safe"]) == ("yes", "no: the lane is forbidden")
    # The less of both lanes counts while it leaves one for the other; then 4 s of change and 4 s of rest.
    assert decision.command.accel == pytest.approx(0.5)
    assert memory == LaneChangeMemory(40)
    json.dumps(dict(notes), allow_nan=False)


@pytest.mark.parametrize(
    ("others", "reason"),
    [
        # The gap of the run that was seen: 8.1 m behind a truck that is 9 m/s slower.
        ([ahead(8.1, lane=1, speed=6.0, length=12.0)], "no: it would have to brake with 9.0 m/s2 itself"),
        ([ahead(1.5, lane=1, speed=30.0)], "no: 1.5 m of room ahead"),
        ([behind(1.5, speed=5.0)], "no: 1.5 m of room behind"),
        ([vehicle("beside", 1.0, 1)], "no: no room, somebody is beside it"),
        # A truck whose front is ahead and whose rear is beside the ego.
        ([vehicle("truck", 9.0, 1, 20.0, 12.0)], "no: no room, somebody is beside it"),
        ([behind(13.0)], "no: the follower would have to brake with 4.7 m/s2"),
        # In its own lane, on its way to the new one: it is there already.
        ([replace(vehicle("coming", 1.0, 1), y=ROAD.center_y(1) + 0.1)], "no: no room, somebody is beside it"),
    ],
)
def test_what_is_not_safe(others, reason):
    decision, _ = decide(scene(ahead(9.0, speed=6.0), *others), forbidden_lanes=[3])
    assert decision.lateral is Lateral.KEEP
    assert decision.notes["lane_1_safe"] == reason


def test_who_brakes_hard_already_may_not_either():
    """Two accelerations that are clipped alike say nothing of the danger."""
    decision, _ = decide(scene(ahead(5.0, speed=2.0), ahead(5.0, lane=1, speed=2.0), behind(200.0, lane=2)))
    assert (decision.notes["lane_2_accel_mps2"], decision.notes["lane_1_accel_mps2"]) == (-9.0, -9.0)
    assert decision.notes["lane_1_safe"] == "no: it would have to brake with 9.0 m/s2 itself"


def test_it_brakes_as_hard_as_it_must():
    decision, _ = decide(scene(ahead(5.0, speed=2.0)), forbidden_lanes=[1, 3])
    assert decision.command.accel == -9.0


def test_it_keeps_behind_whoever_its_body_or_theirs_is_in_one_lane_with():
    # In the change from lane 2 to lane 1 its body of 1.8 m leaves lane 2 at y = 2.9 m.
    for y, accel in ((2.8, -7.0), (2.95, 1.0)):
        now = scene(ahead(10.0), lane=1)
        decision, _ = decide(replace(now, ego=replace(now.ego, y=y)), LaneChangeMemory(100))
        assert decision.command.accel == pytest.approx(accel)
        assert decision.notes["lane_change"] == ("under way" if accel < 0 else "just made: no other yet")
    leaving = replace(ahead(10.0, lane=1), y=ROAD.center_y(2) + 1.0)
    assert decide(scene(leaving))[0].command.accel == pytest.approx(-7.0)


def test_of_two_equal_lanes_the_left_one_wins():
    assert decide(scene(ahead(40.0)))[0].lateral is Lateral.LEFT


# At x = 0 half of the way to 200 m is left, so the pull is 2 * 0.5 = 1 m/s2.
GOAL = Goal(lane=1, x=100.0, distance=200.0, bias=2.0)


def test_a_goal_adds_to_the_incentive_as_its_lane_comes_nearer():
    places = (-150.0, -100.0, 0.0, 50.0, 100.0, 100.1)
    assert [GOAL.pull(vehicle("ego", x, 2), 1) for x in places] == [0, 0, 1, 1.5, 2, 0]
    assert GOAL.pull(vehicle("ego", 0.0, 2), 3) == -1.0
    assert decide(scene(), goal=GOAL)[0].lateral is Lateral.LEFT
    assert decide(scene(lane=1), goal=GOAL)[0].lateral is Lateral.KEEP
    # It does not buy danger: the follower would have to brake with 2 (20 / 13)^2.
    assert decide(scene(behind(13.0)), goal=GOAL)[0].lateral is Lateral.KEEP


@pytest.mark.parametrize(
    ("line", "near", "lateral"),
    [
        (StopLine(frozenset({2}), 2.0, 26.0), None, Lateral.LEFT),
        # Behind one that lets it go no farther it would stand across two lanes.
        (StopLine(frozenset({2}), 2.0, 26.0), 26.0, Lateral.LEFT),
        (StopLine(frozenset({2}), 2.0, 26.0), 25.9, Lateral.KEEP),
        (StopLine(frozenset({2}), 2.0), None, Lateral.KEEP),
        (StopLine(frozenset({2}), 2.0, 2.0), None, Lateral.KEEP),
        (StopLine(frozenset({3}), 2.0, 26.0), None, Lateral.KEEP),
    ],
)
def test_who_stands_before_a_merging_room_may_start_into_the_next_lane(line, near, lateral):
    red = () if near is None else (StopLine(frozenset({1, 3}), near),)
    assert decide(scene(speed=0.0, lines=(line, *red)), goal=GOAL)[0].lateral is lateral


def test_who_leaves_a_lane_may_go_on_into_its_merging_room():
    """Its end at 2 m does not hold the ego any more, from the decision on; the room's at 26 m does."""
    line = StopLine(frozenset({2}), 2.0, 26.0)
    decision, _ = decide(scene(speed=0.0, lines=(line,)), goal=GOAL)
    assert decision.lateral is Lateral.LEFT
    assert decision.command.accel == pytest.approx(2 * (1 - (2 / 26) ** 2))
    over_both = scene(lane=1, speed=0.0, lines=(line,))
    over_both = replace(over_both, ego=replace(over_both.ego, y=ROAD.center_y(2) + 0.5))
    later, _ = decide(over_both, LaneChangeMemory(100))
    assert later.command.accel == pytest.approx(decision.command.accel)
    # A red signal that closes both lanes does.
    red = replace(over_both, stop_lines=(StopLine(frozenset({1, 2, 3}), 2.5),))
    assert decide(red, LaneChangeMemory(100))[0].command.accel < 1.0


def test_a_closed_lane_is_none():
    closed = scene(ahead(10.0), lines=(StopLine(frozenset({1, 3}), 0.0),))
    assert decide(closed, goal=GOAL)[0].lateral is Lateral.KEEP


def test_the_run_in_which_the_published_rules_drive_into_a_truck():
    """They change into 8.1 m behind a truck that is 9 m/s slower; the textbook driver does not."""
    outcome = {}
    for planner in ("idm_mobil_published", "idm_mobil"):
        overrides = {"traffic.density_vpkm_per_lane": 10.0, "duration_s": 30.0}
        if planner == "idm_mobil_published":
            overrides["planners.idm_mobil_published.desired_speed_mps"] = 33.0
        run = load_scenario(find_scenario("highway"), RunOptions(planner=planner, seed=7, overrides=overrides))
        outcome[planner] = execute(run, detailed=False).row["contact_at_fault_count"]
    assert outcome == {"idm_mobil_published": 1, "idm_mobil": 0}
