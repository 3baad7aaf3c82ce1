"""MOBIL decisions against values worked by hand.

Everybody drives 15 m/s, half the desired speed, unless said otherwise. Then s* = 2 + 1.2 * 15 = 20 m and the IDM gives
2 (0.5 - (20 / gap)^2):

    gap     none   80      40     20     16       13.33   10
    accel   1.0    0.875   0.5    -1.0   -2.125   -3.5    -5 (clipped from -7)
"""

from dataclasses import replace

import pytest

from sumo_hmdp.decision.idm import Idm
from sumo_hmdp.decision.mobil import Goal, Mobil, leader_in_lane, neighbours
from sumo_hmdp.domain.maneuver import Lateral
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import Scene, StopLine, VehicleState

ROAD = Road(lane_count=3, lane_width=4.0)
IDM = Idm(accel=2.0, decel=2.0, exponent=1.0, time_gap=1.2)
LENGTH = 4.5


def vehicle(name, x, lane, speed=15.0, length=LENGTH):
    return VehicleState(id=name, x=x, y=ROAD.center_y(lane), speed=speed, lane=lane, length=length)


def ahead(gap, lane=2, speed=15.0):
    return vehicle(f"ahead{lane}", gap + LENGTH, lane, speed)


def follower(gap, lane, ego_length=LENGTH):
    return vehicle(f"behind{lane}", -ego_length - gap, lane)


def scene(*others, ego_lane=2, ego_length=LENGTH):
    return Scene(0.0, ROAD, vehicle("ego", 0.0, ego_lane, length=ego_length), others)


def choose(now, **rules):
    return Mobil(**rules).choose(now, now.ego, IDM)


def incentive(now, lane, **rules):
    return Mobil(**rules).incentive(now, now.ego, lane, IDM)


def test_incentive_of_the_ego_alone():
    now = scene(ahead(40.0), ahead(80.0, lane=1))
    assert incentive(now, 1) == pytest.approx(0.375)  # 0.875 - 0.5
    assert incentive(now, 3) == pytest.approx(0.5)  # 1.0 - 0.5
    assert choose(now) is Lateral.RIGHT


def test_of_two_equal_lanes_the_left_one_wins():
    assert choose(scene(ahead(40.0))) is Lateral.LEFT


def test_forbidden_lanes_and_the_edge_of_the_road():
    assert choose(scene(ahead(40.0)), forbidden_lanes=frozenset({1})) is Lateral.RIGHT
    assert choose(scene(ahead(40.0)), forbidden_lanes=frozenset({1, 3})) is Lateral.KEEP
    assert choose(scene(ahead(40.0, lane=1), ego_lane=1)) is Lateral.RIGHT
    assert choose(scene(ahead(40.0, lane=3), ego_lane=3), forbidden_lanes=frozenset({2})) is Lateral.KEEP


def test_threshold():
    now = scene(ahead(80.0))  # incentive 1.0 - 0.875 = 0.125
    assert choose(now) is Lateral.LEFT
    assert choose(now, threshold=0.13) is Lateral.KEEP


def test_politeness_counts_what_the_new_follower_loses():
    now = scene(ahead(40.0), follower(40.0, lane=1))  # it falls from 1.0 to 0.5
    assert incentive(now, 1) == pytest.approx(0.35)  # 0.5 - 0.3 * 0.5
    assert incentive(now, 1, politeness=0.0) == pytest.approx(0.5)
    assert incentive(now, 1, politeness=1.0) == pytest.approx(0.0)
    no_right = frozenset({3})
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
    assert incentive(scene(ahead(40.0), follower(40.0 / 3.0, lane=1)), 1, safe_decel=3.6) is not None
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
    ego = vehicle("ego", 0.0, 2)
    leaving = replace(vehicle("leaving", 20.0, 1), y=ROAD.center_y(2))
    beside = vehicle("beside", 0.0, 1)
    now = Scene(0.0, ROAD, ego, (leaving, beside))
    assert neighbours(now, ego, 2) == (None, None)
    assert neighbours(now, ego, 1) == (leaving, beside)


# Extensions of the published rules. At x = 0 half of the way to 200 m is left, so the pull is 2 * 0.5 = 1 m/s2.
GOAL = Goal(lane=1, x=100.0, distance=200.0, bias=2.0)


def test_a_goal_adds_to_the_incentive_as_its_lane_comes_nearer():
    assert [GOAL.pull(vehicle("ego", x, 2), 1) for x in (-150.0, -100.0, 0.0, 50.0, 100.0, 100.1)] == [
        0,
        0,
        1,
        1.5,
        2,
        0,
    ]
    assert GOAL.pull(vehicle("ego", 0.0, 2), 3) == -1.0
    now = scene(ahead(40.0))
    assert incentive(now, 1, goal=GOAL) == pytest.approx(1.5)  # 1.0 - 0.5 + 1
    assert incentive(now, 3, goal=GOAL) == pytest.approx(-0.5)
    assert incentive(scene(ahead(40.0), ego_lane=2), 1) == pytest.approx(0.5)


def test_a_goal_needs_no_slow_leader_but_safe_followers():
    assert choose(scene(), goal=GOAL) is Lateral.LEFT
    assert choose(scene(ego_lane=1), goal=GOAL) is Lateral.KEEP
    assert choose(scene(follower(40.0 / 3.0, lane=1)), goal=GOAL) is Lateral.KEEP
    # Worth 1 m/s2, it may cost as much: behind ahead1 the ego would fall from 1.0 to 0.5, and gains 0.5.
    assert choose(scene(ahead(40.0, lane=1)), goal=GOAL) is Lateral.LEFT
    assert choose(scene(ahead(20.0, lane=1)), goal=GOAL) is Lateral.KEEP  # from 1.0 to -1.0


def test_swept_a_change_needs_room_for_the_body():
    # Published: politeness for the follower here, from -3.5 to 0.5, outweighs the ego's own brake of 3.5 m/s2.
    now = scene(ahead(13.34, lane=1), ahead(13.34), follower(40.0 / 3.0, lane=2))
    assert incentive(now, 1, politeness=1.0, safe_decel=9.0) is not None
    assert incentive(now, 1, politeness=1.0, safe_decel=9.0, swept=True) is not None
    hard = scene(ahead(13.0, lane=1), ahead(40.0))
    assert incentive(hard, 1) is not None
    assert incentive(hard, 1, swept=True) is None  # 2 (0.5 - (20 / 13)^2) = -3.7 < -3
    # Who brakes as hard already may go.
    assert incentive(scene(ahead(13.0, lane=1), ahead(12.0)), 1, swept=True) is not None
    beside = scene(ahead(40.0), vehicle("beside", 1.0, 1), ego_lane=2)
    assert incentive(beside, 1, swept=True, safe_decel=9.0) is None
    slow = replace(now, ego=replace(now.ego, speed=2.9))
    assert Mobil(swept=True, safe_decel=9.0).incentive(slow, slow.ego, 1, IDM) is None


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
def test_swept_who_stands_before_a_merging_room_may_start_into_the_next_lane(line, near, lateral):
    red = () if near is None else (StopLine(frozenset({1, 3}), near),)
    now = Scene(0.0, ROAD, vehicle("ego", 0.0, 2, speed=0.0), (), (line, *red))
    assert choose(now, swept=True, goal=GOAL) is lateral


def test_swept_a_closed_lane_is_none():
    closed = replace(scene(ahead(10.0)), stop_lines=(StopLine(frozenset({1, 3}), 0.0),))
    assert choose(closed, swept=True, goal=GOAL) is Lateral.KEEP


def test_the_leader_of_a_lane_that_is_being_left():
    leaving = replace(vehicle("leaving", 20.0, 1), y=ROAD.center_y(2))
    now = Scene(0.0, ROAD, vehicle("ego", 0.0, 2), (leaving, vehicle("far", 50.0, 2)))
    assert leader_in_lane(now, now.ego, 2) == leaving
    assert leader_in_lane(now, now.ego, 1) == leaving
    assert leader_in_lane(now, now.ego, 3) is None
