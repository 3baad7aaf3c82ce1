"""Places: where a vehicle may be at each step, with every probability and without a branch tree.

A policy is one distribution over the lateral action times one over the next mode (docs/formulation.md, eq. 3), so the
motion along the road and the lanes that a vehicle takes up are two independent chains. Along the road, mode sequences
that lead to the same mode, speed and position are merged, which is exact; what falls below a threshold is dropped and
its probability reported, so that the risk of a plan can charge it.

Speeds are counted in speed steps accel * T and positions in lattice units accel * T^2 / 2, as those of the ego
(`decision/lattice.py`).
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from sumo_hmdp.prediction.branches import IntArray
from sumo_hmdp.prediction.dynamics import FloatArray
from sumo_hmdp.prediction.policy import Probabilities

# Places less likely than this are dropped; their probability is charged to every plan.
LEAST_PLACE_PROBABILITY = 1e-9
# Positions and speeds that differ by less are one place [lattice units, speed steps].
_SAME = 1e-9


@dataclass(frozen=True, eq=False)
class StepPlaces:
    """Where one vehicle may be at the end of a step: D distinct places, reached by C pairs of places.

    Attributes:
        point: (D,) position ahead of where the vehicle would be at its present speed [lattice units].
        speed: (D,) speed change since now [speed steps].
        count_before: number of places one step before.
        before: (C,) index of each pair's place one step before.
        after: (C,) index of its place at this step.
        probability: (C,) of the pair.
    """

    point: FloatArray
    speed: FloatArray
    count_before: int
    before: IntArray
    after: IntArray
    probability: FloatArray

    @cached_property
    def place_probability(self) -> FloatArray:
        """Probability of each place, (D,)."""
        return summed(self.after, self.probability, len(self.point))

    @cached_property
    def transition(self) -> FloatArray:
        """Probability of each place of the step before and each of this one, (D before, D)."""
        table = np.zeros((self.count_before, len(self.point)))
        table[self.before, self.after] = self.probability
        return table


@dataclass(frozen=True, eq=False)
class Places:
    """The motion along the road of all vehicles that start in one mode with one distribution over the next.

    Attributes:
        steps: one for each step 1..H; the place before the first step is the present one.
        dropped: probability of what fell below the threshold.
    """

    steps: tuple[StepPlaces, ...]
    dropped: float


def places_of(longitudinal: Probabilities, mode: int, speed: float, steps: int, *, by_speed: bool) -> Places:
    """Return the places of a vehicle over the horizon (docs/formulation.md, eqs. 3, 4 and 38).

    Args:
        longitudinal: probabilities that the next mode is decelerate, cruise, accelerate.
        mode: present mode, -1, 0 or 1.
        speed: present speed [speed steps].
        steps: H.
        by_speed: whether places of one position and different speeds are told apart.
    """
    # A vehicle that cannot come to rest within the horizon moves like any other of its mode.
    return _places(longitudinal, mode, speed if speed < steps else np.inf, steps, by_speed)


@lru_cache(maxsize=1024)
def _places(longitudinal: Probabilities, mode: int, speed: float, steps: int, by_speed: bool) -> Places:  # noqa: FBT001
    """Expand and merge the chain of modes; `speed` is infinite where rest is out of reach."""
    into = mode_transitions(longitudinal)
    point, change, modes, probability = np.zeros(1), np.zeros(1), np.array([mode]), np.ones(1)
    place = np.zeros(1, dtype=np.int64)
    found, dropped, count = [], 0.0, 1
    for _ in range(steps):
        # The mode BEFORE the step's action drives a surrounding vehicle (eq. 4).
        point, change = _advance(point, change, modes, speed)
        keys = (point, change) if by_speed else (point,)
        first, after = distinct(*keys)
        pair_first, pair = distinct(place, after)
        found.append(
            StepPlaces(
                point[first],
                change[first],
                count,
                place[pair_first],
                after[pair_first],
                summed(pair, probability, len(pair_first)),
            )
        )
        count = len(first)
        row, following = np.nonzero(into[modes + 1])
        weight = probability[row] * into[modes[row] + 1, following]
        merged_first, merged = distinct(point[row], change[row], following)
        weight = summed(merged, weight, len(merged_first))
        kept = weight >= LEAST_PLACE_PROBABILITY
        dropped += float(weight[~kept].sum())
        chosen = merged_first[kept]
        point, change, place = point[row[chosen]], change[row[chosen]], after[row[chosen]]
        modes, probability = following[chosen] - 1, weight[kept]
    return Places(tuple(found), dropped)


def mode_transitions(longitudinal: Probabilities) -> FloatArray:
    """Return the probabilities of the next mode given the present one, (3, 3), rows and columns by mode + 1.

    The mode moves by at most one level; what is left is renormalised (docs/formulation.md, eq. 3).
    """
    mode = np.arange(3)
    masked = np.where(np.abs(mode[:, None] - mode) <= 1, np.array(longitudinal), 0.0)
    total = masked.sum(axis=1, keepdims=True)
    return np.asarray(np.divide(masked, total, out=np.zeros_like(masked), where=total > 0), dtype=np.float64)


def _advance(point: FloatArray, change: FloatArray, mode: IntArray, speed: float) -> tuple[FloatArray, FloatArray]:
    """Move places by one step of their modes; a vehicle that would go backwards stops within the step and stands."""
    free_point, free_change = point + 2 * change + mode, change + mode
    if np.isinf(speed):
        return free_point, free_change
    now = speed + change
    stops = now + mode < -_SAME
    # It goes on by v^2 / (2 accel), a square of speed steps in lattice units, while the drift counts 2 v_0 a step.
    return np.where(stops, point + now**2 - 2 * speed, free_point), np.where(stops, -speed, free_change)


def summed(group: IntArray, weights: FloatArray, groups: int) -> FloatArray:
    """Return the sum of the weights of each group, (groups,)."""
    return np.bincount(group, weights=weights, minlength=groups).astype(np.float64)


def distinct(*keys: FloatArray | IntArray) -> tuple[IntArray, IntArray]:
    """Return the first index of each distinct row of some columns, sorted, and which of them each row is.

    Numbers that differ by less than 1e-9 are the same.
    """
    columns = [np.round(np.asarray(key) / _SAME) for key in keys]
    order = np.lexsort(columns[::-1])
    differs = np.zeros(len(order), dtype=bool)
    differs[:1] = True
    for column in columns:
        ranked = column[order]
        differs[1:] |= ranked[1:] != ranked[:-1]
    group = np.cumsum(differs) - 1
    inverse = np.empty(len(order), dtype=np.int64)
    inverse[order] = group
    return order[differs], inverse
