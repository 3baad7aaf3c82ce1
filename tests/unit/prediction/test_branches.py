"""Branches worked by hand, and against a walk through all 9^H sequences."""

import itertools
from fractions import Fraction

import numpy as np
import pytest

from sumo_hmdp.domain.maneuver import ACTIONS, ManeuverState, Mode, transition
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.prediction.branches import PredictedVehicle, PredictionSettings, covariances, lateral_means, predict
from sumo_hmdp.prediction.dynamics import LateralGains, Noise
from sumo_hmdp.prediction.policy import Policy, ScheduledPolicy, action_probabilities, dead_end

KEEP = (0.0, 1.0, 0.0)
CERTAIN = Noise()
CRUISE = (0.0, 1.0, 0.0)


def vehicle(lateral, longitudinal, *, lane=2, mode=Mode.CRUISE, speed=20.0, noise=CERTAIN, **state):
    rows = lateral if isinstance(lateral[0], tuple) else (lateral,) * 3
    return PredictedVehicle(
        VehicleState("sv", state.pop("x", 0.0), state.pop("y", 0.0), speed, lane, mode, **state),
        Policy(rows, longitudinal),
        noise,
    )


def settings(H=3, period=0.5, threshold=1e-9, action_threshold=0.0, gains=None):
    return PredictionSettings(H, period, 2.0, threshold, action_threshold, gains)


def enumerate_all(car, H):
    """Every sequence with positive probability, by brute force: (probability, lanes, modes)."""
    table = action_probabilities(car.policy)
    result = {}
    for sequence in itertools.product(range(9), repeat=H):
        state, probability, path = ManeuverState(car.state.lane, car.state.mode), 1.0, []
        for a in sequence:
            probability *= table[state.lane - 1, state.mode + 1, a]
            if probability == 0:
                break
            state = transition(state, ACTIONS[a], 3)
            path.append((state.lane, int(state.mode)))
        else:
            result[sequence] = (probability, path)
    return result


@pytest.mark.parametrize("threshold", [1e-9, 1e-3, 0.02, 0.2, 0.9])
def test_retained_branches_are_those_of_a_full_enumeration(threshold):
    car = vehicle(((0.0, 0.8, 0.2), (0.15, 0.7, 0.15), (0.3, 0.7, 0.0)), (0.2, 0.5, 0.3), mode=Mode.ACCELERATE)
    H = 4
    everything = enumerate_all(car, H)
    kept = {s: r for s, r in everything.items() if r[0] >= threshold}
    if not kept:
        likeliest = max(everything, key=lambda s: everything[s][0])
        kept = {likeliest: everything[likeliest]}
    branches = predict([car], settings(H, threshold=threshold))
    found = sorted(zip(branches.probability, map(tuple, branches.lanes), map(tuple, branches.modes), strict=True))
    expected = sorted((p, tuple(s[0] for s in path), tuple(s[1] for s in path)) for p, path in kept.values())
    assert len(found) == len(expected)
    for (p, lanes, modes), (q, want_lanes, want_modes) in zip(found, expected, strict=True):
        assert p == pytest.approx(q, rel=1e-12)
        assert (lanes, modes) == (want_lanes, want_modes)
    assert branches.pruned[0] == pytest.approx(1 - sum(p for p, _ in kept.values()), abs=1e-12)


def test_of_equally_likely_sequences_the_first_is_kept():
    rng = np.random.default_rng(7)
    tied = 0
    for _ in range(60):
        # Out of lane 1 and back now, or a step later: the same factors, multiplied in another order.
        keep, right, back = rng.uniform((0.35, 0.35, 0.45), (0.4, 0.4, 0.6))
        rows = ((1 - keep - right, keep, right), (back, 0.9 - back, 0.1), (0.9, 0.1, 0.0))
        car = vehicle(rows, CRUISE, lane=int(rng.integers(1, 4)))
        exact = {}
        for actions in itertools.product((0, 3, 6), repeat=5):
            state, probability = ManeuverState(car.state.lane, Mode.CRUISE), Fraction(1)
            for a in actions:
                probability *= Fraction(action_probabilities(car.policy)[state.lane - 1, 1, a])
                state = transition(state, ACTIONS[a], 3) or state
            exact[actions] = probability
        likeliest = [actions for actions, p in exact.items() if p >= max(exact.values()) * (1 - Fraction(1, 10**12))]
        tied += len(likeliest) > 1
        branches = predict([car], settings(5, threshold=1.0))
        laterals = [int(ACTIONS[a].lateral) for a in min(likeliest)]
        assert branches.laterals.tolist() == [laterals]
    assert tied >= 10


def test_masked_actions_are_renormalised():
    table = action_probabilities(Policy(((0.1, 0.8, 0.1),) * 3, (0.2, 0.6, 0.2)))
    # Lane 1, accelerating: no left, next mode cruise or accelerate; 0.9 * 0.8 of the product is left.
    row = table[0, 2]
    assert row.sum() == pytest.approx(1.0)
    assert row[0] == pytest.approx(0.8 * 0.2 / 0.72)
    assert row[2] == pytest.approx(0.8 * 0.6 / 0.72)
    assert row[1] == row[3] == 0


def test_a_single_unlikely_action_is_dropped_by_its_own_threshold():
    car = vehicle(KEEP, (0.05, 0.9, 0.05))
    all_of_them = predict([car], settings(2))
    # Threshold 0.1 leaves only cruising: 0.9^2.
    pruned = predict([car], settings(2, action_threshold=0.1))
    assert len(all_of_them.vehicle) > len(pruned.vehicle) == 1
    assert pruned.probability[0] == pytest.approx(0.81)
    assert pruned.pruned[0] == pytest.approx(0.19)


def test_the_mode_before_the_action_moves_a_surrounding_vehicle():
    car = vehicle(KEEP, (0.0, 0.0, 1.0), mode=Mode.CRUISE, x=10.0)
    branches = predict([car], settings(2, period=0.5))
    # First step still cruising: 20 * 0.5; then 2 m/s2 for 0.5 s: 20 * 0.5 + 0.25.
    assert branches.x[0].tolist() == pytest.approx([20.0, 30.25])
    assert branches.speed[0].tolist() == pytest.approx([20.0, 21.0])
    assert branches.modes[0].tolist() == [1, 1]


def test_a_decelerating_vehicle_stops_and_stands():
    car = vehicle(KEEP, (1.0, 0.0, 0.0), mode=Mode.DECELERATE, speed=1.5)
    branches = predict([car], settings(4, period=0.5))
    # 1.5 -> 0.5 over 0.5 m; then 0.5^2 / (2 * 2) = 0.0625 m to the stop.
    assert branches.speed[0].tolist() == pytest.approx([0.5, 0.0, 0.0, 0.0])
    assert branches.x[0].tolist() == pytest.approx([0.5, 0.5625, 0.5625, 0.5625])


def test_by_the_papers_law_a_lane_change_is_pulled_towards_the_new_lane():
    car = vehicle((1.0, 0.0, 0.0), CRUISE, lane=2, lateral_speed=0.4)
    config = settings(1, period=0.8, gains=LateralGains())
    y = lateral_means(predict([car], config), Road(3, 4.0), config)
    # T^2/2 = 0.32: (1 - 3 * 0.32) * 0 + 0.32 * (3 * 4 - 1 * 0.4)
    assert y[0, 0] == pytest.approx(0.32 * 11.6)


def test_full_covariance_agrees_with_the_recursion_for_x():
    noise = Noise(0.4, 0.09, 0.05, 0.02)
    car = vehicle((0.2, 0.6, 0.2), (0.1, 0.8, 0.1), noise=noise)
    config = settings(5, period=0.7)
    branches = predict([car], config)
    for row in (0, len(branches.vehicle) - 1):
        full = covariances(branches, row, config)
        assert np.sqrt(full[:, 0, 0]) == pytest.approx(branches.x_std[0], rel=1e-12)
        assert np.allclose(full, np.transpose(full, (0, 2, 1)))
        assert np.linalg.eigvalsh(full).min() >= 0


def test_the_covariance_of_a_lane_change_shrinks_across_the_road():
    gains = LateralGains(3.0, 1.0)
    config = PredictionSettings(1, 0.6, 2.0, 1e-9, 0.0, gains)
    changing = predict([vehicle((1.0, 0.0, 0.0), CRUISE, noise=Noise(1.0))], config)
    # y_from_y = 1 - 3 * 0.36 / 2 = 0.46, so the variance falls to 0.46^2.
    assert covariances(changing, 0, config)[0, 1, 1] == pytest.approx(0.46**2)


def test_no_vehicles_give_no_branches():
    branches = predict([], settings())
    assert branches.vehicle.shape == (0,)
    assert branches.x.shape == (0, 3)
    assert branches.pruned.shape == (0,)


def test_many_vehicles_at_once_equal_each_alone():
    cars = [
        vehicle((0.1, 0.8, 0.1), (0.1, 0.8, 0.1), lane=lane, mode=mode, x=10.0 * lane, speed=5.0 + lane)
        for lane in (1, 2, 3)
        for mode in Mode
    ]
    together = predict(cars, settings(3, threshold=1e-3))
    for index, car in enumerate(cars):
        alone = predict([car], settings(3, threshold=1e-3))
        rows = together.vehicle == index
        assert np.array_equal(together.x[rows], alone.x)
        assert np.array_equal(together.lanes[rows], alone.lanes)
        assert np.array_equal(together.probability[rows], alone.probability)


def test_number_of_branches_is_bounded_by_the_threshold():
    # 9^12 sequences on paper; each that is kept has at least 1e-4 of a probability that sums to 1.
    car = vehicle((0.1, 0.8, 0.1), (0.1, 0.8, 0.1))
    branches = predict([car], settings(12, threshold=1e-4))
    assert 1 < len(branches.vehicle) <= 1e4
    assert branches.probability.min() >= 1e-4 * (1 - 1e-9)


def test_scheduled_policy_changes_at_its_instants():
    first, second = Policy((KEEP,) * 3, CRUISE), Policy((KEEP,) * 3, (0.0, 0.1, 0.9))
    schedule = ScheduledPolicy(((0.0, first), (7.8, second)))
    assert schedule.at(7.2) is first
    # 13 * 0.6 is 7.799999999999999 in binary.
    assert schedule.at(13 * 0.6) is second
    assert schedule.at(100.0) is second


def test_a_policy_without_an_admissible_action_is_found():
    only_accelerate = Policy((KEEP,) * 3, (0.0, 0.0, 1.0))
    assert dead_end(only_accelerate, ManeuverState(2, Mode.CRUISE), 3) is None
    assert dead_end(only_accelerate, ManeuverState(2, Mode.DECELERATE), 3) == ManeuverState(2, Mode.DECELERATE)
    only_left = Policy(((1.0, 0.0, 0.0),) * 3, CRUISE)
    assert dead_end(only_left, ManeuverState(2, Mode.CRUISE), 1) is None
    assert dead_end(only_left, ManeuverState(2, Mode.CRUISE), 2) == ManeuverState(1, Mode.CRUISE)
