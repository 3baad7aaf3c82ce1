"""Expressions of the decision's MILP: modes, speed levels and positions in terms of its columns."""

from collections.abc import Iterable

import pyomo.environ as pyo

MODES = (1, 0, -1)
LATERALS = (-1, 0, 1)


def mode_is(model: pyo.ConcreteModel, k: int, mode: int) -> pyo.Expression:
    """Indicate that step k runs in a mode."""
    return sum(model.u[k, mode, lateral] for lateral in LATERALS)


def mode_value(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Return the mode of step k, s_acc - s_dec."""
    return mode_is(model, k, 1) - mode_is(model, k, -1)


def speed_level(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Return n_k, the sum of the modes of steps 1..k; a step that stops or stands does not lower it."""
    level = sum(mode_value(model, j) for j in range(1, k + 1))
    if hasattr(model, "stop"):
        level += sum(model.stop[j] + model.stand[j] for j in range(1, k + 1))
    return level


def speed_gain(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Return (v_k - v_0) / (accel T); a stop loses less than a speed step."""
    gain = whole_speed_steps(model, k)
    return gain + model.data.lost_share * has_stopped(model, k) if hasattr(model, "stop") else gain


def speed_gained(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Return v_k - v_0 [m/s]."""
    gained = model.data.speed_step * whole_speed_steps(model, k)
    return gained + model.data.lost_speed * has_stopped(model, k) if hasattr(model, "stop") else gained


def whole_speed_steps(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Return by how many speed steps v_k is above v_0, but for the part of a step that a stop does not lose."""
    steps = sum(mode_value(model, j) for j in range(1, k + 1))
    if hasattr(model, "stop"):
        steps += sum(model.stand[j] for j in range(1, k + 1))
    return steps


def lattice_point(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Return s_k, the ego's position in lattice units ahead of cruising (docs/formulation.md, eq. 11).

    Braking from the share r of a speed step to rest covers r^2 units instead of 2 r - 1, that is (1 - r)^2 more, and
    leaves 1 - r speed steps more for the steps that follow; who stands covers none.
    """
    point = sum((2 * (k - j) + 1) * mode_value(model, j) for j in range(1, k + 1))
    if hasattr(model, "stop"):
        for j in range(1, k + 1):
            point += (2 * (k - j) + 1) * model.stand[j]
            point += 2 * (k - j) * model.data.lost_share * model.stop[j] + model.data.lost_share_squared * model.stop[j]
    return point


def has_stopped(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Indicate that a stop happened in steps 1..k: phase 1."""
    return sum(model.stop[j] for j in range(1, k + 1))


def levels(k: int, phases: Iterable[int]) -> list[tuple[int, int]]:
    """List the speed levels and phases that step k may end with."""
    return [(n, p) for n in range(-k, k + 1) for p in phases]


def of_window(model: pyo.ConcreteModel, datum: pyo.Var, k: int) -> pyo.Expression:
    """Return the datum of the window that step k ends in."""
    if not hasattr(model, "w"):
        return sum(datum[k, i] * model.z[k, i] for i in model.I)
    return sum(datum[k, i, n, p] * model.w[k, i, n, p] for i in model.I for n, p in levels(k, model.P))


def total_violation(model: pyo.ConcreteModel) -> pyo.Expression:
    """Return the violation of all steps in lattice units."""
    return sum(model.short_behind[k] + model.short_ahead[k] for k in model.K)
