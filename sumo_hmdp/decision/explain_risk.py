"""Where the risk of a plan comes from: which vehicle, at which step and why; and what a cheaper plan would risk.

Only for decisions under `joint`; under the other rules every distance has a margin, and no risk of a plan is computed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sumo_hmdp.decision.decide import Answer, make_plan
from sumo_hmdp.decision.encounters import Distance, EgoPlaces, encounters
from sumo_hmdp.decision.graph import Path, sequence_of
from sumo_hmdp.decision.joint import Choice
from sumo_hmdp.decision.paths import Plan, bounds_of, frontier, next_cheaper
from sumo_hmdp.decision.plan_risk import PlanRisk
from sumo_hmdp.decision.problem import DecisionProblem
from sumo_hmdp.decision.stop_lines import closed_stretches
from sumo_hmdp.domain.maneuver import Mode
from sumo_hmdp.domain.occupancy import Occupancy, body_lanes
from sumo_hmdp.domain.plan import Cause, ForbiddenInterval, PlanStep, RiskShare
from sumo_hmdp.prediction.branches import IntArray, PredictedVehicle
from sumo_hmdp.prediction.dynamics import FloatArray
from sumo_hmdp.prediction.lane_occupancy import LaneRules, lanes_taken

# Of a vehicle that keeps its mode for sure, so much of its risk must be gone for a change of speed to be the cause.
HALF = 0.5
# Places at which the risk of one step is worked out are so far apart, and its ends interpolated [m].
SPACING = 1.0
# How far beyond the ego's reach they are looked for [m].
ROOM = 60.0

_CERTAIN = {
    Mode.DECELERATE: (1.0, 0.0, 0.0),
    Mode.CRUISE: (0.0, 1.0, 0.0),
    Mode.ACCELERATE: (0.0, 0.0, 1.0),
}
# (from, to) of each stretch of a lane [m], rising.
Stretches = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class PricedPlan:
    """A plan with its cost and its risk.

    Attributes:
        plan: its steps.
        cost: its cost.
        risk: upper bound of the probability that any distance falls short within the horizon.
        chosen: whether it is the answer's.
    """

    plan: tuple[PlanStep, ...]
    cost: float
    risk: float
    chosen: bool = False


@dataclass(frozen=True)
class ExplainedRisk:
    """Why a plan has its risk.

    Attributes:
        level: epsilon, what is asked for.
        taken: of the plan, or of the best one that a fallback gave up.
        least: that any plan could have had.
        contact: upper bound of the probability of contact.
        dropped: probability that the prediction dropped; part of all three.
        shares: from whom it comes, the most first.
        cheaper: the least risky of the plans that cost less; None where none does, or none was asked for.
    """

    level: float
    taken: float
    least: float
    contact: float
    dropped: float
    shares: tuple[RiskShare, ...]
    cheaper: PricedPlan | None


def explain_risk(answer: Answer) -> ExplainedRisk | None:
    """Explain the risk of an answer's plan; None under a rule that does not compute it."""
    choice, risk = answer.choice, answer.risk
    if choice is None or risk is None:
        return None
    return ExplainedRisk(
        level=answer.situation.problem.settings.risk_level,
        taken=risk.taken,
        least=risk.least,
        contact=risk.contact,
        dropped=risk.dropped,
        shares=risk_shares(answer),
        cheaper=_cheaper(answer, choice) if str(answer.status) in ("optimal", "incumbent") else None,
    )


def risk_shares(answer: Answer) -> tuple[RiskShare, ...]:
    """Return what each vehicle adds to the risk of an answer's plan, the most first; empty where there is none.

    The cause is that of the step at which a vehicle adds most. It comes over where it takes up no lane of the ego's
    plan now. Else it may change its speed, if more than half of what it adds were gone if it kept its mode for sure.
    What remains is where it is.
    """
    choice = answer.choice
    if choice is None:
        return ()
    parts, model = choice.risk.parts, choice.model
    if not parts.size:
        return ()
    path = None if choice.plan is None else choice.plan.path
    steady = parts if path is None else replace(model, problem=_keeping_modes(model.problem)).of_path(path)
    shares = []
    for row in np.argsort(-parts.sum(axis=1), kind="stable").tolist():
        total = float(parts[row].sum())
        if total <= 0.0:
            break
        k = int(parts[row].argmax())
        vehicle = model.problem.vehicles[model.vehicles[row]]
        cause = None if path is None else _cause(model, path, vehicle, k, parts[row, k], steady[row, k])
        ahead = vehicle.state.x > model.problem.ego.x
        shares.append(
            RiskShare(vehicle.state.id, total, tuple(parts[row].tolist()), k + 1, cause, vehicle.state.lane, ahead)
        )
    return tuple(shares)


def _cause(model: PlanRisk, path: Path, vehicle: PredictedVehicle, k: int, part: float, steady: float) -> Cause:
    step = model.graph.steps[k]
    after = step.moves.footprints[step.moves.pair[path.moves[k]], 1]
    taken = np.flatnonzero(step.lanes.occupied[after]) + 1
    if not np.isin(_lanes_now(model.problem, vehicle), taken).any():
        return Cause.COMES_OVER
    return Cause.CHANGES_SPEED if steady < HALF * part else Cause.PLACE


def _lanes_now(problem: DecisionProblem, vehicle: PredictedVehicle) -> tuple[int, ...]:
    state = vehicle.state
    swept = problem.settings.occupancy is Occupancy.SWEPT
    return (state.lane, *(body_lanes(problem.road, state.y, state.width) if swept else ()))


def _keeping_modes(problem: DecisionProblem) -> DecisionProblem:
    """Return the problem with vehicles that keep their present mode for sure."""
    return replace(
        problem,
        vehicles=tuple(
            replace(
                vehicle,
                policy=replace(
                    vehicle.policy,
                    longitudinal=_CERTAIN[vehicle.state.mode],
                ),
            )
            for vehicle in problem.vehicles
        ),
    )


def _cheaper(answer: Answer, choice: Choice) -> PricedPlan | None:
    model = choice.model
    if choice.plan is None:
        return None
    cost = [step.cost for step in model.graph.steps]
    found = next_cheaper(model.graph, cost, model.arcs, choice.plan, bounds_of(model.graph, cost, model.arcs))
    return None if found is None else _priced(answer, model, found)


def _priced(answer: Answer, model: PlanRisk, plan: Plan, *, chosen: bool = False) -> PricedPlan:
    steps = make_plan(answer.situation.problem, answer.lattice, sequence_of(model.graph, plan.path))
    return PricedPlan(steps, plan.cost, min(1.0, plan.resource + model.dropped), chosen)


def plan_frontier(answer: Answer) -> tuple[PricedPlan, ...]:
    """Return every plan that is the cheapest for some epsilon, by rising cost; empty under the rules without one.

    The answer's plan takes the place of one that is as cheap and as risky.
    """
    choice = answer.choice
    if choice is None:
        return ()
    model = choice.model
    cost = [step.cost for step in model.graph.steps]
    bounds = bounds_of(model.graph, cost, model.arcs)
    if not np.isfinite(bounds.cost[0][0, 0]):
        return ()
    found = frontier(model.graph, cost, model.arcs, bounds)
    own = choice.plan
    return tuple(
        _priced(answer, model, plan)
        if own is None or abs(plan.cost - own.cost) > 1e-6 or abs(plan.resource - own.resource) > 1e-8
        else _priced(answer, model, own, chosen=True)
        for plan in found
    )


def lane_risks(
    problem: DecisionProblem, vehicles: IntArray, places: Sequence[FloatArray], speeds: Sequence[float]
) -> tuple[FloatArray, ...]:
    """Return how likely it is to be too near to any vehicle at one step, by the ego's lane and place.

    Args:
        problem: the decision problem.
        vehicles: index of each vehicle that may matter.
        places: of the ego at each step 1..H, (E,) each [m].
        speeds: of the ego at each step [m/s].

    Returns:
        (lanes, E) for each step: the sum over the vehicles, at most 1; the ego takes up that lane only.
    """
    seen = [problem.vehicles[index] for index in vehicles]
    settings = problem.settings
    alone = np.eye(problem.road.lane_count, dtype=bool)
    rules = LaneRules(problem.road, settings.period, settings.gains, settings.occupancy is Occupancy.SWEPT)
    forecast = lanes_taken(seen, rules, [alone] * (len(places) + 1))
    ego = [
        # Places between those of the lattice have no number.
        EgoPlaces(np.full(len(x), np.nan), x, np.full(len(x), speed), np.zeros((1, 2), dtype=np.int64))
        for x, speed in zip(places, speeds, strict=True)
    ]
    near = encounters(problem, seen, ego, Distance.SAFE)
    return tuple(np.minimum(taken.now.T @ here.short, 1.0) for taken, here in zip(forecast.steps, near, strict=True))


def risky_stretches(answer: Answer, speeds: Sequence[float]) -> tuple[tuple[Stretches, ...], ...]:
    """Return where being at one step alone is riskier than epsilon allows for a whole plan.

    Args:
        answer: under `joint`.
        speeds: of the ego at each step 1..H [m/s].

    Returns:
        For each step and lane (from, to) [m], rising, as far as `ROOM` beyond the ego's reach; no stretches where no
        mode is admissible.
    """
    problem = answer.situation.problem
    if answer.choice is None:
        raise ValueError("only the rule `joint` has the risk of a step")
    model = answer.choice.model
    places = [
        np.arange(step.x.min() - ROOM, step.x.max() + ROOM + SPACING, SPACING) if len(step.x) else np.zeros(1)
        for step in model.graph.steps
    ]
    risks = lane_risks(problem, model.vehicles, places, speeds)
    level = problem.settings.risk_level
    return tuple(tuple(_above(x, row, level) for row in risk) for x, risk in zip(places, risks, strict=True))


def risky_intervals(answer: Answer) -> tuple[ForbiddenInterval, ...]:
    """Return those stretches at the ego's present speed, and what stop lines close; for display."""
    problem = answer.situation.problem
    stretches = risky_stretches(answer, [problem.ego.speed] * problem.settings.horizon_steps)
    found = [
        ForbiddenInterval(step, lane, low, high)
        for step, lanes in enumerate(stretches, start=1)
        for lane, ends in enumerate(lanes, start=1)
        for low, high in ends
    ]
    return (*found, *closed_stretches(problem, answer.lattice))


def _above(x: FloatArray, value: FloatArray, level: float) -> Stretches:
    """Return the stretches of x where values are above a level, their ends interpolated."""
    over = value > level
    edges = np.flatnonzero(over[1:] != over[:-1])
    share = (level - value[edges]) / (value[edges + 1] - value[edges])
    ends = (x[edges] + share * (x[edges + 1] - x[edges])).tolist()
    if over[0]:
        ends.insert(0, float(x[0]))
    if over[-1]:
        ends.append(float(x[-1]))
    return tuple(zip(ends[::2], ends[1::2], strict=True))
