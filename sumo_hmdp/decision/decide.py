"""One decision from problem to answer: predict, tighten, carve, solve (docs/formulation.md, sections 4 to 9)."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Protocol

import numpy as np

from sumo_hmdp.decision.corridors import Corridors
from sumo_hmdp.decision.cost import objective
from sumo_hmdp.decision.deadline import Deadline
from sumo_hmdp.decision.distance import counted
from sumo_hmdp.decision.fallback import braking_demand
from sumo_hmdp.decision.joint import Choice, RiskTaken, choose, risk_reason
from sumo_hmdp.decision.lattice import EgoLattice
from sumo_hmdp.decision.optimiser import DeadlineError, best_sequence, least_violation
from sumo_hmdp.decision.plan_distances import shortfalls
from sumo_hmdp.decision.problem import DISTANCE_TOLERANCE, DecisionProblem, ManeuverSequence
from sumo_hmdp.decision.search import search_best, search_relaxed
from sumo_hmdp.decision.situation import Situation
from sumo_hmdp.decision.stop_lines import line_shortfalls
from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.domain.plan import PlanStep, Status
from sumo_hmdp.domain.scene import StopLine
from sumo_hmdp.errors import SumoHmdpError
from sumo_hmdp.prediction.branches import Branches
from sumo_hmdp.prediction.dynamics import FloatArray


class Solver(Protocol):
    """Solves a decision in its corridors; None where there is no plan."""

    def __call__(
        self, problem: DecisionProblem, lattice: EgoLattice, corridors: Corridors, *, deadline: Deadline
    ) -> ManeuverSequence | None:
        """Return a plan."""
        ...


def _untimed(find: Callable[[DecisionProblem, EgoLattice, Corridors], ManeuverSequence | None]) -> Solver:
    """Return a solver that is done long before any deadline, as one that takes a deadline."""

    def solve(
        problem: DecisionProblem, lattice: EgoLattice, corridors: Corridors, *, deadline: Deadline
    ) -> ManeuverSequence | None:
        del deadline
        return find(problem, lattice, corridors)

    return solve


@dataclass(frozen=True)
class SolverPair:
    """A way to solve a decision.

    Attributes:
        name: as in `--solver`.
        best: the cheapest plan that keeps every distance, or None.
        relaxed: the least violation, then the least cost, or None.
    """

    name: str
    best: Solver
    relaxed: Solver


MILP = SolverPair("milp", best_sequence, least_violation)
SEARCH = SolverPair("search", _untimed(search_best), _untimed(search_relaxed))
PAIRS = {pair.name: pair for pair in (MILP, SEARCH)}
BOTH = "both"
SOLVERS = (*PAIRS, BOTH)

# Two proofs of one optimum may differ by what HiGHS calls equal.
OBJECTIVE_TOLERANCE = 1e-6
# Two plans of equal cost are told apart by their risk, where it differs by more than this.
RISK_TOLERANCE = 2e-9


@dataclass(frozen=True)
class Shortfall:
    """The worst distance of a plan.

    Attributes:
        vehicle_id: to which vehicle; `stop line` where `line` is given.
        step: at which step.
        metres: how much is missing.
        line: the stop line that the plan passes, or before which it cannot stop; None where it is a vehicle.
    """

    vehicle_id: str
    step: int
    metres: float
    line: StopLine | None = None

    def __str__(self) -> str:
        if self.line is None:
            return f"{self.vehicle_id} at step {self.step} is {self.metres:.2f} m too near"
        return f"from step {self.step} the ego stops {self.metres:.2f} m beyond the stop line at {self.line.x:.2f} m"


@dataclass(frozen=True)
class Answer:
    """The answer to one decision problem.

    Attributes:
        status: optimal, relaxed or fallback.
        objective: cost of the plan, None for a fallback.
        violation: total violation [m], 0 when optimal, None for a fallback.
        reason: why it is not optimal, empty when it is.
        lateral: lateral action to take now.
        mode: mode to take now.
        brake: deceleration of a fallback, a positive magnitude [m/s2]; None otherwise.
        plan: the steps, empty for a fallback.
        sequence: the maneuvers of the plan, None for a fallback.
        situation: what the answer rests on.
        solver: its name.
        solve_time: wall-clock time of the whole answer [s].
        choice: under `joint` the risk of the plan, and of every other; None otherwise.
    """

    status: Status
    objective: float | None
    violation: float | None
    reason: str
    lateral: Lateral
    mode: Mode
    brake: float | None
    plan: tuple[PlanStep, ...]
    sequence: ManeuverSequence | None
    situation: Situation
    solver: str
    solve_time: float
    choice: Choice | None = None

    @property
    def risk(self) -> RiskTaken | None:
        """The risk of the plan, None where it is not computed."""
        return None if self.choice is None else self.choice.risk

    @property
    def lattice(self) -> EgoLattice:
        """Where the ego can be."""
        return self.situation.lattice

    @property
    def branches(self) -> Branches:
        """The likely branches of every vehicle."""
        return self.situation.branches

    @property
    def margin(self) -> FloatArray:
        """Margins of the chance constraint, (B, H) [m]."""
        return self.situation.margin

    @property
    def corridors(self) -> Corridors:
        """The free windows that keep every distance."""
        return self.situation.corridors

    @property
    def branch_count(self) -> int:
        """How many branches were kept; under `joint` how many places of the vehicles at the end of the horizon."""
        return len(self.branches.vehicle) if self.choice is None else self.choice.model.place_count

    @property
    def pruned(self) -> float:
        """The probability that the prediction dropped: under `joint` in all, otherwise the most of any vehicle."""
        return float(self.branches.pruned.max(initial=0.0)) if self.risk is None else self.risk.dropped


class SolversDisagreeError(SumoHmdpError):
    """Two exact solvers gave different answers to one problem: one of them is wrong.

    Attributes:
        problem: the decision problem.
    """

    def __init__(self, message: str, problem: DecisionProblem) -> None:
        super().__init__(message)
        self.problem = problem


def answer(problem: DecisionProblem, solver: str = "milp") -> Answer:
    """Decide: the cheapest safe plan, else the least unsafe one without contact, else brake in lane.

    Args:
        problem: the decision problem.
        solver: a name of `SOLVERS`; `both` solves twice and compares.

    Raises:
        decision.optimiser.SolverError: if the solver proves neither an optimum nor infeasibility.
        decision.risk.RiskBudgetError: if pruning leaves nothing of the risk level.
        SolversDisagreeError: if `both` solvers differ.
    """
    if solver == BOTH:
        first, second = (_answer(problem, pair) for pair in (MILP, SEARCH))
        _require_agreement(problem, first, second)
        return replace(first, solver=BOTH, solve_time=first.solve_time + second.solve_time)
    return _answer(problem, PAIRS[solver])


def _answer(problem: DecisionProblem, solver: SolverPair) -> Answer:
    """Predict, tighten, carve, solve; under `joint` predict, weigh, solve."""
    started = time.perf_counter()
    situation = Situation(problem)
    found = _joint(situation, solver.name, started) if situation.joint else _with_margins(situation, solver, started)
    return replace(found, solve_time=time.perf_counter() - started)


def _joint(situation: Situation, solver: str, started: float) -> Answer:
    """Answer by the risk of whole plans (docs/formulation.md, eq. 41)."""
    choice = choose(situation, solver, Deadline.of(situation.problem.settings, started))
    if choice.sequence is None or choice.plan is None:
        failure = f"the best plan ends in contact with a probability of {choice.risk.contact:.0%}"
        return _fallback(situation, failure, solver, choice)
    status = choice.status
    return Answer(
        status=status,
        objective=choice.plan.cost,
        violation=choice.metres,
        reason="" if status is Status.OPTIMAL else risk_reason(situation.problem, choice),
        lateral=choice.sequence.laterals[0],
        mode=choice.sequence.modes[0],
        brake=None,
        plan=make_plan(situation.problem, situation.lattice, choice.sequence),
        sequence=choice.sequence,
        situation=situation,
        solver=solver,
        solve_time=0.0,
        choice=choice,
    )


def _with_margins(situation: Situation, solver: SolverPair, started: float) -> Answer:
    """Answer by a margin for each distance (docs/formulation.md, eqs. 8 to 15)."""
    problem, lattice = situation.problem, situation.lattice
    failure = "every plan means contact or leaves the speed limits"
    status, sequence = Status.OPTIMAL, None
    deadline = Deadline.of(problem.settings, started)
    try:
        sequence = solver.best(problem, lattice, situation.corridors, deadline=deadline)
        if sequence is None:
            status = Status.RELAXED
            sequence = solver.relaxed(problem, lattice, situation.contact_corridors, deadline=deadline)
    except DeadlineError:
        failure = f"no plan was known when the deadline of {problem.settings.period:g} s came"
    if sequence is None:
        return _fallback(situation, failure, solver.name)
    return _planned(situation, status, sequence, solver.name)


def _planned(situation: Situation, status: Status, sequence: ManeuverSequence, solver: str) -> Answer:
    """Return the answer that follows a sequence of maneuvers."""
    problem = situation.problem
    plan = make_plan(problem, situation.lattice, sequence)
    violation, reason = 0.0, ""
    if status is Status.RELAXED:
        violation, worst = violation_of(problem, plan, situation.branches, situation.margin)
        reason = f"no plan keeps every distance{' and stop line' * bool(problem.stop_lines)}; {worst}"
    if not sequence.proven:
        status = Status.INCUMBENT if status is Status.OPTIMAL else status
        late = "the deadline came before the plan was proven to be the best"
        unsure = "the solver did not prove the plan to be the cheapest"
        reason = f"{reason}; " * bool(reason) + (late if problem.settings.enforce_deadline else unsure)
    return Answer(
        status=status,
        objective=objective(problem.settings.preferences, situation.lattice, problem.ego.lane, sequence),
        violation=violation,
        reason=reason,
        lateral=sequence.laterals[0],
        mode=sequence.modes[0],
        brake=None,
        plan=plan,
        sequence=sequence,
        situation=situation,
        solver=solver,
        solve_time=0.0,
    )


def _fallback(situation: Situation, failure: str, solver: str, choice: Choice | None = None) -> Answer:
    """Return the answer that brakes in lane."""
    brake, blocker = braking_demand(situation.problem, situation.branches)
    return Answer(
        status=Status.FALLBACK,
        objective=None,
        violation=None,
        reason=f"{failure}; brake in lane for {blocker or 'nothing ahead'}",
        lateral=Lateral.KEEP,
        mode=Mode.DECELERATE,
        brake=brake,
        plan=(),
        sequence=None,
        situation=situation,
        solver=solver,
        solve_time=0.0,
        choice=choice,
    )


def _require_agreement(problem: DecisionProblem, first: Answer, second: Answer) -> None:
    """Compare two answers: status, violation and cost must agree, the plans need not."""

    def differ(a: float | None, b: float | None, tolerance: float) -> bool:
        return (a is None) != (b is None) or (a is not None and b is not None and abs(a - b) > tolerance)

    if (
        first.status is not second.status
        or differ(first.violation, second.violation, 10 * DISTANCE_TOLERANCE)
        or differ(first.objective, second.objective, OBJECTIVE_TOLERANCE)
        or differ(_risk_taken(first), _risk_taken(second), RISK_TOLERANCE)
    ):
        told = " but ".join(
            f"{a.solver} says {a.status}, objective {a.objective}, violation {a.violation} m" for a in (first, second)
        )
        raise SolversDisagreeError(f"both solvers must agree, {told}", problem)


def _risk_taken(answer: Answer) -> float | None:
    return None if answer.risk is None else answer.risk.taken


def make_plan(problem: DecisionProblem, lattice: EgoLattice, sequence: ManeuverSequence) -> tuple[PlanStep, ...]:
    """Return where a sequence of maneuvers leads."""
    motions = lattice.walk(tuple(int(mode) for mode in sequence.modes))
    lanes = list(accumulate(sequence.laterals, initial=problem.ego.lane))
    return tuple(
        PlanStep(
            step=k + 1,
            lateral=sequence.laterals[k],
            mode=sequence.modes[k],
            lane=lanes[k + 1],
            x=lattice.position_at(k + 1, motion.point),
            # A speed limit of zero is met up to rounding.
            speed=max(0.0, motion.speed),
        )
        for k, motion in enumerate(motions)
    )


def violation_of(
    problem: DecisionProblem, plan: Sequence[PlanStep], branches: Branches, margin: FloatArray
) -> tuple[float, Shortfall]:
    """Return the total violation of a plan [m] and its worst distance (docs/formulation.md, eqs. 14 and 23).

    The violation of a step is the largest shortfall to what is behind plus the largest to what is ahead, a stop line
    included.
    """
    total, worst = 0.0, Shortfall("no vehicle", 0, 0.0)
    by_step = zip(shortfalls(problem, plan, branches, margin), line_shortfalls(problem, plan), strict=True)
    for (k, rows, ahead, missing), (line, beyond) in by_step:
        short, passed = counted(missing), float(counted(np.array(beyond)))
        total += float(short[ahead].max(initial=0.0) + short[~ahead].max(initial=passed))
        if passed > max(worst.metres, short.max(initial=0.0)):
            worst = Shortfall("stop line", k + 1, passed, line)
        elif short.max(initial=0.0) > worst.metres:
            at = int(short.argmax())
            vehicle = branches.vehicles[branches.vehicle[rows[at]]]
            worst = Shortfall(vehicle.state.id, k + 1, float(short[at]))
    return total, worst
