"""Risk: how epsilon is shared among the constraints, and the margin that each share costs in metres."""

import numpy as np
from scipy.special import ndtri

from sumo_hmdp.decision.problem import PlannerSettings, RiskAllocation
from sumo_hmdp.errors import SumoHmdpError
from sumo_hmdp.prediction.branches import Branches
from sumo_hmdp.prediction.dynamics import FloatArray

# A margin is never negative: no constraint may be violated more often than not.
LARGEST_TAIL = 0.5


class RiskBudgetError(SumoHmdpError):
    """The probability that pruning dropped leaves nothing of the risk level."""


def tail_probabilities(branches: Branches, settings: PlannerSettings) -> FloatArray:
    """Return the probability eps_b with which each branch may violate its distance in a step, shape (B,).

    `individual`: eps for each constraint, as in the paper (docs/formulation.md, eq. 9a). It bounds each constraint by
    itself; the joint probability over vehicles, branches and steps may well exceed eps.

    `uniform`: eps / (H I) for each of I vehicles (eq. 9b). By Boole's bound over vehicles and steps, the
    probability that any distance falls short within the horizon is at most eps, given that no pruned branch
    happens. With `account_pruned` the pruned probability of each vehicle is taken off its share first, and the
    claim holds without that condition.

    `mixture`: each vehicle has eps / I less its pruned probability, each step 1/H of that, and the step's share covers
    the sum over branches of p_b eps_b (eq. 9c). So an unlikely branch may take a larger tail. The probability that
    any distance falls short within the horizon is at most eps.

    `joint`: no share and no margin, since the risk of whole plans is bounded instead (`decision/plan_risk.py`).

    All claims suppose that the world follows the model.

    Raises:
        RiskBudgetError: if a vehicle's pruned probability leaves nothing of its share.
    """
    if settings.risk_allocation is RiskAllocation.JOINT:
        return np.full(len(branches.vehicle), LARGEST_TAIL)
    of_vehicle = _vehicle_shares(branches, settings)
    if settings.risk_allocation is not RiskAllocation.MIXTURE:
        return of_vehicle.take(branches.vehicle)
    tails = np.empty(len(branches.vehicle))
    for vehicle, budget in enumerate(of_vehicle):
        rows = branches.vehicle == vehicle
        tails[rows] = shared_tails(branches.probability[rows], float(budget))
    return tails


def _vehicle_shares(branches: Branches, settings: PlannerSettings) -> FloatArray:
    """Return each vehicle's share of the risk level in a step, (V,): a tail of every branch, or under `mixture` of all.

    Raises:
        RiskBudgetError: as `tail_probabilities`.
    """
    H, vehicles = settings.horizon_steps, len(branches.vehicles)
    if settings.risk_allocation is RiskAllocation.INDIVIDUAL or not vehicles:
        return np.full(vehicles, settings.risk_level)
    if settings.risk_allocation is RiskAllocation.UNIFORM and not settings.account_pruned:
        return np.full(vehicles, settings.risk_level / (H * vehicles))
    budgets = (settings.risk_level / vehicles - branches.pruned) / H
    _require_budgets(budgets, branches, settings)
    return budgets


def shared_tails(probability: FloatArray, budget: float) -> FloatArray:
    """Split a budget so that every branch costs the same unless it reaches the largest tail.

    eps_b = min(1/2, c / p_b) with the c for which the sum of p_b eps_b is the budget: water filling.

    Args:
        probability: p_b of one vehicle's branches.
        budget: what the sum of p_b eps_b may be, > 0.

    Returns:
        eps_b, same shape.
    """
    if LARGEST_TAIL * probability.sum() <= budget:
        return np.full_like(probability, LARGEST_TAIL)
    caps = LARGEST_TAIL * np.sort(probability)
    spent = np.concatenate([[0.0], np.cumsum(caps)[:-1]])
    level = (budget - spent) / np.arange(len(caps), 0, -1)
    # The first k at which the level stays below the next cap is where the water stands.
    standing = level[np.flatnonzero(level <= caps)[0]]
    return np.asarray(np.minimum(LARGEST_TAIL, standing / probability), dtype=np.float64)


def _require_budgets(budgets: FloatArray, branches: Branches, settings: PlannerSettings) -> None:
    if (budgets > 0).all():
        return
    worst = int(branches.pruned.argmax())
    least = len(branches.vehicles) * float(branches.pruned[worst])
    raise RiskBudgetError(
        f"risk_level must be above {least:.6g} for sequence_threshold {settings.sequence_threshold:g} (delta_seq) and "
        f"{len(branches.vehicles)} vehicles, got {settings.risk_level:g}: pruning drops {branches.pruned[worst]:.6g} "
        f"of {branches.vehicles[worst].state.id}. Lower sequence_threshold or raise risk_level."
    )


def quantiles(branches: Branches, settings: PlannerSettings) -> FloatArray:
    """Return z_b = Phi^-1(1 - eps_b) of every branch, (B,), computed as -Phi^-1(eps_b), which keeps its digits.

    Raises:
        RiskBudgetError: as `tail_probabilities`.
    """
    tails = np.minimum(tail_probabilities(branches, settings), LARGEST_TAIL)
    return np.asarray(np.maximum(-ndtri(tails), 0.0), dtype=np.float64)


def margins(branches: Branches, settings: PlannerSettings) -> FloatArray:
    """Return z_b sqrt(Q_xx) of every branch and step, shape (B, H) [m] (docs/formulation.md, eq. 8).

    Raises:
        RiskBudgetError: as `tail_probabilities`.
    """
    # Step by step in memory, as the branches are.
    deviations = branches.x_std.T.take(branches.vehicle, axis=1)
    return np.asarray(quantiles(branches, settings) * deviations).T
