"""The driving corridor graph: where the ego may be, lane by lane and step by step, and how it may get there.

Per lane state and step the stretches that the branches forbid are merged into blocks; what is left between two
blocks is a free window. Nodes are (lane state, step, window). The ego cannot pass through a vehicle, so a move
between two windows is allowed only where every branch that shares a lane with the ego before and after it stays on
its side. The graph grows with the number of windows, not with the number of vehicles.

Under a distance that depends on the ego's speed, each speed level has windows of its own.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.domain.maneuver import Lateral
from sumo_hmdp.domain.plan import ForbiddenInterval
from sumo_hmdp.hmdp.branches import Branches, IntArray
from sumo_hmdp.hmdp.dynamics import FloatArray
from sumo_hmdp.planning.distance import Clearance, contact_clearance, safe_clearance
from sumo_hmdp.planning.lattice import EgoLattice
from sumo_hmdp.planning.occupancy import LaneState, lane_states, occupied_lanes, present_lanes, sweep_steps
from sumo_hmdp.planning.problem import DISTANCE_TOLERANCE, DecisionProblem
from sumo_hmdp.planning.stop_lines import closed_from, closed_stretches, farthest_stop

BoolArray = NDArray[np.bool_]
Level = tuple[int, int]

# A bound in lattice units that a position meets up to rounding is met.
UNIT_TOLERANCE = 1e-9


@dataclass(frozen=True)
class Stage:
    """The N free windows of one step; bounds in units of the ego lattice, clipped to what it can reach.

    Attributes:
        lane: (N,) lane that the ego intends there.
        state: (N,) index of the lane state.
        order: (N,) number of the window in its lane state, counted from behind; it lies ahead of blocks 0..order - 1.
        level: (N,) speed level that it holds for; all zero where `levelled` is false.
        phase: (N,) phase of that speed level.
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
    order: IntArray
    level: IntArray
    phase: IntArray
    low: FloatArray
    high: FloatArray
    soft_low: FloatArray
    soft_high: FloatArray
    stop_high: FloatArray
    moves: BoolArray


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


@dataclass(frozen=True)
class Clearances:
    """The distances that make windows, by the ego's speed.

    Attributes:
        safe: distances to keep at a speed of the ego [m/s].
        hard: distances that make the windows; the safe ones, or those of contact where a plan may be relaxed.
    """

    safe: Callable[[float], Clearance]
    hard: Callable[[float], Clearance]


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
    states = lane_states(problem)
    occupied = occupied_lanes(problem, branches)
    before = _start(problem, branches, states[0][0])
    stages: list[Stage] = []
    by_speed: dict[float, tuple[Clearance, Clearance]] = {}
    for k in range(problem.settings.horizon_steps):
        levels: list[Level] = lattice.levels(k + 1) if levelled else [(0, 0)]
        pieces: list[_Piece] = []
        for index, state in enumerate(states[k + 1]):
            rows = np.flatnonzero(occupied[:, k, [lane - 1 for lane in state.occupied]].any(axis=1))
            closed = closed_from(problem, state.occupied)
            for level, phase in levels:
                speed = lattice.speed_at(level, phase)
                if speed not in by_speed:
                    safe = distances.safe(speed)
                    by_speed[speed] = safe if distances.hard is distances.safe else distances.hard(speed), safe
                place = _Place(state, index, level, phase, closed)
                pieces.append(_carve(lattice, branches, by_speed[speed], k, rows, place))
        after = _Frontier(states[k + 1], pieces)
        stages.append(_stage(after, _moves(before, after, sweep_steps(problem), levelled=levelled)))
        before = after
    return Corridors(
        stages=tuple(stages),
        states=tuple(map(tuple, states)),
        levelled=levelled,
    )


@dataclass(frozen=True)
class _Place:
    """What a piece of the graph is for: a lane state and a speed level; a stop line may close it from some x on."""

    state: LaneState
    index: int
    level: int
    phase: int
    closed_from: float = np.inf


@dataclass(frozen=True)
class _Piece:
    """One lane state at one step and speed level: its windows, and the block that each branch belongs to."""

    place: _Place
    block: IntArray  # (B,), -1 where the branch takes up none of the state's lanes
    block_low: FloatArray
    block_high: FloatArray
    order: IntArray
    bounds: FloatArray  # (4, N): low, high, soft_low, soft_high
    stop_high: float = np.inf


@dataclass(frozen=True)
class _Frontier:
    """All pieces of one step."""

    states: list[LaneState]
    pieces: list[_Piece]


def _start(problem: DecisionProblem, branches: Branches, state: LaneState) -> _Frontier:
    """Describe step 0 like a step with the single window 1; block 0 lies behind it and block 1 ahead."""
    shares = np.array(
        [bool(present_lanes(problem, v.state) & set(state.occupied)) for v in problem.vehicles], dtype=bool
    )
    ego_is_ahead = np.array([problem.ego.x > v.state.x for v in problem.vehicles], dtype=bool)
    block = np.where(shares, np.where(ego_is_ahead, 0, 1), -1).astype(np.int64)
    nothing = np.zeros(0)
    piece = _Piece(_Place(state, 0, 0, 0), block[branches.vehicle], nothing, nothing, np.array([1]), np.zeros((4, 1)))
    return _Frontier([state], [piece])


def _carve(
    lattice: EgoLattice, branches: Branches, by_kind: tuple[Clearance, Clearance], k: int, rows: IntArray, place: _Place
) -> _Piece:
    """Merge the forbidden stretches of some branches at step index k into blocks and list the windows between them."""
    hard, soft = by_kind
    x = branches.x[rows, k]
    # The ends belong to the windows, and a distance may miss its bound by the tolerance.
    low = x - np.maximum(hard.behind[rows, k] - DISTANCE_TOLERANCE, 0.0)
    high = x + np.maximum(hard.ahead[rows, k] - DISTANCE_TOLERANCE, 0.0)
    by_low = np.argsort(low, kind="stable")
    rows, x, low, high = rows[by_low], x[by_low], low[by_low], high[by_low]
    reach = np.maximum.accumulate(high)
    first = np.ones(len(rows), dtype=bool)
    first[1:] = low[1:] >= reach[:-1]
    block = np.full(len(branches.vehicle), -1, dtype=np.int64)
    block[rows] = np.cumsum(first) - 1
    starts = np.flatnonzero(first)
    last = np.append(starts[1:], len(rows)) - 1 if len(rows) else starts
    block_low, block_high = low[starts], reach[last]
    ends = np.full((4, len(starts) + 1), np.inf)
    ends[0::2, 0] = -np.inf
    ends[0, 1:], ends[1, :-1] = block_high, block_low
    if hard is soft:
        ends[2:] = ends[:2]
    else:
        # Within a window the worst distance to all that is behind, and to all that is ahead, counts.
        behind = np.maximum.accumulate(x + np.maximum(soft.ahead[rows, k] - DISTANCE_TOLERANCE, 0.0))
        ahead = (x - np.maximum(soft.behind[rows, k] - DISTANCE_TOLERANCE, 0.0))[::-1]
        ends[2, 1:] = behind[last]
        ends[3, :-1] = np.minimum.accumulate(ahead)[::-1][starts]
    # Metres beyond a line are counted from the line itself, so that one that loses there what it gains elsewhere ties.
    closed = place.closed_from + (DISTANCE_TOLERANCE if hard is soft else 0.0)
    ends[3] = np.minimum(ends[3], closed)
    if hard is soft:
        ends[1] = ends[3]
    units = lattice.to_units(k + 1, ends)
    reach_units = _reach(lattice, k + 1)
    units[0::2] = np.maximum(units[0::2], reach_units[0])
    units[1::2] = np.minimum(units[1::2], reach_units[1])
    if not lattice.stopping:
        # Positions are whole numbers of units: so are the bounds that matter.
        units[0], units[1] = np.ceil(units[0] - UNIT_TOLERANCE), np.floor(units[1] + UNIT_TOLERANCE)
    order = np.flatnonzero(units[0] <= units[1])
    stop_high = float((closed - lattice.drift(k + 1)) / lattice.unit)
    if k + 1 < lattice.steps or stop_high >= farthest_stop(lattice):
        stop_high = np.inf
    return _Piece(place, block, block_low, block_high, order, units[:, order], stop_high)


def _reach(lattice: EgoLattice, step: int) -> tuple[float, float]:
    """Return the least and greatest lattice point within k steps; who stops is at most at rest all the time behind."""
    back = -float(step**2)
    if lattice.stopping:
        back = min(back, (lattice.x - lattice.drift(step)) / lattice.unit)
    return back, float(step**2)


def _stage(frontier: _Frontier, moves: BoolArray) -> Stage:
    """Join the pieces of one step."""
    pieces = frontier.pieces
    sizes = [len(piece.order) for piece in pieces]
    places = [piece.place for piece in pieces]
    bounds = np.concatenate([piece.bounds for piece in pieces], axis=1) if pieces else np.zeros((4, 0))

    def spread(values: list[int]) -> IntArray:
        return np.repeat(np.array(values, dtype=np.int64), sizes)

    return Stage(
        lane=spread([place.state.lane for place in places]),
        state=spread([place.index for place in places]),
        order=np.concatenate([piece.order for piece in pieces]) if pieces else np.zeros(0, dtype=np.int64),
        level=spread([place.level for place in places]),
        phase=spread([place.phase for place in places]),
        low=bounds[0],
        high=bounds[1],
        soft_low=bounds[2],
        soft_high=bounds[3],
        stop_high=np.repeat(np.array([piece.stop_high for piece in pieces], dtype=np.float64), sizes),
        moves=moves,
    )


def _moves(before: _Frontier, after: _Frontier, sweep: int, *, levelled: bool) -> BoolArray:
    """Tell which windows can follow each other, shape (N before, N after)."""
    starts_before = np.concatenate([[0], np.cumsum([len(piece.order) for piece in before.pieces])]).astype(int)
    starts_after = np.concatenate([[0], np.cumsum([len(piece.order) for piece in after.pieces])]).astype(int)
    moves = np.zeros((starts_before[-1], starts_after[-1]), dtype=bool)
    numbers: dict[tuple[LaneState, int, int], int] = {
        (piece.place.state, piece.place.level, piece.place.phase): number for number, piece in enumerate(after.pieces)
    }
    for i, earlier in enumerate(before.pieces):
        if not len(earlier.order):
            continue
        place = earlier.place
        states = (place.state.after(lateral, sweep) for lateral in Lateral)
        levels = tuple(_following_levels(place)) if levelled else ((0, 0),)
        for j in (numbers[key] for key in ((s, *level) for s in states for level in levels) if key in numbers):
            if len(after.pieces[j].order):
                rows = slice(starts_before[i], starts_before[i + 1])
                columns = slice(starts_after[j], starts_after[j + 1])
                moves[rows, columns] = _same_side(earlier, after.pieces[j])
    return moves


def _following_levels(place: _Place) -> Iterator[Level]:
    """Yield the speed levels and phases that one step can lead to."""
    for phase in range(place.phase, 2):
        for level in range(place.level - 1, place.level + 2):
            yield level, phase


def _same_side(earlier: _Piece, later: _Piece) -> BoolArray:
    """Tell for each pair of windows whether every branch that is in both pieces is on the same side in both."""
    shared = (earlier.block >= 0) & (later.block >= 0)
    allowed = np.ones((len(earlier.order), len(later.order)), dtype=bool)
    if shared.any():
        width = int(later.block.max()) + 1
        # Branches repeat one another: few pairs of blocks remain.
        pairs = np.unique(earlier.block[shared] * width + later.block[shared])
        ahead_before = earlier.order[None, :] > (pairs // width)[:, None]
        ahead_after = later.order[None, :] > (pairs % width)[:, None]
        allowed = (ahead_before[:, :, None] == ahead_after[:, None, :]).all(axis=0)
    return allowed


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
    safe = safe_clearance(problem, branches, margin, problem.ego.speed)
    found = []
    for k in range(problem.settings.horizon_steps):
        for lane in range(1, problem.road.lane_count + 1):
            rows = np.flatnonzero(occupied[:, k, lane - 1])
            piece = _carve(lattice, branches, (safe, safe), k, rows, _Place(LaneState(lane), 0, 0, 0))
            found += [
                ForbiddenInterval(k + 1, lane, a, b)
                for a, b in zip(piece.block_low.tolist(), piece.block_high.tolist(), strict=True)
            ]
    return (*found, *closed_stretches(problem, lattice))
