"""The fundamental diagram: cases worked by hand, a grid search for the capacity, and a mix by bisection."""

import numpy as np
import pytest

from sumo_hmdp.errors import InputError
from sumo_hmdp.traffic.drivers import HIGHWAY_CLASSES, Traits, draw_traits, mean_traits
from sumo_hmdp.traffic.spawn import IdmParameters
from sumo_hmdp.traffic.theory import Lane, fundamental_diagram

HAND = Traits("hand", 4.0, 2.0, 40.0, IdmParameters(2.0, 1.5, 2.0, 2.0, 4.0), 0.0)
SLOW = Traits("slow", 10.0, 2.5, 25.0, IdmParameters(3.0, 2.0, 1.0, 2.0, 4.0), 0.0)


def test_one_driver_type_by_hand():
    # At 20 m/s the gap is 32 / sqrt(15/16) = 33.04946 m, the spacing 37.04946 m. Everybody stands at 1 / 6 m.
    found = fundamental_diagram([0.0, 1 / (4 + 32 / np.sqrt(15 / 16)), 1 / 6], [HAND])
    assert found.speed == pytest.approx([40.0, 20.0, 0.0], abs=1e-9)
    assert found.flow == pytest.approx([0.0, 20.0 / 37.04946, 0.0], abs=1e-6)


def test_a_mix_by_bisection():
    density, low, high = 0.03, 0.0, 25.0
    for _ in range(80):
        speed = 0.5 * (low + high)
        spacing = [
            one.length
            + (one.idm.min_gap + speed * one.idm.time_gap)
            / (1 - (speed / one.desired_speed) ** one.idm.exponent) ** 0.5
            for one in (HAND, HAND, SLOW)
        ]
        low, high = (speed, high) if sum(spacing) / 3 < 1 / density else (low, speed)
    assert fundamental_diagram(density, [HAND, HAND, SLOW]).speed == pytest.approx(speed)


def test_nobody_is_faster_than_the_slowest():
    found = fundamental_diagram([0.0, 1e-5, 1e-3], [HAND, SLOW])
    assert found.speed[0] == 25.0
    assert (np.diff(found.speed) < 0.0).all()


def test_many_alike_are_one():
    density = np.linspace(0.0, 0.16, 9)
    assert fundamental_diagram(density, [HAND] * 5).flow == pytest.approx(fundamental_diagram(density, [HAND]).flow)


def test_the_capacity_is_the_top_of_the_diagram():
    rng = np.random.default_rng(3)
    mix = [draw_traits(HIGHWAY_CLASSES, rng.random(4)) for _ in range(50)]
    for traits in ([HAND], [SLOW], [mean_traits(HIGHWAY_CLASSES)], mix):
        lane = Lane.of(traits)
        flow, speed = lane.capacity()
        top = fundamental_diagram(np.linspace(0.0, lane.jam_density, 4001), traits)
        assert flow == pytest.approx(top.flow.max(), rel=1e-5)
        assert flow >= top.flow.max()
        assert fundamental_diagram(float(lane.density(speed)), traits).flow == pytest.approx(flow)


@pytest.mark.parametrize("share", [0.05, 0.5, 0.95, 1.0])
def test_the_free_branch_carries_the_flow(share):
    lane = Lane.of([HAND])
    capacity, best = lane.capacity()
    speed = lane.free_speed(share * capacity)
    assert speed >= best
    assert speed * float(lane.density(speed)) == pytest.approx(share * capacity)


@pytest.mark.parametrize("density", [-0.001, 0.17, np.nan])
def test_no_lane_holds_more_than_a_jam(density):
    with pytest.raises(InputError, match="where everybody stands"):
        fundamental_diagram([0.01, density], [HAND])
