"""Which stop lines are closed to the ego, and which rules it broke: on the arterial, by distances worked by hand."""

from dataclasses import replace
from pathlib import Path

import pytest

from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import StopLine, VehicleState
from sumo_hmdp.sim.network import read_network
from sumo_hmdp.sim.routes import Routes
from sumo_hmdp.sim.signals import Breaches, breaches, closed_lines

NETWORKS = Path(__file__).parents[3] / "networks"
EGO = VehicleState("ego", x=250.0, y=0.0, speed=10.0, lane=2, length=5.0)
EVERY = frozenset({1, 2, 3})


@pytest.fixture(scope="module")
def routes():
    return Routes(read_network(NETWORKS / "urban.net.xml", Road(3, 4.0)))


def lights(routes, letter, **lanes):
    """Return the states of all lights: one letter for all links, others for some lanes of the arterial."""
    states = {}
    for signal in routes.network.signals:
        links = ["r"] * 20
        for lane, link in enumerate(signal.straight, 1):
            if link is not None:
                links[link] = lanes.get(f"lane_{lane}", letter)
        states[signal.name] = "".join(links)
    return states


def test_red_closes_all_lanes_a_metre_before_the_line(routes):
    assert closed_lines(routes, lights(routes, "r"), EGO, ()) == (StopLine(EVERY, 299.0),)


@pytest.mark.parametrize("letter", ["g", "G"])
def test_green_closes_nothing(routes, letter):
    assert closed_lines(routes, lights(routes, letter), EGO, ()) == ()


@pytest.mark.parametrize("letter", ["G", "g", "O", "o", "s"])
def test_a_light_that_is_off_or_asks_to_yield_to_nobody_is_open(routes, letter):
    assert closed_lines(routes, lights(routes, letter), EGO, ()) == ()


@pytest.mark.parametrize("letter", ["r", "R", "u", "U"])
def test_a_light_that_is_red_is_closed(routes, letter):
    assert closed_lines(routes, lights(routes, letter), EGO, ()) == (StopLine(EVERY, 299.0),)


def test_one_lane_at_red(routes):
    assert closed_lines(routes, lights(routes, "G", lane_3="r"), EGO, ()) == (StopLine(frozenset({3}), 299.0),)


@pytest.mark.parametrize(("x", "speed", "closed"), [(49.9, 10.0, False), (50.0, 10.0, True), (300.0, 10.0, False)])
def test_a_line_counts_from_250_m_before_it_until_it_is_passed(routes, x, speed, closed):
    lines = closed_lines(routes, lights(routes, "r"), replace(EGO, x=x, speed=speed), ())
    assert (lines == (StopLine(EVERY, 299.0),)) is closed


# To rest after a second: 10 + 100 / 6.1 = 26.393 m from 10 m/s, 14 + 196 / 6.1 = 46.131 m from 14 m/s.
@pytest.mark.parametrize(
    ("x", "speed", "closed"),
    [(272.60, 10.0, True), (272.61, 10.0, False), (252.86, 14.0, True), (252.87, 14.0, False), (298.9, 0.0, True)],
)
def test_amber_closes_where_the_ego_can_stop(routes, x, speed, closed):
    lines = closed_lines(routes, lights(routes, "y"), replace(EGO, x=x, speed=speed), ())
    assert (lines == (StopLine(EVERY, 299.0),)) is closed


# The junction ends at 324 m: behind the ego's 5 m and 2 m of room, the rear ahead must be beyond 331 m.
@pytest.mark.parametrize(
    ("front", "speed", "lane", "closed"),
    [
        (335.4, 4.9, 2, {2}),
        (335.4, 0.0, 2, {2}),
        (335.4, 0.0, 1, {1}),
        (335.5, 4.9, 2, set()),
        (335.4, 5.0, 2, set()),
        (310.0, 3.0, 2, {2}),
        # Before the line: no business of the junction.
        (299.0, 0.0, 2, set()),
    ],
)
def test_an_exit_that_is_blocked_closes_its_lane(routes, front, speed, lane, closed):
    other = VehicleState("a", x=front, y=0.0, speed=speed, lane=lane, length=4.5)
    lines = closed_lines(routes, lights(routes, "G"), EGO, (other,))
    assert {lane for line in lines for lane in line.lanes} == closed


def test_a_blocked_exit_does_not_stop_an_ego_that_is_too_near(routes):
    other = VehicleState("a", x=320.0, y=0.0, speed=0.0, lane=2)
    assert closed_lines(routes, lights(routes, "G"), replace(EGO, x=280.0), (other,)) == ()


def test_lanes_that_do_not_go_on_are_closed_whatever_the_light(routes):
    # To who is beside them from where it is, to who is in one of them where it ends.
    ego = replace(EGO, x=1400.0)
    closed_beside = StopLine(frozenset({1, 3}), 1400.0)
    assert closed_lines(routes, lights(routes, "G"), ego, ()) == (closed_beside,)
    assert closed_lines(routes, lights(routes, "r"), ego, ()) == (closed_beside, StopLine(frozenset({2}), 1599.0))
    inside = replace(ego, lane=1, y=4.0)
    expected = (StopLine(frozenset({3}), 1400.0), StopLine(frozenset({1}), 1575.0, 1599.0))
    assert closed_lines(routes, lights(routes, "G"), inside, ()) == expected


def test_a_lane_that_ends_without_a_signal_is_closed_too():
    routes = Routes(read_network(NETWORKS / "highway_ramps.net.xml", Road(4, 4.0)))
    ego = replace(EGO, x=1560.0, y=-2.0, lane=3)
    assert closed_lines(routes, {}, ego, ()) == (StopLine(frozenset({4}), 1560.0),)
    assert closed_lines(routes, {}, replace(ego, lane=4, y=-6.0), ()) == (StopLine(frozenset({4}), 1775.0, 1799.0),)
    # And nobody may enter it where it does not exist.
    assert closed_lines(routes, {}, replace(ego, x=1900.0), ()) == (StopLine(frozenset({4}), 1900.0),)


@pytest.mark.parametrize(
    ("letter", "before", "after", "lane", "red"),
    [
        ("r", 299.0, 301.0, 2, True),
        ("r", 300.0, 302.0, 2, True),
        ("r", 298.0, 300.0, 2, False),
        ("r", 301.0, 303.0, 2, False),
        ("G", 299.0, 301.0, 2, False),
        ("y", 299.0, 301.0, 2, False),
        # At the fourth junction lane 1 leads to the left only.
        ("G", 1599.0, 1601.0, 1, True),
        ("G", 1599.0, 1601.0, 2, False),
    ],
)
def test_passing_at_red(routes, letter, before, after, lane, red):
    start, end = replace(EGO, x=before), replace(EGO, x=after)
    assert breaches(routes, lights(routes, letter), start, end, lane) == Breaches(red_light=red)


@pytest.mark.parametrize(
    ("front", "speed", "stands"),
    [(300.0, 0.0, False), (300.5, 0.0, True), (328.9, 0.09, True), (328.9, 0.1, False), (329.0, 0.0, False)],
)
def test_standing_inside_a_junction(routes, front, speed, stands):
    now = replace(EGO, x=front, speed=speed)
    assert breaches(routes, lights(routes, "G"), now, now, 2) == Breaches(junction_stop=stands)


def test_a_lane_that_is_not_there_is_not_entered(routes):
    # Inside the last junction there is lane 2 alone.
    inside = replace(EGO, x=1610.0)
    assert closed_lines(routes, lights(routes, "G"), inside, ()) == (StopLine(frozenset({1, 3}), 1610.0),)
    # Whose body still is over a lane that it has left may go on: up to y = 1.1 m it is over lane 2 alone.
    assert closed_lines(routes, lights(routes, "G"), replace(inside, y=1.2), ()) == (StopLine(frozenset({3}), 1610.0),)
    assert closed_lines(routes, lights(routes, "G"), replace(inside, x=1630.0), ()) == ()
