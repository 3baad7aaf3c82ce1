"""Affine-Gaussian motion of a surrounding vehicle, state (x, y, v) (docs/formulation.md, eqs. 4 to 6)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.domain.maneuver import Lateral

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Noise:
    """Uncertainty of one vehicle.

    Attributes:
        position_var: of the measured position [m2].
        speed_var: of the measured speed [m2/s2].
        process_position_var: added to x in each step, and by the paper's law to y as well [m2].
        process_speed_var: added to the speed in each step [m2/s2].
        lateral_var: of the measured y [m2]; None takes `position_var`.
        process_lateral_var: added to y in each step where a driver follows its lane [m2].
    """

    position_var: float = 0.0
    speed_var: float = 0.0
    process_position_var: float = 0.0
    process_speed_var: float = 0.0
    lateral_var: float | None = None
    process_lateral_var: float = 0.0

    @property
    def initial_lateral_var(self) -> float:
        """Q_yy of the measured y [m2]."""
        return self.position_var if self.lateral_var is None else self.lateral_var

    def initial_covariance(self) -> FloatArray:
        """Return Q of the measured (x, y, v), shape (3, 3)."""
        return np.diag([self.position_var, self.initial_lateral_var, self.speed_var])

    def process_covariance(self) -> FloatArray:
        """Return Xi of one step by the paper's law, shape (3, 3)."""
        return np.diag([self.process_position_var, self.process_position_var, self.process_speed_var])


@dataclass(frozen=True)
class LateralGains:
    """Gains of the paper's virtual lateral control u_y = K1 (y_ref - y) + K2 (0 - v_y).

    Attributes:
        k1: [1/s2].
        k2: [1/s].
    """

    k1: float = 3.0
    k2: float = 1.0

    def stable(self, period: float) -> bool:
        """Tell whether a step of `period` [s] does not overshoot the lane, K1 T^2 / 2 <= 1."""
        return self.k1 * period**2 / 2 <= 1.0 + 1e-9


def state_matrix(lateral: Lateral, period: float, gains: LateralGains) -> FloatArray:
    """Return A(a_lat), shape (3, 3) (docs/formulation.md, eq. 4).

    K1 y stands in A, so the input u_y holds only the rest of the virtual control.
    """
    y_from_y = 1.0 if lateral == Lateral.KEEP else 1.0 - gains.k1 * period**2 / 2
    return np.array([[1.0, 0.0, period], [0.0, y_from_y, 0.0], [0.0, 0.0, 1.0]])


def input_matrix(lateral: Lateral, period: float) -> FloatArray:
    """Return B(a_lat) for the input (a_x, u_y), shape (3, 2) (docs/formulation.md, eq. 4)."""
    y_from_u = 0.0 if lateral == Lateral.KEEP else period**2 / 2
    return np.array([[period**2 / 2, 0.0], [0.0, y_from_u], [period, 0.0]])


def next_covariance(
    covariance: FloatArray, lateral: Lateral, period: float, gains: LateralGains, noise: Noise
) -> FloatArray:
    """Return Q+ = A Q A' + Xi, shape (3, 3) (docs/formulation.md, eq. 5)."""
    A = state_matrix(lateral, period, gains)
    return A @ covariance @ A.T + noise.process_covariance()


def next_longitudinal(
    x: FloatArray, speed: FloatArray, accel: FloatArray, period: float
) -> tuple[FloatArray, FloatArray]:
    """Move means along the road by one step (docs/formulation.md, eq. 4, first and third row).

    Nobody drives backwards: who would, stops within the step, after speed^2 / (2 decel), and stands.

    Args:
        x: [m], any shape.
        speed: [m/s], same shape.
        accel: nominal acceleration of the mode BEFORE the step's action [m/s2], same shape.
        period: [s].

    Returns:
        x and speed at the end of the step.
    """
    free_speed = speed + accel * period
    free_x = x + speed * period + accel * period**2 / 2
    stops = free_speed < 0
    if not stops.any():
        return free_x, free_speed
    stopping_distance = np.divide(speed**2, -2 * accel, out=np.zeros_like(speed), where=stops)
    return np.where(stops, x + stopping_distance, free_x), np.where(stops, 0.0, free_speed)


def next_lateral(
    y: FloatArray,
    lateral_speed: FloatArray,
    changes: NDArray[np.bool_],
    y_ref: FloatArray,
    period: float,
    gains: LateralGains,
) -> FloatArray:
    """Move means across the road by one step (docs/formulation.md, eq. 4, second row).

    Args:
        y: [m], any shape.
        lateral_speed: measured in the first step, the last difference of y over the period after it [m/s].
        changes: whether the step's action changes the lane.
        y_ref: centre of the lane that the step's action leads to [m].
        period: [s].
        gains: of the virtual control.

    Returns:
        y at the end of the step [m]; unchanged where the lane is kept.
    """
    half_square = period**2 / 2
    pulled = (1 - gains.k1 * half_square) * y + half_square * (gains.k1 * y_ref - gains.k2 * lateral_speed)
    return np.where(changes, pulled, y)


def position_variances(noise: Noise, period: float, steps: int) -> FloatArray:
    """Return Q_xx after each step 1..H, shape (H,) [m2] (docs/formulation.md, eq. 6).

    The rows of A for x and v are the same for every action, so Q_xx needs neither the branch nor y.
    """
    xx, xv, vv = noise.position_var, 0.0, noise.speed_var
    variances = np.empty(steps)
    for k in range(steps):
        xx, xv, vv = (
            xx + 2 * period * xv + period**2 * vv + noise.process_position_var,
            xv + period * vv,
            vv + noise.process_speed_var,
        )
        variances[k] = xx
    return variances
