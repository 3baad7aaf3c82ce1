"""The quadratic program against solvers that see the inputs only, and against its dense system of equations."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear, minimize

from sumo_hmdp.vehicle.bicycle import BicycleParameters
from sumo_hmdp.vehicle.linearization import transitions
from sumo_hmdp.vehicle.program import TrackingProgram

STEPS = 6
COSTS = np.array([0.01, 2.0, 1.0, 20.0, 3.0, 5.0, 1.0, 0.5])
DURATIONS = np.array([0.05, 0.1, 0.1, 0.1, 0.1, 0.1])
WIDE = np.array([1e3] * 5)


def example(seed=4):
    rng = np.random.default_rng(seed)
    points = np.array([0, 0, 0.05, 15.0, 0.02, 0.5]) + 0.01 * rng.standard_normal((STEPS, 6))
    moves = transitions(points, BicycleParameters(), DURATIONS)
    start = np.array([0.0, 0.3, 0.02, 14.0, 0.01, 0.0])
    travel = np.cumsum(DURATIONS)
    targets = np.stack([15 * travel, 0 * travel, 0 * travel, 15 + 0 * travel, 0 * travel, 0 * travel], axis=1)
    return moves, start, targets


def states(moves, start, inputs):
    z = [start]
    for k in range(STEPS):
        z.append(moves.F[k] @ np.concatenate([inputs[k], z[-1]]) + moves.c[k])
    return np.array(z[1:])


def solve(moves, start, targets, lower, upper):
    return TrackingProgram(COSTS, DURATIONS, 250).solve(moves, start, targets, (lower, upper))


def affine(function):
    """Return the matrix and the constant of an affine function of the inputs."""
    at_zero = function(np.zeros((STEPS, 2)))
    return np.array([function(unit.reshape(STEPS, 2)) - at_zero for unit in np.eye(2 * STEPS)]).T, at_zero


def weighted_deviations(moves, start, targets):
    """Stack sqrt(cost) * deviation of all states and inputs, which are affine in the inputs."""

    def deviations(inputs):
        z = states(moves, start, inputs)
        return (np.sqrt(DURATIONS[:, None] * COSTS) * np.concatenate([inputs, z - targets], axis=1)).ravel()

    return affine(deviations)


def by_least_squares(moves, start, targets, input_limits):
    matrix, at_zero = weighted_deviations(moves, start, targets)
    limits = np.tile(input_limits, STEPS)
    result = lsq_linear(matrix, -at_zero, bounds=(-limits, limits), tol=1e-14, method="bvls")
    return result.x.reshape(STEPS, 2)


def by_sequential_quadratic_programming(moves, start, targets, lower, upper):
    matrix, at_zero = weighted_deviations(moves, start, targets)
    rows, rows_at_zero = affine(lambda inputs: np.hstack([inputs, states(moves, start, inputs)[:, 3:]]).ravel())
    low, high = lower.ravel() - rows_at_zero, upper.ravel() - rows_at_zero
    result = minimize(
        lambda u: ((matrix @ u + at_zero) ** 2).sum(),
        np.zeros(2 * STEPS),
        jac=lambda u: 2 * matrix.T @ (matrix @ u + at_zero),
        method="SLSQP",
        constraints=[
            {"type": "ineq", "fun": lambda u: rows @ u - low, "jac": lambda _: rows},
            {"type": "ineq", "fun": lambda u: high - rows @ u, "jac": lambda _: -rows},
        ],
        options={"ftol": 1e-14, "maxiter": 500},
    )
    assert result.success
    return result.x.reshape(STEPS, 2)


def by_dense_equations(moves, start, targets):
    """Return the inputs that solve the conditions of stationarity and the dynamics, states and multipliers as well."""
    size = 8 * STEPS
    dynamics, right = np.zeros((6 * STEPS, size)), moves.c.copy()
    right[0] += moves.F[0, :, 2:] @ start
    for k in range(STEPS):
        rows = slice(6 * k, 6 * k + 6)
        dynamics[rows, 8 * k : 8 * k + 2] = -moves.F[k, :, :2]
        dynamics[rows, 8 * k + 2 : 8 * k + 8] = np.eye(6)
        if k > 0:
            dynamics[rows, 8 * k - 6 : 8 * k] = -moves.F[k, :, 2:]
    costs = np.outer(DURATIONS, COSTS).ravel()
    aims = np.hstack([np.zeros((STEPS, 2)), targets]).ravel()
    matrix = np.block([[np.diag(costs), dynamics.T], [dynamics, np.zeros((6 * STEPS, 6 * STEPS))]])
    return np.linalg.solve(matrix, np.concatenate([costs * aims, right.ravel()]))[:size].reshape(STEPS, 8)[:, :2]


@pytest.mark.parametrize("seed", range(5))
def test_without_bounds_the_inputs_are_those_of_the_dense_equations(seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform([-5, -3, -0.5, 0, -0.5, -8], [50, 3, 0.5, 40, 0.5, 3], (STEPS, 6))
    moves = transitions(points, BicycleParameters(), DURATIONS)
    start, targets = points[0] + rng.standard_normal(6), points + rng.standard_normal((STEPS, 6))
    free = np.full((STEPS, 5), np.inf)

    got = solve(moves, start, targets, -free, free)

    assert (got.solved, got.status, got.iterations) == (True, "solved", 0)
    np.testing.assert_allclose(got.inputs, by_dense_equations(moves, start, targets), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("row", range(5), ids=["jerk", "steering rate", "speed", "steering", "accel"])
@pytest.mark.parametrize("side", [-1, 1], ids=["lower", "upper"])
def test_a_bound_that_is_met_goes_to_the_solver_and_the_optimum_is_that_of_another_one(row, side):
    moves, start, targets = example(row)
    wide = np.tile(WIDE, (STEPS, 1))
    free = solve(moves, start, targets, -wide, wide)
    values = np.hstack([free.inputs, states(moves, start, free.inputs)[:, 3:]])[:, row]
    begin = 0.0 if row < 2 else start[row + 1]
    lower, upper = -wide, wide.copy()
    bound = lower if side < 0 else upper
    # As far as the optimum goes to this side, or half of it.
    farthest = side * (side * values).max()

    bound[:, row] = farthest + side * 1e-6
    beside = solve(moves, start, targets, lower, upper)
    bound[:, row] = begin + (farthest - begin) / 2 if side * (farthest - begin) > 1e-3 else farthest - side * 1e-3
    met = solve(moves, start, targets, lower, upper)

    assert beside.iterations == 0
    np.testing.assert_array_equal(beside.inputs, free.inputs)
    assert met.solved
    assert met.iterations > 0
    other = by_sequential_quadratic_programming(moves, start, targets, lower, upper)
    matrix, at_zero = weighted_deviations(moves, start, targets)
    cost, cost_of_other = (((matrix @ inputs.ravel() + at_zero) ** 2).sum() for inputs in (met.inputs, other))
    assert np.abs(met.inputs - free.inputs).max() > 1e-4
    kept = np.hstack([met.inputs, states(moves, start, met.inputs)[:, 3:]])
    assert (kept >= lower - 1e-7).all()
    assert (kept <= upper + 1e-7).all()
    assert cost == pytest.approx(cost_of_other, rel=1e-8)
    np.testing.assert_allclose(met.inputs, other, atol=1e-5)


@pytest.mark.parametrize("input_limits", [(1e3, 1e3), (4.0, 0.1)], ids=["free", "limited"])
def test_the_inputs_are_those_of_least_squares(input_limits):
    moves, start, targets = example()
    bound = np.tile(np.concatenate([input_limits, WIDE[2:]]), (STEPS, 1))

    got = solve(moves, start, targets, -bound, bound)

    expected = by_least_squares(moves, start, targets, input_limits)
    assert got.solved
    if input_limits[0] == 4.0:
        assert np.abs(expected[:, 0]).max() == pytest.approx(4.0)
        assert np.abs(expected[:, 1]).max() == pytest.approx(0.1)
    np.testing.assert_allclose(got.inputs, expected, atol=1e-6)


def test_contradicting_bounds_are_reported():
    moves, start, targets = example()
    bound = np.tile(WIDE, (STEPS, 1))
    bound[:, 1] = 0.01
    lower, upper = -bound, bound.copy()
    lower[:, 3] = 0.4  # the steering angle, out of reach at 0.01 rad/s

    got = solve(moves, start, targets, lower, upper)

    assert not got.solved
    assert "infeasible" in got.status


def test_a_number_that_is_none_is_never_called_solved():
    moves, start, targets = example()
    targets[3, 1] = np.nan
    free = np.full((STEPS, 5), np.inf)

    assert not solve(moves, start, targets, -free, free).solved
