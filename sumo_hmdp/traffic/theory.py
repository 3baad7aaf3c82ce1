"""What theory says of a lane without lane changes: speed and flow over density in equilibrium.

Everybody drives at one common speed V behind everybody else, each with its own equilibrium gap, so that
1 / density = mean(length + gap(V)). With drivers of several kinds nobody is faster than the slowest one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq, elementwise, minimize_scalar

from sumo_hmdp.errors import InputError
from sumo_hmdp.traffic.car_following import Drivers, FloatArray, equilibrium_gap
from sumo_hmdp.traffic.drivers import Traits, drivers_of


@dataclass(frozen=True)
class FundamentalDiagram:
    """Equilibria of one lane; every array has the shape of the densities.

    Attributes:
        density: [1/m].
        speed: [m/s].
        flow: density times speed [1/s].
    """

    density: FloatArray
    speed: FloatArray
    flow: FloatArray


@dataclass(frozen=True)
class Lane:
    """Drivers who share one lane in equal numbers.

    Attributes:
        drivers: how they follow.
        length: of their vehicles [m], shape (n,).
    """

    drivers: Drivers
    length: FloatArray

    @classmethod
    def of(cls, traits: Sequence[Traits]) -> "Lane":
        """Return the lane of these drivers."""
        return cls(drivers_of(traits), np.array([one.length for one in traits]))

    @property
    def jam_density(self) -> float:
        """Density at which everybody stands [1/m]."""
        return 1.0 / float(np.mean(self.length + self.drivers.min_gap))

    @property
    def top_speed(self) -> float:
        """Speed on an empty lane: that of the slowest [m/s]."""
        return float(self.drivers.desired_speed.min())

    def density(self, speed: ArrayLike) -> FloatArray:
        """Return the density at common speeds [1/m], 0 from the top speed on."""
        spacing = self.length + equilibrium_gap(self.drivers, np.asarray(speed, dtype=float)[..., None])
        result: FloatArray = 1.0 / spacing.mean(axis=-1)
        return result

    def capacity(self) -> tuple[float, float]:
        """Return the largest flow [1/s] and its speed [m/s]."""
        best = minimize_scalar(
            lambda speed: -speed * float(self.density(speed)), bounds=(0.0, self.top_speed), method="bounded",
            options={"xatol": 1e-6},
        )  # fmt: skip
        return -float(best.fun), float(best.x)

    def free_speed(self, flow: float) -> float:
        """Return the speed at which this flow runs freely [m/s]; it must be within the capacity."""
        capacity, speed = self.capacity()
        if flow >= capacity:
            return speed
        return float(brentq(lambda v: v * float(self.density(v)) - flow, speed, self.top_speed))


def fundamental_diagram(density: ArrayLike, traits: Sequence[Traits]) -> FundamentalDiagram:
    """Return speed and flow over density, for one driver type or for a mix of drivers.

    Args:
        density: [1/m], from 0 to the jam density.
        traits: one driver, such as `mean_traits`, or many in equal numbers, such as those of a population.

    Raises:
        InputError: a density is out of range.
    """
    density = np.asarray(density, dtype=float)
    lane = Lane.of(traits)
    # The end of the range is often computed as 1 / spacing.
    if not ((density >= 0.0) & (density <= lane.jam_density * (1.0 + 1e-12))).all():
        raise InputError([f"density must be in 0..{lane.jam_density} 1/m, where everybody stands, got {density} 1/m."])
    speed = np.where(density > 0.0, 0.0, lane.top_speed)
    inside = (density > 0.0) & (density < lane.density(0.0))
    if inside.any():
        speed[inside] = elementwise.find_root(
            lambda v, k: lane.density(v) - k, (0.0, lane.top_speed), args=(density[inside],)
        ).x
    return FundamentalDiagram(density, speed, density * speed)
