"""One run as arrays: T instants, V surrounding vehicles, NaN where a vehicle is not there."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from sumo_hmdp.domain.distance import TOUCH
from sumo_hmdp.domain.scene import EGO_ID

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

# Two vehicles whose speeds differ by less keep their distance: the difference is rounding [m/s].
_SAME_SPEED = 1e-6

MOTION = ("x_m", "y_m", "heading_rad", "speed_mps", "accel_mps2", "lane", "intended_lane", "length_m", "width_m")


@dataclass(frozen=True)
class Motion:
    """Bodies over time; the ego's arrays have shape (T, 1), those of the others (T, V).

    Attributes:
        x: front bumper along the road [m].
        y: front bumper across the road, to the left [m].
        heading: counter-clockwise [rad].
        speed: [m/s].
        accel: [m/s2].
        lane: the lane it is in, 1 is leftmost.
        intended_lane: the lane it intends to be in.
        length: [m].
        width: [m].
    """

    x: FloatArray
    y: FloatArray
    heading: FloatArray
    speed: FloatArray
    accel: FloatArray
    lane: FloatArray
    intended_lane: FloatArray
    length: FloatArray
    width: FloatArray


@dataclass(frozen=True)
class Trace:
    """What all metrics are computed from.

    A vehicle is *in the path* while its body and the ego's overlap across the road.

    Attributes:
        time: (T,) of the instants at which the ego was seen [s].
        ego: its motion, shapes (T, 1).
        others: motion of the surrounding vehicles, shapes (T, V).
        ids: their names, V of them.
    """

    time: FloatArray
    ego: Motion
    others: Motion
    ids: tuple[str, ...]

    @cached_property
    def duration(self) -> FloatArray:
        """(T,) time that each instant stands for, up to the next one; 0 at the last [s]."""
        return np.diff(self.time, append=self.time[-1:])

    @cached_property
    def side_gap(self) -> FloatArray:
        """(T, V) free space across the road between two bodies, negative where they overlap across it [m]."""
        return _exact(np.abs(self.others.y - self.ego.y) - (self.others.width + self.ego.width) / 2, TOUCH)

    @cached_property
    def ahead(self) -> BoolArray:
        """(T, V) whether a vehicle's front is level with the ego's or further on."""
        return np.asarray(self.others.x >= self.ego.x)

    @cached_property
    def length_gap(self) -> FloatArray:
        """(T, V) bumper to bumper along the road, negative where two bodies overlap along it [m]."""
        ahead, behind = self.others.x - self.others.length - self.ego.x, self.ego.x - self.ego.length - self.others.x
        return _exact(np.where(self.ahead, ahead, behind), TOUCH)

    @cached_property
    def gap(self) -> FloatArray:
        """(T, V) `length_gap` to the vehicles in the path, NaN to others [m]."""
        return np.where(self.side_gap < 0, self.length_gap, np.nan)

    @cached_property
    def closing_speed(self) -> FloatArray:
        """(T, V) speed at which `length_gap` falls [m/s]."""
        difference = self.ego.speed - self.others.speed
        return _exact(np.where(self.ahead, difference, -difference), _SAME_SPEED)

    @cached_property
    def closing_accel(self) -> FloatArray:
        """(T, V) rate at which `closing_speed` rises [m/s2]."""
        return np.where(self.ahead, self.ego.accel - self.others.accel, self.others.accel - self.ego.accel)


def trace_of(steps: pd.DataFrame) -> Trace:
    """Return the `steps` table of one run as arrays.

    Args:
        steps: with all vehicles; instants without the ego are left out.
    """
    is_ego = (steps["vehicle_id"] == EGO_ID).to_numpy(dtype=bool)
    times = steps["time_s"].to_numpy(dtype=np.float64)
    time = np.unique(times[is_ego])
    seen = ~is_ego & np.isin(times, time)
    code, ids = pd.factorize(steps["vehicle_id"].array[seen], sort=True)
    instant = np.searchsorted(time, times)
    columns = [steps[name].to_numpy(dtype=np.float64) for name in MOTION]

    def motion(rows: BoolArray, column: IntArray, count: int) -> Motion:
        arrays = np.full((len(columns), len(time), count), np.nan)
        for array, values in zip(arrays, columns, strict=True):
            array[instant[rows], column] = values[rows]
        return Motion(*arrays)

    return Trace(
        time=time,
        ego=motion(is_ego, np.zeros(int(is_ego.sum()), dtype=np.int64), 1),
        others=motion(seen, np.asarray(code, dtype=np.int64), len(ids)),
        ids=tuple(str(name) for name in ids),
    )


def _exact(values: FloatArray, rounding: float) -> FloatArray:
    """Return values with those that are zero but for rounding at zero."""
    return np.where(np.abs(values) <= rounding, 0.0, values)


def least(values: FloatArray) -> float:
    """Return the smallest value that is not NaN, NaN where there is none."""
    known = values[~np.isnan(values)]
    return float(known.min()) if known.size else float("nan")


def greatest(values: FloatArray) -> float:
    """Return the largest value that is not NaN, NaN where there is none."""
    return -least(-values)
