"""The Intelligent Driver Model: how hard a vehicle accelerates behind its leader (docs/formulation.md, eq. 20).

Treiber, Hennecke, Helbing, "Congested traffic states in empirical observations and microscopic simulations", 2000.
"""

import math
from dataclasses import dataclass

from sumo_hmdp.domain.scene import VehicleState

# The published rule-based code takes no gap to be smaller, so that overlapping vehicles have an acceleration too [m].
LEAST_GAP = 0.1


@dataclass(frozen=True)
class Idm:
    """Parameters of the model; the defaults are those of the published rule-based baseline.

    Attributes:
        desired_speed: on a free road, v0 [m/s].
        min_gap: gap at standstill, s0 [m].
        time_gap: desired, T [s].
        accel: largest acceleration, a [m/s2].
        decel: comfortable deceleration, b, a positive magnitude [m/s2].
        exponent: of the free-road term.
        decel_max: strongest braking, at which the output is clipped, a positive magnitude [m/s2].
    """

    desired_speed: float = 30.0
    min_gap: float = 2.0
    time_gap: float = 1.5
    accel: float = 8.0
    decel: float = 4.0
    exponent: float = 6.0
    decel_max: float = 5.0

    def follow(self, vehicle: VehicleState, ahead: VehicleState | None) -> float:
        """Return the acceleration behind a leader [m/s2].

            a (1 - (v / v0)^exponent - (s* / gap)^2)   clipped to [-decel_max, a],
            s* = s0 + v T + v closing_speed / (2 sqrt(a b)),   gap = x_lead - length_lead - x.

        As published, s* has no lower bound: behind a leader that is faster by 17 m/s it is about s0, and beyond
        that its square grows again.

        Args:
            vehicle: who follows.
            ahead: its leader, None on a free road.
        """
        free = 1.0 - math.pow(vehicle.speed / self.desired_speed, self.exponent)
        interaction = 0.0 if ahead is None else (self._wanted_gap(vehicle, ahead) / gap(vehicle, ahead)) ** 2
        return min(max(self.accel * (free - interaction), -self.decel_max), self.accel)

    def _wanted_gap(self, vehicle: VehicleState, ahead: VehicleState) -> float:
        closing_speed = vehicle.speed - ahead.speed
        approach = vehicle.speed * closing_speed / (2.0 * math.sqrt(self.accel * self.decel))
        return self.min_gap + vehicle.speed * self.time_gap + approach


def gap(vehicle: VehicleState, ahead: VehicleState) -> float:
    """Return the gap to a leader, from bumper to bumper and at least `LEAST_GAP` [m]."""
    return max(ahead.x - ahead.length - vehicle.x, LEAST_GAP)
