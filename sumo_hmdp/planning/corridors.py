"""The driving corridor graph: where the ego may be, lane by lane and step by step, and how it may get there.

Per lane state and step the stretches that the branches forbid are merged into blocks; what is left between two
blocks is a free window. Nodes are (lane state, step, window). The ego cannot pass through a vehicle, so a move
between two windows is allowed only where every branch that shares a lane with the ego before and after it stays on
its side. The graph grows with the number of windows, not with the number of vehicles.

Under a distance that depends on the ego's speed, each speed level has windows of its own.
"""

from dataclasses import dataclass
from itertools import chain, islice

import numpy as np

from sumo_hmdp.domain.occupancy import LaneState
from sumo_hmdp.domain.plan import ForbiddenInterval
from sumo_hmdp.hmdp.branches import Branches, IntArray
from sumo_hmdp.hmdp.dynamics import FloatArray
from sumo_hmdp.planning.distance import Clearance, contact_clearance, safe_clearance
from sumo_hmdp.planning.lattice import EgoLattice
from sumo_hmdp.planning.occupancy import LaneStep, lane_steps, occupied_lanes
from sumo_hmdp.planning.problem import DecisionProblem
from sumo_hmdp.planning.stop_lines import closed_from, closed_stretches
from sumo_hmdp.planning.windows import (
    BoolArray,
    Clearances,
    Cut,
    Level,
    Place,
    Stretch,
    Traffic,
    farthest_points,
    merge,
    running,
)


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
    cuts = iter(traffic.cuts(lattice, places))
    before = [traffic.start(problem, lanes[0])]
    stages: list[Stage] = []
    for k in range(lattice.steps):
        after = list(islice(cuts, len(levels[k])))
        stages.append(_stage(before, after, lanes[k + 1]))
        before = after
    return Corridors(stages=tuple(stages), states=tuple(step.states for step in lanes), levelled=levelled)


def _closed(problem: DecisionProblem, lanes: LaneStep) -> FloatArray:
    """Return the x from which stop lines close each lane state of a step, shape (S,) [m]."""
    if not problem.stop_lines:
        return np.full(len(lanes.states), np.inf)
    return np.array([closed_from(problem, state) for state in lanes.states])


def _stage(before: list[Cut], after: list[Cut], lanes: LaneStep) -> Stage:
    """Join the windows of one step, by lane state and then by speed level."""
    if len(before) == len(after) == 1:
        # Nothing hangs on the speed: the windows are in order as they are.
        (cut,) = after
        level, phase = (np.full(len(cut.state), number) for number in cut.level)
        low, high, soft_low, soft_high = cut.bounds
        return Stage(
            lane=lanes.lane[cut.state],
            state=cut.state,
            level=level,
            phase=phase,
            opening=np.arange(len(cut.state)),
            low=low,
            high=high,
            soft_low=soft_low,
            soft_high=soft_high,
            stop_high=cut.stop_high,
            moves=_moves(before[0], cut, lanes),
        )
    rows, columns = _by_state(before), _by_state(after)
    moves = np.zeros((len(rows), len(columns)), dtype=bool)
    top = 0
    for earlier in before:
        bottom, left = top + len(earlier.state), 0
        for later in after:
            right = left + len(later.state)
            if _may_follow(earlier.level, later.level):
                moves[top:bottom, left:right] = _moves(earlier, later, lanes)
            left = right
        top = bottom
    nothing = np.zeros(0, dtype=np.int64)
    state = np.concatenate([nothing, *(cut.state for cut in after)])[columns]
    levels = np.array([cut.level for cut in after], dtype=np.int64).reshape(-1, 2)
    level, phase = np.repeat(levels, [len(cut.state) for cut in after], axis=0)[columns].T
    low, high, soft_low, soft_high = np.concatenate([np.zeros((4, 0)), *(cut.bounds for cut in after)], axis=1)[
        :, columns
    ]
    return Stage(
        lane=lanes.lane[state],
        state=state,
        level=level,
        phase=phase,
        opening=_openings(after, lanes)[columns] if len(after) > 1 else np.arange(len(columns)),
        low=low,
        high=high,
        soft_low=soft_low,
        soft_high=soft_high,
        stop_high=np.concatenate([np.zeros(0), *(cut.stop_high for cut in after)])[columns],
        moves=moves[rows[:, None], columns],
    )


def _by_state(cuts: list[Cut]) -> IntArray:
    """Return the order of the windows of all speed levels of a step."""
    states = [cut.state for cut in cuts]
    return np.argsort(np.concatenate([np.zeros(0, dtype=np.int64), *states]), kind="stable")


def _openings(cuts: list[Cut], lanes: LaneStep) -> IntArray:
    """Number the openings of a step and return that of each window of each speed level in turn."""
    found: list[tuple[int, int, bytes]] = []
    for cut in cuts:
        block = cut.block[lanes.footprint[cut.state]]
        behind = (block >= 0) & (block < cut.number[:, None])
        signatures = (bits.tobytes() for bits in np.packbits(behind, axis=1))
        found += zip(cut.state.tolist(), behind.sum(axis=1).tolist(), signatures, strict=True)
    # From behind to ahead in each lane state, as the windows are.
    numbers = {opening: number for number, opening in enumerate(sorted(set(found)))}
    return np.array([numbers[opening] for opening in found], dtype=np.int64)


def _moves(earlier: Cut, later: Cut, lanes: LaneStep) -> BoolArray:
    """Tell which windows can follow each other, shape (W before, W after).

    Every branch that shares a lane with the ego before and after must be on the same side of it: with b the block of a
    branch after the step, the window there lies ahead of the greatest b of those behind the window before, and behind
    the least b of those ahead.
    """
    first = (earlier.block >= 0).take(earlier.order, axis=1).take(lanes.before, axis=0)
    block = later.block.take(earlier.order, axis=1).take(lanes.after, axis=0)
    shared = first & (block >= 0)
    nobody = len(earlier.order) + 1
    behind = running(np.maximum, np.where(shared, block, -1), -1)
    ahead = running(np.minimum, np.where(shared, block, nobody)[:, ::-1], nobody)[:, ::-1]
    move = lanes.move[earlier.state[:, None], later.state]
    place, number = earlier.place[:, None], later.number
    return (move >= 0) & (behind[move, place] < number) & (number <= ahead[move, place])


def _may_follow(before: Level, after: Level) -> bool:
    """Tell whether one step can lead from one speed level and phase to another."""
    return abs(after[0] - before[0]) <= 1 and before[1] <= after[1]


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
