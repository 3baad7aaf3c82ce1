"""Resource-constrained shortest paths: the cheapest plan whose risk is within epsilon (docs/formulation.md, eq. 41).

Exact label setting: a label is the cost and the resource (the risk) of one way to a node, and only ways that no other
dominates are followed. Three bounds on what follows a node, each a backward sweep over the graph, cut it short: the
least cost, the least resource, and the least of cost + price * resource at the price of the Lagrangian dual.

The same functions find the least risk under a cap on the cost: cost and resource only exchange their places.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sumo_hmdp.decision.graph import DecisionGraph, GraphStep, Path
from sumo_hmdp.prediction.branches import IntArray
from sumo_hmdp.prediction.dynamics import FloatArray

# One array for each step, (moves, arcs); both weights of a blocked arc are infinite.
Weights = Sequence[FloatArray]

# Costs that differ by less are equal, and so are risks: far above rounding, far below what anybody means.
COST_TIE = 1e-6
RISK_TIE = 1e-9
# Sums of one path in another order differ by rounding.
ROUNDING = 1e-12
# The dual price is improved at most so often; any price gives a valid bound.
PRICE_UPDATES = 6
# Ties are settled in this order of maneuvers (lateral action, mode); the first step that differs decides.
MANEUVER_ORDER = tuple((lateral, mode) for lateral in (0, -1, 1) for mode in (0, 1, -1))


class Node(NamedTuple):
    """A node of the graph: at the end of step `step`, 0 is now."""

    step: int = 0
    state: int = 0
    motion: int = 0


@dataclass(frozen=True)
class Plan:
    """A path with its two sums."""

    path: Path
    cost: float
    resource: float


@dataclass(frozen=True, eq=False)
class Bounds:
    """What follows each node at least, (S, M) for each step 0..H.

    Attributes:
        cost: least cost.
        resource: least resource.
    """

    cost: tuple[FloatArray, ...]
    resource: tuple[FloatArray, ...]


def least_to_go(graph: DecisionGraph, weights: Weights) -> tuple[FloatArray, ...]:
    """Return the least sum of weights from each node to the end, (S, M) for each step 0..H; infinite at dead ends."""
    last = graph.steps[-1]
    found = [np.zeros((len(last.lanes.states), len(last.x)))]
    shapes = [(1, 1), *((len(step.lanes.states), len(step.x)) for step in graph.steps[:-1])]
    for step, weight, shape in zip(reversed(graph.steps), reversed(weights), reversed(shapes), strict=True):
        moves, motions = step.moves, step.motions
        to_go = np.full(shape, np.inf)
        if len(moves.before) and len(motions.before):
            total = weight + found[-1][moves.after[:, None], motions.after]
            by_motion = np.minimum.reduceat(total, motions.starts, axis=1)
            to_go[moves.leaving[:, None], motions.leaving] = np.minimum.reduceat(by_motion, moves.starts, axis=0)
        found.append(to_go)
    return tuple(reversed(found))


def least_from_start(graph: DecisionGraph, weights: Weights) -> tuple[FloatArray, ...]:
    """Return the least sum of weights from the start to each node, (S, M) for each step 0..H."""
    found = [np.zeros((1, 1))]
    for step, weight in zip(graph.steps, weights, strict=True):
        moves, motions = step.moves, step.motions
        reached = np.full((len(step.lanes.states), len(step.x)), np.inf)
        total_here = found[-1][moves.before[:, None], motions.before] + weight
        np.minimum.at(reached, (moves.after[:, None], motions.after), total_here)
        found.append(reached)
    return tuple(found)


def bounds_of(graph: DecisionGraph, cost: Weights, resource: Weights) -> Bounds:
    """Return the bounds of a decision; both weights of a blocked arc are infinite."""
    return Bounds(least_to_go(graph, cost), least_to_go(graph, resource))


def _follow(graph: DecisionGraph, weights: Weights, to_go: Sequence[FloatArray]) -> Path:
    """Return a path of least weight."""
    state, motion, moves, arcs = 0, 0, [], []
    for step, weight, after in zip(graph.steps, weights, to_go[1:], strict=True):
        move = step.moves.out[state]
        arc = step.motions.out[motion]
        move, arc = move[move >= 0], arc[arc >= 0]
        total = weight[move[:, None], arc] + after[step.moves.after[move][:, None], step.motions.after[arc]]
        row, column = divmod(int(total.argmin()), total.shape[1])
        moves.append(int(move[row]))
        arcs.append(int(arc[column]))
        state, motion = int(step.moves.after[move[row]]), int(step.motions.after[arc[column]])
    return Path(tuple(moves), tuple(arcs))


def total(weights: Weights, path: Path) -> float:
    """Return the sum of weights along a path."""
    return float(sum(float(w[m, a]) for w, m, a in zip(weights, path.moves, path.arcs, strict=True)))


def _plan(path: Path, cost: Weights, resource: Weights) -> Plan:
    return Plan(path, total(cost, path), total(resource, path))


class Dual(NamedTuple):
    """What the Lagrangian dual knows.

    Attributes:
        price: cost of a unit of the resource.
        to_go: least cost + price * resource from each node.
        best: the cheapest path found that keeps the budget.
        bound: no path within the budget costs less.
    """

    price: float
    to_go: tuple[FloatArray, ...]
    best: Plan
    bound: float


def dual(graph: DecisionGraph, cost: Weights, resource: Weights, budget: float, bounds: Bounds) -> Dual | None:
    """Return the price at which the resource is worth its budget; None where no path keeps the budget.

    The dual function is the lower envelope of a line for each path; its top is approached by the lines of two paths,
    one within the budget and one beyond, whose crossing is the next price (Kelley's cutting planes in one variable).
    """
    free = _plan(_follow(graph, cost, bounds.cost), cost, resource) if np.isfinite(bounds.cost[0][0, 0]) else None
    if free is None or bounds.resource[0][0, 0] > budget:
        return None
    if free.resource <= budget:
        return Dual(0.0, bounds.cost, free, free.cost)
    frugal = _plan(_follow(graph, resource, bounds.resource), cost, resource)
    best, price, to_go, bound = frugal, 0.0, bounds.cost, free.cost
    for _ in range(PRICE_UPDATES):
        trial = (frugal.cost - free.cost) / max(free.resource - frugal.resource, ROUNDING)
        if trial <= 0.0:
            break
        priced = [c + trial * r for c, r in zip(cost, resource, strict=True)]
        value = least_to_go(graph, priced)
        found = _plan(_follow(graph, priced, value), cost, resource)
        if value[0][0, 0] - trial * budget > bound:
            price, to_go, bound = trial, value, float(value[0][0, 0]) - trial * budget
        if found.resource <= budget and found.cost < best.cost:
            best = found
        if found.cost + trial * found.resource >= frugal.cost + trial * frugal.resource - COST_TIE:
            break
        if found.resource <= budget:
            frugal = found
        else:
            free = found
    return Dual(price, to_go, best, bound)


def cheapest(
    graph: DecisionGraph, cost: Weights, resource: Weights, budget: float, bounds: Bounds | None = None
) -> Plan | None:
    """Return the cheapest path whose resource is at most a budget, None where there is none (eq. 41)."""
    known = bounds or bounds_of(graph, cost, resource)
    start = dual(graph, cost, resource, budget, known)
    if start is None or start.best.cost - start.bound <= ROUNDING:
        return None if start is None else start.best
    found = labels(graph, cost, resource, Limits(start.best.cost, budget, known, start))
    best = found.best()
    return start.best if best is None or best.cost >= start.best.cost else best


class Limits(NamedTuple):
    """What a label may not exceed.

    Attributes:
        cost: of the whole path.
        resource: of the whole path.
        bounds: on what follows.
        dual: a third bound, None for none.
    """

    cost: float
    resource: float
    bounds: Bounds
    dual: Dual | None = None


class _Front(NamedTuple):
    """The labels of one step, L of them; `parent` is an index into the front before."""

    state: IntArray
    motion: IntArray
    cost: FloatArray
    resource: FloatArray
    parent: IntArray
    move: IntArray
    arc: IntArray


@dataclass(frozen=True, eq=False)
class LabelSet:
    """All labels that may lead to a best path, step by step."""

    fronts: tuple[_Front, ...]

    @property
    def costs(self) -> FloatArray:
        """Cost of each whole path, (L,)."""
        return self.fronts[-1].cost

    @property
    def resources(self) -> FloatArray:
        """Resource of each whole path, (L,)."""
        return self.fronts[-1].resource

    def path(self, label: int) -> Path:
        """Return the path of a label of the last step."""
        moves, arcs = [], []
        for front in reversed(self.fronts[1:]):
            moves.append(int(front.move[label]))
            arcs.append(int(front.arc[label]))
            label = int(front.parent[label])
        return Path(tuple(reversed(moves)), tuple(reversed(arcs)))

    def best(self) -> Plan | None:
        """Return the cheapest path, of several the one of least resource; None where there is none."""
        if not len(self.costs):
            return None
        label = int(np.lexsort((self.resources, self.costs))[0])
        return Plan(self.path(label), float(self.costs[label]), float(self.resources[label]))


def labels(
    graph: DecisionGraph, cost: Weights, resource: Weights, limits: Limits, start: Node | None = None
) -> LabelSet:
    """Return the undominated labels of each step that may still keep the limits, from a node on."""
    node = start or Node()
    zero = np.zeros(1, dtype=np.int64)
    front = _Front(np.array([node.state]), np.array([node.motion]), np.zeros(1), np.zeros(1), zero, zero, zero)
    fronts = [front]
    for k in range(node.step, len(graph.steps)):
        front = _extend(graph.steps[k], front, cost[k], resource[k], limits, k + 1)
        fronts.append(front)
    return LabelSet(tuple(fronts))


def _extend(step: GraphStep, front: _Front, cost: FloatArray, resource: FloatArray, limits: Limits, k: int) -> _Front:
    """Extend labels by every move and arc, and keep those within the limits that no other dominates."""
    move = step.moves.out[front.state][:, :, None]
    arc = step.motions.out[front.motion][:, None, :]
    label, i, j = np.nonzero((move >= 0) & (arc >= 0))
    moves, arcs = move[label, i, 0], arc[label, 0, j]
    costs = front.cost[label] + cost[moves, arcs]
    resources = front.resource[label] + resource[moves, arcs]
    state, motion = step.moves.after[moves], step.motions.after[arcs]
    keep = np.isfinite(costs) & np.isfinite(resources)
    keep &= costs + limits.bounds.cost[k][state, motion] <= limits.cost + ROUNDING * (1 + abs(limits.cost))
    keep &= resources + limits.bounds.resource[k][state, motion] <= limits.resource + ROUNDING
    if limits.dual is not None and limits.dual.price > 0:
        price = limits.dual.price
        most = limits.cost + price * limits.resource
        keep &= costs + price * resources + limits.dual.to_go[k][state, motion] <= most + ROUNDING * (1 + abs(most))
    kept = np.flatnonzero(keep)
    chosen = kept[_undominated(state[kept] * len(step.x) + motion[kept], costs[kept], resources[kept])]
    return _Front(
        state[chosen], motion[chosen], costs[chosen], resources[chosen], label[chosen], moves[chosen], arcs[chosen]
    )


def _undominated(node: IntArray, cost: FloatArray, resource: FloatArray) -> IntArray:
    """Return the labels that no label of the same node beats in one number and at least matches in the other."""
    if not len(node):
        return node
    order = np.lexsort((resource, cost, node))
    ranked, least = node[order], resource[order]
    fresh = np.ones(len(order), dtype=bool)
    fresh[1:] = ranked[1:] != ranked[:-1]
    if fresh.all():
        return order
    # By node, then cost: a label counts if its resource is below those of all cheaper ones of its node. Labels of one
    # node are few, so the running minimum is taken in rounds over neighbours.
    starts = np.flatnonzero(fresh)
    sizes = np.diff(np.append(starts, len(order)))
    keep = np.ones(len(order), dtype=bool)
    running = least[starts]
    for depth in range(1, int(sizes.max())):
        here = np.flatnonzero(sizes > depth)
        at = starts[here] + depth
        keep[at] = least[at] < running[here]
        running[here] = np.minimum(running[here], least[at])
    return order[keep]


def settle(graph: DecisionGraph, cost: Weights, resource: Weights, best: Plan, budget: float, bounds: Bounds) -> Plan:
    """Return the plan that is taken among those as cheap as the best one (docs/formulation.md, eq. 42).

    Of plans whose costs differ by less than `COST_TIE` the one of least resource, where differences below `RISK_TIE` do
    not count; among those the first in the order of maneuvers.

    Args:
        graph: of the decision.
        cost: of its arcs.
        resource: of its arcs.
        best: a cheapest path within the budget.
        budget: of the resource.
        bounds: of the graph.
    """
    most = best.cost + COST_TIE
    swapped = Bounds(bounds.resource, bounds.cost)
    found = labels(graph, resource, cost, Limits(min(best.resource, budget), most, swapped)).best()
    least = best.resource if found is None else min(found.cost, best.resource)
    return first_in_order(graph, cost, resource, Limits(most, min(budget, least + RISK_TIE), bounds)) or best


def first_in_order(graph: DecisionGraph, cost: Weights, resource: Weights, limits: Limits) -> Plan | None:
    """Return the first path in the order of maneuvers that keeps two limits, None where none does."""
    node, spent, used, moves, arcs = Node(), 0.0, 0.0, [], []
    for k, step in enumerate(graph.steps):
        for move, arc in _ordered(step, node):
            c, r = spent + float(cost[k][move, arc]), used + float(resource[k][move, arc])
            following = Node(k + 1, int(step.moves.after[move]), int(step.motions.after[arc]))
            if _can_finish(graph, cost, resource, limits, following, c, r):
                moves.append(move)
                arcs.append(arc)
                node, spent, used = following, c, r
                break
        else:
            return None
    return Plan(Path(tuple(moves), tuple(arcs)), spent, used)


def _ordered(step: GraphStep, node: Node) -> list[tuple[int, int]]:
    moves = {int(step.moves.lateral[m]): int(m) for m in step.moves.out[node.state] if m >= 0}
    arcs = {int(step.motions.mode[step.motions.after[a]]): int(a) for a in step.motions.out[node.motion] if a >= 0}
    return [(moves[lateral], arcs[mode]) for lateral, mode in MANEUVER_ORDER if lateral in moves and mode in arcs]


def _can_finish(
    graph: DecisionGraph, cost: Weights, resource: Weights, limits: Limits, node: Node, spent: float, used: float
) -> bool:
    """Tell whether some path from a node keeps both limits: by the bounds where they decide it, else by labels."""
    slack = ROUNDING * (1 + abs(limits.cost))
    left, leftover = limits.cost - spent + slack, limits.resource - used + ROUNDING
    if not (np.isfinite(spent) and np.isfinite(used)):
        return False
    at = node.state, node.motion
    if limits.bounds.cost[node.step][at] > left or limits.bounds.resource[node.step][at] > leftover:
        return False
    if node.step == len(graph.steps):
        return True
    rest = Limits(left, leftover, limits.bounds)
    return len(labels(graph, cost, resource, rest, node).costs) > 0


def frontier(graph: DecisionGraph, cost: Weights, resource: Weights, bounds: Bounds) -> list[Plan]:
    """Return every plan that is cheapest for some budget, by rising cost (docs/choosing-epsilon.md)."""
    found = labels(graph, cost, resource, Limits(np.inf, np.inf, bounds))
    order = np.lexsort((found.resources, found.costs))
    plans: list[Plan] = []
    for label in order.tolist():
        resource_of = float(found.resources[label])
        if not plans or resource_of < plans[-1].resource - RISK_TIE:
            plans.append(Plan(found.path(label), float(found.costs[label]), resource_of))
    return plans


def next_cheaper(graph: DecisionGraph, cost: Weights, resource: Weights, plan: Plan, bounds: Bounds) -> Plan | None:
    """Return the least risky of the plans that cost less than a plan, None where none does."""
    swapped = Bounds(bounds.resource, bounds.cost)
    found = cheapest(graph, resource, cost, plan.cost - COST_TIE, swapped)
    return None if found is None else Plan(found.path, found.resource, found.cost)
