"""The Intelligent Driver Model over arrays, as SUMO computes it, and its equilibrium (docs/formulation.md, section 15).

Treiber, Hennecke, Helbing, "Congested traffic states in empirical observations and microscopic simulations",
Phys. Rev. E 62, 2000. Variants of it differ in three small things, which `IdmVariant` names.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import elementwise

from sumo_hmdp.traffic.spawn import IdmParameters

FloatArray = NDArray[np.float64]

# SUMO's emergencyDecel of its default vehicle class: nobody brakes harder [m/s2].
EMERGENCY_DECEL = 9.0


@dataclass(frozen=True)
class IdmVariant:
    """What implementations of the model disagree on.

    Attributes:
        decel_max: strongest braking, at which the output is clipped, positive [m/s2].
        least_gap: no gap is taken to be smaller, so that overlapping vehicles have an acceleration too [m].
        wanted_gap_bounded: whether the wanted gap is at least the gap at standstill. Where it is not, its square
            grows again behind a leader that draws away fast.
    """

    decel_max: float
    least_gap: float
    wanted_gap_bounded: bool


# That of SUMO's MSCFModel_IDM, by which the traffic drives, and that of the rule-based code published with the paper.
SUMO_IDM = IdmVariant(decel_max=EMERGENCY_DECEL, least_gap=1e-3, wanted_gap_bounded=True)
PUBLISHED_IDM = IdmVariant(decel_max=5.0, least_gap=0.1, wanted_gap_bounded=False)


@dataclass(frozen=True)
class Drivers:
    """IDM parameters of n vehicles, each of shape (n,).

    Attributes:
        desired_speed: on a free road, v0 [m/s].
        min_gap: gap at standstill, s0 [m].
        time_gap: desired, T [s].
        accel: largest acceleration, a [m/s2].
        decel: comfortable deceleration, b, positive [m/s2].
        exponent: of the free-road term, delta.
    """

    desired_speed: FloatArray
    min_gap: FloatArray
    time_gap: FloatArray
    accel: FloatArray
    decel: FloatArray
    exponent: FloatArray

    @classmethod
    def of(cls, parameters: Sequence[tuple[IdmParameters, float]]) -> Self:
        """Return the arrays of several drivers.

        Args:
            parameters: of each its IDM parameters and its desired speed [m/s].
        """
        names = [field.name for field in fields(cls)][1:]
        rows = [[speed, *(getattr(idm, name) for name in names)] for idm, speed in parameters]
        return cls(*np.array(rows, dtype=float).reshape(len(rows), len(names) + 1).T)


def own_terms(drivers: Drivers, speed: FloatArray) -> FloatArray:
    """Return what the acceleration takes from the follower alone, shape (6, n): see `accel_behind`.

    Args:
        drivers: of n vehicles.
        speed: their speeds [m/s], shape (n,).
    """
    terms = np.empty((6, *np.shape(speed)))
    terms[0] = drivers.accel * (1.0 - (speed / drivers.desired_speed) ** drivers.exponent)
    terms[1] = drivers.accel
    terms[2] = drivers.min_gap
    terms[3] = speed * drivers.time_gap
    terms[4] = speed / (2.0 * np.sqrt(drivers.accel * drivers.decel))
    terms[5] = speed
    return terms


def accel_behind(own: FloatArray, gap: FloatArray, lead_speed: ArrayLike, variant: IdmVariant = SUMO_IDM) -> FloatArray:
    """Return the acceleration behind a leader [m/s2], at least -decel_max (docs/formulation.md, eqs. 20 and 24).

        a (1 - (v / v0)^delta - (s* / gap)^2),   s* = s0 + max(0, v T + v closing_speed / (2 sqrt(a b)))

    without the max in a variant that does not bound s*. SUMO's speed after the step is max(0, v + accel dt), if its
    `stepping` is at least the step.

    Args:
        own: the followers' terms as `own_terms` gives them, shape (6, ...).
        gap: to the leader [m], infinite where there is none.
        lead_speed: the leader's [m/s].
        variant: which implementation.
    """
    free, accel, min_gap, wanted, approach, speed = own
    dynamic = wanted + approach * (speed - lead_speed)
    wanted_gap = min_gap + (np.maximum(0.0, dynamic) if variant.wanted_gap_bounded else dynamic)
    ratio = wanted_gap / np.maximum(gap, variant.least_gap)
    result: FloatArray = np.maximum(free - accel * ratio * ratio, -variant.decel_max)
    return result


def idm_accel(drivers: Drivers, speed: FloatArray, gap: FloatArray, lead_speed: ArrayLike) -> FloatArray:
    """Return the acceleration of n followers [m/s2], shape (n,); see `accel_behind`.

    Args:
        drivers: of the followers.
        speed: theirs [m/s], shape (n,).
        gap: to their leaders [m], shape (n,), infinite where there is none.
        lead_speed: the leaders' [m/s].
    """
    return accel_behind(own_terms(drivers, speed), gap, lead_speed)


def equilibrium_gap(drivers: Drivers, speed: ArrayLike) -> FloatArray:
    """Return the gap at which a follower keeps its leader's speed [m] (docs/formulation.md, eq. 25).

        (s0 + v T) / sqrt(1 - (v / v0)^delta)

    Args:
        drivers: of n vehicles.
        speed: of leader and follower [m/s]; from the desired speed on the gap is infinite.
    """
    speed = np.asarray(speed, dtype=float)
    free = np.maximum(0.0, 1.0 - (speed / drivers.desired_speed) ** drivers.exponent)
    with np.errstate(divide="ignore"):
        result: FloatArray = (drivers.min_gap + speed * drivers.time_gap) / np.sqrt(free)
    return result


def equilibrium_speed(drivers: Drivers, gap: FloatArray) -> FloatArray:
    """Return the speed of a follower behind an equally fast leader [m/s], shape (n,).

    It solves `equilibrium_gap` for the speed: 0 for gaps up to the gap at standstill, v0 for an infinite one.

    Args:
        drivers: of n vehicles.
        gap: to the leaders [m], shape (n,).
    """

    def surplus(
        speed: FloatArray, v0: FloatArray, s0: FloatArray, T: FloatArray, delta: FloatArray, s: FloatArray
    ) -> FloatArray:
        # Multiplied by the root, so that it is finite over the whole bracket.
        result: FloatArray = s * np.sqrt(np.maximum(0.0, 1.0 - (speed / v0) ** delta)) - (s0 + speed * T)
        return result

    gap = np.asarray(gap, dtype=float)
    moving = (gap > drivers.min_gap) & np.isfinite(gap)
    speed = np.where(np.isinf(gap), drivers.desired_speed, 0.0)
    if moving.any():
        v0, s0, T, delta = (
            values[moving] for values in (drivers.desired_speed, drivers.min_gap, drivers.time_gap, drivers.exponent)
        )
        speed[moving] = elementwise.find_root(surplus, (np.zeros_like(v0), v0), args=(v0, s0, T, delta, gap[moving])).x
    return speed
