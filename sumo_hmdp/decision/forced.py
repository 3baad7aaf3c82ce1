"""The joint decision with its first maneuver given: what another first action would lead to, by the same rule."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sumo_hmdp.decision.deadline import Deadline
from sumo_hmdp.decision.graph import DecisionGraph
from sumo_hmdp.decision.joint import Choice, choose
from sumo_hmdp.decision.plan_risk import PlanRisk
from sumo_hmdp.decision.situation import Situation
from sumo_hmdp.domain.maneuver import Lateral, Mode


@dataclass(frozen=True, eq=False)
class _BeginningWith(Situation):
    """A situation in which the ego has decided on its first maneuver.

    Attributes:
        whole: the situation without that.
        first: the maneuver.
    """

    whole: Situation
    first: tuple[Lateral, Mode]

    @cached_property
    def risk(self) -> PlanRisk:
        """The risk of every plan that begins with the maneuver."""
        return self._restricted(self.whole.risk)

    @cached_property
    def open_risk(self) -> PlanRisk:
        """The same, those beyond a stop line included."""
        return self._restricted(self.whole.open_risk)

    def _restricted(self, risk: PlanRisk) -> PlanRisk:
        return replace(risk, graph=beginning_with(risk.graph, self.first))


def choose_beginning(situation: Situation, first: tuple[Lateral, Mode]) -> Choice:
    """Choose among the plans that begin with an admissible maneuver, by the search (docs/formulation.md, eq. 38)."""
    return choose(_BeginningWith(situation.problem, situation, first), "search", Deadline())


def beginning_with(graph: DecisionGraph, first: tuple[Lateral, Mode]) -> DecisionGraph:
    """Return the graph with every other first maneuver blocked."""
    step, (lateral, mode) = graph.steps[0], first
    wanted = (step.moves.lateral == int(lateral))[:, None] & (step.motions.mode[step.motions.after] == int(mode))
    return replace(graph, steps=(replace(step, cost=np.where(wanted, step.cost, np.inf)), *graph.steps[1:]))
