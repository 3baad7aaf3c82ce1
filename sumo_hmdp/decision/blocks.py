"""Stretches of the road merged into blocks, for many sets of lanes at once."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.prediction.branches import IntArray
from sumo_hmdp.prediction.dynamics import FloatArray

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class Merged:
    """Stretches merged into blocks, in J layers of n stretches, for R sets of lanes.

    Attributes:
        order: (J, n) the stretches of each layer by their lower end.
        low: (J, n + 1) lower ends in that order, then infinity.
        rank: (J, n) where in that order each stretch is.
        member: (R, n) which stretches belong to each set, in the order of its layer.
        first: (R, n + 1) whether a stretch in that order begins a block; true at the end, where a last one would.
        reach: (R, n + 1) how far those before it reach; minus infinity before the first block.
    """

    order: IntArray
    low: FloatArray
    rank: IntArray
    member: BoolArray
    first: BoolArray
    reach: FloatArray


def merge(low: FloatArray, high: FloatArray, member: BoolArray, layer: IntArray) -> Merged:
    """Merge stretches.

    Args:
        low: (J, n) lower ends.
        high: (J, n) upper ends.
        member: (R, n) which of them belong to each set of lanes.
        layer: (R,) the layer of each set.
    """
    layers, count = low.shape
    order = np.argsort(low, axis=1, kind="stable")
    rank = np.empty_like(order)
    # Flat: NumPy's functions along an axis build index arrays that cost more than all else here.
    of_layers = order + count * np.arange(layers)[:, None]
    rank.reshape(-1)[of_layers] = np.arange(count)
    high = high.take(of_layers)
    ends = np.full((layers, count + 1), np.inf)
    ends[:, :-1] = low.take(of_layers)
    member = member.take(order.take(layer, axis=0) + count * np.arange(len(layer))[:, None])
    reach = running(np.maximum, np.where(member, high[layer], -np.inf), -np.inf)
    first = np.ones(reach.shape, dtype=bool)
    first[:, :-1] = member & (ends[layer, :-1] >= reach[:, :-1])
    return Merged(order, ends, rank, member, first, reach)


def running(extreme: np.ufunc, values: FloatArray, of_none: float) -> FloatArray:
    """Return the extreme of all values before each place and of all of them, (U, n) to (U, n + 1)."""
    result = np.empty((values.shape[0], values.shape[1] + 1))
    result[:, 0] = of_none
    extreme.accumulate(values, axis=1, out=result[:, 1:])
    return result
