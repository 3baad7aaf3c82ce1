"""Safe distances between two vehicles in one lane, before any margin for uncertainty (docs/formulation.md, eq. 17).

`fixed`, the paper's rule, is measured between front bumpers; `time_headway` and `rss` between bumpers, so the
leader's length comes on top. Whoever plans and whoever checks plans afterwards ask here.
"""

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

# Bodies that overlap by less only touch: positions carry rounding [m]. Planned distances have the same tolerance.
TOUCH = 1e-6


class DistanceRule(StrEnum):
    """What the safe distance is; `SafeDistance` says how."""

    FIXED = "fixed"
    TIME_HEADWAY = "time_headway"
    RSS = "rss"


@dataclass(frozen=True)
class RssParameters:
    """Parameters of the RSS distance.

    Attributes:
        response_time: rho [s].
        accel_max: strongest acceleration of the follower during its response [m/s2].
        brake_min: least braking of the follower after it, a positive magnitude [m/s2].
        brake_max: strongest braking of the leader, a positive magnitude [m/s2].
    """

    response_time: float = 0.5
    accel_max: float = 2.0
    brake_min: float = 4.0
    brake_max: float = 8.0


def rss_distance(rear_speed: FloatArray, front_speed: FloatArray, rss: RssParameters) -> FloatArray:
    """Return the longitudinal safe distance of Responsibility-Sensitive Safety, between bumpers [m].

    d = [v_r rho + a rho^2 / 2 + (v_r + rho a)^2 / (2 b_min) - v_f^2 / (2 b_max)]_+ of Shalev-Shwartz, Shammah and
    Shashua 2017: the rear vehicle accelerates by a for its response time rho and then brakes by at least b_min, while
    the front one brakes by at most b_max.

    Args:
        rear_speed: v_r of the follower [m/s].
        front_speed: v_f of the leader [m/s].
        rss: rho, a, b_min and b_max.
    """
    reached = rear_speed + rss.response_time * rss.accel_max
    travelled = rear_speed * rss.response_time + rss.accel_max * rss.response_time**2 / 2
    distance = travelled + reached**2 / (2 * rss.brake_min) - front_speed**2 / (2 * rss.brake_max)
    return np.maximum(distance, 0.0)


@dataclass(frozen=True)
class SafeDistance:
    """A rule with its numbers.

    Attributes:
        constant: d_safe, the constant part; without effect under `rss` [m].
        rule: which rule.
        time_headway: factor of the ego's speed under `time_headway` [s].
        rss: parameters of `rss`.
    """

    constant: float
    rule: DistanceRule = DistanceRule.FIXED
    time_headway: float = 0.0
    rss: RssParameters = field(default_factory=RssParameters)

    def ahead(self, ego_length: FloatArray, ego_speed: FloatArray, other_speed: FloatArray) -> FloatArray:
        """Return how far the ego's front bumper must be ahead of the other's [m].

        Args:
            ego_length: [m].
            ego_speed: [m/s].
            other_speed: [m/s].
        """
        return self._between(other_speed, ego_speed, ego_speed, ego_length)

    def behind(self, other_length: FloatArray, ego_speed: FloatArray, other_speed: FloatArray) -> FloatArray:
        """Return how far the ego's front bumper must be behind the other's [m].

        Args:
            other_length: [m].
            ego_speed: [m/s].
            other_speed: [m/s].
        """
        return self._between(ego_speed, other_speed, ego_speed, other_length)

    def _between(
        self, rear_speed: FloatArray, front_speed: FloatArray, ego_speed: FloatArray, front_length: FloatArray
    ) -> FloatArray:
        """Return the distance between front bumpers; the leader's length counts where the rule is between bumpers."""
        if self.rule is DistanceRule.FIXED:
            return np.full(np.broadcast_shapes(np.shape(rear_speed), np.shape(front_speed)), self.constant)
        if self.rule is DistanceRule.TIME_HEADWAY:
            return front_length + (self.constant + self.time_headway * ego_speed)
        return front_length + rss_distance(rear_speed, front_speed, self.rss)
