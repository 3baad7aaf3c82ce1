"""What a plan lacks to the safe distances of the branches, at the plan's own speeds (docs/formulation.md, eq. 14)."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.decision.distance import clearance_to
from sumo_hmdp.decision.occupancy import lanes_along, occupied_lanes
from sumo_hmdp.decision.problem import DecisionProblem
from sumo_hmdp.domain.plan import PlanStep
from sumo_hmdp.prediction.branches import Branches
from sumo_hmdp.prediction.dynamics import FloatArray


def missing_distances(
    problem: DecisionProblem, plan: Sequence[PlanStep], branches: Branches, margin: FloatArray
) -> tuple[NDArray[np.bool_], FloatArray]:
    """Compare a plan of H steps with all branches, whichever lanes they are in.

    Returns:
        Whether the ego is ahead of each branch at each step, and the metres that are missing to their distance, not
        above 0 where it is kept; (B, H) both.
    """
    x, speed = np.array([step.x for step in plan]), np.array([step.speed for step in plan])
    ahead = x > branches.x
    safe = clearance_to(problem, branches.length[:, None], branches.speed, margin, speed)
    return ahead, np.where(ahead, safe.ahead, safe.behind) - np.abs(x - branches.x)


def lanes_shared(problem: DecisionProblem, plan: Sequence[PlanStep], branches: Branches) -> NDArray[np.bool_]:
    """Tell which branches take up any lane that the ego does, at each step of a plan of H steps, (B, H)."""
    own = lanes_along(problem, tuple(step.lateral for step in plan))
    return np.asarray((occupied_lanes(problem, branches).T & own.T[:, :, None]).any(axis=0)).T


def shortfalls(
    problem: DecisionProblem, plan: Sequence[PlanStep], branches: Branches, margin: FloatArray
) -> Iterator[tuple[int, NDArray[np.int64], NDArray[np.bool_], FloatArray]]:
    """Yield per step what a plan of H steps, or none, lacks to the safe distance of each branch that shares its lanes.

    Yields:
        Step index k, rows of the branches, whether the ego is ahead of each, and the metres that are missing, not
        above 0 where the distance is kept.
    """
    if not plan:
        return
    ahead, missing = missing_distances(problem, plan, branches, margin)
    shared = lanes_shared(problem, plan, branches)
    for k in range(len(plan)):
        rows = np.flatnonzero(shared[:, k])
        yield k, rows, ahead[rows, k], missing[rows, k]
