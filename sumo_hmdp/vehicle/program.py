"""The quadratic program of the tracking MPC: in closed form where no bound is met, else by an interior-point solver.

Unknowns, for the steps k = 0..N-1: the inputs u[k] and the states z[k+1] of `linearization.py`, each divided by its
unit, which is the deviation that costs one a second. Objective: the sum of duration * (unknown - target)^2 / 2.
Rows, first the dynamics, then the bounds:

    -B[k] u[k] - A[k] z[k] + z[k+1] = c[k]                                     (6 rows a step; z[0] is known)
    lower[k] <= (jerk, steering_rate, speed, steering_angle, accel) <= upper[k]    (5 rows a step)

With w the unknowns, t their targets, D the durations as a diagonal and C w = b the dynamics, the optimum without
bounds is w = t - D^-1 C^T m, where the multipliers m solve S m = C t - b, S = C D^-1 C^T. S is positive definite with
blocks of 6 x 6 on three diagonals, so m takes one banded Cholesky. The program is strictly convex: where this w keeps
the bounds, it is the one optimum with them, too.
"""

from dataclasses import dataclass

import numpy as np
import piqp
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.linalg import lapack

from sumo_hmdp.vehicle.linearization import ACCEL, INPUT_SIZE, SPEED, STATE_SIZE, STEERING, Transitions

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

STAGE_SIZE = INPUT_SIZE + STATE_SIZE
BOUNDED = np.array([0, 1, INPUT_SIZE + SPEED, INPUT_SIZE + STEERING, INPUT_SIZE + ACCEL])
# Entries of a column of S from the diagonal downwards.
BAND = 2 * STATE_SIZE

# Of the solver, on the objective. With its own 1e-8 accelerations came out 6e-4 m/s2 beside the optimum; this takes
# one iteration more.
DUALITY_GAP = 1e-12


@dataclass(frozen=True, eq=False)
class Solution:
    """The optimum, or why there is none.

    Attributes:
        solved: to the tolerances.
        status: in the solver's words.
        iterations: of the solver; zero for the closed form.
        inputs: jerk [m/s3] and steering rate [rad/s], shape (N, 2); without meaning unless solved.
    """

    solved: bool
    status: str
    iterations: int
    inputs: FloatArray


class TrackingProgram:
    """The program for N steps; `solve` takes all that changes and leaves no trace."""

    def __init__(self, costs: FloatArray, durations: FloatArray, max_iterations: int) -> None:
        """Set up.

        Args:
            costs: of the squares of jerk, steering rate and z, per second, in SI units, > 0, shape (8,).
            durations: of the steps [s], shape (N,).
            max_iterations: after which the solver gives up.
        """
        self._units = 1 / np.sqrt(costs)
        self._state_units = self._units[INPUT_SIZE:]
        self._ratios = self._units / self._state_units[:, None]
        self._durations = durations[:, None]
        self._costs = sp.diags_array(np.repeat(durations, STAGE_SIZE), format="csc")
        self._inverse = 1 / self._durations
        # D^-1 of what each step starts from, (u[k], z[k]); z[0] is no unknown.
        self._before = np.repeat(self._inverse, STAGE_SIZE, axis=1)
        self._before[1:, INPUT_SIZE:] = self._inverse[:-1]
        self._before[0, INPUT_SIZE:] = 0.0
        self._band_order = _band_order(len(durations))
        self._max_iterations = max_iterations

    def solve(
        self, transitions: Transitions, start: FloatArray, targets: FloatArray, bounds: tuple[FloatArray, FloatArray]
    ) -> Solution:
        """Return the optimum.

        Args:
            transitions: of the N steps.
            start: z[0], shape (6,).
            targets: z[1..N] aimed at, shape (N, 6); the inputs aim at zero.
            bounds: lower and upper, each of shape (N, 5), in SI units.
        """
        F = transitions.F * self._ratios  # (N, 6, 8)
        c = transitions.c / self._state_units
        z = np.concatenate([start[None], targets]) / self._state_units  # (N + 1, 6)
        unknowns = self._free_optimum(F, c, z) * self._units
        bounded = unknowns[:, BOUNDED]
        lower, upper = bounds
        if ((lower <= bounded) & (bounded <= upper)).all():
            return Solution(solved=True, status="solved", iterations=0, inputs=unknowns[:, :INPUT_SIZE])
        return self._bounded_optimum(F, c, z, bounds)

    def _free_optimum(self, F: FloatArray, c: FloatArray, z: FloatArray) -> FloatArray:
        """Return the unknowns, shape (N, 8), that are best without bounds; all in units.

        Args:
            F: [B A] of the steps, shape (N, 6, 8).
            c: shape (N, 6).
            z: z[0] as it is and z[1..N] as aimed at, shape (N + 1, 6).
        """
        steps = len(c)
        weighted = F * self._before[:, None, :]
        blocks = np.zeros((steps, STATE_SIZE, BAND))  # of each column of S: the diagonal block and the one below
        np.matmul(weighted, F.transpose(0, 2, 1), out=blocks[:, :, :STATE_SIZE])
        blocks.reshape(steps, -1)[:, : STATE_SIZE * BAND : BAND + 1] += self._inverse
        blocks[:-1, :, STATE_SIZE:] = -weighted[1:, :, INPUT_SIZE:].transpose(0, 2, 1)
        band = blocks.ravel().take(self._band_order).T
        missing = z[1:] - np.matvec(F[:, :, INPUT_SIZE:], z[:-1]) - c
        _, m, failed = lapack.dpbsv(band, missing.ravel(), lower=1, overwrite_ab=1, overwrite_b=1)
        if failed:  # numbers that are not finite, or far out of scale
            return np.full((steps, STAGE_SIZE), np.nan)  # which keeps no bound
        m = m.reshape(steps, STATE_SIZE)
        pull: FloatArray = np.vecmat(m, F)  # (N, 8): B^T m and A^T m
        pull[:-1, INPUT_SIZE:] = pull[1:, INPUT_SIZE:] - m[:-1]
        pull[-1, INPUT_SIZE:] = -m[-1]
        pull *= self._inverse
        pull[:, INPUT_SIZE:] += z[1:]
        return pull

    def _bounded_optimum(
        self, F: FloatArray, c: FloatArray, z: FloatArray, bounds: tuple[FloatArray, FloatArray]
    ) -> Solution:
        """Solve with the bounds, of shape (N, 5) in SI units; the rest as in `_free_optimum`."""
        steps = len(c)
        k = np.arange(steps)
        dynamics = np.zeros((steps, STATE_SIZE, steps, STAGE_SIZE))
        dynamics[k, :, k, :INPUT_SIZE] = -F[:, :, :INPUT_SIZE]
        dynamics[k[1:], :, k[:-1], INPUT_SIZE:] = -F[1:, :, INPUT_SIZE:]
        dynamics[k, :, k, INPUT_SIZE:] = np.eye(STATE_SIZE)
        right = c.copy()
        right[0] += F[0, :, INPUT_SIZE:] @ z[0]
        targets = np.zeros((steps, STAGE_SIZE))
        targets[:, INPUT_SIZE:] = z[1:]
        lower, upper = np.full(targets.shape, -np.inf), np.full(targets.shape, np.inf)
        lower[:, BOUNDED], upper[:, BOUNDED] = (bound / self._units[BOUNDED] for bound in bounds)
        solver = piqp.SparseSolver()
        solver.settings.max_iter = self._max_iterations
        solver.settings.eps_duality_gap_abs = solver.settings.eps_duality_gap_rel = DUALITY_GAP
        solver.setup(
            self._costs,
            -(self._durations * targets).ravel(),
            sp.csc_array(dynamics.reshape(right.size, targets.size)),
            right.ravel(),
            x_l=lower.ravel(),
            x_u=upper.ravel(),
        )
        status = solver.solve()
        inputs = solver.result.x.reshape(targets.shape)[:, :INPUT_SIZE] * self._units[:INPUT_SIZE]
        words = status.name.removeprefix("PIQP_").lower().replace("_", " ")
        return Solution(status == piqp.PIQP_SOLVED, words, solver.result.info.iter, inputs)


def _band_order(steps: int) -> IntArray:
    """Return where in the blocks of `_free_optimum` the lower band of S is, shape (6 N, 12), a row a column of S."""
    k, column, down = np.ogrid[:steps, :STATE_SIZE, :BAND]
    row = column + down
    place = (STATE_SIZE * k + column) * BAND + row
    nothing = steps * STATE_SIZE * BAND - 1  # below the last step there is none
    return np.where(row < BAND, place, nothing).reshape(-1, BAND)
