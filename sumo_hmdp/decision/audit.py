"""The paper's two theorems, checked at every decision (docs/guarantees.md).

The *shifted plan* is what was left of the plan before, with one action of the baseline policy at its end. The first
theorem says that it stays feasible when the traffic moves as predicted; the second that the cost then falls by at
least the cost of the step that was taken. Here both are looked at as they turn out, with the reason where they fail.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from sumo_hmdp.decision.cost import baseline_action, stage_cost
from sumo_hmdp.decision.decide import Answer, make_plan
from sumo_hmdp.decision.graph import path_of
from sumo_hmdp.decision.lattice import EgoLattice
from sumo_hmdp.decision.occupancy import shares_lane
from sumo_hmdp.decision.paths import RISK_TIE
from sumo_hmdp.decision.plan_distances import lanes_shared, missing_distances
from sumo_hmdp.decision.plan_risk import PlanRisk
from sumo_hmdp.decision.problem import DISTANCE_TOLERANCE, DecisionProblem, ManeuverSequence
from sumo_hmdp.decision.road_rules import keeps_rules
from sumo_hmdp.decision.stop_lines import line_shortfalls, place_of
from sumo_hmdp.domain.maneuver import ACTIONS, Lateral, ManeuverState, Mode
from sumo_hmdp.domain.plan import PlanStep, Status
from sumo_hmdp.domain.scene import StopLine
from sumo_hmdp.prediction.policy import action_probabilities


class Cause(StrEnum):
    """Why a shifted plan is not feasible.

    NEW_VEHICLE: a vehicle that was not seen before.
    OTHER_MANEUVER: a vehicle did what its policy gives no probability.
    PRUNED_BRANCH: a vehicle did, or may now do, what pruning had dropped.
    NOISE: a vehicle is not where its branch predicted it.
    TRACKING: the ego is not where its plan put it.
    BASELINE: the action of the baseline at the end of the horizon is not feasible; nothing was planned that far.
    LIMITS: the plan leaves the ego's own limits (lane, mode or speed).
    STOP_LINE: a stop line closed that was open before.
    """

    NEW_VEHICLE = "new_vehicle"
    OTHER_MANEUVER = "other_maneuver"
    PRUNED_BRANCH = "pruned_branch"
    NOISE = "noise"
    TRACKING = "tracking"
    BASELINE = "baseline"
    LIMITS = "limits"
    STOP_LINE = "stop_line"


@dataclass(frozen=True)
class Breach:
    """The first thing that makes a sequence of maneuvers infeasible.

    Attributes:
        step: at which step, 1..H.
        row: of the branch that it concerns, None where it concerns the ego alone.
        metres: what is missing to the safe distance, or to the line; 0 where the ego would pass through.
        line: the stop line that it concerns, its x where it acts; None where it concerns none.
        lane: that the ego intends where it passes the line.
    """

    step: int
    row: int | None
    metres: float
    line: StopLine | None = None
    lane: int = 0


@dataclass(frozen=True)
class Audit:
    """What became of the plan before.

    Attributes:
        stage_cost: cost of the step now taken, None for a fallback.
        objective_bound: cost that the second theorem allows now, None where it says nothing: at the first
            decision, with a terminal weight below 1, or after a decision that was not optimal.
        shifted_feasible: whether the shifted plan is feasible, None where there is none.
        shifted_reason: why it is not, empty where it is.
    """

    stage_cost: float | None
    objective_bound: float | None
    shifted_feasible: bool | None
    shifted_reason: str


def audit(problem: DecisionProblem, answer: Answer, before: tuple[DecisionProblem, Answer] | None) -> Audit:
    """Check both theorems between two decisions that follow each other.

    Args:
        problem: the present decision problem.
        answer: its answer.
        before: the problem and answer one period ago, None at the first decision.
    """
    cost = first_stage_cost(problem, answer)
    if before is None or before[1].status is not Status.OPTIMAL:
        return Audit(cost, None, None, "")
    last_problem, last = before
    bound = None
    last_cost = first_stage_cost(last_problem, last)
    if last_problem.settings.preferences.terminal_weight >= 1 and last.objective is not None and last_cost is not None:
        bound = last.objective - last_cost
    if answer.choice is not None:
        feasible, reason = shifted_within_risk(answer.choice.model, last_problem, last)
        return Audit(cost, bound, shifted_feasible=feasible, shifted_reason=reason)
    sequence = shifted(last_problem, last)
    breach = first_breach(problem, answer, sequence)
    if breach is None:
        return Audit(cost, bound, shifted_feasible=True, shifted_reason="")
    cause = cause_of(problem, answer, last_problem, last, breach)
    return Audit(cost, bound, shifted_feasible=False, shifted_reason=_reason(answer, breach, cause))


def first_stage_cost(problem: DecisionProblem, answer: Answer) -> float | None:
    """Return the cost of the step that an answer takes now (docs/formulation.md, eq. 12), None for a fallback."""
    if not answer.plan:
        return None
    step = answer.plan[0]
    return stage_cost(
        problem.settings.preferences, mode=step.mode, lateral=step.lateral, speed=step.speed, lane=step.lane
    )


def shifted(problem: DecisionProblem, answer: Answer) -> ManeuverSequence:
    """Return the rest of a plan with one action of the baseline policy at its end.

    Raises:
        ValueError: if the answer has no plan.
    """
    if answer.sequence is None:
        raise ValueError("only an answer with a plan can be shifted, got a fallback")
    end = answer.plan[-1]
    lateral, mode = baseline_action(problem.settings.preferences, lane=end.lane, speed=end.speed, mode=end.mode)
    return ManeuverSequence(
        (*answer.sequence.laterals[1:], Lateral(lateral)),
        (*answer.sequence.modes[1:], Mode(mode)),
    )


def shifted_within_risk(model: PlanRisk, last_problem: DecisionProblem, last: Answer) -> tuple[bool, str]:
    """Tell whether the shifted plan keeps the risk level under `joint`, and why not.

    At its end stands the better of two actions: the baseline's toward its goal, and braking.
    """
    goal = shifted(last_problem, last)
    end = Mode(max(goal.modes[-2] - 1, -1)) if len(goal.modes) > 1 else Mode.DECELERATE
    braking = ManeuverSequence((*goal.laterals[:-1], Lateral.KEEP), (*goal.modes[:-1], end))
    budget = model.problem.settings.risk_level + RISK_TIE
    found = []
    for sequence in (goal, braking):
        path = path_of(model.graph, sequence)
        if path is None:
            continue
        parts = model.of_path(path)
        if parts.sum() + model.dropped <= budget:
            return True, ""
        found.append(parts)
    if not found:
        return False, f"{Cause.LIMITS}: no admissible maneuver is left at the end, or a stop line closed"
    parts = min(found, key=lambda each: float(each.sum()))
    row, step = divmod(int(parts.argmax()), parts.shape[1])
    name = model.problem.vehicles[model.vehicles[row]].state.id
    known = name in {vehicle.state.id for vehicle in last_problem.vehicles}
    cause = Cause.NEW_VEHICLE if not known else Cause.BASELINE if step + 1 == parts.shape[1] else Cause.NOISE
    return False, f"{cause}: step {step + 1}, risk {parts.sum() + model.dropped:.3g}, most from {name}"


def first_breach(problem: DecisionProblem, answer: Answer, sequence: ManeuverSequence) -> Breach | None:
    """Return the first reason why a sequence is not feasible in a problem, None where it is.

    Args:
        problem: the decision problem.
        answer: its answer, for the prediction and the margins.
        sequence: any sequence of H maneuvers.
    """
    plan = make_plan(problem, answer.lattice, sequence)
    own = _own_breach(problem, answer.lattice, sequence)
    line = _line_breach(problem, plan)
    traffic = _traffic_breach(problem, answer, plan)
    found = [breach for breach in (own, line, traffic) if breach is not None]
    return min(found, key=lambda breach: breach.step, default=None)


def _own_breach(problem: DecisionProblem, lattice: EgoLattice, sequence: ManeuverSequence) -> Breach | None:
    lane, mode = problem.ego.lane, problem.ego.mode
    motions = lattice.walk(tuple(int(m) for m in sequence.modes))
    for k, (lateral, following, motion) in enumerate(zip(sequence.laterals, sequence.modes, motions, strict=True)):
        lane += lateral
        possible = problem.road.has_lane(lane) and lane not in problem.settings.forbidden_lanes
        possible = possible and keeps_rules(problem, k + 1, lane - lateral, lateral, motion.speed)
        possible &= abs(following - mode) <= 1 and lattice.allows(motion.level, motion.phase, step=k + 1)
        if not possible:
            return Breach(k + 1, None, 0.0)
        mode = following
    return None


def _line_breach(problem: DecisionProblem, plan: tuple[PlanStep, ...]) -> Breach | None:
    if not problem.stop_lines:
        return None
    for step, (line, beyond) in zip(plan, line_shortfalls(problem, plan), strict=True):
        if beyond > DISTANCE_TOLERANCE:
            return Breach(step.step, None, beyond, line, step.lane)
    return None


def _traffic_breach(problem: DecisionProblem, answer: Answer, plan: tuple[PlanStep, ...]) -> Breach | None:
    if not all(problem.road.has_lane(step.lane) for step in plan):
        return None
    branches = answer.branches
    ahead, missing = missing_distances(problem, plan, branches, answer.margin)
    shared = lanes_shared(problem, plan, branches)
    missing = np.where(shared, missing, 0.0)
    is_ahead = np.array([problem.ego.x > v.state.x for v in problem.vehicles], dtype=bool)
    at_first = (
        is_ahead[branches.vehicle],
        shares_lane(problem, branches, answer.corridors.states[0][0])[branches.vehicle],
    )
    ahead, shared = (
        np.concatenate([first[None], later.T]) for first, later in zip(at_first, (ahead, shared), strict=True)
    )
    passes = shared[:-1] & shared[1:] & (ahead[:-1] != ahead[1:])
    breached = passes.any(axis=1) | (missing.max(axis=0, initial=0.0) > DISTANCE_TOLERANCE)
    k = int(breached.argmax())
    if not breached[k]:
        return None
    if passes[k].any():
        return Breach(k + 1, int(passes[k].argmax()), 0.0)
    row = int(missing[:, k].argmax())
    return Breach(k + 1, row, float(missing[row, k]))


def cause_of(
    problem: DecisionProblem, answer: Answer, last_problem: DecisionProblem, last: Answer, breach: Breach
) -> Cause:
    """Tell why a shifted plan failed, from what was predicted one period ago."""
    horizon = problem.settings.horizon_steps
    if breach.row is None:
        return _cause_without_vehicle(last_problem, breach)
    branches, row = answer.branches, breach.row
    vehicle = branches.vehicles[branches.vehicle[row]]
    ids = [v.state.id for v in last_problem.vehicles]
    if vehicle.state.id not in ids:
        return Cause.NEW_VEHICLE
    index = ids.index(vehicle.state.id)
    if _impossible(last_problem, index, vehicle.state.lane, vehicle.state.mode):
        return Cause.OTHER_MANEUVER
    if breach.step == horizon:
        return Cause.BASELINE
    # The branch as the decision before saw it: what the vehicle did since, then what it may do now.
    k = breach.step
    lanes = [vehicle.state.lane, *branches.lanes[row, :k]]
    modes = [vehicle.state.mode, *branches.modes[row, :k]]
    same = (
        (last.branches.vehicle == index)
        & (last.branches.lanes[:, : k + 1] == lanes).all(axis=1)
        & (last.branches.modes[:, : k + 1] == modes).all(axis=1)
    )
    if not same.any():
        return Cause.PRUNED_BRANCH
    off = abs(float(last.branches.x[np.flatnonzero(same)[0], 0]) - vehicle.state.x)
    return Cause.TRACKING if abs(last.plan[0].x - problem.ego.x) > off else Cause.NOISE


def _cause_without_vehicle(last_problem: DecisionProblem, breach: Breach) -> Cause:
    if breach.line is not None and not _was_closed(last_problem, breach.line, breach.lane):
        cause = Cause.STOP_LINE
    elif breach.step == last_problem.settings.horizon_steps:
        cause = Cause.BASELINE
    else:
        cause = Cause.LIMITS if breach.line is None else Cause.TRACKING
    return cause


def _was_closed(problem: DecisionProblem, line: StopLine, intended: int) -> bool:
    """Tell whether a problem has a line in the same lanes that stops who intends a lane at the same place or before."""
    return all(
        any(
            lane in old.lanes and place_of(problem.ego, old, intended) <= line.x + DISTANCE_TOLERANCE
            for old in problem.stop_lines
        )
        for lane in line.lanes
    )


def _impossible(problem: DecisionProblem, index: int, lane: int, mode: int) -> bool:
    """Tell whether a vehicle's policy gave no probability to the state that it is in one step later."""
    vehicle = problem.vehicles[index]
    start = ManeuverState(vehicle.state.lane, vehicle.state.mode)
    action = (lane - start.lane, mode - start.mode)
    known = {(a.lateral, a.mode_change): i for i, a in enumerate(ACTIONS)}
    if action not in known:
        return True
    return bool(action_probabilities(vehicle.policy)[start.lane - 1, start.mode + 1, known[action]] == 0.0)


def _reason(answer: Answer, breach: Breach, cause: Cause) -> str:
    where = f"{cause}: step {breach.step}"
    if breach.line is not None:
        return f"{where}, {breach.metres:.2f} m beyond the stop line at {breach.line.x:.2f} m"
    if breach.row is None:
        return where
    vehicle = answer.branches.vehicles[answer.branches.vehicle[breach.row]].state.id
    what = f"{breach.metres:.2f} m too near" if breach.metres else "passed through"
    return f"{where}, {vehicle} {what}"
