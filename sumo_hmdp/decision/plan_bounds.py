"""What bounds a plan: at each of its steps the branch, or stop line, that leaves it the least room on either side."""

from collections.abc import Iterator

import numpy as np

from sumo_hmdp.decision.decide import Answer
from sumo_hmdp.decision.plan_distances import shortfalls
from sumo_hmdp.decision.problem import DISTANCE_TOLERANCE, DecisionProblem
from sumo_hmdp.decision.stop_lines import line_shortfalls
from sumo_hmdp.domain.plan import PlanBound, PlanStep
from sumo_hmdp.prediction.branches import Branches, IntArray
from sumo_hmdp.prediction.dynamics import FloatArray


def plan_bounds(problem: DecisionProblem, answer: Answer) -> Iterator[PlanBound]:
    """Yield what bounds the answer's plan, step by step, behind and ahead; nothing where nobody shares a lane.

    The room to a branch is the distance to its mean less the distance asked for at the plan's own speed
    (docs/formulation.md, eq. 14), so that the missing rooms of a step add up to its violation.

    Args:
        problem: the decision problem.
        answer: of that problem.
    """
    plan, branches = answer.plan, answer.branches
    by_step = zip(plan, shortfalls(problem, plan, branches, answer.margin), line_shortfalls(problem, plan), strict=True)
    for step, (k, rows, ego_ahead, missing), (line, beyond) in by_step:
        behind = _tightest(step, k, branches, rows[ego_ahead], missing[ego_ahead], ahead=False)
        ahead = _tightest(step, k, branches, rows[~ego_ahead], missing[~ego_ahead], ahead=True)
        if line is not None and (ahead is None or -beyond < ahead.room):
            ahead = PlanBound(step.step, True, -beyond, "stop line", None, line.x, line.x - step.x + beyond)  # noqa: FBT003
        yield from (bound for bound in (behind, ahead) if bound is not None)


def _tightest(
    step: PlanStep, k: int, branches: Branches, rows: IntArray, missing: FloatArray, *, ahead: bool
) -> PlanBound | None:
    """Return the branch to which most is missing; of those that are alike the likeliest."""
    if not len(rows):
        return None
    alike = np.flatnonzero(missing >= missing.max() - DISTANCE_TOLERANCE)
    at = int(alike[np.argmax(branches.probability[rows[alike]])])
    row, room = int(rows[at]), -float(missing[at])
    x = float(branches.x[row, k])
    return PlanBound(
        step=step.step,
        ahead=ahead,
        room=room,
        vehicle_id=branches.vehicles[branches.vehicle[row]].state.id,
        probability=float(branches.probability[row]),
        x=x,
        distance=abs(x - step.x) - room,
    )
