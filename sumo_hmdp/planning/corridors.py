"""The driving corridor graph: where the ego may be, lane by lane and step by step, and how it may get there.

Per lane and step the stretches that the branches forbid are merged into blocks; what is left between two blocks
is a free window. Nodes are (lane, step, window). The ego cannot pass through a vehicle, so a move between two
windows is allowed only where every branch that shares the ego's lane before and after it stays on its side.
The graph grows with the number of windows, not with the number of vehicles.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.domain.plan import ForbiddenInterval
from sumo_hmdp.hmdp.branches import Branches, IntArray
from sumo_hmdp.hmdp.dynamics import FloatArray
from sumo_hmdp.planning.lattice import EgoLattice
from sumo_hmdp.planning.problem import DISTANCE_TOLERANCE, DecisionProblem

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class Clearance:
    """How far the ego's front bumper must be from each vehicle's, as a leader and as a follower.

    Attributes:
        ahead: (V, H) least distance while the ego is ahead [m].
        behind: (V, H) least distance while the ego is behind [m].
    """

    ahead: FloatArray
    behind: FloatArray


@dataclass(frozen=True)
class Stage:
    """The N free windows of one step; bounds in units of the ego lattice, clipped to what it can reach.

    Attributes:
        lane: (N,) lane of each window.
        order: (N,) number of the window in its lane, counted from behind; it lies ahead of blocks 0..order - 1.
        low: (N,) lower end.
        high: (N,) upper end; low <= high.
        soft_low: (N,) lower end that keeps every safe distance; equals `low` unless distances are relaxed.
        soft_high: (N,) upper end likewise; it may lie below `soft_low` where no such place exists.
        moves: (N of the previous step, N) whether the ego may move between two windows.
    """

    lane: IntArray
    order: IntArray
    low: FloatArray
    high: FloatArray
    soft_low: FloatArray
    soft_high: FloatArray
    moves: BoolArray


@dataclass(frozen=True)
class Corridors:
    """The corridor graph of one decision.

    Attributes:
        stages: one per step 1..H.
        forbidden: the merged blocks, for display.
    """

    stages: tuple[Stage, ...]
    forbidden: tuple[ForbiddenInterval, ...]

    @property
    def passable(self) -> bool:
        """Tell whether every step has at least one window."""
        return all(len(stage.lane) for stage in self.stages)


def contact_clearance(problem: DecisionProblem, safe: Clearance) -> Clearance:
    """Return the distances below which bumpers touch, never more than the safe ones (docs/formulation.md, eq. 14)."""
    lengths = np.array([v.state.length for v in problem.vehicles]).reshape(-1, 1)
    return Clearance(
        ahead=np.minimum(safe.ahead, problem.ego.length),
        behind=np.minimum(safe.behind, lengths),
    )


def carve(
    problem: DecisionProblem,
    lattice: EgoLattice,
    branches: Branches,
    hard: Clearance,
    soft: Clearance | None = None,
) -> Corridors:
    """Build the corridor graph (docs/formulation.md, eq. 10).

    Args:
        problem: the decision problem.
        lattice: of its ego.
        branches: of its vehicles.
        hard: distances that make the windows.
        soft: distances that the soft ends are measured with; None where they are the hard ones.

    Returns:
        The graph; a step whose lanes are all taken has a stage without windows.
    """
    lanes = [lane for lane in range(1, problem.road.lane_count + 1) if lane not in problem.settings.forbidden_lanes]
    stages: list[Stage] = []
    forbidden: list[ForbiddenInterval] = []
    previous_lane, previous_order, branch_lane, branch_block = _start(problem, branches)
    for k in range(problem.settings.horizon_steps):
        carved = [_carve_lane(lattice, branches, hard, soft or hard, k, lane) for lane in lanes]
        block = np.full(len(branches.vehicle), -1, dtype=np.int64)
        for piece in carved:
            block[piece.rows] = piece.block
        for lane, piece in zip(lanes, carved, strict=True):
            forbidden.extend(
                ForbiddenInterval(k + 1, lane, float(a), float(b))
                for a, b in zip(piece.block_low, piece.block_high, strict=True)
            )
        lane_of = np.concatenate([np.full(len(p.order), lane) for lane, p in zip(lanes, carved, strict=True)])
        order = np.concatenate([piece.order for piece in carved])
        moves = _moves(
            (previous_lane, previous_order),
            (lane_of, order),
            (branch_lane, branch_block),
            (branches.lanes[:, k], block),
        )
        stages.append(
            Stage(
                lane=lane_of,
                order=order,
                low=np.concatenate([piece.low for piece in carved]),
                high=np.concatenate([piece.high for piece in carved]),
                soft_low=np.concatenate([piece.soft_low for piece in carved]),
                soft_high=np.concatenate([piece.soft_high for piece in carved]),
                moves=moves,
            )
        )
        previous_lane, previous_order, branch_lane, branch_block = lane_of, order, branches.lanes[:, k], block
    return Corridors(tuple(stages), tuple(forbidden))


def _start(problem: DecisionProblem, branches: Branches) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """Describe step 0 like a stage with the single window 1; block 0 lies behind it and block 1 ahead."""
    lane = np.array([v.state.lane for v in problem.vehicles], dtype=np.int64)
    ego_is_ahead = np.array([problem.ego.x > v.state.x for v in problem.vehicles], dtype=bool)
    block = np.where(ego_is_ahead, 0, 1)
    return np.array([problem.ego.lane]), np.array([1]), lane[branches.vehicle], block[branches.vehicle]


@dataclass(frozen=True)
class _Lane:
    """One lane at one step: its windows, and the block that each of its branches belongs to."""

    rows: IntArray
    block: IntArray
    block_low: FloatArray
    block_high: FloatArray
    order: IntArray
    low: FloatArray
    high: FloatArray
    soft_low: FloatArray
    soft_high: FloatArray


def _carve_lane(lattice: EgoLattice, branches: Branches, hard: Clearance, soft: Clearance, k: int, lane: int) -> _Lane:
    """Merge the forbidden stretches of one lane at step index k into blocks and list the windows between them."""
    rows = np.flatnonzero(branches.lanes[:, k] == lane)
    x, vehicle = branches.x[rows, k], branches.vehicle[rows]
    # The ends belong to the windows, and a distance may miss its bound by the tolerance.
    low = x - np.maximum(hard.behind[vehicle, k] - DISTANCE_TOLERANCE, 0.0)
    high = x + np.maximum(hard.ahead[vehicle, k] - DISTANCE_TOLERANCE, 0.0)
    by_low = np.argsort(low, kind="stable")
    rows, x, vehicle, low, high = rows[by_low], x[by_low], vehicle[by_low], low[by_low], high[by_low]
    reach = np.maximum.accumulate(high)
    first = np.ones(len(rows), dtype=bool)
    first[1:] = low[1:] >= reach[:-1]
    block = np.cumsum(first) - 1
    starts = np.flatnonzero(first)
    last = np.append(starts[1:], len(rows)) - 1 if len(rows) else starts
    block_low, block_high = low[starts], reach[last]
    # Within a relaxed window the worst distance to all that is behind and to all that is ahead counts.
    soft_reach = np.maximum.accumulate(x + np.maximum(soft.ahead[vehicle, k] - DISTANCE_TOLERANCE, 0.0))
    soft_limit = np.minimum.accumulate((x - np.maximum(soft.behind[vehicle, k] - DISTANCE_TOLERANCE, 0.0))[::-1])[::-1]
    inf = np.array([np.inf])
    ends = np.stack(
        [
            np.concatenate([-inf, block_high]),
            np.concatenate([block_low, inf]),
            np.concatenate([-inf, soft_reach[last]]),
            np.concatenate([soft_limit[starts], inf]),
        ]
    )
    step = k + 1
    units = lattice.to_units(step, ends)
    window_low = np.maximum(np.ceil(units[0]), -(step**2))
    window_high = np.minimum(np.floor(units[1]), step**2)
    order = np.flatnonzero(window_low <= window_high)
    return _Lane(
        rows=rows,
        block=block,
        block_low=block_low,
        block_high=block_high,
        order=order,
        low=window_low[order],
        high=window_high[order],
        soft_low=np.maximum(units[2], -(step**2))[order],
        soft_high=np.minimum(units[3], step**2)[order],
    )


def _moves(
    before: tuple[IntArray, IntArray],
    after: tuple[IntArray, IntArray],
    branch_before: tuple[IntArray, IntArray],
    branch_after: tuple[IntArray, IntArray],
) -> BoolArray:
    """Tell which windows can follow each other.

    Args:
        before: (lane, order) of the windows before.
        after: the same after.
        branch_before: (lane, block) of the branches before.
        branch_after: the same after.

    Returns:
        (N before, N after): lanes at most one apart, and every branch that shares the ego's lane in both steps is
        on the same side of it in both.
    """
    lane_before, order_before = before
    lane_after, order_after = after
    allowed: BoolArray = np.abs(lane_before[:, None] - lane_after[None, :]) <= 1
    relations = np.stack([*branch_before, *branch_after], axis=1)
    # Branches that have the ego on neither side of a move need no look; most of the rest repeat one another.
    relevant = (relations[:, 1] >= 0) & (relations[:, 3] >= 0) & (np.abs(relations[:, 0] - relations[:, 2]) <= 1)
    relations = relations[relevant]
    if len(relations) and allowed.size:
        seen = np.zeros(relations.max(axis=0) + 1, dtype=bool)
        seen[tuple(relations.T)] = True
        from_lane, from_block, to_lane, to_block = np.nonzero(seen)
        concerns = (lane_before == from_lane[:, None])[:, :, None] & (lane_after == to_lane[:, None])[:, None, :]
        ahead_before = (order_before > from_block[:, None])[:, :, None]
        ahead_after = (order_after > to_block[:, None])[:, None, :]
        allowed &= ~(concerns & (ahead_before != ahead_after)).any(axis=0)
    return allowed
