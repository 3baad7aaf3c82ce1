"""The corridor graph as the solvers read it: by opening, and within an opening by speed level.

An opening is what lies between the same two neighbours in a lane state, whatever the ego's speed; a window is its
stretch of x. Under a distance that depends on the ego's speed a step has windows for each speed level, a dozen times
as many as openings. Which opening follows which does not depend on the speed, so both solvers choose openings and
look up the one window that an opening has at a speed level.
"""

from dataclasses import dataclass

import numpy as np

from sumo_hmdp.decision.blocks import BoolArray
from sumo_hmdp.decision.corridors import Corridors, Stage
from sumo_hmdp.prediction.branches import IntArray
from sumo_hmdp.prediction.dynamics import FloatArray


@dataclass(frozen=True)
class Openings:
    """The W openings of one step and their windows.

    Windows lie in arrays of shape (W, levels, phases); levels run from -H to H. Without speed levels both axes have
    length 1.

    Attributes:
        lane: (W,) lane that the ego intends there.
        stop_high: (W,) upper end of where the ego may come to rest if it brakes from here.
        moves: (W of the previous step, W) whether the ego may move between two openings.
        low: lower end of the window, infinite where an opening has none at a speed level.
        high: its upper end, then minus infinite.
        soft_low: lower end that keeps every safe distance, likewise.
        soft_high: upper end that keeps every safe distance, likewise.
        levelled: whether windows hold for one speed level only.
    """

    lane: IntArray
    stop_high: FloatArray
    moves: BoolArray
    low: FloatArray
    high: FloatArray
    soft_low: FloatArray
    soft_high: FloatArray
    levelled: bool

    @property
    def open(self) -> BoolArray:
        """Which windows there are, shape (W, levels, phases)."""
        return np.isfinite(self.low)

    def at(self, bounds: FloatArray, level: IntArray, phase: IntArray) -> FloatArray:
        """Return bounds of the windows at P speed levels, shape (P, W)."""
        if not self.levelled:
            return bounds[:, 0, 0][None]
        return bounds[:, level + bounds.shape[1] // 2, phase].T


def openings_of(corridors: Corridors, *, stopping: bool) -> tuple[Openings, ...]:
    """Arrange the windows of each step by opening.

    Args:
        corridors: the corridor graph.
        stopping: whether there are speed levels of phase 1.
    """
    if not corridors.levelled:
        return tuple(_as_they_are(stage) for stage in corridors.stages)
    levels, phases = 2 * len(corridors.stages) + 1, 1 + stopping
    found, before = [], np.zeros(1, dtype=np.int64)
    for stage in corridors.stages:
        found.append(_arranged(stage, before, (stage.opening_count, levels, phases)))
        before = stage.opening
    return tuple(found)


def _as_they_are(stage: Stage) -> Openings:
    """Return one step in which each window is an opening of its own, in the same order."""
    low, high, soft_low, soft_high = (
        bound[:, None, None] for bound in (stage.low, stage.high, stage.soft_low, stage.soft_high)
    )
    return Openings(stage.lane, stage.stop_high, stage.moves, low, high, soft_low, soft_high, levelled=False)


def _arranged(stage: Stage, before: IntArray, shape: tuple[int, int, int]) -> Openings:
    """Arrange one step with speed levels, given the opening of each window of the step before."""
    lane, stop_high = np.zeros(shape[0], dtype=np.int64), np.zeros(shape[0])
    lane[stage.opening], stop_high[stage.opening] = stage.lane, stage.stop_high
    moves = np.zeros((1 + int(before.max(initial=-1)), shape[0]), dtype=bool)
    start, end = np.nonzero(stage.moves)
    moves[before[start], stage.opening[end]] = True
    place = (stage.opening, stage.level + shape[1] // 2, stage.phase)

    def windows(bound: FloatArray, missing: float) -> FloatArray:
        array = np.full(shape, missing)
        array[place] = bound
        return array

    return Openings(
        lane=lane,
        stop_high=stop_high,
        moves=moves,
        low=windows(stage.low, np.inf),
        high=windows(stage.high, -np.inf),
        soft_low=windows(stage.soft_low, np.inf),
        soft_high=windows(stage.soft_high, -np.inf),
        levelled=True,
    )
