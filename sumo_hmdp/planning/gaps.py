"""The corridor graph as the solvers read it: by gap, and within a gap by speed level.

Under a distance that depends on the ego's speed a step has windows for each speed level, a dozen times as many as
there are gaps between branches. Which gap follows which does not depend on the speed, so both solvers choose gaps and
look up the bounds of the one window that a gap has at a speed level.
"""

from dataclasses import dataclass

import numpy as np

from sumo_hmdp.hmdp.branches import IntArray
from sumo_hmdp.hmdp.dynamics import FloatArray
from sumo_hmdp.planning.corridors import Corridors, Stage
from sumo_hmdp.planning.windows import BoolArray


@dataclass(frozen=True)
class Gaps:
    """The G gaps of one step and their windows.

    Windows lie in arrays of shape (G, levels, phases); levels run from -H to H. Without speed levels both axes have
    length 1.

    Attributes:
        lane: (G,) lane that the ego intends there.
        stop_high: (G,) upper end of where the ego may come to rest if it brakes from here.
        moves: (G of the previous step, G) whether the ego may move between two gaps.
        low: lower end of the window, infinite where a gap has none at a speed level.
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
        """Which windows there are, shape (G, levels, phases)."""
        return np.isfinite(self.low)

    def at(self, bounds: FloatArray, level: IntArray, phase: IntArray) -> FloatArray:
        """Return bounds of the windows at P speed levels, shape (P, G)."""
        if not self.levelled:
            return bounds[:, 0, 0][None]
        return bounds[:, level + bounds.shape[1] // 2, phase].T


def gaps_of(corridors: Corridors, *, stopping: bool) -> tuple[Gaps, ...]:
    """Arrange the windows of each step by gap.

    Args:
        corridors: the corridor graph.
        stopping: whether there are speed levels of phase 1.
    """
    levels = 2 * len(corridors.stages) + 1 if corridors.levelled else 1
    phases = 1 + stopping if corridors.levelled else 1
    found, before = [], np.zeros(1, dtype=np.int64)
    for stage in corridors.stages:
        found.append(_arranged(stage, before, (stage.gap_count, levels, phases), levelled=corridors.levelled))
        before = stage.gap
    return tuple(found)


def _arranged(stage: Stage, before: IntArray, shape: tuple[int, int, int], *, levelled: bool) -> Gaps:
    """Arrange one step, given the gap of each window of the step before."""
    lane, stop_high = np.zeros(shape[0], dtype=np.int64), np.zeros(shape[0])
    lane[stage.gap], stop_high[stage.gap] = stage.lane, stage.stop_high
    moves = np.zeros((1 + int(before.max(initial=-1)), shape[0]), dtype=bool)
    start, end = np.nonzero(stage.moves)
    moves[before[start], stage.gap[end]] = True
    place = (stage.gap, stage.level + shape[1] // 2, stage.phase)

    def windows(bound: FloatArray, missing: float) -> FloatArray:
        array = np.full(shape, missing)
        array[place] = bound
        return array

    return Gaps(
        lane=lane,
        stop_high=stop_high,
        moves=moves,
        low=windows(stage.low, np.inf),
        high=windows(stage.high, -np.inf),
        soft_low=windows(stage.soft_low, np.inf),
        soft_high=windows(stage.soft_high, -np.inf),
        levelled=levelled,
    )
