"""Safe distances: how far apart two vehicles in one lane must be on average (docs/formulation.md, eqs. 8 and 17).

The rules are in `domain/distance.py`; the margin of the chance constraint is added to each.
"""

from dataclasses import dataclass

import numpy as np

from sumo_hmdp.hmdp.branches import Branches
from sumo_hmdp.hmdp.dynamics import FloatArray
from sumo_hmdp.planning.problem import DecisionProblem


@dataclass(frozen=True)
class Clearance:
    """How far the ego's front bumper must be from each branch's.

    Attributes:
        ahead: (B, H) least distance while the ego is ahead [m].
        behind: (B, H) least distance while the ego is behind [m].
    """

    ahead: FloatArray
    behind: FloatArray


def safe_clearance(problem: DecisionProblem, branches: Branches, margin: FloatArray, ego_speed: float) -> Clearance:
    """Return the least distances at one speed of the ego.

    Args:
        problem: the decision problem.
        branches: of its vehicles.
        margin: of the chance constraint, shape (B, H) [m].
        ego_speed: of the ego at the step's end [m/s]; without effect under `fixed`.
    """
    safe, own = problem.settings.distance, np.array(ego_speed)
    return Clearance(
        ahead=safe.ahead(np.array(problem.ego.length), own, branches.speed) + margin,
        behind=safe.behind(_lengths(branches), own, branches.speed) + margin,
    )


def contact_clearance(problem: DecisionProblem, branches: Branches, safe: Clearance) -> Clearance:
    """Return the distances below which bumpers touch, never more than the safe ones (docs/formulation.md, eq. 14)."""
    return Clearance(
        ahead=np.minimum(safe.ahead, problem.ego.length), behind=np.minimum(safe.behind, _lengths(branches))
    )


def _lengths(branches: Branches) -> FloatArray:
    """Return the length of the vehicle of each branch, shape (B, 1) [m]."""
    return np.array([v.state.length for v in branches.vehicles])[branches.vehicle][:, None]
