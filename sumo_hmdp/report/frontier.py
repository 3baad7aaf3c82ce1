"""What a decision could have had for its risk: every plan that is the cheapest for some epsilon, cost over risk."""

from matplotlib.figure import Figure

from sumo_hmdp.decision.decide import Answer
from sumo_hmdp.decision.explain_risk import PricedPlan, plan_frontier
from sumo_hmdp.errors import InputError
from sumo_hmdp.report.short import percent, short_plan

# Plans of less risk are drawn here: what is below is next to what the prediction leaves out.
LEAST_RISK = 1e-7


def frontier_figure(answer: Answer) -> Figure:
    """Draw the frontier of one decision: more risk to the right, more cost upwards, epsilon as a line.

    Raises:
        InputError: if the answer's rule computes no risk of plans, or no plan keeps the limits.
    """
    settings = answer.situation.problem.settings
    plans = plan_frontier(answer)
    if not plans:
        rule = settings.risk_allocation
        why = "no plan keeps the speed limits" if answer.choice is not None else f"risk_allocation is {rule}"
        raise InputError([f"--frontier: must have plans with a risk, got none: {why}. Use a problem under `joint`"])
    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    axes = figure.subplots()
    risks = [max(plan.risk, LEAST_RISK) for plan in plans]
    costs = [plan.cost for plan in plans]
    level = settings.risk_level
    low, high = min(*risks, level) / 2, min(2.0, 2 * max(*risks, level))
    # Each plan is the cheapest for every epsilon from its risk to that of the next.
    axes.step([*risks[::-1], high], [*costs[::-1], costs[0]], where="post", color="0.55", linewidth=1.2, zorder=2)
    axes.axvspan(low, level, color="#dbe9f6", zorder=0)
    axes.axvline(level, color="#1f4e79", linewidth=1.2, zorder=1)
    axes.plot(risks, costs, linestyle="", marker="o", markersize=4.5, color="0.35", zorder=3)
    for plan in plans:
        if plan.chosen:
            axes.plot(max(plan.risk, LEAST_RISK), plan.cost, "o", markersize=9, color="#c1440e", zorder=4)
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    axes.margins(y=0.16)
    axes.annotate(
        f"\u03b5 = {percent(level)}", (level, 1.0), (4, -4), xycoords=("data", "axes fraction"),
        textcoords="offset points", color="#1f4e79", va="top",
    )  # fmt: skip
    for plan, side in _named(plans):
        axes.annotate(
            short_plan(plan.plan), (max(plan.risk, LEAST_RISK), plan.cost), (6 * side, 6), textcoords="offset points",
            fontsize=7, color="#c1440e" if plan.chosen else "0.3", ha="left" if side > 0 else "right",
        )  # fmt: skip
    axes.xaxis.set_major_formatter(lambda risk, _: f"{100 * risk:g} %")
    axes.set_xlabel("risk of the plan: bound of the probability that any distance falls short")
    axes.set_ylabel("cost of the plan")
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_title(_title(answer, plans), loc="left")
    return figure


def _named(plans: tuple[PricedPlan, ...]) -> list[tuple[PricedPlan, int]]:
    """Return the chosen plan, the next cheaper and the next safer one, else the safest, each with the side of its name.

    Plans come by rising cost, so the safer ones are those after it.
    """
    at = next((index for index, plan in enumerate(plans) if plan.chosen), None)
    if at is None:
        return [(plans[-1], 1)]
    return [(plans[at], 1), *((plan, 1) for plan in plans[:at][-1:]), *((plan, -1) for plan in plans[at + 1 : at + 2])]


def _title(answer: Answer, plans: tuple[PricedPlan, ...]) -> str:
    count = f"{len(plans)} plan{'s' if len(plans) > 1 else ''}, each the cheapest for some \u03b5"
    chosen = next((plan for plan in plans if plan.chosen), None)
    if chosen is None:
        return f"{count}; none within {percent(answer.situation.problem.settings.risk_level)}"
    return f"{count}; chosen: cost {chosen.cost:.2f}, risk {percent(chosen.risk)}"
