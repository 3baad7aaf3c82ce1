"""The risk of a plan as lines for a terminal: how much of epsilon it takes, from whom, when and why."""

from collections.abc import Iterator

from sumo_hmdp.decision.explain import Explanation
from sumo_hmdp.decision.explain_risk import ExplainedRisk, PricedPlan
from sumo_hmdp.domain.plan import RiskShare
from sumo_hmdp.report.short import percent, short_plan

# Who adds less than this share of the risk is counted, not named.
NAMED_SHARE = 0.01


def risk_lines(explanation: Explanation, risk: ExplainedRisk) -> Iterator[str]:
    """Yield how much risk a plan takes, from whom, and what a cheaper plan would risk."""
    answer = explanation.answer
    whose = "plan" if answer.plan else "best plan, which was given up"
    yield (
        f"Risk of the {whose}: {percent(risk.taken)} of {percent(risk.level)}; the least of any plan is"
        f" {percent(risk.least)}, contact {percent(risk.contact)}"
    )
    if risk.shares:
        yield f"  {'vehicle':<12}{'adds':>12}{'of the risk':>13}{'step':>6}  why, at that step"
    named = [share for share in risk.shares if share.total >= NAMED_SHARE * risk.taken]
    for share in named:
        yield _share(share, risk)
    rest = risk.shares[len(named) :]
    if rest:
        yield f"  {f'{len(rest)} more':<12}{percent(sum(share.total for share in rest)):>12}"
    if risk.dropped:
        yield f"  {'dropped':<12}{percent(risk.dropped):>12}{'':>21}what the prediction left out as too unlikely"
    if not risk.shares:
        yield "  no vehicle adds to it"
    if risk.cheaper is not None and answer.objective is not None:
        yield _cheaper(risk.cheaper, answer.objective)
    elif str(answer.status) == "optimal":
        yield "  No plan costs less, whatever its risk."


def _share(share: RiskShare, risk: ExplainedRisk) -> str:
    part = share.total / max(risk.taken, share.total)
    return f"  {share.vehicle_id:<12}{percent(share.total):>12}{part:>13.0%}{share.step:>6}  {share.reason}"


def _cheaper(cheaper: PricedPlan, cost: float) -> str:
    return (
        f"  Of the plans that cost less the least risky, {short_plan(cheaper.plan)}, costs {cheaper.cost:.3f}"
        f" ({cheaper.cost - cost:+.3f}) and risks {percent(cheaper.risk)}."
    )
