"""The quadratic program against a least-squares solver that sees the inputs only."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from sumo_hmdp.vehicle.bicycle import BicycleParameters
from sumo_hmdp.vehicle.linearization import transitions
from sumo_hmdp.vehicle.program import TrackingProgram

STEPS = 6
COSTS = np.array([0.01, 2.0, 1.0, 20.0, 3.0, 5.0, 1.0, 0.5])
DURATIONS = np.array([0.05, 0.1, 0.1, 0.1, 0.1, 0.1])
WIDE = np.array([1e3] * 5)


def example():
    rng = np.random.default_rng(4)
    points = np.array([0, 0, 0.05, 15.0, 0.02, 0.5]) + 0.01 * rng.standard_normal((STEPS, 6))
    moves = transitions(points, BicycleParameters(), DURATIONS)
    start = np.array([0.0, 0.3, 0.02, 14.0, 0.01, 0.0])
    travel = np.cumsum(DURATIONS)
    targets = np.stack([15 * travel, 0 * travel, 0 * travel, 15 + 0 * travel, 0 * travel, 0 * travel], axis=1)
    return moves, start, targets


def by_least_squares(moves, start, targets, input_limits):
    """Stack sqrt(cost) * deviation of all states and inputs, which are affine in the inputs."""

    def deviations(inputs):
        z, rows = start, []
        for k in range(STEPS):
            z = moves.A[k] @ z + moves.B[k] @ inputs[k] + moves.c[k]
            rows.append(np.sqrt(DURATIONS[k] * COSTS) * np.concatenate([inputs[k], z - targets[k]]))
        return np.concatenate(rows)

    at_zero = deviations(np.zeros((STEPS, 2)))
    columns = [deviations(unit.reshape(STEPS, 2)) - at_zero for unit in np.eye(2 * STEPS)]
    limits = np.tile(input_limits, STEPS)
    result = lsq_linear(np.array(columns).T, -at_zero, bounds=(-limits, limits), tol=1e-14, method="bvls")
    return result.x.reshape(STEPS, 2)


@pytest.mark.parametrize("input_limits", [(1e3, 1e3), (4.0, 0.1)], ids=["free", "limited"])
def test_the_inputs_are_those_of_least_squares(input_limits):
    moves, start, targets = example()
    bound = np.tile(np.concatenate([input_limits, WIDE[2:]]), (STEPS, 1))

    got = TrackingProgram(COSTS, DURATIONS, 4000).solve(moves, start, targets, (-bound, bound), None)

    expected = by_least_squares(moves, start, targets, input_limits)
    assert got.solved
    if input_limits[0] == 4.0:
        assert np.abs(expected[:, 0]).max() == pytest.approx(4.0)
        assert np.abs(expected[:, 1]).max() == pytest.approx(0.1)
    np.testing.assert_allclose(got.inputs, expected, atol=1e-4)


@pytest.mark.parametrize(("row", "state"), [(2, 3), (3, 4), (4, 5)], ids=["speed", "steering", "accel"])
def test_bounds_of_the_states_hold(row, state):
    moves, start, targets = example()

    def largest(limit: float) -> float:
        upper = np.tile(WIDE, (STEPS, 1))
        upper[:, row] = limit
        bounds = (np.tile(-WIDE, (STEPS, 1)), upper)
        inputs = TrackingProgram(COSTS, DURATIONS, 4000).solve(moves, start, targets, bounds, None).inputs
        z, values = start, []
        for k in range(STEPS):
            z = moves.A[k] @ z + moves.B[k] @ inputs[k] + moves.c[k]
            values.append(z[state])
        return max(values)

    free = largest(1e3)
    limit = start[state] + (free - start[state]) / 2

    assert free > start[state] + 1e-4
    assert largest(limit) == pytest.approx(limit, abs=1e-4)


def test_contradicting_bounds_are_reported():
    moves, start, targets = example()
    bound = np.tile(WIDE, (STEPS, 1))
    bound[:, 1] = 0.01
    lower, upper = -bound, bound.copy()
    lower[:, 3] = 0.4  # the steering angle, out of reach at 0.01 rad/s

    got = TrackingProgram(COSTS, DURATIONS, 4000).solve(moves, start, targets, (lower, upper), None)

    assert not got.solved
    assert "infeasible" in got.status
    assert got.warm_start is None


def test_the_first_solution_is_found_at_once_from_itself():
    moves, start, targets = example()
    bounds = (np.tile(-WIDE, (STEPS, 1)), np.tile(WIDE, (STEPS, 1)))
    program = TrackingProgram(COSTS, DURATIONS, 4000)
    cold = program.solve(moves, start, targets, bounds, None)
    # The warm start counts x from the bumper after the first step, so the same problem again is moved by it.
    first = moves.A[0] @ start + moves.B[0] @ cold.inputs[0] + moves.c[0]
    shift = np.array([first[0], 0, 0, 0, 0, 0])

    warm = program.solve(moves, start - shift, targets - shift, bounds, cold.warm_start)

    assert warm.iterations < cold.iterations
    np.testing.assert_allclose(warm.inputs, cold.inputs, atol=1e-5)
