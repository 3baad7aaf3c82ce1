"""Safe distances: how far apart two vehicles in one lane must be on average (docs/formulation.md, eqs. 8 and 17).

`fixed`, the paper's rule, is measured between front bumpers; `time_headway` and `rss` between bumpers, so the
leader's length comes on top. The margin of the chance constraint is added to each.
"""

from dataclasses import dataclass

import numpy as np

from sumo_hmdp.hmdp.branches import Branches
from sumo_hmdp.hmdp.dynamics import FloatArray
from sumo_hmdp.planning.problem import DecisionProblem, DistanceRule, RssParameters


@dataclass(frozen=True)
class Clearance:
    """How far the ego's front bumper must be from some branches' at some steps; arrays of one shape.

    Attributes:
        ahead: least distance while the ego is ahead [m].
        behind: least distance while the ego is behind [m].
    """

    ahead: FloatArray
    behind: FloatArray


def rss_distance(rear_speed: FloatArray, front_speed: FloatArray, rss: RssParameters) -> FloatArray:
    """Return the longitudinal safe distance of Responsibility-Sensitive Safety, between bumpers [m].

    d = [v_r rho + a rho^2 / 2 + (v_r + rho a)^2 / (2 b_min) - v_f^2 / (2 b_max)]_+ of Shalev-Shwartz, Shammah and
    Shashua 2017: the rear vehicle accelerates by a for its response time rho and then brakes by at least b_min, while
    the front one brakes by at most b_max.

    Args:
        rear_speed: v_r of the follower [m/s].
        front_speed: v_f of the leader [m/s].
        rss: rho, a, b_min and b_max.
    """
    reached = rear_speed + rss.response_time * rss.accel_max
    travelled = rear_speed * rss.response_time + rss.accel_max * rss.response_time**2 / 2
    distance = travelled + reached**2 / (2 * rss.brake_min) - front_speed**2 / (2 * rss.brake_max)
    return np.maximum(distance, 0.0)


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
    problem: DecisionProblem, lengths: FloatArray, speeds: FloatArray, margin: FloatArray, ego_speed: float
) -> Clearance:
    """Return the least distances to vehicles of given lengths [m], mean speeds [m/s] and margins [m], of one shape."""
    settings = problem.settings
    if settings.distance_rule is DistanceRule.FIXED:
        distance = settings.safe_distance + margin
        return Clearance(ahead=distance, behind=distance)
    if settings.distance_rule is DistanceRule.TIME_HEADWAY:
        between = settings.safe_distance + settings.time_headway * ego_speed
        return Clearance(ahead=problem.ego.length + between + margin, behind=lengths + between + margin)
    own = np.full_like(speeds, ego_speed)
    return Clearance(
        ahead=problem.ego.length + rss_distance(speeds, own, settings.rss) + margin,
        behind=lengths + rss_distance(own, speeds, settings.rss) + margin,
    )


def contact_clearance(problem: DecisionProblem, branches: Branches, safe: Clearance) -> Clearance:
    """Return the distances below which bumpers touch, never more than the safe ones (docs/formulation.md, eq. 14)."""
    behind = np.minimum(safe.behind, branches.length[:, None])
    return Clearance(ahead=np.minimum(safe.ahead, problem.ego.length), behind=behind)
