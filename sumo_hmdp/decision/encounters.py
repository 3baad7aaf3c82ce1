"""Encounters: how likely each surrounding vehicle is too near to the ego along the road, place by place.

For every vehicle and every place of the ego, the probability that the distance falls short, that it is kept ahead, and
that it is kept behind, summed over the vehicle's places (`prediction/places.py`); lanes do not matter here. With
component c of vehicle i at step k, mean m and deviation sigma (docs/formulation.md, eq. 39):

    Pa(x) = Phi((x - d_a - m) / sigma),   Pb(x) = 1 - Phi((x + d_b - m) / sigma),   N(x) = 1 - Pa(x) - Pb(x)

with sigma = 0: 0 or 1.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from sumo_hmdp.decision.distance import clearance_to
from sumo_hmdp.decision.problem import DISTANCE_TOLERANCE, DecisionProblem
from sumo_hmdp.prediction.branches import IntArray, PredictedVehicle, drifts_of
from sumo_hmdp.prediction.dynamics import FloatArray, Noise, position_variances
from sumo_hmdp.prediction.places import Places, places_of

# A normal variable is farther from its mean than this many deviations with a probability of 1e-15.
FAR = 8.0


class Distance(Enum):
    """Which distance is asked about: the safe one, or the one below which bodies touch."""

    SAFE = "safe"
    CONTACT = "contact"


class EgoPlaces(NamedTuple):
    """Places of the ego at the end of one step.

    Attributes:
        point: (E,) position [lattice units ahead of cruising].
        x: (E,) front bumper [m].
        speed: (E,) [m/s].
        hops: (G, 2) pairs of a place one step before and a place of this step.
    """

    point: FloatArray
    x: FloatArray
    speed: FloatArray
    hops: IntArray


@dataclass(frozen=True, eq=False)
class StepEncounters:
    """What V vehicles may be to the ego at one step.

    Attributes:
        short: (V, E) probability that the distance falls short.
        again: (V, G) probability that it falls short at this step and one step before.
        passes: (V, G) probability that it is kept at both, on different sides.
        missing: (V, E) expectation of the metres that are missing; None where not asked for.
    """

    short: FloatArray
    again: FloatArray
    passes: FloatArray
    missing: FloatArray | None


@dataclass(frozen=True, eq=False)
class _Group:
    """Vehicles with the same places relative to where they would be at their present speeds."""

    rows: IntArray
    places: Places
    x: FloatArray
    speed: FloatArray
    length: FloatArray
    std: FloatArray
    drift: FloatArray


def encounters(
    problem: DecisionProblem,
    vehicles: Sequence[PredictedVehicle],
    ego: Sequence[EgoPlaces],
    distance: Distance,
    *,
    missing: bool = False,
) -> tuple[StepEncounters, ...]:
    """Return what each vehicle may be to the ego at each step (docs/formulation.md, eq. 39).

    Args:
        problem: the decision problem.
        vehicles: some of its vehicles, V.
        ego: its places at each step 1..H.
        distance: which distance.
        missing: whether the missing metres are wanted.
    """
    V = len(vehicles)
    found = [
        StepEncounters(
            np.zeros((V, len(place.x))),
            np.zeros((V, len(place.hops))),
            np.zeros((V, len(place.hops))),
            np.zeros((V, len(place.x))) if missing else None,
        )
        for place in ego
    ]
    for group in _groups(problem, vehicles):
        before = _start_sides(problem, group)
        for k, place in enumerate(ego):
            before = _fill(problem, group, k, place, before, found[k], distance)
    return tuple(found)


def dropped_probability(problem: DecisionProblem, vehicles: Sequence[PredictedVehicle]) -> FloatArray:
    """Return the probability of the places along the road that are too unlikely to be kept, (V,)."""
    return np.array([vehicle_places(problem, vehicle).dropped for vehicle in vehicles], dtype=np.float64)


def place_count(problem: DecisionProblem, vehicles: Sequence[PredictedVehicle]) -> int:
    """Return how many places along the road vehicles have at the end of the horizon."""
    return sum(len(vehicle_places(problem, vehicle).steps[-1].point) for vehicle in vehicles)


def in_reach(
    problem: DecisionProblem, vehicles: Sequence[PredictedVehicle], ego: Sequence[EgoPlaces]
) -> tuple[int, ...]:
    """Return the vehicles whose distance may matter to some plan: those that are not surely ahead, or surely behind.

    Only bounds of the positions of the ego and of the vehicle are looked at, so that a vehicle out of reach costs next
    to nothing.
    """
    if not vehicles:
        return ()
    settings, V = problem.settings, len(vehicles)
    H, T, accel = settings.horizon_steps, settings.period, settings.accel
    step = np.arange(1, H + 1)
    x, speed, length = np.array([(v.state.x, v.state.speed, v.state.length) for v in vehicles]).T
    low, high = np.array([place.x.min() for place in ego]), np.array([place.x.max() for place in ego])
    fastest = max(float(place.speed.max()) for place in ego)
    drifts = drifts_of(vehicles, H)
    drift, way = x[:, None] + speed[:, None] * step * T + drifts[:, :, 0], accel * (step * T) ** 2 / 2
    slack = FAR * np.array([deviations_of(vehicle.noise, T, H) for vehicle in vehicles])
    # Distances grow with the speed of the vehicle behind, and fall with that of the one ahead.
    others = np.stack([speed + H * accel * T + drifts[:, :, 1].max(axis=1), np.zeros(V)])
    most = clearance_to(problem, length, others, np.zeros(1), fastest)
    least = clearance_to(problem, length, others, np.zeros(1), 0.0)
    to_follow, to_lead = (
        np.broadcast_to(np.maximum(one, other), others.shape).max(axis=0)[:, None]
        for one, other in ((most.behind, least.behind), (most.ahead, least.ahead))
    )
    ahead = drift - np.minimum(way, speed[:, None] * step * T) - slack > high + to_follow
    behind = drift + way + slack < low - to_lead
    surely = (ahead.all(axis=1) & (x >= problem.ego.x)) | (behind.all(axis=1) & (x < problem.ego.x))
    return tuple(np.flatnonzero(~surely).tolist())


def _groups(problem: DecisionProblem, vehicles: Sequence[PredictedVehicle]) -> list[_Group]:
    rows: dict[int, list[int]] = {}
    known: dict[int, Places] = {}
    for row, vehicle in enumerate(vehicles):
        places = vehicle_places(problem, vehicle)
        known[id(places)] = places
        rows.setdefault(id(places), []).append(row)
    T, H = problem.settings.period, problem.settings.horizon_steps
    return [
        _Group(
            np.array(members),
            known[key],
            np.array([vehicles[row].state.x for row in members]),
            np.array([vehicles[row].state.speed for row in members]),
            np.array([vehicles[row].state.length for row in members]),
            np.array([deviations_of(vehicles[row].noise, T, H) for row in members]),
            drifts_of([vehicles[row] for row in members], H),
        )
        for key, members in rows.items()
    ]


def vehicle_places(problem: DecisionProblem, vehicle: PredictedVehicle, *, by_speed: bool = False) -> Places:
    """Return the places of a vehicle, those of different speeds told apart where asked for or needed."""
    settings = problem.settings
    return places_of(
        vehicle.policy.longitudinal,
        int(vehicle.state.mode),
        vehicle.state.speed / (settings.accel * settings.period),
        settings.horizon_steps,
        by_speed=by_speed or settings.distance_needs_other_speed,
    )


@lru_cache(maxsize=4096)
def deviations_of(noise: Noise, period: float, steps: int) -> FloatArray:
    """Return the standard deviation of x after each step 1..H, (H,) [m]."""
    deviations: FloatArray = np.sqrt(position_variances(noise, period, steps))
    deviations.flags.writeable = False
    return deviations


class _Sides(NamedTuple):
    """Probabilities at one step, (V, E, D): kept ahead of the vehicle, kept behind it, short."""

    ahead: FloatArray
    behind: FloatArray
    short: FloatArray


def _start_sides(problem: DecisionProblem, group: _Group) -> _Sides:
    """Return the sides now: nothing falls short yet, and a side is where the front bumper is."""
    ahead = (problem.ego.x > group.x).astype(np.float64)[:, None, None]
    return _Sides(ahead, 1.0 - ahead, np.zeros_like(ahead))


def _fill(
    problem: DecisionProblem,
    group: _Group,
    k: int,
    ego: EgoPlaces,
    before: _Sides,
    into: StepEncounters,
    distance: Distance,
) -> _Sides:
    """Work one step out for one group and write it into its rows; return the sides for the step that follows."""
    settings, places = problem.settings, group.places.steps[k]
    unit, T = settings.accel * settings.period**2 / 2, settings.period
    mean = (group.x + group.speed * (k + 1) * T + group.drift[:, k, 0])[:, None] + unit * places.point
    other_speed = (group.speed + group.drift[:, k, 1])[:, None] + settings.accel * T * places.speed
    if group.drift.any():
        other_speed = np.maximum(other_speed, 0.0)
    apart = ego.x[:, None] - mean[:, None, :]
    ahead, behind = _distances(problem, group, ego, other_speed, distance)
    std = group.std[:, k, None, None]
    between = ego.point[:, None] - places.point
    if settings.distance_hangs_on_speed or not _whole(between):
        sides = _sides(apart, ahead, behind, std)
    else:
        # On a common lattice few distances are different: each is looked at once, and taken where it occurs.
        least, at = int(between.min()), (between - between.min()).astype(np.int64)
        start = apart[:, 0, 0] + unit * (least - between[0, 0])
        table = _sides((start[:, None] + unit * np.arange(int(at.max()) + 1))[:, None], ahead, behind, std)
        sides = _Sides(*(each[:, 0].take(at, axis=1) for each in table))
    weight = places.place_probability
    into.short[group.rows] = sides.short @ weight
    old, new = ego.hops.T
    chance = places.transition

    def both(first: FloatArray, second: FloatArray) -> FloatArray:
        return np.asarray(np.einsum("vgd,vgd->vg", (first @ chance)[:, old], second[:, new]), dtype=np.float64)

    into.again[group.rows] = both(before.short, sides.short)
    into.passes[group.rows] = both(before.ahead, sides.behind) + both(before.behind, sides.ahead)
    if into.missing is not None:
        into.missing[group.rows] = _missing(apart, ahead, behind, std) @ weight
    return sides


def _whole(numbers: FloatArray) -> bool:
    """Tell whether all numbers are whole."""
    return bool((numbers == np.rint(numbers)).all())


def _distances(
    problem: DecisionProblem, group: _Group, ego: EgoPlaces, other_speed: FloatArray, distance: Distance
) -> tuple[FloatArray, FloatArray]:
    """Return the distances ahead and behind, less the tolerance of eq. 14, broadcast against (V, E, D) [m]."""
    length = group.length[:, None, None]
    if problem.settings.distance_hangs_on_speed:
        speed, other = ego.speed[:, None], other_speed[:, None, :]
    else:
        speed, other = np.zeros(1), np.zeros((1, 1, 1))
    safe = clearance_to(problem, length, other, np.zeros(1), speed)
    ahead, behind = np.asarray(safe.ahead), np.asarray(safe.behind)
    if distance is Distance.CONTACT:
        ahead, behind = np.minimum(ahead, problem.ego.length), np.minimum(behind, length)
    return ahead - DISTANCE_TOLERANCE, behind - DISTANCE_TOLERANCE


def _sides(apart: FloatArray, ahead: FloatArray, behind: FloatArray, std: FloatArray) -> _Sides:
    """Return on which side the distance is kept, and that it is not (docs/formulation.md, eq. 39)."""
    certain = std == 0.0
    spread = np.where(certain, 1.0, std)
    kept_ahead = ndtr((apart - ahead) / spread)
    not_behind = ndtr((apart + behind) / spread)
    if certain.any():
        kept_ahead = np.where(certain, apart >= ahead, kept_ahead)
        not_behind = np.where(certain, apart > -behind, not_behind)
    return _Sides(kept_ahead, 1.0 - not_behind, np.maximum(not_behind - kept_ahead, 0.0))


def _missing(apart: FloatArray, ahead: FloatArray, behind: FloatArray, std: FloatArray) -> FloatArray:
    """Return the expected metres that are missing to the distance of the nearer side, (V, E, D).

    With Z the place of the vehicle behind the ego's, normal about `apart`, that is d_a - Z for 0 < Z < d_a and
    d_b + Z for -d_b < Z <= 0.
    """
    spread = np.where(std == 0.0, 1e-9, std)

    def upto(bound: FloatArray | float) -> tuple[FloatArray, FloatArray]:
        z = (bound - apart) / spread
        density = np.exp(-np.minimum(z**2, 1400.0) / 2) / np.sqrt(2 * np.pi)
        chance = ndtr(z)
        return chance, apart * chance - spread * density

    (p_low, e_low), (p_zero, e_zero), (p_high, e_high) = upto(-behind), upto(0.0), upto(ahead)
    below = behind * (p_zero - p_low) + (e_zero - e_low)
    above = ahead * (p_high - p_zero) - (e_high - e_zero)
    return np.asarray(np.maximum(below, 0.0) + np.maximum(above, 0.0))
