"""Who is next ahead and behind, in every lane, of every vehicle of a scene at once."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.errors import InputError

IntArray = NDArray[np.intp]
FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Neighbours:
    """Indices of the nearest vehicles, each of shape (lane_count, n): row l - 1 is lane l, column i is vehicle i.

    Where there is none the index is n, which no array of the n vehicles has: who forgets to look is told.

    Attributes:
        ahead: of those whose front bumper is ahead of that of vehicle i, the one whose rear bumper is nearest.
        behind: nearest by the front bumper, behind vehicle i.
        rank: of each vehicle along the road, shape (n,); 0 is the last one.
    """

    ahead: IntArray
    behind: IntArray
    rank: IntArray


def find_neighbours(
    x: FloatArray, lane: IntArray, second_lane: IntArray, lane_count: int, length: FloatArray | None = None
) -> Neighbours:
    """Return everybody's nearest vehicles in every lane.

    Of two at the same x the one later in the arrays counts as ahead. Two that are level in a lane, as when one is about
    to enter it beside a truck, may both be ahead: the one whose rear bumper is nearer is the leader.

    Args:
        x: front bumpers [m], shape (n,).
        lane: 1 is leftmost, shape (n,).
        second_lane: the other lane that a vehicle occupies while it changes, 0 for none; it is there in both.
        lane_count: number of lanes.
        length: [m], shape (n,); None where all are of no length.

    Raises:
        InputError: a position is not finite, or a lane is not on the road.
    """
    count = len(x)
    # A sum is finite where every term is.
    if not (math.isfinite(x.sum()) and _within(lane, 1, lane_count) and _within(second_lane, 0, lane_count)):
        raise InputError([_mistake(x, lane, second_lane, lane_count)])
    order = x.argsort(kind="stable")
    place = np.arange(count)
    rank = np.empty_like(order)
    rank[order] = place
    there = np.zeros((lane_count + 1, count), dtype=bool)
    there[lane, rank] = True
    # Row 0 takes those without a second lane, and is left out from here on.
    there[second_lane, rank] = True
    there = there[1:]
    by_rear = place if length is None else (x - length).take(order).argsort(kind="stable")
    rear_rank = np.empty_like(place)
    rear_rank[by_rear] = place
    # Both -1 and n select the last entry, which stands for nobody.
    leaders, followers = np.empty(count + 1, dtype=np.intp), np.empty(count + 1, dtype=np.intp)
    leaders[:-1], followers[:-1] = order.take(by_rear), order
    leaders[-1] = followers[-1] = count
    ahead, behind = np.empty((2, lane_count, count + 1), dtype=np.intp)
    ahead[:, -1], behind[:, 0] = count, -1
    np.minimum.accumulate(np.where(there, rear_rank, count)[:, ::-1], axis=1, out=ahead[:, -2::-1])
    np.maximum.accumulate(np.where(there, place, -1), axis=1, out=behind[:, 1:])
    # Column r of `ahead` still counts the vehicle of rank r itself, column r of `behind` ends before it.
    # `take` is several times as fast as indexing here.
    return Neighbours(
        leaders.take(ahead.take(rank + 1, axis=1)), followers.take(behind.take(rank, axis=1), mode="wrap"), rank
    )


def _within(lanes: IntArray, low: int, high: int) -> bool:
    return not len(lanes) or bool(lanes.min() >= low and lanes.max() <= high)


def _mistake(x: FloatArray, lane: IntArray, second_lane: IntArray, lane_count: int) -> str:
    on_road = (lane >= 1) & (lane <= lane_count) & (second_lane >= 0) & (second_lane <= lane_count)
    i = int(np.argmin(np.isfinite(x) & on_road))
    return (
        f"a vehicle must have a finite x, a lane in 1..{lane_count} and a second lane in 0..{lane_count}, got x = "
        f"{x[i]} m, lane {lane[i]} and second lane {second_lane[i]} (vehicle number {i}). Leave it out."
    )
