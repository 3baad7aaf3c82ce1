"""One decision from problem to answer: predict, tighten, carve, solve (docs/formulation.md, section 9)."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.domain.plan import PlanStep, Status
from sumo_hmdp.hmdp.branches import Branches, predict
from sumo_hmdp.planning.corridors import Clearance, Corridors, carve, contact_clearance
from sumo_hmdp.planning.cost import objective
from sumo_hmdp.planning.fallback import braking_demand
from sumo_hmdp.planning.lattice import EgoLattice, ego_lattice
from sumo_hmdp.planning.optimiser import best_sequence, least_violation
from sumo_hmdp.planning.problem import DISTANCE_TOLERANCE, DecisionProblem, ManeuverSequence
from sumo_hmdp.planning.risk import margins

Solver = Callable[[DecisionProblem, EgoLattice, Corridors], ManeuverSequence | None]


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
SOLVERS = {MILP.name: MILP}


@dataclass(frozen=True)
class Shortfall:
    """The worst distance of a plan.

    Attributes:
        vehicle_id: to which vehicle.
        step: at which step.
        metres: how much is missing.
    """

    vehicle_id: str
    step: int
    metres: float


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
        branches: the prediction.
        corridors: the free windows that keep every distance.
        solver: its name.
        solve_time: wall-clock time of the whole answer [s].
    """

    status: Status
    objective: float | None
    violation: float | None
    reason: str
    lateral: Lateral
    mode: Mode
    brake: float | None
    plan: tuple[PlanStep, ...]
    branches: Branches
    corridors: Corridors
    solver: str
    solve_time: float


def answer(problem: DecisionProblem, solver: SolverPair = MILP) -> Answer:
    """Decide: the cheapest safe plan, else the least unsafe one without contact, else brake in lane.

    Args:
        problem: the decision problem.
        solver: how to solve it.

    Raises:
        planning.optimiser.SolverError: if the solver proves neither an optimum nor infeasibility.
    """
    started = time.perf_counter()
    lattice = ego_lattice(problem)
    branches = predict(problem.vehicles, problem.settings.prediction())
    distance = problem.settings.safe_distance + margins(branches, problem.settings)
    safe = Clearance(ahead=distance, behind=distance)
    corridors = carve(problem, lattice, branches, safe)
    status, reason, violation = Status.OPTIMAL, "", 0.0
    sequence = solver.best(problem, lattice, corridors)
    if sequence is None:
        status = Status.RELAXED
        touching = contact_clearance(problem, safe)
        sequence = solver.relaxed(problem, lattice, carve(problem, lattice, branches, touching, safe))
    if sequence is None:
        brake, blocker = braking_demand(problem, branches)
        reason = (
            f"every plan means contact or leaves the speed limits; brake in lane for {blocker or 'no vehicle ahead'}"
        )
        return Answer(
            status=Status.FALLBACK,
            objective=None,
            violation=None,
            reason=reason,
            lateral=Lateral.KEEP,
            mode=Mode.DECELERATE,
            brake=brake,
            plan=(),
            branches=branches,
            corridors=corridors,
            solver=solver.name,
            solve_time=time.perf_counter() - started,
        )
    plan = make_plan(problem, lattice, sequence)
    if status is Status.RELAXED:
        violation, worst = violation_of(plan, branches, safe)
        reason = (
            f"no plan keeps every distance; {worst.vehicle_id} at step {worst.step} is {worst.metres:.2f} m too near"
        )
    return Answer(
        status=status,
        objective=objective(problem.settings.preferences, lattice, problem.ego.lane, sequence),
        violation=violation,
        reason=reason,
        lateral=sequence.laterals[0],
        mode=sequence.modes[0],
        brake=None,
        plan=plan,
        branches=branches,
        corridors=corridors,
        solver=solver.name,
        solve_time=time.perf_counter() - started,
    )


def make_plan(problem: DecisionProblem, lattice: EgoLattice, sequence: ManeuverSequence) -> tuple[PlanStep, ...]:
    """Return where a sequence of maneuvers leads."""
    levels, points = lattice.walk(tuple(int(mode) for mode in sequence.modes))
    lanes = problem.ego.lane + np.cumsum(np.array(sequence.laterals, dtype=int))
    return tuple(
        PlanStep(
            step=k + 1,
            lateral=sequence.laterals[k],
            mode=sequence.modes[k],
            lane=int(lanes[k]),
            x=lattice.position_at(k + 1, points[k]),
            speed=max(0.0, lattice.speed_at(levels[k])),
        )
        for k in range(lattice.steps)
    )


def violation_of(plan: tuple[PlanStep, ...], branches: Branches, safe: Clearance) -> tuple[float, Shortfall]:
    """Return the total violation of a plan [m] and its worst distance (docs/formulation.md, eq. 14).

    The violation of a step is the largest shortfall to what is behind plus the largest to what is ahead.
    """
    total, worst = 0.0, Shortfall("no vehicle", 0, 0.0)
    for k, step in enumerate(plan):
        rows = np.flatnonzero(branches.lanes[:, k] == step.lane)
        vehicle, x = branches.vehicle[rows], branches.x[rows, k]
        ahead = step.x > x
        missing = np.where(ahead, safe.ahead[vehicle, k], safe.behind[vehicle, k]) - np.abs(step.x - x)
        missing[missing <= DISTANCE_TOLERANCE] = 0.0
        for side in (ahead, ~ahead):
            if side.any():
                total += float(missing[side].max())
        if len(rows) and missing.max() > worst.metres:
            at = int(missing.argmax())
            worst = Shortfall(branches.vehicles[vehicle[at]].state.id, step.step, float(missing[at]))
    return total, worst
