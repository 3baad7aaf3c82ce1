"""The joint decision: the cheapest plan whose risk is within epsilon, else the least bad one (eq. 41)."""

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from sumo_hmdp.decision.deadline import Deadline
from sumo_hmdp.decision.flow_milp import cheapest_flow
from sumo_hmdp.decision.graph import sequence_of
from sumo_hmdp.decision.paths import (
    COST_TIE,
    RISK_TIE,
    Bounds,
    Plan,
    Weights,
    bounds_of,
    cheapest,
    least_to_go,
    settle,
)
from sumo_hmdp.decision.plan_risk import PlanRisk
from sumo_hmdp.decision.problem import DecisionProblem, ManeuverSequence
from sumo_hmdp.decision.situation import Situation
from sumo_hmdp.domain.plan import Status
from sumo_hmdp.prediction.dynamics import FloatArray

# A plan that is as likely as not to end in contact is none: the ego brakes instead.
LIKELY_CONTACT = 0.5


class RelaxedOrder(StrEnum):
    """What is least in a plan where none keeps the risk.

    RISK: the risk, then the expected missing metres.
    METRES: the expected missing metres, then the risk.
    """

    RISK = "risk"
    METRES = "metres"


# docs/adr/0046 says which of the two realises less risk in the closed loop.
RELAXED_ORDER = RelaxedOrder.RISK
# A metre that is missing for sure weighs as much as this risk in the second place of either order.
SECOND_WEIGHT = 1e-3


@dataclass(frozen=True, eq=False)
class RiskTaken:
    """The risk of a decision's plan.

    Attributes:
        taken: of the plan, at most 1.
        least: that any plan could have had, at most 1.
        contact: upper bound of the probability that the plan ends in contact, at most 1.
        way_out: what of the risk level pays for the way out at the end, beside what is taken.
        dropped: probability that the prediction dropped; part of all three.
        vehicles: ids of the vehicles that may matter, V of them.
        parts: (V, H) what each of them adds at each step.
    """

    taken: float
    least: float
    contact: float
    dropped: float
    way_out: float = 0.0
    vehicles: tuple[str, ...] = ()
    parts: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def by_vehicle(self) -> dict[str, float]:
        """What each vehicle adds over the horizon, the most first; vehicles that add nothing are left out."""
        sums = dict(zip(self.vehicles, self.parts.sum(axis=1).tolist(), strict=True))
        return {name: part for name, part in sorted(sums.items(), key=lambda item: -item[1]) if part > 0.0}


@dataclass(frozen=True, eq=False)
class Choice:
    """What was chosen.

    Attributes:
        status: optimal, incumbent, relaxed or fallback.
        plan: the path, its cost and its resource; None for a fallback.
        sequence: its maneuvers, None for a fallback.
        metres: expected missing metres of a relaxed plan, 0 otherwise.
        risk: of the plan; of a fallback, of the best plan that was given up.
        model: the risk of every plan, of which this is one.
    """

    status: Status
    plan: Plan | None
    sequence: ManeuverSequence | None
    metres: float
    risk: RiskTaken
    model: PlanRisk


def choose(situation: Situation, solver: str, deadline: Deadline, *, reduced: bool = True) -> Choice:
    """Choose a plan (docs/formulation.md, eqs. 41 to 43).

    Args:
        situation: of the decision.
        solver: `search` or `milp`.
        deadline: of the whole decision; only the MILP looks at it.
        reduced: whether bounds of the search make the MILP smaller.
    """
    problem, risk = situation.problem, situation.risk
    cost: Weights = [step.cost for step in risk.graph.steps]
    bounds = bounds_of(risk.graph, cost, risk.arcs)
    budget = problem.settings.risk_level + RISK_TIE - risk.dropped
    least = float(bounds.resource[0][0, 0]) + risk.dropped
    found, proven = _best(problem, risk, cost, risk.arcs, budget, bounds, solver, deadline, reduced=reduced)
    if found is None:
        return _relaxed(situation, least, solver, deadline, reduced=reduced)
    if proven:
        found = settle(risk.graph, cost, risk.arcs, found, budget, bounds)
    status = Status.OPTIMAL if proven else Status.INCUMBENT
    taken = _taken(risk, found, least)
    return Choice(status, found, _sequence(risk, found, proven=proven), 0.0, taken, risk)


def _best(
    problem: DecisionProblem,
    risk: PlanRisk,
    cost: Weights,
    resource: Weights,
    budget: float,
    bounds: Bounds,
    solver: str,
    deadline: Deadline,
    *,
    reduced: bool,
) -> tuple[Plan | None, bool]:
    """Return the cheapest plan within a budget and whether it is proven."""
    if solver == "search":
        return cheapest(risk.graph, cost, resource, budget, bounds), True
    preferences = problem.settings.preferences
    return cheapest_flow(risk.graph, cost, resource, budget, preferences, reduced=reduced, time_limit=deadline.left())


def _relaxed(situation: Situation, least: float, solver: str, deadline: Deadline, *, reduced: bool) -> Choice:
    """Choose among plans none of which keeps the risk; braking where even the best means contact."""
    problem, risk = situation.problem, situation.risk
    if not np.isfinite(least):
        # No plan keeps the stop lines, or the speed limits.
        risk = situation.open_risk
    cost: Weights = [step.cost for step in risk.graph.steps]
    measure = relaxed_measure(risk, RELAXED_ORDER)
    to_go = least_to_go(risk.graph, measure)
    smallest = float(to_go[0][0, 0])
    if not np.isfinite(smallest):
        nothing = RiskTaken(1.0, 1.0, 1.0, risk.dropped)
        return Choice(Status.FALLBACK, None, None, 0.0, nothing, risk)
    least = float(least_to_go(risk.graph, risk.arcs)[0][0, 0]) + risk.dropped
    bounds = Bounds(least_to_go(risk.graph, cost), to_go)
    budget = smallest + COST_TIE
    found, proven = _best(problem, risk, cost, measure, budget, bounds, solver, deadline, reduced=reduced)
    if found is None:
        found, proven = cheapest(risk.graph, cost, measure, budget, bounds), False
    if found is None:
        raise ArithmeticError("the least bad plan must keep its own measure")
    found = settle(risk.graph, cost, measure, found, budget, bounds)
    taken = _taken(risk, found, least)
    if taken.contact >= LIKELY_CONTACT:
        return Choice(Status.FALLBACK, None, None, 0.0, taken, risk)
    metres = sum(
        float(m[move, arc]) for m, move, arc in zip(risk.shortfall, found.path.moves, found.path.arcs, strict=True)
    )
    return Choice(Status.RELAXED, found, _sequence(risk, found, proven=proven), metres, taken, risk)


def relaxed_measure(risk: PlanRisk, order: RelaxedOrder) -> Weights:
    """Return what is least in a relaxed plan, for each move and arc (docs/formulation.md, eq. 44).

    Both orders count a change of sides, without which driving through a vehicle would end its risk.
    """
    if order is RelaxedOrder.RISK:
        return [r + SECOND_WEIGHT * s for r, s in zip(risk.arcs, risk.shortfall, strict=True)]
    return [s + SECOND_WEIGHT * r for r, s in zip(risk.arcs, risk.shortfall, strict=True)]


def _sequence(risk: PlanRisk, plan: Plan, *, proven: bool) -> ManeuverSequence:
    sequence = sequence_of(risk.graph, plan.path)
    return ManeuverSequence(sequence.laterals, sequence.modes, proven)


def _taken(risk: PlanRisk, plan: Plan, least: float) -> RiskTaken:
    parts = risk.of_path(plan.path)
    contact = risk.contact_of_path(plan.path)
    names = tuple(risk.problem.vehicles[index].state.id for index in risk.vehicles)
    return RiskTaken(
        taken=min(1.0, float(parts.sum()) + risk.dropped),
        way_out=risk.way_out_of(plan.path),
        least=min(1.0, least),
        contact=min(1.0, contact),
        dropped=risk.dropped,
        vehicles=names,
        parts=parts,
    )


def risk_reason(problem: DecisionProblem, choice: Choice) -> str:
    """Say why a plan is not optimal, and from whom its risk comes."""
    if choice.status is Status.INCUMBENT:
        return "the deadline came before the plan was proven to be the best"
    risk, asked = choice.risk, problem.settings.risk_level
    text = f"no plan keeps the risk within {asked:.3g}; this one takes {risk.taken:.3g}, the least is {risk.least:.3g}"
    worst = next(iter(risk.by_vehicle), None)
    if worst is not None:
        step = int(risk.parts[risk.vehicles.index(worst)].argmax()) + 1
        text += f"; most comes from {worst} at step {step}"
    if any(step.beyond.any() for step in choice.model.graph.steps) and choice.metres > 0.0:
        text += "; it may not stop before its line"
    return text
