"""Vehicles drawn from the model: their frequencies and moments against the model's own."""

import math

import numpy as np
import pytest

from sumo_hmdp.domain.maneuver import Mode
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.errors import InputError
from sumo_hmdp.prediction.dynamics import Noise
from sumo_hmdp.prediction.lateral import LaneFollowing
from sumo_hmdp.prediction.policy import Policy, ScheduledPolicy
from sumo_hmdp.traffic.matched import MatchedModel, draw_path

ROAD = Road(3, 4.0)
KEEP = ((0.0, 1.0, 0.0),) * 3
START = VehicleState("a", x=10.0, y=0.0, speed=20.0, lane=2)


def model(lateral=KEEP, longitudinal=(0.0, 1.0, 0.0), noise=None, **changes):
    settings = {"period": 0.5, "accel": 2.0, "following": LaneFollowing(change_time=2.0)} | changes
    return MatchedModel(
        ScheduledPolicy(((0.0, Policy(lateral, longitudinal)),)), Noise() if noise is None else noise, **settings
    )


def test_without_noise_the_path_is_that_of_the_mode_before_the_action():
    path = draw_path(START, model(longitudinal=(0.0, 0.0, 1.0)), ROAD, 5.0, seed=1)
    # Cruise until 0.5 s, since the first action only takes effect on the motion after it; then 2 m/s2.
    assert [path.at(t).mode for t in (0.0, 0.25, 0.5, 0.75)] == [Mode.CRUISE, Mode.CRUISE, *[Mode.ACCELERATE] * 2]
    assert path.at(0.5).x == pytest.approx(20.0)
    assert path.at(1.5).speed == pytest.approx(22.0)
    assert path.at(1.5).x == pytest.approx(10.0 + 20.0 * 1.5 + 0.5 * 2.0 * 1.0**2)
    assert path.at(1.25).x == pytest.approx(10.0 + 20.0 * 1.25 + 0.5 * 2.0 * 0.75**2)


def test_a_lane_change_is_intended_after_the_instant_of_its_action_and_done_within_its_time():
    path = draw_path(START, model(lateral=((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))), ROAD, 4.0, seed=1)
    assert path.at(0.0).lane == 2
    assert path.at(0.01).lane == path.at(0.5).lane == 1
    # At 4 m in 2 s: half way after half of its time.
    assert path.at(0.0).lateral_speed == 0.0
    assert path.at(0.3).y == pytest.approx(0.6)
    assert path.at(1.0).y == pytest.approx(2.0)
    assert path.at(1.0).lateral_speed == pytest.approx(2.0)
    assert path.at(1.0).heading == pytest.approx(math.atan2(2.0, 20.0))
    assert path.at(2.0).y == path.at(3.0).y == pytest.approx(4.0)
    assert path.at(2.2).lateral_speed == path.at(3.0).lateral_speed == 0.0


def test_frequencies_and_moments_are_the_models():
    noise = Noise(process_position_var=0.09, process_speed_var=0.04)
    drawn = model(longitudinal=(0.2, 0.7, 0.1), noise=noise)
    ends, modes = [], []
    for seed in range(3000):
        path = draw_path(START, drawn, ROAD, 1.0, seed=seed)
        cruise = path.periods[0].x + 20.0 * 0.5
        ends.append(path.at(0.5).x - cruise)
        modes.append(path.at(0.5).mode)
    # Four standard errors: 0.3 / sqrt(3000) = 0.0055 for the mean; the variance's relative one is sqrt(2 / 3000).
    assert np.mean(ends) == pytest.approx(0.0, abs=4 * 0.0055)
    assert np.var(ends) == pytest.approx(0.09, rel=4 * 0.0258)
    for mode, share in ((Mode.DECELERATE, 0.2), (Mode.CRUISE, 0.7), (Mode.ACCELERATE, 0.1)):
        assert modes.count(mode) / 3000 == pytest.approx(share, abs=4 * math.sqrt(share * (1 - share) / 3000))


def test_variance_grows_as_the_prediction_says():
    # Q_xx after two steps: 2 process variances of the position, and T^2 times one of the speed.
    noise = Noise(process_position_var=0.09, process_speed_var=0.04)
    ends = [draw_path(START, model(noise=noise), ROAD, 1.0, seed=seed).at(1.0).x for seed in range(3000)]
    assert np.var(ends) == pytest.approx(2 * 0.09 + 0.25 * 0.04, rel=4 * 0.0258)


def test_another_policy_leaves_the_noise_as_it_was():
    noise = Noise(process_position_var=0.09)
    cruising, mixed = (
        draw_path(START, model(longitudinal=p, noise=noise), ROAD, 5.0, seed=3)
        for p in ((0.0, 1.0, 0.0), (0.3, 0.4, 0.3))
    )
    assert [p.noise_x for p in cruising.periods] == [p.noise_x for p in mixed.periods]
    assert [p.state for p in cruising.periods] != [p.state for p in mixed.periods]


def test_nobody_drives_backwards():
    noise = Noise(process_speed_var=4.0)
    slow = VehicleState("a", x=0.0, y=0.0, speed=1.0, lane=2)
    path = draw_path(slow, model(longitudinal=(0.5, 0.5, 0.0), noise=noise), ROAD, 30.0, seed=5)
    speeds = [path.at(0.1 * k).speed for k in range(300)]
    assert min(speeds) == 0.0


def test_times_beyond_the_path_and_dead_ends_are_errors():
    path = draw_path(START, model(), ROAD, 1.0, seed=1)
    with pytest.raises(InputError, match="within the drawn"):
        path.at(60.0)
    with pytest.raises(InputError, match="leave it an action in lane 2, mode decelerate"):
        draw_path(
            VehicleState("a", x=0.0, y=0.0, speed=9.0, lane=2, mode=Mode.DECELERATE),
            model(longitudinal=(0.0, 0.0, 1.0)),
            ROAD,
            1.0,
            seed=1,
        )
