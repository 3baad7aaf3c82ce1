"""Which lines are closed to the ego, by hand: signal_1 of the town has its line at 300 m and ends at 324 m."""

from pathlib import Path

import pytest

from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import StopLine, VehicleState
from sumo_hmdp.sim.network import read_network
from sumo_hmdp.sim.routes import Routes
from sumo_hmdp.sim.signals import closed_lines

ROUTES = Routes(read_network(Path(__file__).parents[3] / "networks" / "urban.net.xml", Road(3, 4.0)))
ALL = StopLine(frozenset({1, 2, 3}), 299.0)
GREEN, AMBER, RED = "rrrGGGGG", "rrryyyyy", "rrrrrrrr"


def ego(x, speed=10.0):
    return VehicleState("ego", x=x, y=0.0, speed=speed, lane=2)


def other(x, speed, lane=2, length=4.5):
    return VehicleState(f"v{x}", x=x, y=ROUTES.network.road.center_y(lane), speed=speed, lane=lane, length=length)


def lines(state, where, others=(), told=()):
    return closed_lines(ROUTES, {"signal_1": state, "signal_2": GREEN}, where, others, told)


def test_red_closes_and_green_opens():
    assert lines(RED, ego(200.0)) == (ALL,)
    assert lines(RED, ego(298.9)) == (ALL,)
    assert lines(GREEN, ego(200.0)) == ()


# From 10 m/s one second of reaction and 3.05 m/s2 take 10 + 16.39 m; the bumper stops 1 m before the line.
@pytest.mark.parametrize(("x", "closed"), [(272.5, True), (272.7, False)])
def test_amber_closes_to_who_can_stop(x, closed):
    assert lines(AMBER, ego(x)) == ((ALL,) if closed else ())


@pytest.mark.parametrize("state", [AMBER, RED])
def test_who_stands_a_little_beyond_its_place_has_not_passed(state):
    assert lines(state, ego(299.02, speed=0.0)) == (StopLine(frozenset({1, 2, 3}), 299.02),)
    # Rolling at 0.061 m/s it comes 0.061 m and 0.061^2 / 6.1 m farther.
    assert lines(state, ego(299.02, speed=0.061))[0].x == pytest.approx(299.02 + 0.061 + 0.00061)
    # Told so, it stays told, and the place does not move on with it.
    told = (StopLine(frozenset({1, 2, 3}), 299.4),)
    assert lines(state, ego(299.3, speed=0.5), told=told) == told
    assert lines(AMBER, ego(299.5, speed=2.0), told=told) == (StopLine(frozenset({1, 2, 3}), 299.9),)
    # Within the last 10 cm it stays where it is: tracking could carry it over the line.
    assert lines(state, ego(299.95, speed=0.0)) == (StopLine(frozenset({1, 2, 3}), 299.95),)
    assert lines(state, ego(300.1, speed=0.0)) == ()


def test_who_was_told_to_stop_at_amber_stays_told():
    assert lines(AMBER, ego(290.0), told=(ALL,)) == (ALL,)
    # What was told of another line does not matter, nor once it is green.
    assert lines(AMBER, ego(290.0), told=(StopLine(frozenset({1, 2, 3}), 749.0),)) == ()
    assert lines(GREEN, ego(290.0), told=(ALL,)) == ()


# The ego, 4.5 m long, fits between the junction's end and a standing vehicle whose rear is at 324 + 4.5 + 2 m or more,
# 4.5 + 2 m farther if a vehicle goes before it into the same room.
@pytest.mark.parametrize(
    ("others", "closed"),
    [
        ([other(335.1, 0.0)], False),
        ([other(334.9, 0.0)], True),
        ([other(334.9, 4.9)], True),
        ([other(334.9, 5.1)], False),
        ([other(334.9, 0.0, lane=1)], True),
        ([other(341.6, 0.0), other(310.0, 8.0)], False),
        ([other(341.4, 0.0), other(310.0, 8.0)], True),
        ([other(341.4, 0.0), other(270.0, 8.0)], True),
        ([other(341.4, 0.0), other(250.0, 8.0)], False),
        ([other(310.0, 8.0)], False),
    ],
)
def test_a_blocked_exit_closes_its_lane(others, closed):
    line = StopLine(frozenset({others[0].lane}), 299.0)
    assert lines(GREEN, ego(260.0), others) == ((line,) if closed else ())


def test_a_blocked_exit_stops_nobody_who_cannot_stop_unless_told():
    blocked, two = [other(330.0, 0.0)], StopLine(frozenset({2}), 299.0)
    assert lines(GREEN, ego(290.0), blocked) == ()
    assert lines(GREEN, ego(290.0), blocked, told=(ALL,)) == (two,)
    assert lines(GREEN, ego(290.0), blocked, told=(StopLine(frozenset({1}), 299.0),)) == ()


def at_last(where, state="rrrGGG"):
    return closed_lines(ROUTES, {"signal_3": GREEN, "signal_4": state}, where, ())


def test_lanes_that_only_turn_end_at_the_last_signal():
    left = VehicleState("ego", x=1400.0, y=4.0, speed=10.0, lane=1)
    # 3 m/s2 for 4 s take 24 m.
    end, beside = StopLine(frozenset({1}), 1575.0, 1599.0), StopLine(frozenset({3}), 1400.0)
    assert at_last(left) == (beside, end)
    # Also while it leaves the lane: 1 m beside the centre of lane 2 its body of 1.8 m is in lane 2 alone.
    leaving = VehicleState("ego", x=1400.0, y=1.2, speed=10.0, lane=2)
    assert at_last(leaving) == (beside, end)
    assert at_last(VehicleState("ego", x=1400.0, y=1.0, speed=10.0, lane=2)) == (StopLine(frozenset({1, 3}), 1400.0),)


# From 6.1 m/s one second of reaction and 3.05 m/s2 take 6.1 + 6.1 m.
@pytest.mark.parametrize(
    ("x", "speed", "told", "place", "leaving"),
    [
        (1575.0, 0.0, (), 1575.0, 1599.0),
        (1575.3, 0.0, (), 1575.3, 1599.0),
        (1575.3, 0.1, (StopLine(frozenset({1}), 1575.5, 1599.0),), 1575.5, 1599.0),
        # What another lane was told does not matter.
        (1580.0, 6.1, (StopLine(frozenset({3}), 1580.0),), 1592.2, 1599.0),
        (1590.0, 6.1, (), 1599.0, 1599.0),
        (1599.2, 0.0, (), 1599.2, 1599.2),
    ],
)
def test_who_is_late_stops_with_as_much_room_as_it_can(x, speed, told, place, leaving):
    late = VehicleState("ego", x=x, y=4.0, speed=speed, lane=1)
    (end,) = (
        line
        for line in closed_lines(ROUTES, {"signal_3": GREEN, "signal_4": "rrrGGG"}, late, (), told)
        if 1 in line.lanes
    )
    assert (end.x, end.leaving_x) == (pytest.approx(place), pytest.approx(leaving))


def test_a_lane_that_ends_soon_is_not_entered():
    beside = StopLine(frozenset({1, 3}), 1400.0)
    assert at_last(ego(1400.0)) == (beside,)
    assert at_last(ego(1400.0), "rrrrrr") == (beside, StopLine(frozenset({2}), 1599.0))
    # 417 m before its end.
    assert at_last(ego(1182.0)) == ()
    assert at_last(ego(1184.0)) == (StopLine(frozenset({1, 3}), 1184.0),)
