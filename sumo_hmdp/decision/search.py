"""The second exact solver: all longitudinal sequences at once, lanes and windows by dynamic programming.

Sequences of modes are kept as a tree, one array row a prefix. For every prefix the best way to each window of the
present step is kept; a step extends every prefix by each admissible mode and every window by each allowed move.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate, pairwise

import numpy as np

from sumo_hmdp.decision.blocks import BoolArray
from sumo_hmdp.decision.corridors import Corridors
from sumo_hmdp.decision.cost import lane_cost, speed_cost, terminal_table
from sumo_hmdp.decision.distance import counted
from sumo_hmdp.decision.lattice import EgoLattice
from sumo_hmdp.decision.openings import Openings, openings_of
from sumo_hmdp.decision.problem import (
    DISTANCE_TOLERANCE,
    SPEED_TOLERANCE,
    DecisionProblem,
    ManeuverSequence,
    Preferences,
)
from sumo_hmdp.decision.road_rules import top_speeds
from sumo_hmdp.decision.stop_lines import stopping_distance
from sumo_hmdp.decision.windows import UNIT_TOLERANCE
from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.errors import SumoHmdpError
from sumo_hmdp.prediction.branches import IntArray
from sumo_hmdp.prediction.dynamics import FloatArray

Maneuver = tuple[Lateral, Mode]

_MODES = np.array([-1, 0, 1])

# The largest table that the search may make [bytes]; it holds a few of that size at a time, and a process must do with
# 500 MB in all, of which the libraries take about 150.
TABLE_LIMIT = 64 * 2**20
# About how many numbers a sequence of modes takes by itself.
SEQUENCE_NUMBERS = 16


class SearchTooLargeError(SumoHmdpError):
    """The search would need more memory than is sensible."""


@dataclass(frozen=True)
class ModeTree:
    """All admissible sequences of modes up to one step, P prefixes.

    Attributes:
        parent: (P,) prefix one step before.
        mode: (P,) mode of the last step.
        level: (P,) speed level n.
        phase: (P,) phase of that level.
        point: (P,) position in lattice units ahead of cruising.
    """

    parent: IntArray
    mode: IntArray
    level: IntArray
    phase: IntArray
    point: FloatArray


def mode_tree(lattice: EgoLattice, start_mode: Mode, first: Mode | None = None) -> Sequence[ModeTree]:
    """Return the sequences of modes that keep the speed limits, step by step; the root comes first.

    Args:
        lattice: of the ego.
        start_mode: its mode now.
        first: mode of the first step; None leaves it open.
    """
    H = lattice.steps
    if first is None and not lattice.stopping and lattice.unlimited:
        # No limit is near: the tree is the same for every decision.
        return _unlimited_tree(start_mode, H)
    return _grow(lattice, start_mode, first)


@lru_cache(maxsize=64)
def _unlimited_tree(start_mode: Mode, steps: int) -> Sequence[ModeTree]:
    """Return the tree of an ego that nothing limits."""
    return _grow(EgoLattice(0.0, 0.0, 1.0, 1.0, steps, -np.inf, np.inf), start_mode, None)


def _grow(lattice: EgoLattice, start_mode: Mode, first: Mode | None) -> Sequence[ModeTree]:
    """Return the tree step by step."""
    zero = np.zeros(1, dtype=np.int64)
    steps = [ModeTree(zero, np.array([int(start_mode)]), zero, zero, np.zeros(1))]
    for k in range(lattice.steps):
        modes = _MODES if k or first is None else np.array([int(first)])
        steps.append(extend_modes(lattice, steps[-1], modes, lattice.limits(k + 1)))
    return steps


def extend_modes(lattice: EgoLattice, before: ModeTree, modes: IntArray, limits: tuple[float, float]) -> ModeTree:
    """Extend every prefix by each of some modes that is at most one level away (docs/formulation.md, eq. 11).

    Speeds [m/s] beyond the limits of the step are left out.
    """
    parent, choice = np.nonzero(np.abs(before.mode[:, None] - modes) <= 1)
    mode = modes[choice]
    level = before.level[parent] + mode
    phase = before.phase[parent]
    point = before.point[parent] + 2 * (before.level[parent] - phase * lattice.rest_share) + mode
    if lattice.stopping:
        speed = _speeds(lattice, level, phase)
        rests = (mode < 0) & (speed < -SPEED_TOLERANCE)
        rolls = (phase == 0) & (lattice.rest_share > 0)
        rest_point = before.point[parent] + rolls * lattice.rest_share**2 - 2 * lattice.speed / lattice.speed_step
        point = np.where(rests, rest_point, point)
        level = np.where(rests, -lattice.levels_to_rest, level)
        phase = np.where(rests & (lattice.rest_share > 0), 1, phase)
    speed = _speeds(lattice, level, phase)
    keep = (speed >= limits[0] - SPEED_TOLERANCE) & (speed <= limits[1] + SPEED_TOLERANCE)
    return ModeTree(parent[keep], mode[keep], level[keep], phase[keep], point[keep])


def _speeds(lattice: EgoLattice, level: IntArray, phase: IntArray) -> FloatArray:
    """Return the speeds of levels and phases [m/s]."""
    moving = np.asarray(lattice.speed + lattice.speed_step * level, dtype=np.float64)
    if not lattice.stopping:
        return moving
    return np.where(phase == 1, lattice.speed_step * (lattice.levels_to_rest + level), moving)


def search_best(
    problem: DecisionProblem, lattice: EgoLattice, corridors: Corridors, first: Maneuver | None = None
) -> ManeuverSequence | None:
    """Return the cheapest sequence of maneuvers inside the corridors, None where there is none.

    Args:
        problem: the decision problem.
        lattice: of its ego.
        corridors: carved with safe distances.
        first: lateral action and mode to begin with; None leaves them open.
    """
    steps = openings_of(corridors, stopping=lattice.stopping)
    _require_searchable(problem, steps)
    tree = mode_tree(lattice, problem.ego.mode, None if first is None else first[1])
    usable = _usable(problem, lattice, steps, tree, first)
    if corridors.lines:
        stop = _stopping_points(problem, lattice, tree[-1])
        usable[-1] &= stop[:, None] <= steps[-1].stop_high + UNIT_TOLERANCE
    return _cheapest(problem, lattice, steps, tree, usable)


def search_relaxed(
    problem: DecisionProblem, lattice: EgoLattice, corridors: Corridors, first: Maneuver | None = None
) -> ManeuverSequence | None:
    """Return the sequence with the least total violation and, among those, the least cost; None where contact is sure.

    Args:
        problem: the decision problem.
        lattice: of its ego.
        corridors: carved with contact distances; the safe distances are their soft ends.
        first: lateral action and mode to begin with; None leaves them open.
    """
    steps = openings_of(corridors, stopping=lattice.stopping)
    _require_searchable(problem, steps)
    tree = mode_tree(lattice, problem.ego.mode, None if first is None else first[1])
    shortfall = []
    usable = _usable(problem, lattice, steps, tree, first)
    for openings, prefixes, inside in zip(steps, tree[1:], usable, strict=True):
        point = prefixes.point[:, None]
        beyond = point - openings.at(openings.soft_high, prefixes.level, prefixes.phase)
        if openings is steps[-1] and corridors.lines:
            beyond = np.maximum(beyond, _stopping_points(problem, lattice, prefixes)[:, None] - openings.stop_high)
        behind = openings.at(openings.soft_low, prefixes.level, prefixes.phase) - point
        missing = counted(behind, lattice.unit) + counted(beyond, lattice.unit)
        shortfall.append(np.where(inside, missing, np.inf))
    to_here = [np.zeros((1, 1))]
    for openings, prefixes, missing in zip(steps, tree[1:], shortfall, strict=True):
        arrive = np.where(openings.moves, 0.0, np.inf)
        to_here.append((to_here[-1][prefixes.parent][:, :, None] + arrive).min(axis=1, initial=np.inf) + missing)
    least = to_here[-1].min(initial=np.inf)
    if not np.isfinite(least):
        return None
    slack = DISTANCE_TOLERANCE / lattice.unit
    onward = [np.zeros_like(to_here[-1])]
    for k in range(lattice.steps - 1, 0, -1):
        openings, prefixes = steps[k], tree[k + 1]
        leave = np.where(openings.moves, 0.0, np.inf)
        best = (leave[None] + (shortfall[k] + onward[0])[:, None, :]).min(axis=2, initial=np.inf)
        ahead = np.full(to_here[k].shape, np.inf)
        np.minimum.at(ahead, prefixes.parent, best)
        onward.insert(0, ahead)
    # A window is on a least-violation path if what leads to it and what follows add up to no more than the least.
    allowed = [here + after <= least + slack for here, after in zip(to_here[1:], onward, strict=True)]
    return _cheapest(problem, lattice, steps, tree, allowed)


def _require_searchable(problem: DecisionProblem, steps: tuple[Openings, ...]) -> None:
    """Refuse what memory cannot hold: per step a number for every sequence of modes and pair of openings.

    Where there are few openings, the sequences themselves take the most.
    """
    largest = 0
    counts = _sequence_counts(problem.ego.mode, len(steps))
    for openings, sequences in zip(steps, counts, strict=True):
        largest = max(largest, 8 * sequences * max(openings.moves.size, SEQUENCE_NUMBERS))
    if largest > TABLE_LIMIT:
        raise SearchTooLargeError(
            f"the search must make no table above {TABLE_LIMIT / 2**20:g} MiB, got {largest / 2**20:.0f} MiB "
            f"(horizon_steps {problem.settings.horizon_steps}). Shorten the horizon or decide with the milp solver."
        )


@lru_cache(maxsize=64)
def _sequence_counts(start_mode: Mode, steps: int) -> tuple[int, ...]:
    """Return how many sequences of modes there are up to each step, speed limits aside."""
    ways = {mode: int(mode == start_mode) for mode in Mode}
    counts = []
    for _ in range(steps):
        ways = {mode: sum(count for before, count in ways.items() if abs(before - mode) <= 1) for mode in Mode}
        counts.append(sum(ways.values()))
    return tuple(counts)


def _usable(
    problem: DecisionProblem,
    lattice: EgoLattice,
    steps: tuple[Openings, ...],
    tree: Sequence[ModeTree],
    first: Maneuver | None,
) -> list[BoolArray]:
    """Tell per step which openings each prefix may use, (P, W) each: inside, no faster than the lane's top speed there.

    The first is as asked.
    """
    usable = [_inside(openings, prefixes) for openings, prefixes in zip(steps, tree[1:], strict=True)]
    if first is not None:
        usable[0] &= steps[0].lane == problem.ego.lane + first[0]
    tops = top_speeds(problem)
    if tops is not None:
        for k, (openings, prefixes, top) in enumerate(zip(steps, tree[1:], tops, strict=True)):
            speed = _speeds(lattice, prefixes.level, prefixes.phase)
            usable[k] &= speed[:, None] <= top[openings.lane - 1] + SPEED_TOLERANCE
    return usable


def _stopping_points(problem: DecisionProblem, lattice: EgoLattice, prefixes: ModeTree) -> FloatArray:
    """Return where each prefix comes to rest if it brakes at its end, in lattice units."""
    speed = _speeds(lattice, prefixes.level, prefixes.phase)
    return prefixes.point + stopping_distance(problem.settings, speed, prefixes.mode) / lattice.unit


def _inside(openings: Openings, prefixes: ModeTree) -> BoolArray:
    """Tell which openings each prefix is inside of at its speed level, (P, W)."""
    point = prefixes.point[:, None]
    low, high = (openings.at(bounds, prefixes.level, prefixes.phase) for bounds in (openings.low, openings.high))
    return (point >= low - UNIT_TOLERANCE) & (point <= high + UNIT_TOLERANCE)


def _cheapest(
    problem: DecisionProblem,
    lattice: EgoLattice,
    steps: tuple[Openings, ...],
    tree: Sequence[ModeTree],
    allowed: list[BoolArray],
) -> ManeuverSequence | None:
    """Return the cheapest sequence that only uses allowed openings."""
    preferences = problem.settings.preferences
    by_action = _by_action(preferences.maneuver_cost)
    by_lane = lane_cost(preferences, np.arange(problem.road.lane_count + 1))
    by_speed = _speed_costs(preferences, lattice, tree)
    # Of each step, what it costs each prefix to be in each opening, and to get there by each mode.
    costs, step_costs = [np.zeros((1, 1))], []
    lanes_before = np.array([problem.ego.lane])
    for openings, prefixes, usable, of_speed in zip(steps, tree[1:], allowed, by_speed, strict=True):
        if not len(openings.lane) or not len(prefixes.mode):
            return None
        # What changes by more than a lane wraps around to some cost or other; there is no such move.
        lateral = openings.lane - lanes_before[:, None]
        step_cost = np.where(openings.moves, by_action.take(lateral, axis=1, mode="wrap"), np.inf)
        # The least of some tables, (W before, P, W), is found much faster than the least within rows of one.
        onward = step_cost.transpose(1, 0, 2).take(prefixes.mode, axis=1, mode="wrap")
        least = np.minimum.reduce(costs[-1].T.take(prefixes.parent, axis=1)[:, :, None] + onward)
        ends = of_speed[:, None] + by_lane[openings.lane]
        costs.append(np.where(usable, least + ends, np.inf))
        step_costs.append(step_cost)
        lanes_before = openings.lane
    cost, last, leaves = costs[-1], steps[-1], tree[-1]
    if preferences.terminal_weight:
        table = terminal_table(preferences, lattice, problem.road.lane_count)
        end = table[:, leaves.level + lattice.steps, leaves.phase, leaves.mode + 1]
        cost = cost + preferences.terminal_weight * end[last.lane - 1].T
    prefix, opening = divmod(int(cost.argmin()), cost.shape[1])
    if cost[prefix, opening] == np.inf:
        return None
    modes, passed = [], []
    for k in range(lattice.steps, 0, -1):
        mode, parent = int(tree[k].mode[prefix]), int(tree[k].parent[prefix])
        modes.append(Mode(mode))
        passed.append(opening)
        opening = int((costs[k - 1][parent] + step_costs[k - 1][mode, :, opening]).argmin())
        prefix = parent
    lanes = [problem.ego.lane, *(int(s.lane[opening]) for s, opening in zip(steps, reversed(passed), strict=True))]
    laterals = tuple(Lateral(b - a) for a, b in pairwise(lanes))
    return ManeuverSequence(laterals, tuple(reversed(modes)))


@lru_cache(maxsize=64)
def _by_action(maneuver_cost: tuple[tuple[float, float, float], ...]) -> FloatArray:
    """Return the cost of maneuvers, indexed by mode and lateral action themselves: -1 is the last row, or column."""
    return np.array(maneuver_cost)[[1, 0, 2]][:, [1, 2, 0]]


def _speed_costs(preferences: Preferences, lattice: EgoLattice, tree: Sequence[ModeTree]) -> list[FloatArray]:
    """Return what the speed at the end of each step costs each prefix, (P,) for each step."""
    level, phase = (np.concatenate(each) for each in zip(*((step.level, step.phase) for step in tree[1:]), strict=True))
    cost = speed_cost(preferences, _speeds(lattice, level, phase))
    ends = list(accumulate((len(step.level) for step in tree[1:]), initial=0))
    return [cost[start:end] for start, end in pairwise(ends)]
