"""The joint decision as a mixed-integer linear program, written in Pyomo and solved by HiGHS (eq. 43).

Columns: the paper's one-hot maneuvers u[k, mode, lateral] and the flow f[e] over the arcs of the decision graph. One
unit flows from now to the end of the horizon; each maneuver is the flow over its arcs; ONE row bounds the risk. Once
the maneuvers are whole, the flow is: a maneuver leads from a node to one node.

Bounds of the search leave out arcs that no cheapest plan can use. `reduced=False` keeps every arc, so that the two
solvers share nothing but the graph and its weights.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pyomo.environ as pyo
from pyomo.core.expr import LinearExpression

from sumo_hmdp.decision.graph import DecisionGraph, Path
from sumo_hmdp.decision.highs import MilpResult, solve_model
from sumo_hmdp.decision.paths import (
    ROUNDING,
    Bounds,
    Limits,
    Plan,
    Weights,
    bounds_of,
    dual,
    least_from_start,
    total,
)
from sumo_hmdp.decision.problem import Preferences
from sumo_hmdp.errors import SumoHmdpError
from sumo_hmdp.prediction.branches import IntArray
from sumo_hmdp.prediction.dynamics import FloatArray

# HiGHS may exceed the one row of the risk by its tolerance; the row is then drawn tighter and solved again.
TRIES = 4


class FlowArc(NamedTuple):
    """One arc of the flow.

    Attributes:
        step: 1..H.
        tail: node at the end of the step before.
        head: node at the end of the step.
        move: index of its move.
        arc: index of its arc.
        maneuver: (mode, lateral).
        cost: beside that of the maneuver.
        resource: its risk.
    """

    step: int
    tail: int
    head: int
    move: int
    arc: int
    maneuver: tuple[int, int]
    cost: float
    resource: float


class FlowError(SumoHmdpError):
    """HiGHS proved neither an optimum nor infeasibility."""


def cheapest_flow(
    graph: DecisionGraph,
    cost: Weights,
    resource: Weights,
    budget: float,
    preferences: Preferences,
    *,
    reduced: bool = True,
    time_limit: float = np.inf,
) -> tuple[Plan | None, bool]:
    """Return the cheapest path within a budget, by HiGHS, and whether it is proven.

    Args:
        graph: of the decision.
        cost: of its arcs.
        resource: of its arcs, such as their risk.
        budget: of the resource.
        preferences: with the cost of the maneuvers, which the columns u carry.
        reduced: whether arcs that no cheapest path can use are left out.
        time_limit: of all solves [s].

    Returns:
        None where no path keeps the budget, or none was known in time.

    Raises:
        FlowError: if HiGHS proves nothing.
    """
    bounds = bounds_of(graph, cost, resource)
    if not np.isfinite(bounds.cost[0][0, 0]) or (reduced and bounds.resource[0][0, 0] > budget):
        return None, True
    usable = _usable(graph, cost, resource, budget, bounds) if reduced else [np.isfinite(c) for c in cost]
    arcs = list(_arcs(graph, cost, resource, usable, preferences))
    allowed = budget
    for _ in range(TRIES):
        model = flow_model(arcs, len(graph.steps), allowed, preferences)
        result = solve_model(model, time_limit)
        if result.status == "Infeasible":
            return None, True
        if result.values is None:
            if result.timed_out:
                return None, False
            raise FlowError(f"HiGHS must prove an optimum or infeasibility, got {result.status!r}")
        path = _path(arcs, result, len(graph.steps))
        plan = Plan(path, total(cost, path), total(resource, path))
        if plan.resource <= budget + ROUNDING:
            return plan, result.optimal
        allowed -= 2 * (plan.resource - budget)
    raise FlowError("HiGHS must keep the bound of the risk, got a plan beyond it every time")


def _usable(
    graph: DecisionGraph, cost: Weights, resource: Weights, budget: float, bounds: Bounds
) -> list[np.ndarray[tuple[int, ...], np.dtype[np.bool_]]]:
    """Tell which arcs a path within the budget may use that costs no more than the best one known."""
    known = dual(graph, cost, resource, budget, bounds)
    if known is None:
        return [np.isfinite(c) for c in cost]
    limits = Limits(known.best.cost, budget, bounds, known)
    priced = [c + known.price * r if known.price > 0 else c for c, r in zip(cost, resource, strict=True)]
    most = limits.cost + known.price * budget
    found = [np.isfinite(c) for c in cost]
    for weights, to_go, limit in (
        (cost, bounds.cost, limits.cost),
        (resource, bounds.resource, budget),
        (priced, known.to_go, most),
    ):
        so_far = least_from_start(graph, weights)
        for k, step in enumerate(graph.steps):
            before, after = step.moves, step.motions
            through = (
                so_far[k][before.before[:, None], after.before]
                + weights[k]
                + to_go[k + 1][before.after[:, None], after.after]
            )
            found[k] &= through <= limit + 1e3 * ROUNDING * (1 + abs(limit))
    return found


def _arcs(
    graph: DecisionGraph,
    cost: Weights,
    resource: Weights,
    usable: list[np.ndarray[tuple[int, ...], np.dtype[np.bool_]]],
    preferences: Preferences,
) -> Iterator[FlowArc]:
    motions_before = 1
    for k, (step, mask) in enumerate(zip(graph.steps, usable, strict=True)):
        moves, arcs = np.nonzero(mask)
        motions = len(step.x)
        for move, arc in zip(moves.tolist(), arcs.tolist(), strict=True):
            maneuver = int(step.motions.mode[step.motions.after[arc]]), int(step.moves.lateral[move])
            yield FlowArc(
                step=k + 1,
                tail=int(step.moves.before[move]) * motions_before + int(step.motions.before[arc]),
                head=int(step.moves.after[move]) * motions + int(step.motions.after[arc]),
                move=move,
                arc=arc,
                maneuver=maneuver,
                cost=float(cost[k][move, arc]) - preferences.maneuver(*maneuver),
                resource=float(resource[k][move, arc]),
            )
        motions_before = motions


def flow_model(arcs: list[FlowArc], steps: int, budget: float, preferences: Preferences) -> pyo.ConcreteModel:
    """Write the program: minimise the cost of the maneuvers and of the flow within the budget.

    Args:
        arcs: of the flow.
        steps: H.
        budget: of the resource.
        preferences: with the cost of the maneuvers.
    """
    model = pyo.ConcreteModel(name="joint_decision")
    model.E = pyo.RangeSet(0, len(arcs) - 1)
    model.U = pyo.Set(initialize=sorted({(a.step, *a.maneuver) for a in arcs}), dimen=3)
    model.f = pyo.Var(model.E, bounds=(0, 1))
    model.u = pyo.Var(model.U, domain=pyo.Binary)
    into: dict[tuple[int, int], list[int]] = {}
    out: dict[tuple[int, int], list[int]] = {}
    by_maneuver: dict[tuple[int, int, int], list[int]] = {}
    for e, arc in enumerate(arcs):
        into.setdefault((arc.step, arc.head), []).append(e)
        out.setdefault((arc.step - 1, arc.tail), []).append(e)
        by_maneuver.setdefault((arc.step, *arc.maneuver), []).append(e)

    def one_unit(model: pyo.ConcreteModel) -> pyo.Expression:
        """Row: sum of f[e] over the arcs that leave now = 1."""
        return _sum(model, out.get((0, 0), [])) == 1

    def what_comes_goes(model: pyo.ConcreteModel, k: int, node: int) -> pyo.Expression:
        """Row: sum of f[e] into a node = sum of f[e] out of it."""
        entering, leaving = into.get((k, node), []), out.get((k, node), [])
        signs = [1.0] * len(entering) + [-1.0] * len(leaving)
        return _linear(signs, [model.f[e] for e in (*entering, *leaving)]) == 0

    def maneuver_is_flow(model: pyo.ConcreteModel, k: int, mode: int, lateral: int) -> pyo.Expression:
        """Row: u[k, mode, lateral] = sum of f[e] over its arcs."""
        return _sum(model, by_maneuver[k, mode, lateral]) - model.u[k, mode, lateral] == 0

    def risk_within_budget(model: pyo.ConcreteModel) -> pyo.Expression:
        """Row: sum over e of risk[e] f[e] <= eps."""
        return _linear([a.resource for a in arcs], [model.f[e] for e in model.E]) <= budget

    inner = sorted({node for node in (*into, *out) if 0 < node[0] < steps})
    model.one_unit = pyo.Constraint(rule=one_unit)
    model.what_comes_goes = pyo.Constraint(inner, rule=what_comes_goes)
    model.maneuver_is_flow = pyo.Constraint(model.U, rule=maneuver_is_flow)
    model.risk_within_budget = pyo.Constraint(rule=risk_within_budget)
    of_maneuvers = [(preferences.maneuver(mode, lateral), model.u[k, mode, lateral]) for k, mode, lateral in model.U]
    terms = [*((arc.cost, model.f[e]) for e, arc in enumerate(arcs)), *of_maneuvers]
    model.cost = pyo.Objective(expr=_linear([c for c, _ in terms], [v for _, v in terms]))
    return model


def _sum(model: pyo.ConcreteModel, arcs: list[int]) -> LinearExpression:
    return _linear([1.0] * len(arcs), [model.f[e] for e in arcs])


def _linear(factors: list[float], variables: list[pyo.Var]) -> LinearExpression:
    return LinearExpression(constant=0.0, linear_coefs=factors, linear_vars=variables)


def _path(arcs: list[FlowArc], result: MilpResult, steps: int) -> Path:
    """Return the path of a flow: at each step the arc that carries most, from the node where the last one ended."""
    if result.values is None:
        raise ValueError("a path needs a solution")
    flow: FloatArray = result.values[: len(arcs)]
    order: IntArray = np.argsort(-flow, kind="stable")
    node, moves, chosen = 0, [], []
    for k in range(1, steps + 1):
        best = next(arcs[e] for e in order if arcs[e].step == k and arcs[e].tail == node)
        moves.append(best.move)
        chosen.append(best.arc)
        node = best.head
    return Path(tuple(moves), tuple(chosen))
