"""The driving corridor graph: where the ego may be, lane by lane and step by step, and how it may get there.

Per lane state and step the stretches that the branches forbid are merged into blocks; what is left between two
blocks is a free window. Nodes are (lane state, step, window). The ego cannot pass through a vehicle, so a move
between two windows is allowed only where every branch that shares a lane with the ego before and after it stays on
its side. The graph grows with the number of windows, not with the number of vehicles.

Under a distance that depends on the ego's speed, each speed level has windows of its own.
"""

from dataclasses import dataclass
from itertools import chain, pairwise

import numpy as np

from sumo_hmdp.decision.blocks import BoolArray, merge
from sumo_hmdp.decision.distance import Clearance, contact_clearance, safe_clearance
from sumo_hmdp.decision.lattice import EgoLattice
from sumo_hmdp.decision.occupancy import LaneStep, lane_steps, occupied_lanes
from sumo_hmdp.decision.problem import DecisionProblem
from sumo_hmdp.decision.stop_lines import closed_from, closed_stretches
from sumo_hmdp.decision.windows import (
    Clearances,
    Level,
    Place,
    Stretch,
    Traffic,
    Windows,
    farthest_points,
)
from sumo_hmdp.domain.occupancy import LaneState
from sumo_hmdp.domain.plan import ForbiddenInterval
from sumo_hmdp.prediction.branches import Branches, IntArray
from sumo_hmdp.prediction.dynamics import FloatArray


@dataclass(frozen=True)
class Stage:
    """The N free windows of one step; bounds in units of the ego lattice, clipped to what it can reach.

    Attributes:
        lane: (N,) lane that the ego intends there.
        state: (N,) index of the lane state.
        level: (N,) speed level that it holds for; all zero where `levelled` is false.
        phase: (N,) phase of that speed level.
        opening: (N,) number of the opening whose window it is at its speed level: the same branches are behind it and
            ahead, in the same lane state. Where `levelled` is false, each window is an opening of its own.
        low: (N,) lower end.
        high: (N,) upper end; low <= high.
        soft_low: (N,) lower end that keeps every safe distance; equals `low` unless distances are relaxed.
        soft_high: (N,) upper end likewise; it may lie below `soft_low` where no such place exists.
        stop_high: (N,) upper end of where the ego may come to rest if it brakes from here, soft in relaxed corridors;
            infinite but at the last step, where a stop line matters.
        moves: (N of the previous step, N) whether the ego may move between two windows.
    """

    lane: IntArray
    state: IntArray
    level: IntArray
    phase: IntArray
    opening: IntArray
    low: FloatArray
    high: FloatArray
    soft_low: FloatArray
    soft_high: FloatArray
    stop_high: FloatArray
    moves: BoolArray

    @property
    def opening_count(self) -> int:
        """Number of openings."""
        return 1 + int(self.opening.max(initial=-1))


@dataclass(frozen=True)
class Corridors:
    """The corridor graph of one decision.

    Attributes:
        stages: one per step 1..H.
        states: the ego's lane states at the end of each step 0..H.
        levelled: whether windows hold for one speed level only.
    """

    stages: tuple[Stage, ...]
    states: tuple[tuple[LaneState, ...], ...]
    levelled: bool

    @property
    def passable(self) -> bool:
        """Tell whether every step has at least one window."""
        return all(len(stage.lane) for stage in self.stages)

    @property
    def lines(self) -> bool:
        """Tell whether a stop line may matter."""
        return bool(np.isfinite(self.stages[-1].stop_high).any())


def clearances(problem: DecisionProblem, branches: Branches, margin: FloatArray, *, relaxed: bool) -> Clearances:
    """Return the distances of a decision.

    Args:
        problem: the decision problem.
        branches: of its vehicles.
        margin: of the chance constraint, (B, H) [m].
        relaxed: whether only contact makes the windows.
    """

    def safe(speed: float) -> Clearance:
        return safe_clearance(problem, branches, margin, speed)

    def contact(speed: float) -> Clearance:
        return contact_clearance(problem, branches, safe(speed))

    return Clearances(safe, contact if relaxed else safe)


def carve(problem: DecisionProblem, lattice: EgoLattice, branches: Branches, distances: Clearances) -> Corridors:
    """Build the corridor graph (docs/formulation.md, eqs. 10 and 23).

    Returns:
        The graph; a step at which everything is taken has a stage without windows.
    """
    levelled = problem.settings.distance_hangs_on_speed
    levels: list[dict[Level, tuple[float, float]]] = [
        lattice.ranges[k] if levelled else {(0, 0): farthest_points(lattice, k + 1)} for k in range(lattice.steps)
    ]
    lanes = lane_steps(problem)
    traffic = Traffic.of(problem, lattice, branches, distances, chain.from_iterable(levels))
    places = [
        Place(k, lanes[k + 1], _closed(problem, lanes[k + 1]), level, reach)
        for k in range(lattice.steps)
        for level, reach in levels[k].items()
    ]
    windows = [traffic.start(problem, branches, lanes[0]), *traffic.windows(lattice, places)]
    stages = [
        _stage(before, after, step, levelled=levelled)
        for (before, after), step in zip(pairwise(windows), lanes[1:], strict=True)
    ]
    return Corridors(stages=tuple(stages), states=tuple(step.states for step in lanes), levelled=levelled)


def _closed(problem: DecisionProblem, lanes: LaneStep) -> FloatArray:
    """Return the x from which stop lines close each lane state of a step, shape (S,) [m]."""
    if not problem.stop_lines:
        return np.full(len(lanes.states), np.inf)
    return np.array([closed_from(problem, state) for state in lanes.states])


def _stage(before: Windows, after: Windows, lanes: LaneStep, *, levelled: bool) -> Stage:
    """Describe one step by its windows and those of the step before."""
    low, high, soft_low, soft_high = after.bounds
    return Stage(
        lane=lanes.lane[after.state],
        state=after.state,
        level=after.level,
        phase=after.phase,
        opening=_openings(after) if levelled else np.arange(len(after.state)),
        low=low,
        high=high,
        soft_low=soft_low,
        soft_high=soft_high,
        stop_high=after.stop_high,
        moves=_moves(before, after, lanes, levelled=levelled),
    )


def _openings(windows: Windows) -> IntArray:
    """Number the openings of a step and return that of each window."""
    counts = np.bitwise_count(windows.behind).sum(axis=1)
    signatures = (bits.tobytes() for bits in windows.behind)
    found = list(zip(windows.state.tolist(), counts.tolist(), signatures, strict=True))
    # From behind to ahead in each lane state, as the windows are.
    numbers = {opening: number for number, opening in enumerate(sorted(set(found)))}
    return np.array([numbers[opening] for opening in found], dtype=np.int64)


def _moves(before: Windows, after: Windows, lanes: LaneStep, *, levelled: bool) -> BoolArray:
    """Tell which windows can follow each other, shape (W before, W after).

    Every branch that shares a lane with the ego before and after must be on the same side of it.
    """
    overtaken = before.ahead.T[:, :, None] & after.behind.T[:, None]
    overtaking = before.behind.T[:, :, None] & after.ahead.T[:, None]
    passed = np.bitwise_or.reduce(overtaken | overtaking, axis=0)
    moves: BoolArray = lanes.move[before.state[:, None], after.state] & (passed == 0)
    if levelled:
        moves &= np.abs(after.level - before.level[:, None]) <= 1
        moves &= before.phase[:, None] <= after.phase
    return moves


def forbidden_intervals(
    problem: DecisionProblem, lattice: EgoLattice, branches: Branches, margin: FloatArray
) -> tuple[ForbiddenInterval, ...]:
    """Return what is forbidden in each lane taken alone, at the ego's present speed, and by stop lines; for display.

    Args:
        problem: the decision problem.
        lattice: of its ego.
        branches: of its vehicles.
        margin: of the chance constraint, (B, H) [m].
    """
    occupied = occupied_lanes(problem, branches)
    stretch = Stretch.of(branches.x, safe_clearance(problem, branches, margin, problem.ego.speed))
    horizon, lanes = problem.settings.horizon_steps, problem.road.lane_count
    member = occupied.transpose(1, 2, 0).reshape(horizon * lanes, -1)
    merged = merge(stretch.low.T, stretch.high.T, member, np.repeat(np.arange(horizon), lanes))
    found = []
    for row, (first, reach) in enumerate(zip(merged.first, merged.reach, strict=True)):
        k, index = divmod(row, lanes)
        starts = np.flatnonzero(first)
        # What begins a block ends the one before it.
        ends = zip(merged.low[k, starts[:-1]].tolist(), reach[starts[1:]].tolist(), strict=True)
        found += [ForbiddenInterval(k + 1, index + 1, a, b) for a, b in ends]
    return (*found, *closed_stretches(problem, lattice))
