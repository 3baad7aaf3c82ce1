"""Risk: how epsilon is shared among the constraints, and the margin that each share costs in metres."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from sumo_hmdp.hmdp.branches import Branches
from sumo_hmdp.planning.problem import PlannerSettings, RiskAllocation


def share_of_risk(settings: PlannerSettings, vehicle_count: int) -> float:
    """Return eps_k, the risk of one vehicle at one step (docs/formulation.md, eq. 9).

    `individual`: eps for each constraint. It bounds each constraint by itself; the joint probability over
    vehicles and steps may well exceed eps.
    `uniform`: eps / (H * vehicles), Boole's bound: the probability that any retained branch's constraint is
    violated over the horizon is at most eps, given that no pruned branch happens.
    """
    if settings.risk_allocation is RiskAllocation.UNIFORM and vehicle_count:
        return settings.risk_level / (settings.horizon_steps * vehicle_count)
    return settings.risk_level


def margins(branches: Branches, settings: PlannerSettings) -> NDArray[np.float64]:
    """Return z * sqrt(Q_xx) of every vehicle and step, shape (V, H) [m] (docs/formulation.md, eq. 8).

    z = Phi^-1(1 - eps_k), computed as -Phi^-1(eps_k), which keeps its digits for a small eps_k.
    """
    quantile = -float(ndtri(share_of_risk(settings, len(branches.vehicles))))
    return quantile * branches.x_std
