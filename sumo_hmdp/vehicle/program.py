"""The quadratic program of the tracking MPC, with fixed sparsity and a solver without memory.

Unknowns, for the steps k = 0..N-1: the inputs u[k] and the states z[k+1] of `linearization.py`, each divided by its
unit, which is the deviation that costs one a second. Objective: the sum of duration * (unknown - target)^2 / 2.
Rows, first the dynamics, then the bounds:

    -B[k] u[k] - A[k] z[k] + z[k+1] = c[k]                                     (6 rows a step; z[0] is known)
    lower[k] <= (jerk, steering_rate, speed, steering_angle, accel) <= upper[k]    (5 rows a step)
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import osqp
import scipy.sparse as sp
from numpy.typing import NDArray

from sumo_hmdp.vehicle.linearization import (
    ACCEL,
    INPUT_SIZE,
    SPEED,
    STATE_SIZE,
    STEERING,
    Transitions,
    X,
)

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

STAGE_SIZE = INPUT_SIZE + STATE_SIZE
BOUNDED = np.array([0, 1, INPUT_SIZE + SPEED, INPUT_SIZE + STEERING, INPUT_SIZE + ACCEL])
BOUND_SIZE = len(BOUNDED)

# With it and the start of `_following` most solutions take 5 to 20 iterations, and rho need not be adapted.
START_RHO = 0.3
SETTINGS: dict[str, Any] = {
    # The units scale well enough, and the solver's own scaling carries round-off from one solution to the next.
    "scaling": 0,
    "rho": START_RHO,
    "adaptive_rho": 1,  # by iterations, never by time
    "adaptive_rho_interval": 20,
    "check_termination": 5,
    "eps_abs": 1e-5,
    "eps_rel": 1e-5,
    "polishing": True,
    "verbose": False,
}

# Entries of A[k] and B[k] that can differ from zero.
A_PATTERN = np.array(
    [
        [1, 0, 1, 1, 1, 1],
        [0, 1, 1, 1, 1, 1],
        [0, 0, 1, 1, 1, 1],
        [0, 0, 0, 1, 0, 1],
        [0, 0, 0, 0, 1, 0],
        [0, 0, 0, 0, 0, 1],
    ],
    dtype=bool,
)
B_PATTERN = np.array([[1, 1], [1, 1], [1, 1], [1, 0], [0, 1], [1, 0]], dtype=bool)


@dataclass(frozen=True, eq=False)
class WarmStart:
    """Where the solver begins.

    Attributes:
        unknowns: in their units, shape (8 N,).
        multipliers: of the rows, shape (11 N,).
    """

    unknowns: FloatArray
    multipliers: FloatArray


@dataclass(frozen=True, eq=False)
class Solution:
    """The solver's answer.

    Attributes:
        solved: to the tolerances.
        status: in the solver's words.
        iterations: it took.
        inputs: jerk [m/s3] and steering rate [rad/s], shape (N, 2); without meaning unless solved.
        warm_start: for the solution one step later; None unless solved.
    """

    solved: bool
    status: str
    iterations: int
    inputs: FloatArray
    warm_start: WarmStart | None


class TrackingProgram:
    """The program for N steps, set up once; `solve` replaces all of its numbers and leaves no trace."""

    def __init__(self, costs: FloatArray, durations: FloatArray, max_iterations: int) -> None:
        """Set up.

        Args:
            costs: of the squares of jerk, steering rate and z, per second, in SI units, > 0, shape (8,).
            durations: of the steps [s], shape (N,).
            max_iterations: after which the solver gives up.
        """
        self.steps = steps = len(durations)
        self._units = 1 / np.sqrt(costs)
        self._input_units, self._state_units = np.split(self._units, [INPUT_SIZE])
        self._equal_steps = bool((durations == durations[0]).all())
        self._adapted = False
        self._costs = np.repeat(durations / durations[-1], STAGE_SIZE)
        self._cold = WarmStart(np.zeros(steps * STAGE_SIZE), np.zeros(steps * (STATE_SIZE + BOUND_SIZE)))
        matrix, self._order = _constraint_pattern(steps)
        self._ones = np.ones(steps * (STATE_SIZE + BOUND_SIZE))
        self._solver = osqp.OSQP()
        self._solver.setup(
            sp.csc_matrix(sp.diags_array(self._costs)),
            np.zeros(matrix.shape[1]),
            matrix,
            np.zeros(matrix.shape[0]),
            np.zeros(matrix.shape[0]),
            max_iter=max_iterations,
            **SETTINGS,
        )

    def solve(
        self,
        transitions: Transitions,
        start: FloatArray,
        targets: FloatArray,
        bounds: tuple[FloatArray, FloatArray],
        warm_start: WarmStart | None,
    ) -> Solution:
        """Solve with new numbers.

        Args:
            transitions: of the N steps.
            start: z[0], shape (6,).
            targets: z[1..N] aimed at, shape (N, 6); the inputs aim at zero.
            bounds: lower and upper, each of shape (N, 5), in SI units.
            warm_start: where to begin, None for zeros.
        """
        aims = np.zeros((self.steps, STAGE_SIZE))
        aims[:, INPUT_SIZE:] = targets / self._state_units
        offsets = transitions.c.copy()
        offsets[0] += transitions.A[0] @ start
        dynamics = (offsets / self._state_units).ravel()
        lower, upper = ((bound / self._units[BOUNDED]).ravel() for bound in bounds)
        begin = warm_start or self._cold
        self._solver.update(
            q=-self._costs * aims.ravel(),
            l=np.concatenate((dynamics, lower)),
            u=np.concatenate((dynamics, upper)),
            Ax=self._matrix_data(transitions),
        )
        if self._adapted:
            # The solver adapts rho during a solution: every one starts from the same.
            self._solver.update_settings(rho=START_RHO)
        self._solver.warm_start(x=begin.unknowns, y=begin.multipliers)
        result = self._solver.solve(raise_error=False)
        solved = result.info.status_val == osqp.SolverStatus.OSQP_SOLVED
        self._adapted = result.info.rho_updates > 0
        unknowns = np.array(result.x).reshape(self.steps, STAGE_SIZE)
        inputs = unknowns[:, :INPUT_SIZE] * self._input_units
        following = self._following(unknowns, np.array(result.y)) if solved else None
        return Solution(solved, str(result.info.status), int(result.info.iter), inputs, following)

    def _following(self, unknowns: FloatArray, multipliers: FloatArray) -> WarmStart:
        """Return what is likely to solve the program one step later, in which x counts from the front bumper then.

        Where all steps are equal that is the rest of the solution, its last step repeated. Where the first one is
        shorter the steps of the next program lie nearly as far ahead of the vehicle as these.
        """
        if not self._equal_steps:
            return WarmStart(unknowns.ravel(), multipliers)
        later = _without_first(unknowns)
        x = INPUT_SIZE + X
        if self.steps > 1:
            later[-1, x] += unknowns[-1, x] - unknowns[-2, x]
        later[:, x] -= unknowns[0, x]
        dynamics, bounds = multipliers[: self.steps * STATE_SIZE], multipliers[self.steps * STATE_SIZE :]
        rest = [_without_first(part.reshape(self.steps, -1)).ravel() for part in (dynamics, bounds)]
        return WarmStart(later.ravel(), np.concatenate(rest))

    def _matrix_data(self, transitions: Transitions) -> FloatArray:
        """Return the entries of the constraint matrix in the solver's order."""
        B = transitions.B * self._input_units / self._state_units[:, None]
        A = transitions.A[1:] * self._state_units / self._state_units[:, None]
        return np.concatenate([-B.ravel(), -A.ravel(), self._ones]).take(self._order)


def _without_first(rows: FloatArray) -> FloatArray:
    """Return rows 1.., the last one twice."""
    return np.concatenate([rows[1:], rows[-1:]])


def _constraint_pattern(steps: int) -> tuple[sp.csc_matrix, IntArray]:
    """Return the constraint matrix with ones in its pattern, and where each of its data comes from.

    Its data are counted as in `_matrix_data`: B of all steps, A of all but the first, the unit entries of the next
    states, the unit entries of the bounds. Entries of B and A that are always zero are counted, but in no place.
    """
    k = np.arange(steps)[:, None]
    b_row, b_column = np.nonzero(B_PATTERN)
    a_row, a_column = np.nonzero(A_PATTERN)
    state, bound = np.arange(STATE_SIZE), np.arange(BOUND_SIZE)
    rows = (
        STATE_SIZE * k + b_row,
        STATE_SIZE * k[1:] + a_row,
        STATE_SIZE * k + state,
        STATE_SIZE * steps + BOUND_SIZE * k + bound,
    )
    columns = (
        STAGE_SIZE * k + b_column,
        STAGE_SIZE * k[:-1] + INPUT_SIZE + a_column,
        STAGE_SIZE * k + INPUT_SIZE + state,
        STAGE_SIZE * k + BOUNDED,
    )
    b_count, a_count = steps * STATE_SIZE * INPUT_SIZE, (steps - 1) * STATE_SIZE**2
    numbers = (
        STATE_SIZE * INPUT_SIZE * k + INPUT_SIZE * b_row + b_column,
        b_count + STATE_SIZE**2 * k[:-1] + STATE_SIZE * a_row + a_column,
        b_count + a_count + np.arange(steps * (STATE_SIZE + BOUND_SIZE)),
    )
    row, column, number = (np.concatenate([part.ravel() for part in parts]) for parts in (rows, columns, numbers))
    shape = (steps * (STATE_SIZE + BOUND_SIZE), steps * STAGE_SIZE)
    # Numbered from 1, as an entry of zero would be none.
    numbered = sp.csc_matrix((number + 1.0, (row, column)), shape=shape)
    numbered.sort_indices()
    order = numbered.data.astype(np.intp) - 1
    numbered.data[:] = 1.0
    return numbered, order
