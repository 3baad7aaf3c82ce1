"""Safe distances: how far apart two vehicles in one lane must be on average (docs/formulation.md, eqs. 8 and 17).

The rules are in `domain/distance.py`; the margin of the chance constraint is added to each.
"""

from dataclasses import dataclass

import numpy as np

from sumo_hmdp.decision.problem import DISTANCE_TOLERANCE, DecisionProblem
from sumo_hmdp.prediction.branches import Branches
from sumo_hmdp.prediction.dynamics import FloatArray


@dataclass(frozen=True)
class Clearance:
    """How far the ego's front bumper must be from some branches' at some steps; arrays of one shape.

    Attributes:
        ahead: least distance while the ego is ahead [m].
        behind: least distance while the ego is behind [m].
    """

    ahead: FloatArray
    behind: FloatArray


def safe_clearance(problem: DecisionProblem, branches: Branches, margin: FloatArray, ego_speed: float) -> Clearance:
    """Return the least distances to all branches at all steps, (B, H), at one speed of the ego.

    Args:
        problem: the decision problem.
        branches: of its vehicles.
        margin: of the chance constraint, shape (B, H) [m].
        ego_speed: of the ego at the step's end [m/s]; without effect under `fixed`.
    """
    return clearance_to(problem, branches.length[:, None], branches.speed, margin, ego_speed)


def clearance_to(
    problem: DecisionProblem, lengths: FloatArray, speeds: FloatArray, margin: FloatArray, ego_speed: float | FloatArray
) -> Clearance:
    """Return the least distances to vehicles of given lengths [m], mean speeds [m/s] and margins [m] that broadcast.

    The ego's speed [m/s] broadcasts against them too.
    """
    safe, own = problem.settings.distance, np.array(ego_speed)
    return Clearance(
        ahead=safe.ahead(np.array(problem.ego.length), own, speeds) + margin,
        behind=safe.behind(lengths, own, speeds) + margin,
    )


def counted(missing: FloatArray, unit: float = 1.0) -> FloatArray:
    """Return what counts of what is missing to some distances: all of it, or nothing within the tolerance (eq. 14).

    Args:
        missing: any shape, not above 0 where a distance is kept [unit].
        unit: in which that is given [m].
    """
    return np.where(missing > DISTANCE_TOLERANCE / unit, missing, 0.0)


def contact_clearance(problem: DecisionProblem, branches: Branches, safe: Clearance) -> Clearance:
    """Return the distances below which bumpers touch, never more than the safe ones (docs/formulation.md, eq. 14)."""
    behind = np.minimum(safe.behind, branches.length[:, None])
    return Clearance(ahead=np.minimum(safe.ahead, problem.ego.length), behind=behind)
