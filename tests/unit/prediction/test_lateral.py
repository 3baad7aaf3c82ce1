"""How others move across the road: worked by hand, and the lanes that they take up against samples."""

import math

import numpy as np
import pytest
from scipy.stats import norm

from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.prediction.dynamics import LateralGains, Noise
from sumo_hmdp.prediction.lateral import LaneFollowing, forecast, lateral_variances

ROAD = Road(3, 4.0)
KEEP = np.zeros((1, 6), dtype=np.int64)
# What a period of 0.8 s leaves of a deviation with a time constant of 2 s.
R = 0.6703200460356393


def seen(y, lane, laterals=KEEP, *, noise=None, following=None, period=0.8, gains=None, **state):
    vehicle = VehicleState("v", x=0.0, y=y, speed=20.0, lane=lane, **state)
    return forecast(vehicle, noise or Noise(), following or LaneFollowing(), ROAD, laterals, period, gains)


def test_a_lane_change_takes_its_time_at_constant_speed():
    change = np.array([[-1, 0, 0, 0, 0, 0]])
    assert seen(0.0, 2, change).y[0].tolist() == pytest.approx([0.0, 0.8, 1.6, 2.4, 3.2, 4.0, 4.0])
    slow = seen(0.0, 2, change, following=LaneFollowing(change_time=8.0))
    assert slow.y[0].tolist() == pytest.approx([0.0, 0.4, 0.8, 1.2, 1.6, 2.0, 2.4])


@pytest.mark.parametrize(("y", "lane", "end"), [(1.0, 1, 4.0), (1.0, 2, 0.0), (-3.0, 2, 0.0), (6.5, 1, 4.0)])
def test_who_is_half_way_goes_on_to_the_lane_that_it_intends(y, lane, end):
    y_after = seen(y, lane).y[0]
    assert np.abs(np.diff(y_after)).max() <= 0.8 + 1e-12
    assert y_after[-1] == pytest.approx(end, abs=0.1)


def test_the_last_metre_of_a_lane_change_is_told_from_lane_keeping_by_the_lateral_speed():
    assert seen(3.1, 1, lateral_speed=1.0).y[0, :3].tolist() == pytest.approx([3.1, 3.9, 4.0])
    # It moves away from the centre, or slower than half a lane change: a deviation, steered back.
    for speed in (0.0, 0.4, -1.0):
        assert seen(3.1, 1, lateral_speed=speed).y[0, :3].tolist() == pytest.approx([3.1, 4 - 0.9 * R, 4 - 0.9 * R**2])


def test_a_lane_change_that_is_broken_off_returns_and_a_second_one_follows_the_first():
    back = seen(0.0, 2, np.array([[-1, 0, 1, 0, 0, 0]])).y[0]
    assert back.tolist() == pytest.approx([0.0, 0.8, 1.6, 0.8, 0.0, 0.0, 0.0])
    two = seen(-4.0, 3, np.array([[-1, -1, 0, 0, 0, 0]])).y[0]
    assert two.tolist() == pytest.approx([-4.0, -3.2, -2.4, -1.6, -0.8, 0.0, 0.8])


def test_a_deviation_decays_at_its_rate_whatever_the_period():
    assert seen(0.5, 2).y[0, 1] == pytest.approx(0.5 * R)
    fine = seen(0.5, 2, np.zeros((1, 8), dtype=np.int64), period=0.1)
    assert fine.y[0, 8] == pytest.approx(0.5 * R)


def test_the_variance_stays_bounded():
    noise = Noise(position_var=0.02, process_position_var=0.05, process_lateral_var=0.01)
    variances = lateral_variances(noise, LaneFollowing(), 0.8, 50)
    assert variances[:3].tolist() == pytest.approx([0.02, R**2 * 0.02 + 0.01, R**4 * 0.02 + R**2 * 0.01 + 0.01])
    assert variances[-1] == pytest.approx(0.01 / (1 - R**2))
    assert lateral_variances(Noise(0.02, lateral_var=0.5), LaneFollowing(), 0.8, 1)[0] == 0.5


def test_the_lane_that_is_left_is_free_when_the_body_has_left_it():
    taken = seen(0.0, 2, np.array([[-1, 0, 0, 0, 0, 0]])).taken()[0]
    assert taken.shape == (7, 3)
    # The body of 1.8 m clears the line at 2 m with y = 2.9 m: at 2.4 it is there, at 3.2 it has left.
    assert taken[:, 1].tolist() == [1, 1, 1, 1, 0, 0, 0]
    assert taken[:, 0].tolist() == [0, 1, 1, 1, 1, 1, 1]
    assert not taken[:, 2].any()


def test_a_body_that_touches_a_line_is_not_beyond_it():
    assert seen(1.1, 2).taken()[0, 0].tolist() == [0, 1, 0]
    assert seen(1.1001, 2).taken()[0, 0].tolist() == [1, 1, 0]


def test_probabilities_are_the_shares_of_samples():
    noise = Noise(lateral_var=0.25, process_lateral_var=0.04)
    found = seen(0.8, 2, np.array([[0, 0, -1, 0]]), noise=noise, width=2.0)
    rng, count = np.random.default_rng(1), 200_000
    # Written out again: a deviation that decays and is stirred, about a path that leaves the centre in the third step.
    deviation, path = 0.8 + 0.5 * rng.standard_normal(count), 0.0
    for k in range(5):
        if k:
            path += 0.8 if k >= 3 else 0.0
            deviation = R * deviation + 0.2 * rng.standard_normal(count)
        left_edge, right_edge = path + deviation + 1.0, path + deviation - 1.0
        over = {1: left_edge > 2.0, 2: (left_edge > -2.0) & (right_edge < 2.0), 3: right_edge < -2.0}
        for footprint in ((1,), (2,), (3,), (1, 2), (2, 3), (1, 2, 3)):
            intended = (1 if k >= 3 else 2) in footprint
            share = 1.0 if intended else np.mean(np.any([over[lane] for lane in footprint], axis=0))
            assert found.takes_up(footprint)[0, k] == pytest.approx(share, abs=5 * 0.5 / math.sqrt(count))


def test_without_bodies_only_the_intended_lane_counts():
    found = seen(0.8, 2, np.array([[0, -1]]), noise=Noise(lateral_var=1.0))
    assert found.taken(swept=False)[0].tolist() == [[0, 1, 0], [0, 1, 0], [1, 0, 0]]


def test_the_papers_law():
    change = np.array([[-1, 0], [0, 0]])
    found = seen(0.0, 2, change, noise=Noise(0.25, process_position_var=0.04), gains=LateralGains(), lateral_speed=0.4)
    # T^2/2 = 0.32: (1 - 3 * 0.32) * 0 + 0.32 * (3 * 4 - 1 * 0.4); then it keeps its y.
    assert found.y.tolist() == [pytest.approx([0.0, 3.712, 3.712]), [0.0, 0.0, 0.0]]
    assert found.std[0] ** 2 == pytest.approx([0.25, 0.04**2 * 0.25 + 0.04, 0.04**2 * 0.25 + 0.08])
    assert found.std[1] ** 2 == pytest.approx([0.25, 0.29, 0.33])
    assert found.taken()[1, 0, 0] == pytest.approx(norm.sf(1.1 / 0.5))
