"""What each of the nine first actions of the ego would lead to, and why it was not taken.

Each is solved exactly: the best plan that begins with it, else the least violation among those that do, else the
contact that ends them all. Under `joint` the best plan is the cheapest whose risk is within epsilon.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property

from sumo_hmdp.decision.contacts import Contact, first_contact
from sumo_hmdp.decision.corridors import Corridors, carve, clearances
from sumo_hmdp.decision.cost import objective
from sumo_hmdp.decision.decide import Answer, Shortfall, make_plan, violation_of
from sumo_hmdp.decision.forced import choose_beginning
from sumo_hmdp.decision.problem import DecisionProblem, ManeuverSequence
from sumo_hmdp.decision.road_rules import banned_moves, keeps_rules, top_speeds
from sumo_hmdp.decision.search import search_best, search_relaxed
from sumo_hmdp.decision.stop_lines import place_of
from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.domain.plan import PlanStep, Status


class Verdict(StrEnum):
    """What a first action can lead to.

    FEASIBLE: a plan that keeps every distance; under `joint` one whose risk is within epsilon.
    SHORT: plans without contact, none of which keeps every distance, or the risk.
    CONTACT: nothing but contact; under `joint` nothing where contact is unlikely.
    INADMISSIBLE: nothing at all; the ego may not do this.
    """

    FEASIBLE = "feasible"
    SHORT = "short"
    CONTACT = "contact"
    INADMISSIBLE = "inadmissible"


@dataclass(frozen=True)
class FirstAction:
    """One first action and the best that can follow it.

    Attributes:
        lateral: the lateral action.
        mode: the mode.
        chosen: whether it is the answer's.
        verdict: what it can lead to.
        reason: why its best plan is not feasible, empty where it is.
        objective: cost of its best plan, None where it has none.
        violation: total violation of its best plan [m], None where it has none.
        worst: the worst distance of its best plan, None where every distance is kept or there is no plan.
        contact: what ends every plan, None unless the verdict is contact.
        plan: its best plan; the answer's own where it is chosen, since others may be as good.
        risk: of its best plan, None where it has none; only under `joint`.
    """

    lateral: Lateral
    mode: Mode
    chosen: bool
    verdict: Verdict
    reason: str = ""
    objective: float | None = None
    violation: float | None = None
    worst: Shortfall | None = None
    contact: Contact | None = None
    plan: tuple[PlanStep, ...] = ()
    risk: float | None = None


def first_actions(problem: DecisionProblem, answer: Answer) -> tuple[FirstAction, ...]:
    """Judge every first action, lateral by lateral, each from accelerating to decelerating.

    Args:
        problem: the decision problem.
        answer: of that problem, by any solver.

    Returns:
        Nine of them. One is chosen; its objective comes from the search and not from the answer.

    Raises:
        decision.search.SearchTooLargeError: if the horizon is too long for the search.
    """
    judge = _Judge(problem, answer)
    return tuple(judge.action(lateral, mode) for lateral in Lateral for mode in reversed(Mode))


@dataclass(frozen=True)
class _Judge:
    problem: DecisionProblem
    answer: Answer

    @cached_property
    def open_corridors(self) -> Corridors:
        """The corridors that keep every distance, and no stop line."""
        safe = clearances(self.problem, self.answer.branches, self.answer.margin, relaxed=False)
        return carve(replace(self.problem, stop_lines=()), self.answer.lattice, self.answer.branches, safe)

    def action(self, lateral: Lateral, mode: Mode) -> FirstAction:
        """Judge one first action."""
        problem, answer = self.problem, self.answer
        chosen = (lateral, mode) == (answer.lateral, answer.mode)
        action = FirstAction(lateral, mode, chosen, Verdict.INADMISSIBLE)
        objections = tuple(_objections(problem, answer, lateral, mode))
        if objections:
            return replace(action, reason="; ".join(objections))
        first = lateral, mode
        if answer.situation.joint:
            return self._by_risk(action, first)
        sequence = search_best(problem, answer.lattice, answer.corridors, first)
        if sequence is not None:
            return self._with_plan(replace(action, verdict=Verdict.FEASIBLE), sequence)
        sequence = search_relaxed(problem, answer.lattice, answer.situation.contact_corridors, first)
        if sequence is not None:
            return self._with_plan(replace(action, verdict=Verdict.SHORT), sequence)
        contact = first_contact(problem, answer, first)
        return replace(action, verdict=Verdict.CONTACT, reason=str(contact), contact=contact)

    def _by_risk(self, action: FirstAction, first: tuple[Lateral, Mode]) -> FirstAction:
        """Judge one first action by the risk of the plans that begin with it (docs/formulation.md, eq. 41)."""
        choice, level = choose_beginning(self.answer.situation, first), self.problem.settings.risk_level
        if choice.plan is None or choice.sequence is None:
            reason = f"contact with a probability of up to {100 * choice.risk.contact:.3g} %"
            return replace(action, verdict=Verdict.CONTACT, reason=reason, risk=choice.risk.taken)
        short = choice.status is Status.RELAXED
        plan = make_plan(self.problem, self.answer.lattice, choice.sequence)
        return replace(
            action,
            verdict=Verdict.SHORT if short else Verdict.FEASIBLE,
            reason=f"no plan risks less than {100 * choice.risk.least:.3g} %, of {100 * level:g} %" if short else "",
            objective=choice.plan.cost,
            violation=choice.metres,
            plan=self.answer.plan if action.chosen and self.answer.plan else plan,
            risk=choice.risk.taken,
        )

    def _with_plan(self, action: FirstAction, sequence: ManeuverSequence) -> FirstAction:
        problem, answer = self.problem, self.answer
        plan = make_plan(problem, answer.lattice, sequence)
        violation, worst, reason = 0.0, None, ""
        if action.verdict is Verdict.SHORT:
            violation, worst = violation_of(problem, plan, answer.branches, answer.margin)
            reason = str(worst) + self._blamed_lines(action, worst)
        return replace(
            action,
            reason=reason,
            objective=objective(problem.settings.preferences, answer.lattice, problem.ego.lane, sequence),
            violation=violation,
            worst=worst,
            plan=answer.plan if action.chosen and answer.plan else plan,
        )

    def _blamed_lines(self, action: FirstAction, worst: Shortfall) -> str:
        """Name the stop lines where they alone forbid an action, and the best plan falls short of a vehicle instead."""
        ego = self.problem.ego
        places = {place_of(ego, line, lane) for line in self.problem.stop_lines for lane in line.lanes}
        ahead = sorted(x for x in places if ego.x <= x)
        first = action.lateral, action.mode
        if not ahead or worst.line is not None:
            return ""
        if search_best(self.problem, self.answer.lattice, self.open_corridors, first) is None:
            return ""
        return f"; a stop line ({', '.join(f'{x:.2f} m' for x in ahead)}) forbids those that keep every distance"


def _objections(problem: DecisionProblem, answer: Answer, lateral: Lateral, mode: Mode) -> Iterator[str]:
    """Yield every rule that forbids a first action, whatever the traffic."""
    ego, settings = problem.ego, problem.settings
    lane = ego.lane + lateral
    if abs(mode - ego.mode) > 1:
        yield f"the mode cannot go from {ego.mode.label} to {mode.label} in one step"
    if not 1 <= lane <= problem.road.lane_count:
        yield f"there is no lane {lateral.label} of lane {ego.lane}"
    elif lane in settings.forbidden_lanes:
        yield f"lane {lane} is forbidden"
    elif (ego.lane, int(lateral)) in banned_moves(problem)[0]:
        yield f"the line to the {lateral.label} of lane {ego.lane} may not be crossed here"
    motion = answer.lattice.walk((mode,))[0]
    if not answer.lattice.allows(motion.level, motion.phase, step=1):
        slow = motion.speed < settings.speed_min
        limit = f"below speed_min, {settings.speed_min:g}" if slow else f"above speed_max, {settings.speed_max:g}"
        yield f"{motion.speed:.2f} m/s is {limit} m/s"
    elif 1 <= lane <= problem.road.lane_count and not keeps_rules(problem, 1, lane, Lateral.KEEP, motion.speed):
        tops = top_speeds(problem)
        top = "" if tops is None else f", which allows {tops[0, lane - 1]:.2f} m/s at most"
        yield f"{motion.speed:.2f} m/s is too fast for the road's speed limit{top}"
