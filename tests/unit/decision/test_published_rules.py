"""The published rules' lane changes against values worked by hand.

Everybody drives 15 m/s, half the desired speed, unless said otherwise. Then s* = 2 + 1.2 * 15 = 20 m and the IDM gives
2 (0.5 - (20 / gap)^2):

    gap     none   80      40     20     16       13.33   10
    accel   1.0    0.875   0.5    -1.0   -2.125   -3.5    -5 (clipped from -7)
"""

from dataclasses import replace

import pytest

from sumo_hmdp.decision.lane_rules import see
from sumo_hmdp.decision.published_rules import PublishedFile, PublishedPlanner
from sumo_hmdp.domain.maneuver import Lateral
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import Scene, StopLine, VehicleState

ROAD = Road(lane_count=3, lane_width=4.0)
KEYS = {"accel_mps2": 2.0, "decel_mps2": 2.0, "exponent": 1.0, "time_gap_s": 1.2}
LENGTH = 4.5


def vehicle(name, x, lane, speed=15.0, length=LENGTH):
    return VehicleState(id=name, x=x, y=ROAD.center_y(lane), speed=speed, lane=lane, length=length)


def ahead(gap, lane=2, speed=15.0):
    return vehicle(f"ahead{lane}", gap + LENGTH, lane, speed)


def follower(gap, lane, ego_length=LENGTH):
    return vehicle(f"behind{lane}", -ego_length - gap, lane)


def scene(*others, ego_lane=2, ego_length=LENGTH):
    return Scene(0.0, ROAD, vehicle("ego", 0.0, ego_lane, length=ego_length), others)


def choose(now, leader_range=95.0, **rules):
    planner = PublishedPlanner(0.6, 8.0, leader_range=leader_range, rules=PublishedFile(**KEYS, **rules).rules())
    return planner.decide(now, planner.initial_memory())[0].lateral


def incentive(now, lane, **rules):
    weighed = see(now, PublishedFile(**KEYS, **rules).rules()).changes([lane])
    return float(weighed.incentive[0]) if weighed.safe[0] else None


def test_incentive_of_the_ego_alone():
    now = scene(ahead(40.0), ahead(80.0, lane=1))
    assert incentive(now, 1) == pytest.approx(0.375)  # 0.875 - 0.5
    assert incentive(now, 3) == pytest.approx(0.5)  # 1.0 - 0.5
    assert choose(now) is Lateral.RIGHT


def test_of_two_equal_lanes_the_left_one_wins():
    assert choose(scene(ahead(40.0))) is Lateral.LEFT


def test_forbidden_lanes_and_the_edge_of_the_road():
    assert choose(scene(ahead(40.0)), forbidden_lanes=[1]) is Lateral.RIGHT
    assert choose(scene(ahead(40.0)), forbidden_lanes=[1, 3]) is Lateral.KEEP
    assert choose(scene(ahead(40.0, lane=1), ego_lane=1)) is Lateral.RIGHT
    assert choose(scene(ahead(40.0, lane=3), ego_lane=3), forbidden_lanes=[2]) is Lateral.KEEP


def test_threshold():
    now = scene(ahead(80.0))  # incentive 1.0 - 0.875 = 0.125
    assert choose(now) is Lateral.LEFT
    assert choose(now, threshold_mps2=0.13) is Lateral.KEEP


def test_politeness_counts_what_the_new_follower_loses():
    now = scene(ahead(40.0), follower(40.0, lane=1))  # it falls from 1.0 to 0.5
    assert incentive(now, 1) == pytest.approx(0.35)  # 0.5 - 0.3 * 0.5
    assert incentive(now, 1, politeness=0.0) == pytest.approx(0.5)
    assert incentive(now, 1, politeness=1.0) == pytest.approx(0.0)
    no_right = [3]
    assert choose(now, forbidden_lanes=no_right) is Lateral.LEFT
    assert choose(now, politeness=1.0, forbidden_lanes=no_right) is Lateral.KEEP


def test_the_new_follower_had_a_leader_before():
    # The ego would come in 40 m behind ahead1; the follower is 40 + 4.5 + 15.5 = 60 m behind it: 2 (0.5 - 1/9) = 7/9.
    # Behind the ego it has 15.5 m: 2 (0.5 - (20 / 15.5)^2) = -2.3299.
    now = scene(ahead(40.0), ahead(40.0, lane=1), follower(15.5, lane=1))
    assert incentive(now, 1) == pytest.approx(0.3 * (-2.3299 - 7 / 9), abs=1e-4)


def test_politeness_counts_what_the_old_follower_gains():
    # Behind an ego of 20 m it has 20 m, then 20 + 20 + 40 = 80 m: from -1.0 to 0.875.
    now = scene(ahead(40.0), follower(20.0, lane=2, ego_length=20.0), ego_length=20.0)
    assert incentive(now, 1) == pytest.approx(0.5 + 0.3 * 1.875)


def test_safety_of_the_new_follower():
    assert incentive(scene(ahead(40.0), follower(40.0 / 3.0, lane=1)), 1) is None  # -3.5 < -3
    assert incentive(scene(ahead(40.0), follower(40.0 / 3.0, lane=1)), 1, safe_decel_mps2=3.6) is not None
    assert incentive(scene(ahead(40.0), follower(16.0, lane=1)), 1) == pytest.approx(0.5 - 0.3 * 3.125)
    assert choose(scene(ahead(10.0), follower(40.0 / 3.0, lane=1))) is Lateral.RIGHT


def test_safety_of_the_old_follower():
    # Behind the slow leader s* = 20 + 15 * 10 / 4 = 57.5, at 20 + 4.5 + 10 = 34.5 m: 2 (0.5 - 2.78) = -4.56 < -3.
    slow = ahead(10.0, speed=5.0)
    assert incentive(scene(slow, follower(20.0, lane=2)), 1) is None
    assert incentive(scene(slow), 1) == pytest.approx(6.0)  # from -5 to 1


def test_considered_only_while_the_leader_is_near():
    now = scene(ahead(40.0))  # 44.5 m between the front bumpers
    assert choose(now, leader_range=44.6) is Lateral.LEFT
    assert choose(now, leader_range=44.5) is Lateral.KEEP
    assert choose(scene(ahead(40.0, lane=3))) is Lateral.KEEP


def test_vehicles_in_a_lane_change_count_in_their_target_lane():
    leaving = replace(vehicle("leaving", 20.0, 1), y=ROAD.center_y(2))
    beside = vehicle("beside", 0.0, 1)
    seen = see(Scene(0.0, ROAD, vehicle("ego", 0.0, 2), (leaving, beside)), PublishedFile(**KEYS).rules())
    assert seen.accels()[1] == pytest.approx(1.0)  # nobody in lane 2
    # The leader's rear is 15.5 m ahead; the one side by side is behind.
    assert seen.changes([1]).gap_ahead[0] == pytest.approx(15.5)
    assert seen.changes([1]).gap_behind[0] == pytest.approx(-4.5)


def test_it_asks_nothing_of_itself():
    # What makes it a straw man in random traffic: it brakes with 5 m/s2 here and there, 1.2 m behind a slower truck, so
    # it gains nothing and loses nothing, and politeness to the follower alone decides.
    truck = vehicle("truck", 1.2 + 12.0, 1, speed=6.0, length=12.0)
    now = replace(scene(truck, follower(20.0, lane=2)), stop_lines=(StopLine(frozenset({2}), 8.0),))
    weighed = see(now, PublishedFile(**KEYS).rules()).changes([1])
    assert (weighed.stay[0], weighed.go[0]) == (-5.0, -5.0)
    assert choose(now, forbidden_lanes=[3]) is Lateral.LEFT


def test_a_stop_line_is_a_leader_of_no_length():
    now = replace(scene(), stop_lines=(StopLine(frozenset({2}), 40.0),))
    planner = PublishedPlanner(0.6, 8.0, rules=PublishedFile(**KEYS, forbidden_lanes=[1, 3]).rules())
    # s* = 20 + 15 * 15 / 4 = 76.25: 2 (0.5 - (76.25 / 40)^2), clipped.
    assert planner.decide(now, planner.initial_memory())[0].command.accel == -5.0
