"""The rule of lane changes and the vehicles that it is applied to, as arrays."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from sumo_hmdp.errors import InputError
from sumo_hmdp.traffic.car_following import SUMO_IDM, Drivers, FloatArray, IdmVariant
from sumo_hmdp.traffic.neighbours import IntArray


class Passing(StrEnum):
    """Where one may pass slower vehicles.

    ANY_SIDE: the paper's symmetric rule.
    LEFT_ONLY: the paper's asymmetric, European rule. A vehicle that is faster than the leader in the lane to its left
        accelerates no more than it would behind that leader, unless that one is at most critical_speed fast.
        The paper has two lanes; with more the rule holds in every lane that has one to its left.
    """

    ANY_SIDE = "any_side"
    LEFT_ONLY = "left_only"


@dataclass(frozen=True)
class LaneChangeRule:
    """What holds for all drivers.

    The threshold and safe_decel are the defaults that other implementations quote from the paper; the other numbers are
    stated choices.

    Attributes:
        passing: where one may pass.
        threshold: incentive above which one changes [m/s2].
        safe_decel: how hard the new follower may have to brake, positive [m/s2]. The changer itself too, unless it
            brakes harder already: a bias must not send anybody against the new leader.
        right_bias: added to the incentive to go right, taken from that to go left [m/s2], such as 0.3 with
            LEFT_ONLY. It keeps right only where it is above the threshold.
        critical_speed: up to which traffic in the left lane is congested and may be passed on the right [m/s].
        least_gap: to the new leader and to the new follower [m].
        published: whether it is safe by the published code's criterion instead: neither follower, the one that is left
            included, need brake harder than safe_decel. Nothing is asked of the changer itself or of the gaps.
        idm: the variant of the car-following model by which accelerations are judged.
    """

    passing: Passing = Passing.ANY_SIDE
    threshold: float = 0.1
    safe_decel: float = 4.0
    right_bias: float = 0.0
    critical_speed: float = 60.0 / 3.6
    least_gap: float = 2.0
    published: bool = False
    idm: IdmVariant = SUMO_IDM

    def __post_init__(self) -> None:
        """Refuse numbers that are not finite, or below 0."""
        names = ("threshold", "safe_decel", "right_bias", "critical_speed", "least_gap")
        values = {name: getattr(self, name) for name in names}
        problems = [
            f"{name} must be finite and at least 0, got {value}."
            for name, value in values.items()
            if not 0 <= value < np.inf
        ]
        if problems:
            raise InputError(problems)


@dataclass(frozen=True)
class Vehicles:
    """The n vehicles of a step, the ego included; every array has the shape (n,).

    Attributes:
        x: front bumpers [m].
        speed: [m/s].
        lane: 1 is leftmost.
        second_lane: the other lane that a vehicle occupies while it changes, 0 for none.
        length: [m].
        politeness: weight of what the followers gain or lose.
        drivers: how they follow; for the ego, how others believe it does.
    """

    x: FloatArray
    speed: FloatArray
    lane: IntArray
    second_lane: IntArray
    length: FloatArray
    politeness: FloatArray
    drivers: Drivers
