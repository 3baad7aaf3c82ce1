"""How a surrounding vehicle moves across the road, and which lanes its body takes up (docs/formulation.md, section 4).

A driver follows a path: the centre of the lane that it intends, or, while it changes lanes, a line toward that centre
at the constant lateral speed lane_width / change_time. So SUMO moves its vehicles, and so matched vehicles move. From
the path it deviates by a little, which it steers back: a deviation decays with the time constant `keeping_time`.

The paper's own law (`prediction/dynamics.py`, `next_lateral`) is taken where its gains are given.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from sumo_hmdp.domain.occupancy import BODY_TOLERANCE
from sumo_hmdp.domain.road import Road
from sumo_hmdp.prediction.dynamics import FloatArray, LateralGains, Noise, next_lateral

if TYPE_CHECKING:
    from sumo_hmdp.domain.scene import VehicleState

IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class LaneFollowing:
    """How a driver moves across the road.

    Attributes:
        change_time: from one lane's centre to the next [s], at constant lateral speed.
        keeping_time: in which a deviation from the path falls to 1/e [s].
    """

    change_time: float = 4.0
    keeping_time: float = 2.0

    def change_speed(self, road: Road) -> float:
        """Return the lateral speed of a lane change [m/s]."""
        return road.lane_width / self.change_time

    def decay(self, period: float) -> float:
        """Return r, what is left of a deviation after a step of `period` [s]."""
        return math.exp(-period / self.keeping_time)


def path_of(
    y: FloatArray,
    lateral_speed: FloatArray,
    width: FloatArray,
    center: FloatArray,
    change_speed: FloatArray,
    road: Road,
) -> FloatArray:
    """Return where the paths are of vehicles that are at y; what is left is their deviation. All (N,).

    A lane change is under way where a body is over another lane than the one intended, and where it moves toward its
    lane's centre at more than half the speed of a lane change: it is nearer to changing than to keeping. Then the path
    is where the vehicle is. Else the path is the lane's centre.

    Args:
        y: of the front bumper [m].
        lateral_speed: dy/dt as measured [m/s].
        width: of the body [m].
        center: of the lane that it intends [m].
        change_speed: of a lane change [m/s].
        road: the lanes.
    """
    to_go = center - y
    outside = np.abs(to_go) > (road.lane_width - width) / 2 + BODY_TOLERANCE
    under_way = lateral_speed * np.sign(to_go) > change_speed / 2
    return np.asarray(np.where(outside | under_way, y, center), dtype=np.float64)


def next_on_path(path: FloatArray, center: FloatArray, reach: FloatArray) -> FloatArray:
    """Move paths by one step toward the centre of the lane that is intended (docs/formulation.md, eq. 32).

    Args:
        path: [m], any shape.
        center: [m].
        reach: how far a lane change comes in the step [m].
    """
    return np.asarray(path + np.clip(center - path, -reach, reach), dtype=np.float64)


def followed(y: FloatArray, path: FloatArray, centers: FloatArray, reach: FloatArray, decay: FloatArray) -> FloatArray:
    """Return the mean y after each step of drivers who follow their paths, (N, H) [m] (docs/formulation.md, eq. 32).

    Args:
        y: (N,) now [m].
        path: (N,) now, as `path_of` gives it [m].
        centers: (N, H) of the lane that is intended after each step's action [m].
        reach: (N,) how far a lane change comes in a step [m].
        decay: (N,) what is left of a deviation after a step.
    """
    means, deviation = np.empty(centers.shape), y - path
    for k in range(centers.shape[1]):
        path = next_on_path(path, centers[:, k], reach)
        deviation = decay * deviation
        means[:, k] = path + deviation
    return means


@lru_cache(maxsize=4096)
def lateral_variances(noise: Noise, following: LaneFollowing, period: float, steps: int) -> FloatArray:
    """Return Q_yy now and after each step, (1 + H,) [m2]: Q_yy+ = r^2 Q_yy + Xi_yy (docs/formulation.md, eq. 33)."""
    variances = np.empty(1 + steps)
    variances[0] = noise.initial_lateral_var
    for k in range(steps):
        variances[k + 1] = following.decay(period) ** 2 * variances[k] + noise.process_lateral_var
    variances.flags.writeable = False
    return variances


@lru_cache(maxsize=4096)
def lateral_deviations(noise: Noise, following: LaneFollowing, period: float, steps: int) -> FloatArray:
    """Return the standard deviation of y now and after each step, (1 + H,) [m]."""
    deviations = np.sqrt(lateral_variances(noise, following, period, steps))
    deviations.flags.writeable = False
    return deviations


@dataclass(frozen=True, eq=False)
class LateralForecast:
    """Where one vehicle is across the road along S sequences of lateral actions, now and after each of H steps.

    Attributes:
        road: the lanes.
        width: of its body [m].
        lanes: (S, 1 + H) the lane that it intends.
        y: (S, 1 + H) mean [m].
        std: (1 + H,) standard deviation [m], or (S, 1 + H) where the paper's law makes it differ.
    """

    road: Road
    width: float
    lanes: IntArray
    y: FloatArray
    std: FloatArray

    def takes_up(self, footprint: Collection[int], *, swept: bool = True) -> FloatArray:
        """Return the probability that it takes up any lane of a footprint, given the sequence, (S, 1 + H).

        It does if it intends one of the lanes, or, where `swept`, if its body is over one. With a standard deviation of
        0 that is 0 or 1, with the tolerance of `domain.occupancy.bodies_over`.

        Args:
            footprint: lanes next to each other.
            swept: whether bodies count.
        """
        intended = np.isin(self.lanes, list(footprint))
        if not swept:
            return intended.astype(np.float64)
        centers = [self.road.center_y(lane) for lane in footprint]
        reach = (self.road.lane_width + self.width) / 2 - BODY_TOLERANCE
        over = _between(self.y, self.std, min(centers) - reach, max(centers) + reach)
        return np.where(intended, 1.0, over)

    def taken(self, *, swept: bool = True) -> FloatArray:
        """Return the probability that it takes up each lane, given the sequence, (S, 1 + H, lanes)."""
        lanes = range(1, self.road.lane_count + 1)
        return np.stack([self.takes_up((lane,), swept=swept) for lane in lanes], axis=-1)


def _between(mean: FloatArray, std: FloatArray, low: float, high: float) -> FloatArray:
    """Return P(low < y < high) for y of a normal distribution; exact where the standard deviation is 0."""
    certain = std == 0.0
    spread = np.where(certain, 1.0, std)
    uncertain = np.maximum(ndtr((high - mean) / spread) - ndtr((low - mean) / spread), 0.0)
    inside = (low < mean) & (mean < high)
    return np.asarray(np.where(certain, inside, uncertain), dtype=np.float64)


def forecast(
    state: VehicleState,
    noise: Noise,
    following: LaneFollowing,
    road: Road,
    laterals: IntArray,
    period: float,
    gains: LateralGains | None = None,
) -> LateralForecast:
    """Say where a vehicle is across the road along sequences of lateral actions.

    Args:
        state: the vehicle, with the lane that it intends.
        noise: how uncertain its motion is.
        following: how it changes and keeps lanes.
        road: the lanes.
        laterals: (S, H) lateral action of each step, -1, 0 or 1.
        period: of a step [s].
        gains: of the paper's law; None for lane changes that take their time.
    """
    rows, steps = laterals.shape
    lanes = state.lane + np.cumsum(np.column_stack([np.zeros(rows, dtype=np.int64), laterals]), axis=1)
    y = np.full(rows, state.y)
    centers = centers_of(road, lanes[:, 1:])
    if gains is not None:
        means = paper_means(y, np.full(rows, state.lateral_speed), laterals != 0, centers, period, gains)
        std = _paper_deviations(laterals != 0, noise, period, gains)
    else:
        speed = np.full(rows, following.change_speed(road))
        center, width = np.full(rows, road.center_y(state.lane)), np.full(rows, state.width)
        path = path_of(y, np.full(rows, state.lateral_speed), width, center, speed, road)
        means = followed(y, path, centers, speed * period, np.full(rows, following.decay(period)))
        std = lateral_deviations(noise, following, period, steps)
    return LateralForecast(road, state.width, lanes, np.column_stack([y, means]), std)


def centers_of(road: Road, lanes: IntArray) -> FloatArray:
    """Return y of the lanes' centres [m]; any shape."""
    return np.asarray(((road.lane_count + 1) / 2 - lanes.astype(np.float64)) * road.lane_width)


def paper_means(
    y: FloatArray,
    lateral_speed: FloatArray,
    changes: NDArray[np.bool_],
    centers: FloatArray,
    period: float,
    gains: LateralGains,
) -> FloatArray:
    """Return the mean y after each step by the paper's law, (N, H) [m] (docs/formulation.md, eq. 4).

    Args:
        y: (N,) now [m].
        lateral_speed: (N,) as measured [m/s].
        changes: (N, H) whether each step's action changes the lane.
        centers: (N, H) of the lane that each step's action leads to [m].
        period: [s].
        gains: of the virtual control.
    """
    means = np.empty(centers.shape)
    for k in range(centers.shape[1]):
        following = next_lateral(y, lateral_speed, changes[:, k], centers[:, k], period, gains)
        lateral_speed = (following - y) / period
        y = means[:, k] = following
    return means


def _paper_deviations(changes: NDArray[np.bool_], noise: Noise, period: float, gains: LateralGains) -> FloatArray:
    """Return the standard deviation of y by the paper's law, (S, 1 + H) [m]."""
    variances = np.empty((changes.shape[0], 1 + changes.shape[1]))
    variances[:, 0] = noise.initial_lateral_var
    factor = np.where(changes, (1.0 - gains.k1 * period**2 / 2) ** 2, 1.0)
    for k in range(changes.shape[1]):
        variances[:, k + 1] = factor[:, k] * variances[:, k] + noise.process_position_var
    return np.sqrt(variances)
