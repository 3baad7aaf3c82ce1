"""Kinds of drivers: what differs from one to the next, and how one driver's traits are drawn."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from scipy.special import ndtr, ndtri

from sumo_hmdp.errors import InputError, Problem
from sumo_hmdp.traffic.car_following import Drivers
from sumo_hmdp.traffic.spawn import IdmParameters

# Shares are typed as decimal fractions, whose sum need not be exact.
_SAME = 1e-9


@dataclass(frozen=True)
class TruncatedNormal:
    """A normal distribution cut off on both sides.

    Attributes:
        mean: of the normal distribution before it is cut; within the limits.
        std: of the same; 0 always gives the mean.
        low: least value.
        high: greatest value.
    """

    mean: float
    std: float
    low: float
    high: float

    def __post_init__(self) -> None:
        """Refuse limits that do not hold the mean."""
        numbers = (self.mean, self.std, self.low, self.high)
        if not (all(map(math.isfinite, numbers)) and self.std >= 0.0 and self.low <= self.mean <= self.high):
            raise InputError(
                [f"a truncated normal must have finite numbers, std >= 0 and low <= mean <= high, got {self}."]
            )

    def quantile(self, u: float) -> float:
        """Return the value below which a share u of the draws lies; one uniform number gives one draw.

        Args:
            u: in [0, 1].
        """
        if not self._spread:
            return self.mean
        below, above = ndtr(self._standard(self.low)), ndtr(self._standard(self.high))
        value = self.mean + self.std * float(ndtri(below + u * (above - below)))
        return min(max(value, self.low), self.high)

    @property
    def expected(self) -> float:
        """The mean of the draws: that of the normal distribution, moved by an uneven cut."""
        if not self._spread:
            return self.mean
        low, high = self._standard(self.low), self._standard(self.high)
        peak = (math.exp(-0.5 * low * low) - math.exp(-0.5 * high * high)) / math.sqrt(2.0 * math.pi)
        return self.mean + self.std * peak / float(ndtr(high) - ndtr(low))

    @property
    def _spread(self) -> bool:
        return self.std > 0.0 and self.low < self.high

    def _standard(self, value: float) -> float:
        return (value - self.mean) / self.std


@dataclass(frozen=True)
class VehicleClass:
    """One kind of vehicles and their drivers.

    Attributes:
        name: such as `car`.
        share: of all vehicles.
        length: [m].
        width: [m].
        desired_speed: on a free road [m/s].
        time_gap: desired [s].
        politeness: weight of what followers gain or lose by a lane change.
        min_gap: gap at standstill [m].
        accel: largest acceleration [m/s2].
        decel: comfortable deceleration, positive [m/s2].
        exponent: of the free-road term.
    """

    name: str
    share: float
    length: float
    width: float
    desired_speed: TruncatedNormal
    time_gap: TruncatedNormal
    politeness: TruncatedNormal
    min_gap: float = 2.0
    accel: float = 1.4
    decel: float = 2.0
    exponent: float = 4.0

    def __post_init__(self) -> None:
        """Refuse vehicles that cannot drive."""
        positive = {name: getattr(self, name) for name in ("length", "width", "min_gap", "accel", "decel", "exponent")}
        positive |= {"desired_speed.low": self.desired_speed.low, "time_gap.low": self.time_gap.low}
        problems = [
            Problem(name, f"{name} must be finite and above 0, got {value}.")
            for name, value in positive.items()
            if not 0.0 < value < math.inf
        ]
        if not 0.0 <= self.share <= 1.0:
            problems.append(Problem("share", f"share must be in [0, 1], got {self.share}."))
        if self.politeness.low < 0.0:
            problems.append(Problem("politeness.low", f"politeness must be at least 0, got {self.politeness.low}."))
        if problems:
            raise InputError(problems, f"vehicle class {self.name}")


@dataclass(frozen=True)
class Traits:
    """One driver and its vehicle.

    Attributes:
        class_name: the class it is of.
        length: [m].
        width: [m].
        desired_speed: on a free road [m/s].
        idm: how it follows.
        politeness: weight of what followers gain or lose by its lane changes.
        speed_factor: its desired speed as a multiple of its class's mean: where a limit is below that mean, it drives
            at so many times the limit.
    """

    class_name: str
    length: float
    width: float
    desired_speed: float
    idm: IdmParameters
    politeness: float
    speed_factor: float = 1.0


def class_problems(classes: Sequence[VehicleClass]) -> Iterator[Problem]:
    """Yield what is wrong with several classes together."""
    names = [kind.name for kind in classes]
    total = math.fsum(kind.share for kind in classes)
    if abs(total - 1.0) > _SAME:
        yield Problem(
            "classes", f"shares must sum to 1, got {total:.9g} ({', '.join(names) or 'no class'}). Change a share."
        )
    if len(set(names)) != len(names):
        yield Problem("classes", f"class names must differ, got {', '.join(names)}. Rename one.")


def limited(kind: VehicleClass, speed_limit: float) -> VehicleClass:
    """Return a class as it drives under a speed limit.

    Drivers who would go faster on average go at the limit on average, with the spread that they have around their own
    speed: v0 of each is multiplied by min(1, limit / mean). So some are above the limit, as SUMO's speedFactor has it.

    Args:
        kind: the class.
        speed_limit: > 0 [m/s].
    """
    speed = kind.desired_speed
    factor = min(1.0, speed_limit / speed.mean)
    slower = TruncatedNormal(speed.mean * factor, speed.std * factor, speed.low * factor, speed.high * factor)
    return kind if factor == 1.0 else replace(kind, desired_speed=slower)


def draw_traits(classes: Sequence[VehicleClass], uniforms: Sequence[float]) -> Traits:
    """Return the traits of one driver.

    Args:
        classes: shares sum to 1.
        uniforms: four numbers in [0, 1): for the class, the desired speed, the time gap and the politeness. Each
            is used for one thing only, so that a change of one distribution leaves the rest as it was.
    """
    which, speed, time_gap, politeness = uniforms
    kind, total = classes[0], 0.0
    # A last class without a share, or a sum a little under 1, must not let a draw fall through.
    for candidate in (kind for kind in classes if kind.share > 0.0):
        kind = candidate
        total += kind.share
        if which < total:
            break
    return _traits(
        kind, kind.desired_speed.quantile(speed), kind.time_gap.quantile(time_gap), kind.politeness.quantile(politeness)
    )


def mean_traits(classes: Sequence[VehicleClass]) -> Traits:
    """Return the driver whose every number is the mean over all drivers."""
    typical = [
        _traits(kind, kind.desired_speed.expected, kind.time_gap.expected, kind.politeness.expected) for kind in classes
    ]

    def mean(values: list[float]) -> float:
        return math.fsum(kind.share * value for kind, value in zip(classes, values, strict=True))

    idm = {
        name: mean([getattr(one.idm, name) for one in typical])
        for name in ("min_gap", "time_gap", "accel", "decel", "exponent")
    }
    return Traits(
        "mean",
        mean([one.length for one in typical]),
        mean([one.width for one in typical]),
        mean([one.desired_speed for one in typical]),
        IdmParameters(**idm),
        mean([one.politeness for one in typical]),
    )


def drivers_of(traits: Sequence[Traits]) -> Drivers:
    """Return the IDM parameters of several drivers as arrays."""
    return Drivers.of([(one.idm, one.desired_speed) for one in traits])


def _traits(kind: VehicleClass, desired_speed: float, time_gap: float, politeness: float) -> Traits:
    idm = IdmParameters(kind.min_gap, time_gap, kind.accel, kind.decel, kind.exponent)
    factor = desired_speed / kind.desired_speed.mean
    return Traits(kind.name, kind.length, kind.width, desired_speed, idm, politeness, factor)


def _km_per_h(mean: float, std: float, low: float, high: float) -> TruncatedNormal:
    return TruncatedNormal(mean / 3.6, std / 3.6, low / 3.6, high / 3.6)


# All of these are stated choices, of the size of published ones: on a highway 120 and 85 km/h, T = 1.5 and 1.7 s,
# s0 = 2 m, a = 1.4 and 0.7 m/s2, b = 2 m/s2, delta = 4, after Kesting, Treiber, Helbing, "Enhanced intelligent driver
# model to access the impact of driving strategies on traffic capacity", Phil. Trans. R. Soc. A 368, 2010. Treiber's
# page on MOBIL calls a politeness of 0 to 0.5 realistic. In the city 50 km/h.
_POLITENESS = TruncatedNormal(0.25, 0.1, 0.0, 0.5)
_CAR_GAP, _TRUCK_GAP = TruncatedNormal(1.5, 0.25, 0.9, 2.4), TruncatedNormal(1.7, 0.25, 1.1, 2.6)
HIGHWAY_CLASSES = (
    VehicleClass("car", 0.85, 4.5, 1.8, _km_per_h(120, 12, 95, 150), _CAR_GAP, _POLITENESS),
    VehicleClass("truck", 0.15, 12.0, 2.5, _km_per_h(85, 3, 78, 92), _TRUCK_GAP, _POLITENESS, accel=0.7),
)
URBAN_CLASSES = (
    VehicleClass("car", 0.95, 4.5, 1.8, _km_per_h(50, 4, 40, 60), _CAR_GAP, _POLITENESS),
    VehicleClass("truck", 0.05, 12.0, 2.5, _km_per_h(47, 3, 38, 54), _TRUCK_GAP, _POLITENESS, accel=0.7),
)
