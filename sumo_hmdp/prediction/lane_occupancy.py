"""How likely a vehicle takes up the lanes of a footprint, without a branch tree (docs/formulation.md, eq. 38).

The lateral actions of a policy are a chain of their own. Sequences that lead to the same intended lane and the same
place across the road are merged, which is exact; what falls below a threshold is dropped and its probability reported.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from sumo_hmdp.domain.occupancy import BODY_TOLERANCE
from sumo_hmdp.domain.road import Road
from sumo_hmdp.prediction.branches import IntArray, PredictedVehicle
from sumo_hmdp.prediction.dynamics import FloatArray, LateralGains, next_lateral
from sumo_hmdp.prediction.lateral import centers_of, lateral_deviations, next_on_path, path_of
from sumo_hmdp.prediction.places import LEAST_PLACE_PROBABILITY, distinct, summed
from sumo_hmdp.prediction.policy import Policy

_MOST_MICROMETRES = 4 * 10**12
BoolArray = NDArray[np.bool_]


class LanesTaken(NamedTuple):
    """Probabilities at one step for V vehicles and the ego's U footprints, U' one step before.

    Attributes:
        now: (V, U) that the vehicle takes up a lane of the footprint.
        both: (V, U', U) that it does, of one footprint before and of one now.
    """

    now: FloatArray
    both: FloatArray


@dataclass(frozen=True, eq=False)
class LaneForecast:
    """The lanes of V vehicles over the horizon.

    Attributes:
        steps: one for each step 1..H.
        dropped: (V,) probability of what fell below the threshold.
    """

    steps: tuple[LanesTaken, ...]
    dropped: FloatArray


@dataclass(frozen=True)
class LaneRules:
    """How lanes are predicted and counted.

    Attributes:
        road: the lanes.
        period: of a step [s].
        gains: of the paper's law across the road; None for lane changes that take their time.
        swept: whether the lanes that a body is over count, beside the lane that is intended.
    """

    road: Road
    period: float
    gains: LateralGains | None
    swept: bool


class _States(NamedTuple):
    """R states of vehicles across the road; `y` is the path where drivers follow their lanes, else the place itself."""

    vehicle: IntArray
    lane: IntArray
    y: FloatArray
    speed: FloatArray
    variance: FloatArray
    probability: FloatArray

    def at(self, rows: IntArray) -> "_States":
        """Return some of the states."""
        return _States(
            self.vehicle[rows],
            self.lane[rows],
            self.y[rows],
            self.speed[rows],
            self.variance[rows],
            self.probability[rows],
        )


def lanes_taken(
    vehicles: Sequence[PredictedVehicle], rules: LaneRules, footprints: Sequence[BoolArray]
) -> LaneForecast:
    """Return how likely each vehicle takes up the ego's lanes, step by step (docs/formulation.md, eq. 38).

    Args:
        vehicles: any number, V.
        rules: the road and the law.
        footprints: of the ego now and at each step 1..H, (U, lanes) each.
    """
    V, steps = len(vehicles), []
    dropped = np.zeros(V)
    if not V:
        empty = [LanesTaken(np.zeros((0, len(b))), np.zeros((0, len(a), len(b)))) for a, b in _pairs(footprints)]
        return LaneForecast(tuple(empty), dropped)
    drivers = _Drivers.of(vehicles, rules, len(footprints) - 1)
    states = drivers.start()
    taken = _taken(states, drivers, 0, footprints[0])
    for k, footprint in enumerate(footprints[1:], start=1):
        moved, before = _expand(states, drivers, k - 1)
        first, merged = _merged(moved, rules)
        states = moved.at(first)._replace(probability=summed(merged, moved.probability, len(first)))
        after = _taken(states, drivers, k, footprint)
        # Rows come vehicle by vehicle, so the sums over a vehicle's rows are sums of neighbours.
        starts = np.searchsorted(moved.vehicle, np.arange(V))
        pairs = moved.probability[:, None, None] * taken[before][:, :, None] * after[merged][:, None, :]
        steps.append(
            LanesTaken(
                np.add.reduceat(moved.probability[:, None] * after[merged], starts, axis=0),
                np.add.reduceat(pairs, starts, axis=0),
            )
        )
        kept = states.probability >= LEAST_PLACE_PROBABILITY
        if not kept.all():
            dropped += summed(states.vehicle[~kept], states.probability[~kept], V)
            states = states.at(np.flatnonzero(kept))
            after = after[kept]
        taken = after
    return LaneForecast(tuple(steps), dropped)


def _merged(states: _States, rules: LaneRules) -> tuple[IntArray, IntArray]:
    """Return the first of the states that are alike, vehicle by vehicle, and which of them each is."""
    if rules.swept and rules.gains is not None:
        return distinct(states.vehicle, states.lane, states.y, states.speed, states.variance)
    # Micrometres across the road, lanes and vehicles in one number: sorting it is several times faster.
    micrometres = np.rint(states.y * 1e6).astype(np.int64) + _MOST_MICROMETRES // 2
    lanes = states.vehicle * (rules.road.lane_count + 1) + states.lane
    _, first, group = np.unique(lanes * _MOST_MICROMETRES + micrometres, return_index=True, return_inverse=True)
    return first, group.ravel()


def _pairs(footprints: Sequence[BoolArray]) -> list[tuple[BoolArray, BoolArray]]:
    return list(pairwise(footprints))


@lru_cache(maxsize=4096)
def lateral_transitions(policy: Policy) -> FloatArray:
    """Return the probabilities of left, keep and right at the first step, (lanes, 3), masked, renormalised (eq. 3)."""
    table = np.array(policy.lateral, dtype=np.float64)
    table[0, 0] = table[-1, 2] = 0.0
    total = table.sum(axis=1, keepdims=True)
    result: FloatArray = np.divide(table, total, out=np.zeros_like(table), where=total > 0)
    result.flags.writeable = False
    return result


@dataclass(frozen=True, eq=False)
class _Drivers:
    """What does not change within the horizon, one row a vehicle; `table` has one table a step where policies do."""

    rules: LaneRules
    table: FloatArray
    states: _States
    width: FloatArray
    reach: FloatArray
    deviation: FloatArray
    std: FloatArray
    step_variance: FloatArray

    @staticmethod
    def of(vehicles: Sequence[PredictedVehicle], rules: LaneRules, steps: int) -> "_Drivers":
        road, V = rules.road, len(vehicles)
        lane = np.array([v.state.lane for v in vehicles], dtype=np.int64)
        y, speed, width = np.array([(v.state.y, v.state.lateral_speed, v.state.width) for v in vehicles]).T
        change_speed = np.array([v.following.change_speed(road) for v in vehicles])
        decay = np.array([v.following.decay(rules.period) for v in vehicles])
        tables = steps if any(v.policy.later for v in vehicles) else 1
        place, variance, zero = y, np.array([v.noise.initial_lateral_var for v in vehicles]), np.zeros(V)
        std = np.zeros((V, steps + 1))
        if not rules.swept:
            place, speed, variance = zero, zero, zero
        elif rules.gains is None:
            place = path_of(y, speed, width, centers_of(road, lane), change_speed, road)
            std = np.array([lateral_deviations(v.noise, v.following, rules.period, steps) for v in vehicles])
            # A body that is seen is where it is seen.
            std[:, 0] = 0.0
            speed, variance = zero, zero
        return _Drivers(
            rules=rules,
            table=np.stack([[lateral_transitions(v.policy.at_step(k)) for k in range(tables)] for v in vehicles]),
            states=_States(np.arange(V), lane, place, speed, variance, np.ones(V)),
            width=width,
            reach=change_speed * rules.period,
            deviation=(y - place)[:, None] * decay[:, None] ** np.arange(steps + 1),
            std=std,
            step_variance=np.array([v.noise.process_position_var for v in vehicles]),
        )

    def start(self) -> _States:
        return self.states


def _expand(states: _States, drivers: _Drivers, k: int) -> tuple[_States, IntArray]:
    """Return every state one step on, by the action of step k = 0..H-1, and the state that each comes from."""
    rules = drivers.rules
    chance = drivers.table[states.vehicle, min(k, drivers.table.shape[1] - 1), states.lane - 1]
    row, action = np.nonzero(chance)
    vehicle, lane = states.vehicle[row], states.lane[row] + action - 1
    y, speed, variance = states.y[row], states.speed[row], states.variance[row]
    if rules.swept and rules.gains is None:
        y = next_on_path(y, centers_of(rules.road, lane), drivers.reach[vehicle])
    elif rules.swept and rules.gains is not None:
        changes, factor = action != 1, 1.0 - rules.gains.k1 * rules.period**2 / 2
        following = next_lateral(y, speed, changes, centers_of(rules.road, lane), rules.period, rules.gains)
        speed, y = (following - y) / rules.period, following
        variance = np.where(changes, factor**2, 1.0) * variance + drivers.step_variance[vehicle]
    return _States(vehicle, lane, y, speed, variance, states.probability[row] * chance[row, action]), row


def _taken(states: _States, drivers: _Drivers, k: int, footprint: BoolArray) -> FloatArray:
    """Return the probability that each state takes up a lane of each footprint at step k, (R, U)."""
    intended = footprint[:, states.lane - 1].T
    rules = drivers.rules
    if not rules.swept or not len(footprint):
        return intended.astype(np.float64)
    if rules.gains is None:
        y, std = states.y + drivers.deviation[states.vehicle, k], drivers.std[states.vehicle, k]
    else:
        y, std = states.y, np.sqrt(states.variance) if k else np.zeros(len(states.y))
    reach = (rules.road.lane_width + drivers.width[states.vehicle]) / 2 - BODY_TOLERANCE
    over = np.zeros(intended.shape)
    for rows, first, last in _blocks(footprint):
        left, right = centers_of(rules.road, first + 1), centers_of(rules.road, last + 1)
        above, below = left + reach[:, None] - y[:, None], right - reach[:, None] - y[:, None]
        over[:, rows] += _between(below, above, std[:, None])
    return np.where(intended, 1.0, np.minimum(over, 1.0))


def _blocks(footprint: BoolArray) -> list[tuple[IntArray, IntArray, IntArray]]:
    """Return the blocks of lanes side by side of some footprints: the n-th of all that have one, n after n.

    A block is where a body is over any of its lanes: from the left edge of its first to the right edge of its last.
    Bodies are narrower than lanes, so one that is over a block is over no other.

    Returns:
        For each n the footprints, and the indices of the first and the last lane of their n-th block.
    """
    edges = np.diff(np.pad(footprint, ((0, 0), (1, 1))).astype(np.int64), axis=1)
    rows, firsts = np.nonzero(edges == 1)
    lasts = np.nonzero(edges == -1)[1] - 1
    number = np.arange(len(rows)) - np.searchsorted(rows, rows)
    return [
        (rows[number == n], firsts[number == n], lasts[number == n]) for n in range(int(number.max(initial=-1)) + 1)
    ]


def _between(below: FloatArray, above: FloatArray, std: FloatArray) -> FloatArray:
    """Return P(below < e < above) for an error e of some deviation, 0 or 1 where that is 0."""
    certain = std == 0.0
    spread = np.where(certain, 1.0, std)
    inside = np.maximum(ndtr(above / spread) - ndtr(below / spread), 0.0)
    return np.asarray(np.where(certain, (below < 0) & (above > 0), inside), dtype=np.float64)
