"""The situation of a decision: what several functions derive from one problem, made once, when needed."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sumo_hmdp.decision.corridors import Corridors, carve, clearances
from sumo_hmdp.decision.graph import DecisionGraph, decision_graph
from sumo_hmdp.decision.lattice import EgoLattice, ego_lattice
from sumo_hmdp.decision.plan_risk import PlanRisk, plan_risk
from sumo_hmdp.decision.problem import DecisionProblem, RiskAllocation
from sumo_hmdp.decision.risk import margins
from sumo_hmdp.prediction.branches import Branches, predict
from sumo_hmdp.prediction.dynamics import FloatArray


@dataclass(frozen=True, eq=False)
class Situation:
    """One decision problem with what follows from it.

    Attributes:
        problem: the decision problem.
    """

    problem: DecisionProblem

    @property
    def joint(self) -> bool:
        """Tell whether the risk of the whole plan is bounded, instead of a margin for each distance."""
        return self.problem.settings.risk_allocation is RiskAllocation.JOINT

    @cached_property
    def lattice(self) -> EgoLattice:
        """Where the ego can be."""
        return ego_lattice(self.problem)

    @cached_property
    def branches(self) -> Branches:
        """The likely branches of every vehicle; under `joint` they are only shown."""
        return predict(self.problem.vehicles, self.problem.settings.prediction())

    @cached_property
    def margin(self) -> FloatArray:
        """Margins of the chance constraint, (B, H) [m]; zero under `joint`.

        Raises:
            decision.risk.RiskBudgetError: if pruning leaves nothing of the risk level.
        """
        if self.joint:
            return np.zeros((len(self.branches.vehicle), self.problem.settings.horizon_steps))
        return margins(self.branches, self.problem.settings)

    @cached_property
    def corridors(self) -> Corridors:
        """The free windows that keep every distance."""
        return self._carved(relaxed=False)

    @cached_property
    def contact_corridors(self) -> Corridors:
        """The windows that end at contact."""
        return self._carved(relaxed=True)

    def _carved(self, *, relaxed: bool) -> Corridors:
        distances = clearances(self.problem, self.branches, self.margin, relaxed=relaxed)
        return carve(self.problem, self.lattice, self.branches, distances)

    @cached_property
    def graph(self) -> DecisionGraph:
        """Every plan that keeps the stop lines, as a path."""
        return decision_graph(self.problem, self.lattice)

    @cached_property
    def risk(self) -> PlanRisk:
        """The risk of every plan."""
        return plan_risk(self.problem, self.graph)

    @cached_property
    def open_risk(self) -> PlanRisk:
        """The risk of every plan, those beyond a stop line included."""
        return plan_risk(self.problem, decision_graph(self.problem, self.lattice, closed=False))
