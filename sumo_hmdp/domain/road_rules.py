"""What a road forbids: speeds above a limit, and lane changes across a solid line or into a closed lane."""

import math
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.domain.maneuver import Lateral


@dataclass(frozen=True)
class SpeedZone:
    """A speed limit in one lane.

    Attributes:
        lane: 1 is leftmost.
        x_begin: where it begins [m].
        x_end: where it ends [m].
        speed: the limit [m/s].
    """

    lane: int
    x_begin: float
    x_end: float
    speed: float


@dataclass(frozen=True)
class NoChange:
    """A stretch on which nobody may change from one lane to one side.

    Attributes:
        lane: the lane that may not be left there, 1 is leftmost.
        lateral: to which side.
        x_begin: where that begins [m].
        x_end: where it ends [m].
    """

    lane: int
    lateral: Lateral
    x_begin: float
    x_end: float


@dataclass(frozen=True)
class RoadRules:
    """The rules of a road.

    Attributes:
        speed_zones: in any order.
        no_change: in any order.
    """

    speed_zones: tuple[SpeedZone, ...] = ()
    no_change: tuple[NoChange, ...] = field(default=())

    def may_change(self, lane: int, lateral: Lateral | int, x_from: float, x_to: float) -> bool:
        """Tell whether a change from a lane to a side is allowed all along from one x to another [m]."""
        return not any(
            rule.lane == lane and rule.lateral == lateral and rule.x_begin < x_to and x_from < rule.x_end
            for rule in self.no_change
        )

    def speed_limit(self, lane: int, x: float) -> float:
        """Return the limit in a lane at x, infinite where there is none [m/s]."""
        return min((z.speed for z in self.speed_zones if z.lane == lane and z.x_begin <= x < z.x_end), default=math.inf)

    def approach_speed(self, lane: int, x: float, decel: float) -> float:
        """Return the greatest speed in a lane at x from which every limit ahead is met by braking [m/s].

            min over the zones that are not passed of sqrt(limit^2 + 2 decel max(0, x_begin - x)).

        Args:
            lane: 1 is leftmost.
            x: [m].
            decel: with which one brakes, positive [m/s2].
        """
        return min(
            (
                math.sqrt(zone.speed**2 + 2.0 * decel * max(0.0, zone.x_begin - x))
                for zone in self.speed_zones
                if zone.lane == lane and x < zone.x_end
            ),
            default=math.inf,
        )

    def allowed_accel(self, lane: int, x: float, speed: float, decel: float, dt: float) -> float:
        """Return the greatest acceleration of a step that keeps to the limits [m/s2]; infinite where there are none.

        Who is too fast brakes with up to twice `decel`, from which it follows the braking curve of `decel` again.

        Args:
            lane: 1 is leftmost.
            x: [m].
            speed: [m/s].
            decel: with which one brakes before a lower limit, positive [m/s2].
            dt: length of the step [s].
        """
        if not self.speed_zones:
            return math.inf
        return max(-2.0 * decel, (self.approach_speed(lane, x + speed * dt, decel) - speed) / dt)


_Number = TypeVar("_Number", float, NDArray[np.float64])


def change_reach(speed: _Number, accel: _Number, duration: float) -> _Number:
    """Return how far a vehicle goes during a lane change at most [m].

    Args:
        speed: at its beginning [m/s].
        accel: the most that it may accelerate meanwhile [m/s2].
        duration: of the change [s].
    """
    return speed * duration + 0.5 * accel * duration**2
