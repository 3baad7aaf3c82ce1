"""The decision graph: every admissible plan of the ego is one path through it (docs/formulation.md, section 7).

A node is (step k, lane state, motion), where the lane state says which lanes the ego takes up (`decision/occupancy.py`)
and the motion is the mode with the speed level and the position of the lattice (`decision/lattice.py`). Mode sequences
that lead to the same motion are merged, which is exact: nothing that follows depends on how a node was reached. An arc
is one maneuver: a move between two lane states and an arc between two motions.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sumo_hmdp.decision.cost import lane_cost, speed_cost, terminal_table
from sumo_hmdp.decision.distance import counted
from sumo_hmdp.decision.lattice import EgoLattice
from sumo_hmdp.decision.occupancy import LaneStep, lane_steps
from sumo_hmdp.decision.problem import SPEED_TOLERANCE, DecisionProblem, ManeuverSequence
from sumo_hmdp.decision.road_rules import top_speeds
from sumo_hmdp.decision.search import ModeTree, extend_modes
from sumo_hmdp.decision.stop_lines import closed_from, stopping_distance
from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.prediction.branches import IntArray
from sumo_hmdp.prediction.dynamics import FloatArray

# Motions of one step whose numbers differ by less are one [lattice units].
_SAME = 1e-9
_MODES = np.array([-1, 0, 1])


@dataclass(frozen=True, eq=False)
class MotionStep:
    """The M motions that the ego can end a step with, and the A arcs to them from those of the step before.

    Attributes:
        mode: (M,) mode during the step.
        level: (M,) speed level.
        phase: (M,) phase of the level.
        point: (M,) position [lattice units ahead of cruising].
        before: (A,) motion that each arc leaves, rising.
        after: (A,) motion that it enters.
        starts: first arc of each motion of the step before that has any.
        leaving: those motions.
        out: (M of the step before, 3) arcs that leave each, -1 where there are fewer.
        places: the distinct points.
        hops: the distinct pairs of places.
    """

    mode: IntArray
    level: IntArray
    phase: IntArray
    point: FloatArray
    before: IntArray
    after: IntArray
    starts: IntArray
    leaving: IntArray
    out: IntArray
    places: "Grouping"
    hops: "Grouping"


@dataclass(frozen=True, eq=False)
class Grouping:
    """Which of some things are alike.

    Attributes:
        first: (N,) the first of each group.
        group: the group of each thing.
    """

    first: IntArray
    group: IntArray


@dataclass(frozen=True, eq=False)
class MoveStep:
    """The P moves between the lane states of two steps.

    Attributes:
        before: (P,) lane state that each leaves, rising.
        after: (P,) lane state that it enters.
        lateral: (P,) lateral action.
        pair: (P,) index into `footprints`.
        footprints: (Q, 2) pairs of footprints before and after, each once.
        starts: first move of each lane state that has any.
        leaving: those lane states.
        out: (S of the step before, 3) moves that leave each, -1 where there are fewer.
    """

    before: IntArray
    after: IntArray
    lateral: IntArray
    pair: IntArray
    footprints: IntArray
    starts: IntArray
    leaving: IntArray
    out: IntArray


@dataclass(frozen=True, eq=False)
class GraphStep:
    """One step of the graph: S lane states times M motions, P moves times A arcs.

    Attributes:
        lanes: the lane states.
        motions: the motions.
        moves: between lane states.
        x: (M,) position [m].
        speed: (M,) [m/s].
        beyond: (S, M) metres beyond a stop line, 0 where none is passed.
        cost: (P, A) of the maneuvers and of the nodes that they lead to; infinite where a node is blocked.
    """

    lanes: LaneStep
    motions: MotionStep
    moves: MoveStep
    x: FloatArray
    speed: FloatArray
    beyond: FloatArray
    cost: FloatArray


@dataclass(frozen=True, eq=False)
class DecisionGraph:
    """All plans of one decision.

    Attributes:
        steps: one for each step 1..H.
        start: the lane state now and its footprint.
    """

    steps: tuple[GraphStep, ...]
    start: LaneStep


@dataclass(frozen=True)
class Path:
    """One plan as a path.

    Attributes:
        moves: index of the move of each step.
        arcs: index of the arc of each step.
    """

    moves: tuple[int, ...]
    arcs: tuple[int, ...]


def decision_graph(problem: DecisionProblem, lattice: EgoLattice, *, closed: bool = True) -> DecisionGraph:
    """Build the graph of a decision; what the road forbids is left out (docs/formulation.md, eqs. 11 and 23).

    Args:
        problem: the decision problem.
        lattice: of its ego.
        closed: whether nodes beyond a stop line are blocked.
    """
    lanes, tops = lane_steps(problem), top_speeds(problem)
    steps = []
    for k, motions in enumerate(motion_steps(lattice, problem.ego.mode), start=1):
        speed = np.array(speeds(lattice, motions.level, motions.phase))
        x = lattice.drift(k) + lattice.unit * motions.point
        moves = _moves(lanes[k - 1], lanes[k])
        beyond = _beyond_lines(problem, lanes[k], motions, x, speed, last=k == lattice.steps)
        cost = _costs(problem, lattice, lanes[k], moves, motions, speed, last=k == lattice.steps)
        if closed:
            cost[(beyond > 0.0)[moves.after[:, None], motions.after]] = np.inf
        if tops is not None:
            too_fast = speed > tops[k - 1][lanes[k].lane - 1][:, None] + SPEED_TOLERANCE
            cost[too_fast[moves.after[:, None], motions.after]] = np.inf
        steps.append(GraphStep(lanes[k], motions, moves, x, speed, beyond, cost))
    return DecisionGraph(tuple(steps), lanes[0])


def motion_steps(lattice: EgoLattice, mode: Mode) -> tuple[MotionStep, ...]:
    """Return the motions of the ego, step by step (docs/formulation.md, eq. 11)."""
    H = lattice.steps
    if not lattice.stopping and lattice.unlimited:
        # No limit is near: the motions are the same for every decision.
        return _unlimited_motions(mode, H)
    return _motions(lattice, mode)


@lru_cache(maxsize=64)
def _unlimited_motions(mode: Mode, steps: int) -> tuple[MotionStep, ...]:
    return _motions(EgoLattice(0.0, 0.0, 1.0, 1.0, steps, -np.inf, np.inf), mode)


def _motions(lattice: EgoLattice, mode: Mode) -> tuple[MotionStep, ...]:
    zero = np.zeros(1, dtype=np.int64)
    front, steps = ModeTree(zero, np.array([int(mode)]), zero, zero, np.zeros(1)), []
    place_before = zero
    for k in range(lattice.steps):
        tree = extend_modes(lattice, front, _MODES, lattice.limits(k + 1))
        first, after = _merged(tree)
        before, order = np.sort(tree.parent, kind="stable"), np.argsort(tree.parent, kind="stable")
        leaving, starts = np.unique(before, return_index=True)
        places = _grouped(np.round(tree.point[first] / _SAME))
        hops = _grouped(place_before[before] * len(first) + places.group[after[order]])
        place_before = places.group
        steps.append(
            MotionStep(
                tree.mode[first],
                tree.level[first],
                tree.phase[first],
                tree.point[first],
                before,
                after[order],
                starts,
                leaving,
                _leaving(before, len(front.mode)),
                places,
                hops,
            )
        )
        front = ModeTree(zero, tree.mode[first], tree.level[first], tree.phase[first], tree.point[first])
    return tuple(steps)


def _grouped(keys: FloatArray | IntArray) -> Grouping:
    _, first, group = np.unique(keys, return_index=True, return_inverse=True)
    return Grouping(first, group.ravel())


def _merged(tree: ModeTree) -> tuple[IntArray, IntArray]:
    """Return the first prefix of each distinct motion, and which motion each prefix leads to."""
    keys = np.stack([tree.mode, tree.level, tree.phase, np.round(tree.point / _SAME).astype(np.int64)])
    _, first, inverse = np.unique(keys, axis=1, return_index=True, return_inverse=True)
    return first, inverse.ravel()


def speeds(lattice: EgoLattice, level: IntArray, phase: IntArray) -> FloatArray:
    """Return the speeds at levels and phases, never below zero where the ego may stop [m/s]."""
    moving = lattice.speed + lattice.speed_step * level.astype(np.float64)
    if not lattice.stopping:
        return moving
    rested = lattice.speed_step * (lattice.levels_to_rest + level.astype(np.float64))
    return np.maximum(np.where(phase == 1, rested, moving), 0.0)


@lru_cache(maxsize=1024)
def _moves(before: LaneStep, after: LaneStep) -> MoveStep:
    source, target = np.nonzero(after.move)
    lateral = after.lane[target] - before.lane[source]
    pairs = np.stack([before.footprint[source], after.footprint[target]], axis=1)
    footprints, pair = np.unique(pairs, axis=0, return_inverse=True) if len(pairs) else (pairs, source)
    leaving, starts = np.unique(source, return_index=True)
    out = _leaving(source, len(before.states))
    return MoveStep(source, target, lateral, pair.ravel(), footprints, starts, leaving, out)


def _leaving(source: IntArray, count: int) -> IntArray:
    """Return which of some arcs leave each of `count` sources, (count, 3); `source` rises."""
    out = np.full((count, 3), -1, dtype=np.int64)
    out[source, np.arange(len(source)) - np.searchsorted(source, source)] = np.arange(len(source))
    return out


def _beyond_lines(
    problem: DecisionProblem, lanes: LaneStep, motions: MotionStep, x: FloatArray, speed: FloatArray, *, last: bool
) -> FloatArray:
    """Return by how much each node is beyond a stop line, at the end with the way to rest, (S, M) [m] (eq. 23)."""
    if not problem.stop_lines:
        return np.zeros((len(lanes.states), len(x)))
    place = x + stopping_distance(problem.settings, speed, motions.mode) if last else x
    closed = np.array([closed_from(problem, state) for state in lanes.states])
    return counted(place - closed[:, None])


def _costs(
    problem: DecisionProblem,
    lattice: EgoLattice,
    lanes: LaneStep,
    moves: MoveStep,
    motions: MotionStep,
    speed: FloatArray,
    *,
    last: bool,
) -> FloatArray:
    """Return the cost of each move and arc, (P, A) (docs/formulation.md, eqs. 12 and 13)."""
    preferences = problem.settings.preferences
    rows = np.array(preferences.maneuver_cost)
    node = speed_cost(preferences, speed) + lane_cost(preferences, lanes.lane)[:, None]
    if last and preferences.terminal_weight:
        table = terminal_table(preferences, lattice, problem.road.lane_count)
        end = table[:, motions.level + lattice.steps, motions.phase, motions.mode + 1]
        node = node + preferences.terminal_weight * end[lanes.lane - 1]
    maneuver = rows[1 - motions.mode[motions.after], moves.lateral[:, None] + 1]
    return np.asarray(maneuver + node[moves.after[:, None], motions.after])


def sequence_of(graph: DecisionGraph, path: Path) -> ManeuverSequence:
    """Return the maneuvers of a path."""
    laterals, modes = [], []
    for step, move, arc in zip(graph.steps, path.moves, path.arcs, strict=True):
        laterals.append(Lateral(int(step.moves.lateral[move])))
        modes.append(Mode(int(step.motions.mode[step.motions.after[arc]])))
    return ManeuverSequence(tuple(laterals), tuple(modes))


def path_of(graph: DecisionGraph, sequence: ManeuverSequence) -> Path | None:
    """Return the path of some maneuvers; None where one of them is not admissible or leads to a closed place."""
    state, motion, moves, arcs = 0, 0, [], []
    for step, lateral, mode in zip(graph.steps, sequence.laterals, sequence.modes, strict=True):
        move = np.flatnonzero((step.moves.before == state) & (step.moves.lateral == int(lateral)))
        arc = np.flatnonzero((step.motions.before == motion) & (step.motions.mode[step.motions.after] == int(mode)))
        if not len(move) or not len(arc) or not np.isfinite(step.cost[move[0], arc[0]]):
            return None
        moves.append(int(move[0]))
        arcs.append(int(arc[0]))
        state, motion = int(step.moves.after[move[0]]), int(step.motions.after[arc[0]])
    return Path(tuple(moves), tuple(arcs))
