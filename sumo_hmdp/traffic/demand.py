"""Random background traffic: who is on the road at the start, and who enters later.

Every vehicle draws from streams of its own, named by the seed, the lane and its number in the lane. So what it
draws depends neither on how many others there are nor on anything the ego does.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np
from scipy.optimize import brentq

from sumo_hmdp.errors import InputError, Problem
from sumo_hmdp.traffic.car_following import equilibrium_speed, idm_accel
from sumo_hmdp.traffic.drivers import Traits, VehicleClass, class_problems, draw_traits, drivers_of, mean_traits
from sumo_hmdp.traffic.spawn import DriverKind, Spawn
from sumo_hmdp.traffic.theory import Lane, fundamental_diagram

# Ids of all background vehicles begin so.
CROWD_PREFIX = "bg-"


class _Stream(IntEnum):
    """What is drawn; the numbers are part of every result and must never change."""

    LANE = 0
    PRESENT = 1
    ARRIVING = 2
    HEADWAY = 3


@dataclass(frozen=True)
class Demand:
    """How much traffic there is, and of what kind; every lane has the same.

    Exactly one of density and flow is given; the other one follows from the equilibrium of the mean driver.

    Attributes:
        classes: kinds of vehicles; their shares sum to 1.
        density: of a lane [1/m].
        flow: of a lane [1/s], taken to run freely.
        gap_spread: the part of a gap above the gap at standstill is drawn from 1 - gap_spread to 1 + gap_spread
            times its share; 0 spaces evenly.
    """

    classes: tuple[VehicleClass, ...]
    density: float | None = None
    flow: float | None = None
    gap_spread: float = 0.3

    def __post_init__(self) -> None:
        """Refuse more traffic than a lane can hold."""
        problems = list(class_problems(self.classes))
        if not 0.0 <= self.gap_spread < 1.0:
            problems.append(Problem("gap_spread", f"gap_spread must be in [0, 1), got {self.gap_spread}."))
        if (self.density is None) == (self.flow is None):
            message = f"exactly one of density and flow must be given, got {self.density} and {self.flow}."
            problems.append(Problem("density", message))
        if not problems:
            problems = list(self._excess())
        if problems:
            raise InputError(problems)

    def _excess(self) -> Iterator[Problem]:
        jam = self._lane.jam_density
        if self.density is not None and not 0.0 <= self.density < jam:
            yield Problem(
                "density",
                f"density must be at least 0 and below {jam:.6g} 1/m, where vehicles stand bumper to bumper but for "
                f"min_gap, got {self.density} 1/m. Lower it, or make the vehicles or min_gap shorter.",
            )
        if self.flow is not None:
            capacity, _ = self._lane.capacity()
            if not 0.0 <= self.flow <= capacity:
                yield Problem(
                    "flow",
                    f"flow must be at least 0 and at most {capacity:.6g} 1/s, the capacity of a lane, got {self.flow} "
                    "1/s. Lower it or the time gaps, or give a density.",
                )

    @cached_property
    def mean_driver(self) -> Traits:
        """The driver whose every number is the mean over all."""
        return mean_traits(self.classes)

    @cached_property
    def mean_speed(self) -> float:
        """Equilibrium speed of the mean driver at this demand [m/s]."""
        if self.flow is not None:
            return self._lane.free_speed(self.flow)
        return float(fundamental_diagram(self.density or 0.0, [self.mean_driver]).speed)

    @property
    def mean_density(self) -> float:
        """Vehicles on a metre of a lane [1/m]."""
        return self.density if self.density is not None else (self.flow or 0.0) / self.mean_speed

    @property
    def mean_flow(self) -> float:
        """Vehicles that pass a point of a lane in a second [1/s]."""
        return self.flow if self.flow is not None else (self.density or 0.0) * self.mean_speed

    @cached_property
    def _lane(self) -> Lane:
        return Lane.of([self.mean_driver])


@dataclass(frozen=True)
class BackgroundVehicle:
    """One vehicle of the traffic as it enters.

    Attributes:
        id: such as `bg-2-017`, lane and number; `bg-2-in-017` if it enters later.
        lane: 1 is leftmost.
        x: front bumper [m].
        speed: at most the desired one [m/s].
        traits: its driver.
        time: when it enters [s].
    """

    id: str
    lane: int
    x: float
    speed: float
    traits: Traits
    time: float = 0.0


def initial_population(
    demand: Demand, lanes: Sequence[int], x_from: float, x_to: float, seed: int
) -> tuple[BackgroundVehicle, ...]:
    """Return the vehicles that stand on a piece of road at time 0, by lane and from front to back.

    A lane holds density times length vehicles, a fraction of one counting as the chance of one more. Whatever the
    vehicles and their gaps at standstill leave free is shared in proportion to the drivers' time gaps, up to the
    spread. Each drives at the equilibrium speed of its gap, or slower where it would have to brake harder than is
    comfortable for the one in front.

    Args:
        demand: how much traffic.
        lanes: which lanes have it, 1 is leftmost.
        x_from: where the last vehicles' rear bumpers may be [m].
        x_to: where the first vehicles' front bumpers may be [m].
        seed: of the run, at least 0.

    Raises:
        InputError: the road has no length, or the vehicles that were drawn do not fit.
    """
    problems = _call_problems(lanes, seed)
    if not (math.isfinite(x_from) and math.isfinite(x_to) and x_from < x_to):
        problems.append(Problem("x_from", f"x_from must be finite and below x_to, got {x_from} and {x_to} m."))
    if problems:
        raise InputError(problems)
    return tuple(vehicle for lane in lanes for vehicle in _lane_population(demand, lane, x_from, x_to, seed))


def arrivals(
    demand: Demand, lanes: Sequence[int], x_entry: float, duration: float, seed: int
) -> tuple[BackgroundVehicle, ...]:
    """Return the vehicles that enter after time 0, by time.

    The time between two entries is the least one, (length in front + min_gap) / speed + time_gap at the mean
    driver's speed, and an exponentially distributed rest, such that the flow is the demand's. Each enters at that
    speed, or slower where it desires less or would have to brake harder than is comfortable. The one in front is
    taken to have kept its speed since it entered: who enters must look at the actual gap once more.

    Args:
        demand: how much traffic.
        lanes: which lanes have it, 1 is leftmost.
        x_entry: where their front bumpers enter [m].
        duration: until when [s].
        seed: of the run, at least 0.

    Raises:
        InputError: duration or seed make no sense.
    """
    problems = _call_problems(lanes, seed)
    if not (math.isfinite(x_entry) and math.isfinite(duration) and duration >= 0.0):
        message = f"x_entry and duration must be finite, duration at least 0, got {x_entry} m and {duration} s."
        problems.append(Problem("duration", message))
    if problems:
        raise InputError(problems)
    found = [vehicle for lane in lanes for vehicle in _lane_arrivals(demand, lane, x_entry, duration, seed)]
    return tuple(sorted(found, key=lambda vehicle: (vehicle.time, vehicle.id)))


def to_spawn(vehicle: BackgroundVehicle) -> Spawn:
    """Return the vehicle as the simulation takes it, driven by SUMO's IDM."""
    traits = vehicle.traits
    return Spawn(
        vehicle.id,
        vehicle.lane,
        vehicle.x,
        vehicle.speed,
        DriverKind.IDM,
        traits.desired_speed,
        traits.length,
        traits.width,
        vehicle.time,
        traits.idm,
        speed_factor=traits.speed_factor,
    )


def _call_problems(lanes: Sequence[int], seed: int) -> list[Problem]:
    problems = []
    if len(set(lanes)) != len(lanes) or min(lanes, default=1) < 1:
        problems.append(Problem("lanes", f"lanes must be different numbers from 1 on, got {list(lanes)}."))
    if seed < 0:
        problems.append(Problem("seed", f"seed must be at least 0, got {seed}."))
    return problems


def _uniforms(seed: int, stream: _Stream, lane: int, index: int, count: int) -> list[float]:
    """Return the first numbers of one vehicle's own stream, in [0, 1)."""
    sequence = np.random.SeedSequence(entropy=seed, spawn_key=(int(stream), lane, index))
    return [float(u) for u in np.random.Generator(np.random.PCG64(sequence)).random(count)]


def _lane_population(demand: Demand, lane: int, x_from: float, x_to: float, seed: int) -> Iterator[BackgroundVehicle]:
    extra, phase = _uniforms(seed, _Stream.LANE, lane, 0, 2)
    count = math.floor(demand.mean_density * (x_to - x_from) + extra)
    draws = [_uniforms(seed, _Stream.PRESENT, lane, index, 5) for index in range(count)]
    traits = [draw_traits(demand.classes, draw[:4]) for draw in draws]
    least = math.fsum(one.length + one.idm.min_gap for one in traits)
    if least >= x_to - x_from:
        message = (
            f"the {count} vehicles drawn for lane {lane} must fit into {x_to - x_from} m, but with their gaps at "
            f"standstill they need {least:.1f} m. Lower the density or the share of long vehicles."
        )
        raise InputError([Problem("density", message)])
    weights = [
        one.idm.time_gap * (1.0 + demand.gap_spread * (2.0 * draw[4] - 1.0))
        for one, draw in zip(traits, draws, strict=True)
    ]
    unit = (x_to - x_from - least) / math.fsum(weights) if weights else 0.0
    gaps = [one.idm.min_gap + unit * weight for one, weight in zip(traits, weights, strict=True)]
    wishes = equilibrium_speed(drivers_of(traits), np.array(gaps))
    ahead: BackgroundVehicle | None = None
    for index, (one, gap, wish) in enumerate(zip(traits, gaps, wishes, strict=True)):
        if ahead is None:
            # As on a ring: the gap ahead of the first is split between the two ends of the road.
            x, speed = x_to - phase * gap, float(wish)
        else:
            x = ahead.x - ahead.traits.length - gap
            speed = _comfortable_speed(one, float(wish), gap, ahead.speed)
        ahead = BackgroundVehicle(f"{CROWD_PREFIX}{lane}-{index:03d}", lane, x, speed, one)
        yield ahead


def _lane_arrivals(
    demand: Demand, lane: int, x_entry: float, duration: float, seed: int
) -> Iterator[BackgroundVehicle]:
    if demand.mean_flow == 0.0:
        return
    mean, mean_speed = demand.mean_driver, demand.mean_speed
    rest = max(0.0, 1.0 / demand.mean_flow - _least_headway(mean, mean.length, mean_speed))
    # Nobody knows who is in front of the first: somebody like the mean driver.
    ahead = BackgroundVehicle("", lane, x_entry, mean_speed, mean)
    index = 0
    while True:
        one = draw_traits(demand.classes, _uniforms(seed, _Stream.ARRIVING, lane, index, 4))
        (u,) = _uniforms(seed, _Stream.HEADWAY, lane, index, 1)
        headway = _least_headway(one, ahead.traits.length, mean_speed) - rest * math.log1p(-u)
        # Behind somebody very slow and long the least headway is too little to be behind it at all.
        gap = max(headway * ahead.speed - ahead.traits.length, one.idm.min_gap)
        time = ahead.time + (gap + ahead.traits.length) / ahead.speed
        if time >= duration:
            return
        speed = _comfortable_speed(one, min(mean_speed, one.desired_speed), gap, ahead.speed)
        ahead = BackgroundVehicle(f"{CROWD_PREFIX}{lane}-in-{index:03d}", lane, x_entry, speed, one, time)
        yield ahead
        index += 1


def _least_headway(traits: Traits, length_ahead: float, speed: float) -> float:
    return (length_ahead + traits.idm.min_gap) / speed + traits.idm.time_gap


def _comfortable_speed(traits: Traits, wish: float, gap: float, lead_speed: float) -> float:
    """Return the wish [m/s], or the largest speed below it at which nobody brakes harder than is comfortable."""
    driver = drivers_of([traits])

    def margin(speed: float) -> float:
        return float(idm_accel(driver, np.array([speed]), np.array([gap]), lead_speed)[0]) + traits.idm.decel

    # At standstill the margin is positive: the gap is at least the one at standstill.
    return wish if margin(wish) >= 0.0 else float(brentq(margin, 0.0, wish))
