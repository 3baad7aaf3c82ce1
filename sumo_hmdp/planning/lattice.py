"""Where the ego can be: with a fixed acceleration magnitude its positions and speeds lie on a lattice.

With n_k = sum of the modes up to step k and s_k = sum over j <= k of (2 (k - j) + 1) mode_j, both integers,

    v_k = v_0 + accel T n_k,        x_k = x_0 + v_0 k T + (accel T^2 / 2) s_k        (docs/formulation.md, eq. 11)

so a free window of x becomes a range of integers, exactly, and solvers never meet a rounding error in a position.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.planning.problem import SPEED_TOLERANCE, DecisionProblem


@dataclass(frozen=True)
class EgoLattice:
    """The lattice of one decision.

    Attributes:
        x: position now [m].
        speed: now [m/s].
        period: T [s].
        accel: [m/s2].
        steps: H.
        level_min: least n that keeps the speed limit (same at every step).
        level_max: greatest such n.
    """

    x: float
    speed: float
    period: float
    accel: float
    steps: int
    level_min: int
    level_max: int

    @property
    def unit(self) -> float:
        """Length of one step of s [m]."""
        return self.accel * self.period**2 / 2

    def speed_at(self, level: int) -> float:
        """Return the speed at a level n [m/s]."""
        return self.speed + self.accel * self.period * level

    def drift(self, step: int) -> float:
        """Return where the ego is after k steps of cruising [m]."""
        return self.x + self.speed * step * self.period

    def position_at(self, step: int, s: int) -> float:
        """Return x after k steps on lattice point s [m]."""
        return self.drift(step) + self.unit * s

    def to_units(self, step: int, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return positions x [m] at step k as real numbers of lattice units."""
        return (x - self.drift(step)) / self.unit

    def walk(self, modes: tuple[int, ...]) -> tuple[list[int], list[int]]:
        """Return (levels n_1..n_H, points s_1..s_H) of a sequence of modes."""
        levels, points = [], []
        level = point = 0
        for mode in modes:
            # s grows by twice the level at the step's start plus the step's own mode.
            point += 2 * level + mode
            level += mode
            levels.append(level)
            points.append(point)
        return levels, points


def ego_lattice(problem: DecisionProblem) -> EgoLattice:
    """Build the lattice of a decision problem."""
    settings = problem.settings
    speed_step = settings.accel * settings.period
    below = (settings.speed_min - problem.ego.speed - SPEED_TOLERANCE) / speed_step
    above = (settings.speed_max - problem.ego.speed + SPEED_TOLERANCE) / speed_step
    return EgoLattice(
        x=problem.ego.x,
        speed=problem.ego.speed,
        period=settings.period,
        accel=settings.accel,
        steps=settings.horizon_steps,
        level_min=math.ceil(below),
        level_max=math.floor(above),
    )
