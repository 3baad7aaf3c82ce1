"""Branches: the action sequences of the surrounding vehicles that are likely enough, and where they lead.

Branches are expanded one array row a branch and pruned inside the recursion: a prefix goes as soon as even its best
completion falls below the threshold, so no more rows ever live than branches survive.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.domain.maneuver import ACTIONS, Lateral, Mode
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.errors import SumoHmdpError
from sumo_hmdp.prediction.dynamics import (
    FloatArray,
    LateralGains,
    Noise,
    next_covariance,
    next_longitudinal,
    position_variances,
)
from sumo_hmdp.prediction.lateral import (
    LaneFollowing,
    centers_of,
    followed,
    lateral_deviations,
    lateral_variances,
    paper_means,
    path_of,
)
from sumo_hmdp.prediction.policy import Policy, action_probabilities

IntArray = NDArray[np.int64]
Drift = tuple[tuple[float, float], ...]

# A product that equals the threshold on paper may miss it by rounding; it is kept.
THRESHOLD_SLACK = 1e-12

# A vehicle with more likely sequences than this has a threshold that means nothing, and a decision takes minutes. The
# probabilities of sequences sum to 1, so that a threshold of 1e-4 cannot lead here.
SEQUENCES_MAX = 10_000
# All branches and steps together.
PREDICTION_MAX = 1_000_000


class PredictionTooLargeError(SumoHmdpError):
    """More sequences are likely enough than can be kept."""


_LATERAL_OF_ACTION = np.array([action.lateral for action in ACTIONS])
_MODE_CHANGE_OF_ACTION = np.array([action.mode_change for action in ACTIONS])


@dataclass(frozen=True)
class PredictedVehicle:
    """A surrounding vehicle with what is believed of it.

    Attributes:
        state: where it is and what it intends.
        policy: how it chooses its actions.
        noise: how uncertain its motion is.
        following: how it moves across the road.
        drift: for each step 1..H how much farther [m] and faster [m/s] it is than its modes alone lead to, whatever
            they are: a fading acceleration, say (docs/formulation.md, eq. 46). Empty for none. Only for vehicles that
            cannot come to rest within the horizon.
    """

    state: VehicleState
    policy: Policy
    noise: Noise
    following: LaneFollowing = field(default_factory=LaneFollowing)
    drift: Drift = ()


@dataclass(frozen=True)
class PredictionSettings:
    """How far and how finely to predict.

    Attributes:
        horizon_steps: H >= 1.
        period: of one step [s].
        accel: nominal acceleration of the modes [m/s2].
        sequence_threshold: least probability delta_seq of a whole sequence, in (0, 1].
        action_threshold: least probability delta of a single action; 0 drops none.
        gains: of the paper's law across the road; None for lane changes that take their time (`prediction/lateral.py`).
    """

    horizon_steps: int
    period: float
    accel: float
    sequence_threshold: float
    action_threshold: float = 0.0
    gains: LateralGains | None = None


@dataclass(frozen=True, eq=False)
class Branches:
    """All retained branches of all vehicles: B rows, H steps, V vehicles.

    In memory the rows of a step lie side by side: there are many, and few steps.

    Attributes:
        vehicles: the vehicles they belong to, V of them.
        vehicle: (B,) index into `vehicles`, rising.
        probability: (B,) of the whole sequence.
        laterals: (B, H) lateral action of each step.
        lanes: (B, H) intended lane after each step.
        modes: (B, H) mode after each step's action, -1, 0 or 1.
        x: (B, H) mean front bumper [m].
        speed: (B, H) mean [m/s].
        x_std: (V, H) standard deviation of x [m].
        pruned: (V,) probability of all that was dropped.
    """

    vehicles: tuple[PredictedVehicle, ...]
    vehicle: IntArray
    probability: FloatArray
    laterals: IntArray
    lanes: IntArray
    modes: IntArray
    x: FloatArray
    speed: FloatArray
    x_std: FloatArray
    pruned: FloatArray

    @cached_property
    def length(self) -> FloatArray:
        """Of each branch's vehicle, (B,) [m]."""
        return np.array([v.state.length for v in self.vehicles], dtype=np.float64)[self.vehicle]


def predict(vehicles: Sequence[PredictedVehicle], settings: PredictionSettings) -> Branches:
    """Predict every vehicle over the horizon (docs/formulation.md, eqs. 3 to 7).

    Args:
        vehicles: any number, in the order in which the branches shall come.
        settings: horizon, thresholds and model.

    Returns:
        For each vehicle the sequences whose probability reaches `sequence_threshold`, or the single likeliest
        one where none does; of several the first in the order of actions.

    Raises:
        PredictionTooLargeError: if there are too many.
    """
    H = settings.horizon_steps
    V = len(vehicles)
    trees = _trees(vehicles, settings)
    size = H * sum(len(tree.probability) for tree in trees)
    if size > PREDICTION_MAX:
        message = f"must leave at most {PREDICTION_MAX} steps of likely sequences, got {size}"
        raise PredictionTooLargeError(f"sequence_threshold {message}. Raise it, or shorten horizon_steps")
    vehicle = np.repeat(np.arange(V), [len(tree.probability) for tree in trees])
    probability, laterals, lanes, modes = (
        np.concatenate(each, axis=-1).T for each in zip(_no_tree(H), *trees, strict=True)
    )
    x_now = np.array([v.state.x for v in vehicles], dtype=np.float64)[vehicle]
    speed_now = np.array([v.state.speed for v in vehicles], dtype=np.float64)[vehicle]
    mode = np.array([int(v.state.mode) for v in vehicles], dtype=np.int64)[vehicle]
    x, speed = np.empty((2, H, len(vehicle))).transpose(0, 2, 1)
    for k in range(H):
        # The mode BEFORE the step's action gives the acceleration of a surrounding vehicle.
        x_now, speed_now = next_longitudinal(
            x_now, speed_now, settings.accel * mode.astype(np.float64), settings.period
        )
        x[:, k], speed[:, k], mode = x_now, speed_now, modes[:, k]
    if any(v.drift for v in vehicles):
        drifts = drifts_of(vehicles, H)
        x += drifts[vehicle, :, 0]
        speed[:] = np.maximum(speed + drifts[vehicle, :, 1], 0.0)
    deviations = np.array([_position_deviations(v.noise, settings.period, H) for v in vehicles]).reshape(V, H)
    kept = np.bincount(vehicle, weights=probability, minlength=V) if V else np.zeros(0)
    return Branches(
        vehicles=tuple(vehicles),
        vehicle=vehicle,
        probability=probability,
        laterals=laterals,
        lanes=lanes,
        modes=modes,
        x=x,
        speed=speed,
        x_std=deviations,
        pruned=np.minimum(np.maximum(1.0 - kept, 0.0), 1.0),
    )


def drifts_of(vehicles: Sequence[PredictedVehicle], steps: int) -> FloatArray:
    """Return the drifts of vehicles after each step 1..H in metres and m/s, (V, H, 2) (docs/formulation.md, eq. 46)."""
    found = np.zeros((len(vehicles), steps, 2))
    for row, vehicle in enumerate(vehicles):
        if vehicle.drift:
            found[row] = vehicle.drift
    return found


def require_few_sequences(policy: Policy, settings: PredictionSettings) -> None:
    """Make sure that a policy leaves few enough likely sequences, whatever maneuver a vehicle starts from.

    Raises:
        PredictionTooLargeError: if it does not.
    """
    for lane in range(1, len(policy.lateral) + 1):
        for mode in Mode:
            _likely_from(policy, lane, int(mode), _shared(settings))


def _shared(settings: PredictionSettings) -> PredictionSettings:
    """Return settings without what makes no difference to the sequences, so that these are looked up."""
    return replace(settings, accel=0.0, period=1.0, gains=None)


class _Tree(NamedTuple):
    """The B likely sequences from one maneuver, (H, B) but for the probability."""

    probability: FloatArray
    laterals: IntArray
    lanes: IntArray
    modes: IntArray


def _no_tree(steps: int) -> _Tree:
    """Return no sequence at all; what is joined to it has the right shape and type."""
    nothing = np.zeros((steps, 0), dtype=np.int64)
    return _Tree(np.zeros(0), nothing, nothing, nothing)


def _trees(vehicles: Sequence[PredictedVehicle], settings: PredictionSettings) -> list[_Tree]:
    """Return the likely sequences of each vehicle (docs/formulation.md, eq. 7)."""
    shared = _shared(settings)
    # Policies are long to compare, and most vehicles have the very same one.
    known: dict[tuple[int, int, int], _Tree] = {}
    trees = []
    for vehicle in vehicles:
        maneuver = id(vehicle.policy), vehicle.state.lane, int(vehicle.state.mode)
        if maneuver not in known:
            known[maneuver] = _likely_from(vehicle.policy, *maneuver[1:], shared)
        trees.append(known[maneuver])
    return trees


# Vehicles in the same maneuver of which the same is believed have the same sequences.
@lru_cache(maxsize=256)
def _likely_from(policy: Policy, lane: int, mode: int, settings: PredictionSettings) -> _Tree:
    """Expand and prune the sequences from one maneuver."""
    H = settings.horizon_steps
    # (H, lanes, 3, 9): a policy may differ from step to step.
    table = np.stack([action_probabilities(policy.at_step(k)) for k in range(H)])
    likeliest = _completions(table)
    usable = np.where(table >= max(settings.action_threshold * (1 - THRESHOLD_SLACK), np.nextafter(0, 1)), table, 0.0)
    reachable = _completions(usable) if settings.action_threshold > 0 else likeliest
    lanes, modes, probability = np.array([lane - 1]), np.array([mode + 1]), np.ones(1)
    threshold = settings.sequence_threshold * (1 - THRESHOLD_SLACK)
    # A vehicle none of whose sequences reaches the threshold keeps its likeliest one: the first of those that are as
    # likely, since the same factors in another order may differ by rounding.
    lonely = bool(reachable[H][lane - 1, mode + 1] < threshold)
    allowed, best = (table, likeliest) if lonely else (usable, reachable)
    if lonely:
        threshold = likeliest[H][lane - 1, mode + 1] * (1 - THRESHOLD_SLACK)
    history = np.zeros((1, 0), dtype=np.int64)
    for k in range(H):
        next_lane = np.clip(lanes[:, None] + _LATERAL_OF_ACTION, 0, table.shape[1] - 1)
        next_mode = np.clip(modes[:, None] + _MODE_CHANGE_OF_ACTION, 0, 2)
        child = probability[:, None] * allowed[k, lanes, modes]
        onward = best[H - 1 - k][next_lane, next_mode]
        row, action = np.nonzero((child > 0) & (child * onward >= threshold))
        if lonely:
            row, action = row[:1], action[:1]
        if len(row) > SEQUENCES_MAX:
            message = f"must leave a vehicle at most {SEQUENCES_MAX} likely sequences"
            raise PredictionTooLargeError(f"sequence_threshold {message}, got more. Raise it, or shorten horizon_steps")
        history = np.column_stack([history[row], action])
        probability = child[row, action]
        lanes, modes = next_lane[row, action], next_mode[row, action]
    laterals, changes = _LATERAL_OF_ACTION[history.T], _MODE_CHANGE_OF_ACTION[history.T]
    return _Tree(probability, laterals, lane + np.cumsum(laterals, axis=0), mode + np.cumsum(changes, axis=0))


def _completions(table: FloatArray) -> list[FloatArray]:
    """Return for 0..H remaining steps the probability of the likeliest way on, each of shape (lanes, 3).

    Args:
        table: probabilities of the actions at each step, (H, lanes, 3, 9).
    """
    lanes = table.shape[1]
    lane, mode = np.arange(lanes)[:, None, None], np.arange(3)[None, :, None]
    # Inadmissible actions have probability 0, so where their clipped successor points does not matter.
    next_lane = np.clip(lane + _LATERAL_OF_ACTION, 0, lanes - 1)
    next_mode = np.clip(mode + _MODE_CHANGE_OF_ACTION, 0, 2)
    best = [np.ones((lanes, 3))]
    for step in table[::-1]:
        best.append((step * best[-1][next_lane, next_mode]).max(axis=2))
    return best


@lru_cache(maxsize=4096)
def _position_deviations(noise: Noise, period: float, steps: int) -> FloatArray:
    """Return the standard deviation of x after each step 1..H, shape (H,) [m]."""
    return np.sqrt(position_variances(noise, period, steps))


def lateral_means(branches: Branches, road: Road, settings: PredictionSettings) -> FloatArray:
    """Return the mean y of every branch and step, shape (B, H) [m] (docs/formulation.md, eqs. 4 and 32)."""
    # Most branches stay in their lane, and those of a vehicle are the same then.
    means = lane_keeping_means(branches, road, settings).take(branches.vehicle, axis=0)
    rows = lane_changing(branches)
    means[rows] = lane_change_means(branches, rows, road, settings)
    return means


def lane_changing(branches: Branches) -> IntArray:
    """Return the rows that change lanes at some step; the others stay in theirs, and are by far the most."""
    return np.flatnonzero((branches.laterals != 0).any(axis=1))


def lane_keeping_means(branches: Branches, road: Road, settings: PredictionSettings) -> FloatArray:
    """Return the mean y of each vehicle that takes no lateral action, (V, H) [m]; a lane change under way goes on."""
    vehicles = np.arange(len(branches.vehicles))
    lanes = np.array([v.state.lane for v in branches.vehicles], dtype=np.int64)
    stays = np.repeat(lanes[:, None], settings.horizon_steps, axis=1)
    return _means(branches, vehicles, stays, np.zeros_like(stays), road, settings)


def lane_change_means(branches: Branches, rows: IntArray, road: Road, settings: PredictionSettings) -> FloatArray:
    """Return the mean y of some branches, (N, H) [m] (docs/formulation.md, eqs. 4 and 32)."""
    return _means(branches, branches.vehicle[rows], branches.lanes[rows], branches.laterals[rows], road, settings)


def _means(
    branches: Branches,
    vehicle: IntArray,
    lanes: IntArray,
    laterals: IntArray,
    road: Road,
    settings: PredictionSettings,
) -> FloatArray:
    """Return the mean y of N vehicles, by index, along the lanes that they intend, (N, H) [m]."""
    vehicles = branches.vehicles
    now = [(v.state.y, v.state.lateral_speed, v.state.width, road.center_y(v.state.lane)) for v in vehicles]
    y, lateral_speed, width, center = np.array(now, dtype=np.float64).reshape(-1, 4).T.take(vehicle, axis=1)
    centers = centers_of(road, lanes)
    if settings.gains is not None:
        return paper_means(y, lateral_speed, laterals != 0, centers, settings.period, settings.gains)
    drivers = [(v.following.change_speed(road), v.following.decay(settings.period)) for v in vehicles]
    speed, decay = np.array(drivers, dtype=np.float64).reshape(-1, 2).T.take(vehicle, axis=1)
    path = path_of(y, lateral_speed, width, center, speed, road)
    return followed(y, path, centers, speed * settings.period, decay)


def lateral_spread(branches: Branches, settings: PredictionSettings) -> FloatArray:
    """Return the standard deviation of each vehicle's y now and after each step, (V, 1 + H) [m].

    The same for every branch of a vehicle (docs/formulation.md, eq. 33), but not by the paper's law.
    """
    H = settings.horizon_steps
    spread = [lateral_deviations(v.noise, v.following, settings.period, H) for v in branches.vehicles]
    return np.array(spread, dtype=np.float64).reshape(len(branches.vehicles), 1 + H)


def covariances(branches: Branches, index: int, settings: PredictionSettings) -> FloatArray:
    """Return the full covariance of one branch after each step, (H, 3, 3) (docs/formulation.md, eqs. 5 and 33)."""
    vehicle, laterals = branches.vehicles[branches.vehicle[index]], tuple(branches.laterals[index].tolist())
    return _covariances(vehicle.noise, vehicle.following, laterals, settings.period, settings.gains)


@lru_cache(maxsize=1024)
def _covariances(
    noise: Noise, following: LaneFollowing, laterals: tuple[int, ...], period: float, gains: LateralGains | None
) -> FloatArray:
    """Return the covariances of all branches with these lateral actions: nothing else changes them."""
    covariance = noise.initial_covariance()
    result = []
    for lateral in laterals:
        along = Lateral(lateral) if gains is not None else Lateral.KEEP
        covariance = next_covariance(covariance, along, period, gains or LateralGains(), noise)
        result.append(covariance)
    stacked = np.array(result)
    if gains is None:
        # y is coupled to nothing.
        stacked[:, 1, 1] = lateral_variances(noise, following, period, len(laterals))[1:]
    stacked.flags.writeable = False
    return stacked
