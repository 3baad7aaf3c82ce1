"""What the network's rules leave to the background drivers: how fast they want to be, and where they change lanes."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.domain.road_rules import change_reach
from sumo_hmdp.sim.network import Network
from sumo_hmdp.traffic.mobil import Vehicles
from sumo_hmdp.traffic.spawn import Spawn

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
# The row of the desired speed among the traits.
_DESIRED = 2


@dataclass(frozen=True, eq=False)
class SpeedLimits:
    """How fast drivers want to be where the road has several limits; where it has one, they are drawn for it.

    Attributes:
        factors: how many times a limit each driver wants to drive, shape (drivers,).
        limits: of the fastest lane of each stretch, empty where the road has one limit [m/s].
        x_ends: where the stretches end [m].
    """

    factors: FloatArray
    limits: FloatArray
    x_ends: FloatArray

    @classmethod
    def of(cls, network: Network, spawns: Sequence[Spawn]) -> "SpeedLimits":
        """Return the limits of a network for its drivers."""
        tops = [
            max((part.speed_limit for part in stretch.lane_parts if part and part.is_open), default=math.inf)
            for stretch in network.stretches
        ]
        return cls(
            np.array([math.inf if spawn.speed_factor is None else spawn.speed_factor for spawn in spawns]),
            np.array(tops if len(set(tops)) > 1 else []),
            np.array([stretch.x_end for stretch in network.stretches]),
        )

    def applied(self, rows: IntArray, x: FloatArray, traits: FloatArray) -> FloatArray:
        """Return traits of drivers with the desired speed that they have where they are, in the fastest lane there.

        Args:
            rows: of the n drivers.
            x: where they are, shape (n,) [m].
            traits: theirs, shape (8, n).
        """
        if not len(self.limits):
            return traits
        here = self.limits[np.searchsorted(self.x_ends, x, side="right").clip(max=len(self.limits) - 1)]
        applied = traits.copy()
        applied[_DESIRED] = np.minimum(applied[_DESIRED], self.factors[rows] * here)
        return applied


def keep_lines(network: Network, vehicles: Vehicles, allowed: NDArray[np.bool_], duration: float) -> None:
    """Take the lanes out that may not be changed into now: a change must be over before a solid line begins.

    Args:
        network: the road.
        vehicles: n of them.
        allowed: lanes that each may drive in, shape (n, lanes); changed in place.
        duration: of a lane change [s].
    """
    for rule in network.rules.no_change:
        way = change_reach(vehicles.speed, vehicles.drivers.accel, duration)
        there = (vehicles.x + way > rule.x_begin) & (vehicles.x - vehicles.length < rule.x_end)
        allowed[(vehicles.lane == rule.lane) & there, rule.lane + rule.lateral - 1] = False
