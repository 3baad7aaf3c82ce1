"""Lane changes of the traffic: against loops over the paper's formulas, and cases worked by hand."""

import importlib.util
import math
from pathlib import Path

import numpy as np
import pytest

from sumo_hmdp.errors import InputError
from sumo_hmdp.traffic.car_following import Drivers
from sumo_hmdp.traffic.mobil import LaneChangeRule, Passing, Vehicles, choose_lanes

_spec = importlib.util.spec_from_file_location("mobil_by_loops", Path(__file__).with_name("mobil_by_loops.py"))
loops = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(loops)
Car, Loops = loops.Car, loops.Loops

LEFT, KEEP, RIGHT = -1, 0, 1
EUROPEAN = LaneChangeRule(Passing.LEFT_ONLY, right_bias=0.3)


def vehicles(cars):
    def column(name, kind=float):
        return np.array([getattr(car, name) for car in cars], dtype=kind)

    drivers = Drivers(*map(column, ("desired", "min_gap", "time_gap", "accel", "decel", "exponent")))
    return Vehicles(
        column("x"), column("speed"), column("lane", int), column("second", int), column("length"),
        column("politeness"), drivers,
    )  # fmt: skip


def choose(cars, rule=LaneChangeRule(), *, lanes=2, allowed=None, may=None, bias=None, ends=None):  # noqa: B008
    allowed = np.ones((len(cars), lanes), dtype=bool) if allowed is None else np.array(allowed)
    may = np.ones(len(cars), dtype=bool) if may is None else np.array(may)
    bias = None if bias is None else np.array(bias, dtype=float)
    ends = None if ends is None else np.array(ends, dtype=float)
    return choose_lanes(vehicles(cars), rule, allowed, may, bias, ends).tolist()


def random_scene(rng):
    lanes, count = int(rng.integers(1, 5)), int(rng.integers(0, 26))
    density = rng.choice([0.01, 0.03, 0.08])
    x = rng.uniform(0, 1 + count / lanes / density, count)
    lane = rng.integers(1, lanes + 1, count)
    second = np.where(rng.random(count) < 0.15, np.clip(lane + rng.choice([-1, 1], count), 1, lanes), 0)
    second[second == lane] = 0
    speed = rng.choice([12.0, 25.0]) + rng.uniform(-5, 5, count)
    cars = [
        Car(
            float(x[i]), float(speed[i]), int(lane[i]), int(second[i]), rng.choice([4.0, 12.0]), rng.uniform(0, 0.6),
            rng.uniform(15, 36), rng.uniform(1, 3), rng.uniform(0.8, 2), rng.uniform(0.6, 2.5), rng.uniform(1, 3), 4.0,
        )
        for i in range(count)
    ]  # fmt: skip
    allowed, may = rng.random((count, lanes)) < 0.8, rng.random(count) < 0.9
    bias = np.where(rng.random((count, 2)) < 0.2, rng.uniform(-2, 3, (count, 2)), 0.0)
    ends = np.where(
        rng.random((count, lanes)) < 0.15, rng.uniform(0, 1 + 2 * count / density / lanes, (count, lanes)), np.inf
    )
    return cars, allowed, may, bias, ends


@pytest.mark.parametrize(
    "rule",
    [
        LaneChangeRule(),
        LaneChangeRule(right_bias=0.2, threshold=0.3, safe_decel=2.0, least_gap=5.0),
        EUROPEAN,
        LaneChangeRule(Passing.LEFT_ONLY, critical_speed=5.0, safe_decel=6.0, least_gap=0.5),
    ],
)
def test_against_loops(rule):
    rng = np.random.default_rng(11)
    counts = {LEFT: 0, KEEP: 0, RIGHT: 0}
    for _ in range(400):
        cars, allowed, may, bias, ends = random_scene(rng)
        found = choose_lanes(vehicles(cars), rule, allowed, may, bias, ends).tolist()
        assert found == Loops(cars, rule, allowed, may, bias, ends).choose()
        for move in found:
            counts[move] += 1
    assert min(counts.values()) > 100


def test_without_bias_and_ends_they_are_none():
    rng = np.random.default_rng(12)
    for _ in range(50):
        cars, allowed, may, bias, ends = random_scene(rng)
        free = choose_lanes(vehicles(cars), EUROPEAN, allowed, may)
        same = choose_lanes(vehicles(cars), EUROPEAN, allowed, may, 0 * bias, np.full(ends.shape, np.inf))
        assert free.tolist() == same.tolist()


# By hand, with s0 = 2, T = 1.5, a = b = 2, v0 = 30, length 4. At v = 15 behind an equally fast leader s* = 24.5 and
# the free-road term is 1 - 1/16 = 15/16: a gap of 49 gives 2 (15/16 - 1/4) = 1.375, no leader gives 1.875.
SLOWED = Car(x=0.0, speed=15.0, lane=2)
LEADER = Car(x=53.0, speed=15.0, lane=2)


@pytest.mark.parametrize(("threshold", "expected"), [(0.49, LEFT), (0.51, KEEP)])
def test_the_gain_of_a_free_lane(threshold, expected):
    # 1.875 - 1.375 = 0.5.
    assert choose([SLOWED, LEADER], LaneChangeRule(threshold=threshold)) == [expected, KEEP]


# A follower there with the same numbers, 49 m behind: it loses 0.5 if the change comes.
BEHIND = Car(x=-53.0, speed=15.0, lane=1)


@pytest.mark.parametrize(("politeness", "expected"), [(0.79, LEFT), (0.81, KEEP)])
def test_politeness_weighs_the_loss_of_the_new_follower(politeness, expected):
    # 0.5 - p 0.5 > 0.1 for p < 0.8.
    polite = loops.Car(**{**vars(SLOWED), "politeness": politeness})
    moves = choose([polite, LEADER, BEHIND], may=[True, False, False])
    assert moves[0] == expected


@pytest.mark.parametrize(("politeness", "expected"), [(0.9, KEEP), (1.1, LEFT)])
def test_politeness_weighs_the_gain_of_the_old_follower(politeness, expected):
    # A changer on free roads gains nothing; its follower at 49 m gains 1.875 - 1.375 = 0.5, and p 0.5 > 0.5 for p > 1.
    polite = Car(x=0.0, speed=15.0, lane=2, politeness=politeness)
    follower = Car(x=-53.0, speed=15.0, lane=2)
    assert choose([polite, follower], LaneChangeRule(threshold=0.5), may=[True, False])[0] == expected


@pytest.mark.parametrize(("safe_decel", "expected"), [(2.89, KEEP), (2.90, LEFT)])
def test_the_new_follower_need_not_brake_harder_than_is_safe(safe_decel, expected):
    # It closes with 5: s* = 2 + 30 + 20 * 5 / 4 = 57, and at a gap of 38 2 (1 - (2/3)^4 - (57/38)^2) = -2.8951.
    follower = Car(x=-42.0, speed=20.0, lane=1)
    rule = LaneChangeRule(safe_decel=safe_decel)
    assert choose([SLOWED, LEADER, follower], rule, may=[True, False, False])[0] == expected


@pytest.mark.parametrize(
    "blocker",
    [
        Car(x=0.0, speed=15.0, lane=1),
        Car(x=3.0, speed=30.0, lane=1),
        Car(x=-3.0, speed=0.0, lane=1),
        # Long: its front is ahead, its rear is behind.
        Car(x=6.0, speed=15.0, lane=1, length=12.0),
        # On its way into the lane, or out of it.
        Car(x=1.0, speed=15.0, lane=3, second=1),
        Car(x=1.0, speed=15.0, lane=1, second=3),
        # A gap of 1.5 m, ahead and behind, between equally slow vehicles.
        Car(x=5.5, speed=30.0, lane=1),
        Car(x=-5.5, speed=0.0, lane=1),
    ],
)
def test_an_occupied_place_is_never_entered(blocker):
    cars = [SLOWED, LEADER, blocker]
    urge = [[1e6, 0.0], [0.0, 0.0], [0.0, 0.0]]
    allowed = [[True, True, False]] * 3
    assert choose(cars, lanes=3, allowed=allowed, bias=urge, may=[True, False, False]) == [KEEP] * 3
    assert choose(cars[:2], lanes=3, allowed=allowed[:2], bias=urge[:2]) == [LEFT, KEEP]


def test_a_bias_sends_nobody_against_the_new_leader():
    # Behind a standing leader at a gap of 30 in the new lane: s* = 2 + 22.5 + 15 * 15 / 4 = 80.75, far above 4 m/s2.
    standing = Car(x=34.0, speed=0.0, lane=1)
    urge = [[1e6, 0.0], [0.0, 0.0]]
    assert choose([SLOWED, standing], bias=urge) == [KEEP, KEEP]
    # Who brakes even harder here may: a gap of 10 instead of 30.
    nearer = Car(x=14.0, speed=0.0, lane=2)
    faraway = Car(x=104.0, speed=0.0, lane=1)
    assert choose([SLOWED, nearer, faraway], may=[True, False, False])[0] == LEFT


def test_a_bias_moves_the_threshold():
    # Free roads: no gain at all.
    lonely = [Car(x=0.0, speed=15.0, lane=2)]
    assert choose(lonely, lanes=3, bias=[[0.0, 0.11]]) == [RIGHT]
    assert choose(lonely, lanes=3, bias=[[0.0, 0.09]]) == [KEEP]
    assert choose(lonely, lanes=3, bias=[[0.2, 0.3]]) == [RIGHT]
    # Equal incentives: to the left.
    assert choose(lonely, lanes=3, bias=[[0.2, 0.2]]) == [LEFT]


@pytest.mark.parametrize(("right_bias", "expected"), [(0.09, KEEP), (0.11, RIGHT)])
def test_the_right_bias_acts_above_the_threshold(right_bias, expected):
    lonely = [Car(x=0.0, speed=15.0, lane=1)]
    assert choose(lonely, LaneChangeRule(Passing.LEFT_ONLY, right_bias=right_bias)) == [expected]


def test_european_drivers_keep_left_while_the_right_is_no_gain():
    # To the left the incentive of 0.5 must exceed 0.1 + 0.3; at a bias of 0.45 it does not.
    assert choose([SLOWED, LEADER], EUROPEAN) == [LEFT, KEEP]
    assert choose([SLOWED, LEADER], LaneChangeRule(Passing.LEFT_ONLY, right_bias=0.45)) == [KEEP, KEEP]


# v = 25 behind a left leader with 20 at a gap of 100: s* = 2 + 37.5 + 25 * 5 / 4 = 70.75, (70.75 / 100)^2 = 0.50056;
# free road 2 (1 - (25/30)^4) = 1.03549, behind it 1.03549 - 1.00111 = 0.03438.
FAST_RIGHT = Car(x=0.0, speed=25.0, lane=2)
SLOW_LEFT = Car(x=104.0, speed=20.0, lane=1)


@pytest.mark.parametrize(
    ("rule", "expected"),
    [
        # Any side: on the left it would lose 1.00111, which a bias of 1 to the left does not outweigh.
        (LaneChangeRule(), KEEP),
        # Left only: it may not pass anyway, e = 0.03438, so it loses nothing: 1 > 0.1.
        (LaneChangeRule(Passing.LEFT_ONLY), LEFT),
        # Congested: at most 21 m/s fast traffic may be passed on the right.
        (LaneChangeRule(Passing.LEFT_ONLY, critical_speed=21.0), KEEP),
    ],
)
def test_passing_on_the_right(rule, expected):
    assert choose([FAST_RIGHT, SLOW_LEFT], rule, bias=[[1.0, 0.0], [0.0, 0.0]], may=[True, False])[0] == expected


def test_nobody_goes_right_in_order_to_pass():
    # In the left lane behind the slow one, with the right lane free: any side gains 1.00111, left only nothing.
    stuck = Car(x=0.0, speed=25.0, lane=1)
    assert choose([stuck, SLOW_LEFT], may=[True, False])[0] == RIGHT
    assert choose([stuck, SLOW_LEFT], LaneChangeRule(Passing.LEFT_ONLY), may=[True, False])[0] == KEEP


@pytest.mark.parametrize("politeness", [0.0, 50.0])
def test_european_drivers_neglect_followers_to_the_right(politeness):
    # To the left only the new follower counts, to the right only the old one: neither of those is here.
    to_left = [Car(x=0.0, speed=15.0, lane=2, politeness=politeness), LEADER, Car(x=-53.0, speed=15.0, lane=2)]
    assert choose(to_left, LaneChangeRule(Passing.LEFT_ONLY, threshold=0.6), may=[True, False, False])[0] == KEEP
    to_right = [Car(x=0.0, speed=15.0, lane=1, politeness=politeness), Car(x=-53.0, speed=15.0, lane=2)]
    assert choose(to_right, EUROPEAN, may=[True, False])[0] == RIGHT


def test_the_end_of_a_lane_is_a_standing_leader():
    # v = 15, the end 100 m ahead: s* = 24.5 + 15 * 15 / 4 = 80.75; 2 (15/16 - 0.65206) = 0.5709, a loss of 1.30411.
    lonely = [Car(x=0.0, speed=15.0, lane=2)]
    for threshold, expected in ((1.30, LEFT), (1.31, KEEP)):
        rule = LaneChangeRule(threshold=threshold)
        assert choose(lonely, rule, ends=[[math.inf, 100.0]]) == [expected]
    assert choose(lonely, ends=[[100.0, 100.0]], bias=[[1.0, 0.0]]) == [LEFT]
    assert choose(lonely, ends=[[1.0, 100.0]], bias=[[1e6, 0.0]]) == [KEEP]


def test_what_is_not_allowed_is_not_done():
    for allowed in ([[False, True, True]], [[True, True, False]]):
        (move,) = choose([Car(x=0.0, speed=15.0, lane=2)], lanes=3, allowed=allowed, bias=[[1.0, 1.0]])
        assert move == (RIGHT if not allowed[0][0] else LEFT)
    lonely = [Car(x=0.0, speed=15.0, lane=1)]
    assert choose(lonely, lanes=1, bias=[[9.0, 9.0]]) == [KEEP]
    assert choose(lonely, lanes=2, bias=[[9.0, 9.0]], may=[False]) == [KEEP]
    assert choose([Car(x=0.0, speed=15.0, lane=1, second=2)], lanes=3, bias=[[9.0, 9.0]]) == [KEEP]
    assert choose([], lanes=3) == []


def test_of_two_into_the_same_place_the_keener_goes():
    from_left, from_right = Car(x=0.0, speed=15.0, lane=1), Car(x=2.0, speed=15.0, lane=3)
    for left, right, expected in ((2.0, 1.0, [RIGHT, KEEP]), (1.0, 2.0, [KEEP, LEFT]), (1.0, 1.0, [RIGHT, KEEP])):
        assert choose([from_left, from_right], lanes=3, bias=[[0.0, left], [right, 0.0]]) == expected
    # Far enough apart both go: at a gap of 49 nobody brakes.
    far = Car(x=53.0, speed=15.0, lane=3)
    assert choose([from_left, far], lanes=3, bias=[[0.0, 1.0], [1.0, 0.0]]) == [RIGHT, LEFT]


def test_who_waits_does_not_block_a_third():
    # All three want into lane 2. The middle one overlaps both others; the keenest is in front of it, so it waits,
    # and the last, who would have waited for it, goes: it is 5 m behind the front one, which is faster.
    last, middle = Car(x=0.0, speed=15.0, lane=1), Car(x=4.0, speed=15.0, lane=3)
    front = Car(x=9.0, speed=30.0, lane=1, desired=40.0)
    cars = [last, middle, front]
    keen = [[0.0, 1.0], [2.0, 0.0], [0.0, 3.0]]
    assert choose(cars, lanes=3, bias=keen) == [RIGHT, KEEP, RIGHT]
    # Without the front one the middle one goes and the last one waits.
    assert choose(cars[:2], lanes=3, bias=keen[:2]) == [KEEP, LEFT]


def test_rules_that_make_no_sense_are_refused():
    with pytest.raises(InputError) as caught:
        LaneChangeRule(threshold=-1.0, safe_decel=math.nan, least_gap=math.inf)
    assert len(caught.value.problems) == 3
