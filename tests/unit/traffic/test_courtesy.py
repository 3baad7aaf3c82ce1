"""Who asks for room and who gives way: cases worked by hand, and loops over eqs. 30 and 31."""

import importlib.util
import math
from pathlib import Path

import numpy as np
import pytest

from sumo_hmdp.errors import InputError
from sumo_hmdp.traffic.car_following import Drivers
from sumo_hmdp.traffic.courtesy import Approach, CourtesyRule, Patience, asked_lanes, give_way
from sumo_hmdp.traffic.mobil import Vehicles

_spec = importlib.util.spec_from_file_location("mobil_by_loops", Path(__file__).with_name("mobil_by_loops.py"))
loops = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(loops)
DT = 0.2
INF = math.inf


def car(x, speed, lane=2, **traits):
    """Return a driver at its desired speed with s0 = 2 m, T = 1 s, a = b = 1 m/s2, of a car of 4 m."""
    return loops.Car(x, speed, lane, **({"desired": 10.0, "time_gap": 1.0, "accel": 1.0, "decel": 1.0} | traits))


def vehicles(cars):
    def column(name, kind=float):
        return np.array([getattr(one, name) for one in cars], dtype=kind)

    drivers = Drivers(*map(column, ("desired", "min_gap", "time_gap", "accel", "decel", "exponent")))
    return Vehicles(
        column("x"), column("speed"), column("lane", int), column("second", int), column("length"),
        column("politeness"), drivers,
    )  # fmt: skip


def room(cars, asked, willing=None, keep=4.0):
    willing = np.ones(len(cars), dtype=bool) if willing is None else np.array(willing)
    found = give_way(vehicles(cars), np.array(asked), willing, keep, DT)
    return dict(zip(found.driver.tolist(), zip(found.accel.tolist(), found.waits.tolist(), strict=True), strict=True))


# Behind one that stands, at 10 m/s: s* = 2 + 10 + 10 * 10 / (2 * 1) = 62 m, accel = -(62 / gap)^2. It stands at x = 100
# with its rear at 96; 4 m are kept.
STANDS = car(100.0, 0.0, 1)


def test_who_can_brake_comfortably_gives_way():
    # A gap of 62 m takes just b. It would keep its speed, its desired one, so it does not wait.
    assert room([STANDS, car(29.9999, 10.0)], [2, 0]) == {1: (pytest.approx(-1.0, abs=1e-5), False)}
    assert room([STANDS, car(30.0001, 10.0)], [2, 0]) == {}


def test_who_cannot_is_passed_over_for_the_next_one():
    # The first has 61 m: -(62/61)^2 = -1.033. The next one has 77.5 m: -(57/77.5)^2, as T = 0.5 s.
    cars = [STANDS, car(31.0, 10.0), car(14.5, 10.0, time_gap=0.5)]
    assert room(cars, [2, 0, 0]) == {2: (pytest.approx(-((57 / 77.5) ** 2)), False)}
    assert room([STANDS, car(31.0, 10.0)], [2, 0]) == {}


def test_of_several_who_can_the_nearest_one_gives_way():
    assert list(room([STANDS, car(10.0, 10.0), car(20.0, 10.0), car(15.0, 10.0)], [2, 0, 0, 0])) == [2]


@pytest.mark.parametrize(("x", "gives_way"), [(91.0, True), (92.1, False), (99.0, False), (101.0, False)])
def test_who_stands_in_a_queue_stays_if_there_is_room(x, gives_way):
    # 1 m beyond what is kept is less than s0: accel = 1 - (2/1)^2, but who stands need not brake for it.
    found = room([STANDS, car(x, 0.0)], [2, 0])
    assert found == ({1: (pytest.approx(-3.0), True)} if gives_way else {})


@pytest.mark.parametrize(
    ("second", "lane", "willing", "asked"),
    [(2, 2, True, 2), (0, 3, True, 2), (0, 2, False, 2), (0, 2, True, 0)],
    ids=["changes already", "another lane", "not willing", "asks for none"],
)
def test_nobody_gives_way(second, lane, willing, asked):
    asking = loops.Car(100.0, 0.0, 1, second)
    assert room([asking, car(10.0, 10.0, lane)], [asked, 0], [True, willing]) == {}


def test_who_gives_way_to_two_minds_the_nearer_one():
    cars = [STANDS, car(100.0 - 15.5, 0.0, 3), car(7.0, 10.0)]
    # Gaps of 85 and 69.5 m.
    assert room(cars, [2, 2, 0]) == {2: (pytest.approx(-((62 / 69.5) ** 2)), False)}


@pytest.mark.parametrize(("leader", "waits"), [(96.05, False), (120.0, True), (None, True)])
def test_waiting_for_the_own_leader_is_no_courtesy(leader, waits):
    # Who stands 2.05 m behind the leader would hardly drive on, by 1 - (2/2.05)^2; 26 m behind it would.
    cars = [STANDS, car(90.0, 0.0)] + ([] if leader is None else [car(leader, 0.0)])
    found = room(cars, [2] + [0] * (len(cars) - 1))
    assert found[1][1] is waits


def test_who_is_held_back_more_by_its_own_leader_is_not_slower_out_of_courtesy():
    # Gaps of 62 m less 12 m to a leader of its speed, which takes s* = 12 m: 0 - (12/7)^2 = -2.9.
    assert room([STANDS, car(29.0, 10.0), car(40.0, 10.0)], [2, 0, 0]) == {}


def test_of_two_that_are_level_ahead_the_one_whose_rear_is_nearer_leads():
    # A car about to enter the lane has its rear 12.5 m ahead, a truck, whose front is farther, 12 m: 0 - (12/12)^2 = -1
    # is less than courtesy takes, -(62/63)^2 = -0.97. Behind the car alone it would be -(12/12.5)^2 = -0.92.
    cars = [STANDS, car(29.0, 10.0), car(45.5, 10.0, 3, second=2), car(53.0, 10.0, length=12.0)]
    assert room(cars, [2, 0, 0, 0]) == {}
    assert list(room(cars[:3], [2, 0, 0])) == [1]


def ask(x, speed, lane, ends, exists=(True, True, True), distance=50.0):
    there = Approach(np.array([x]), np.array([speed]), np.array([lane]), np.array([2.0]))
    return int(asked_lanes(CourtesyRule(distance=distance), there, np.array([ends]), np.array([exists]))[0])


@pytest.mark.parametrize(
    ("x", "speed", "asked"),
    # It takes 20^2 / (2 * 2) = 100 m to stop from 20 m/s, and 50 m come on top.
    [(1449.9, 20.0, 0), (1450.1, 20.0, 2), (1549.9, 0.0, 0), (1550.1, 0.0, 2), (1599.0, 0.0, 2)],
)
def test_one_asks_near_the_end_of_the_lane(x, speed, asked):
    assert ask(x, speed, 1, [1600.0, INF, INF]) == asked


@pytest.mark.parametrize(
    ("lane", "ends", "exists", "asked"),
    [
        (1, [1600.0, 1600.0, INF], (True, True, True), 2),  # two lanes to go
        (3, [INF, 1600.0, 1600.0], (True, True, True), 2),
        (2, [INF, 1600.0, INF], (True, True, True), 1),  # both as near
        (2, [1700.0, 1600.0, INF], (False, True, True), 3),
        (2, [1700.0, 1600.0, 1600.0], (True, True, True), 1),  # a little farther
        (2, [1600.0, INF, 1600.0], (True, True, True), 0),
        (2, [1600.0, 1600.0, 1600.0], (True, True, True), 0),  # nowhere to go
        (1, [1600.0, INF, INF], (True, False, False), 0),
        (1, [1600.0, 1600.0, INF], (True, False, True), 0),
    ],
)
def test_one_asks_toward_the_nearest_lane_that_goes_on(lane, ends, exists, asked):
    assert ask(1590.0, 0.0, lane, ends, exists) == asked


def test_patience_ends_and_comes_back():
    patience = Patience(3, 1.0)
    states = []
    for step in range(12):
        patience.note(np.array([1]) if step < 4 else np.array([], dtype=int), 0.25)
        states.append(patience.over.tolist())
    assert [state[1] for state in states] == [False] * 3 + [True] * 4 + [False] * 5
    assert not any(state[0] or state[2] for state in states)


def by_loops(cars, asked, willing, keep):
    """Return eq. 31 with plain loops over scalars: driver to acceleration and whether it waits."""
    chosen = {}
    for i, asking in enumerate(cars):
        if not asked[i] or asking.second:
            continue
        for j in sorted(range(len(cars)), key=lambda j: (cars[j].x, j), reverse=True):
            driver, gap = cars[j], asking.x - asking.length - cars[j].x - keep
            if not willing[j] or driver.lane != asked[i] or gap <= 0:
                continue
            accel = loops.idm(driver, gap, asking.speed)
            if min(-accel, driver.speed / DT) <= driver.decel:
                chosen[j] = min(accel, chosen.get(j, INF))
                break
    result = {}
    for j, accel in chosen.items():
        lane, place = cars[j].lane, (cars[j].x, j)
        ahead = [one for i, one in enumerate(cars) if lane in (one.lane, one.second) and (one.x, i) > place]
        leader = min(ahead, key=lambda one: one.x - one.length, default=None)
        gap, speed = (INF, 0.0) if leader is None else (leader.x - leader.length - cars[j].x, leader.speed)
        free = loops.idm(cars[j], gap, speed)
        if accel < free:
            result[j] = (pytest.approx(accel), free > 0.1)
    return result


def test_against_loops():
    rng = np.random.default_rng(5)
    given, waiting = 0, 0
    for _ in range(500):
        count = int(rng.integers(0, 20))
        lane = rng.integers(1, 4, count)
        second = np.where(rng.random(count) < 0.2, np.clip(lane + rng.choice([-1, 1], count), 1, 3), 0)
        second[second == lane] = 0
        cars = [
            loops.Car(
                float(rng.integers(0, 250)), float(rng.choice([0.0, rng.uniform(0, 15)])), int(lane[i]), int(second[i]),
                rng.choice([4.0, 12.0]), 0.0, rng.uniform(13, 17), rng.uniform(1, 3), rng.uniform(0.8, 2),
                rng.uniform(0.6, 2.5), rng.uniform(1, 3), 4.0,
            )
            for i in range(count)
        ]  # fmt: skip
        asked = np.where(rng.random(count) < 0.3, np.clip(lane + rng.choice([-1, 1], count), 1, 3), 0)
        willing, keep = rng.random(count) < 0.7, float(rng.choice([0.0, 2.0, 4.0]))
        found = room(cars, asked, willing, keep)
        assert found == by_loops(cars, asked, willing, keep)
        given, waiting = given + len(found), waiting + sum(waits for _, waits in found.values())
    assert given > waiting > 50


@pytest.mark.parametrize("mistake", [{"share": 1.1}, {"share": -0.1}, {"distance": -1.0}, {"patience": INF}])
def test_numbers_out_of_range_are_refused(mistake):
    with pytest.raises(InputError, match=next(iter(mistake))):
        CourtesyRule(**mistake)
