"""An explanation as text for a terminal, at most 100 columns wide."""

import math
from collections.abc import Iterator

from sumo_hmdp.decision.explain import Bound, ExplainedLane, ExplainedStep, ExplainedVehicle, Explanation, Window
from sumo_hmdp.decision.first_actions import FirstAction, Verdict
from sumo_hmdp.decision.problem import DISTANCE_TOLERANCE
from sumo_hmdp.report.explain_risk_text import risk_lines
from sumo_hmdp.report.short import percent, short_plan, short_sequence, uncovered_text

# How many branches of a vehicle are told one by one.
BRANCHES_SHOWN = 4
WIDTH = 100
ROUNDING = 1e-12
_MERIT = list(Verdict)


def explanation_text(explanation: Explanation, title: str = "") -> str:
    """Return an explanation as lines of text: the answer, the first actions, the prediction, the windows.

    Under `joint` the risk of the plan takes the place of the last two, since no single distance bounds a plan.

    Args:
        explanation: what to tell.
        title: first line, such as the file's name; may be empty.
    """
    why = (
        [_prediction(explanation), _windows(explanation)]
        if explanation.risk is None
        else [risk_lines(explanation, explanation.risk)]
    )
    blocks = [_answer(explanation), _actions(explanation), *why]
    parts = ["\n".join(block) for block in blocks]
    return "\n\n".join([title, *parts] if title else parts) + "\n"


def _answer(explanation: Explanation) -> Iterator[str]:
    problem, answer = explanation.problem, explanation.answer
    ego, settings = problem.ego, problem.settings
    yield f"Answer: {answer.lateral.label}, {answer.mode.label} ({answer.status})"
    if answer.reason:
        yield from _folded(f"  {answer.reason}", "  ")
    yield (
        f"  ego: lane {ego.lane} of {problem.road.lane_count}, x {ego.x:.2f} m, {ego.speed:.2f} m/s, {ego.mode.label};"
        f" {settings.horizon_steps} steps of {settings.period:g} s"
    )
    if answer.objective is not None and answer.violation is not None:
        missing = f", {answer.violation:.2f} m missing in all" if answer.violation else ""
        yield from _folded(f"  plan: {short_plan(answer.plan)}, cost {answer.objective:.3f}{missing}", "    ")
    uncovered = uncovered_text(answer.pruned, str(settings.risk_allocation), account_pruned=settings.account_pruned)
    if uncovered:
        yield f"  {uncovered}"
    if answer.brake is not None:
        yield f"  brakes in lane with {answer.brake:.2f} m/s2"
    yield "  In sequences: L left, K keep, R right; + accelerate, 0 cruise, - decelerate; *3 three times."


def _actions(explanation: Explanation) -> Iterator[str]:
    yield "First actions, each with the best plan that begins with it (* chosen)"
    measure = "missing m" if explanation.risk is None else "risk"
    yield f"    {'lateral':<8}{'mode':<11}{'cost':>10}{'more':>10}{measure:>11}  plan, or why there is none"
    for action in sorted(explanation.actions, key=_merit):
        start = f"  {'*' if action.chosen else ' '} {action.lateral.label:<8}{action.mode.label:<11}"
        if action.objective is None or action.violation is None:
            yield from _folded(f"{start}{'':>31}  {action.reason}", " " * 56)
            continue
        more = _more(explanation.chosen, action)
        measured = f"{action.violation:.2f}" if action.risk is None else percent(action.risk)
        yield from _folded(
            f"{start}{action.objective:>10.3f}{more:>10}{measured:>11}  {short_plan(action.plan)}", " " * 56
        )
        if action.reason:
            yield from _folded(f"{'':>56}{action.reason}", " " * 56)


def _more(chosen: FirstAction, action: FirstAction) -> str:
    """Return how much more an action costs than the chosen one; only among equal violations does the cost count."""
    if None in (chosen.objective, action.objective) or action.chosen or _merit(action)[1:3] != _merit(chosen)[1:3]:
        return ""
    return f"{(action.objective or 0.0) - (chosen.objective or 0.0):+.3f}"


def _merit(action: FirstAction) -> tuple[bool, int, float, float]:
    """Sort the chosen one first, then by verdict, violation and cost."""
    violation = 0.0 if action.violation is None else round(action.violation / DISTANCE_TOLERANCE) * DISTANCE_TOLERANCE
    cost = 0.0 if action.objective is None else action.objective
    return not action.chosen, _MERIT.index(action.verdict), violation, cost


def _prediction(explanation: Explanation) -> Iterator[str]:
    if not explanation.vehicles:
        yield "Prediction: no surrounding vehicles"
        return
    yield "Prediction, likeliest branches first; x and margin are those at the end of the horizon"
    yield f"  {'vehicle':<12}{'branch':>8}{'probability':>13}{'lane':>6}{'x m':>11}{'margin m':>10}  sequence"
    for vehicle in explanation.vehicles:
        yield from _vehicle(vehicle)


def _vehicle(vehicle: ExplainedVehicle) -> Iterator[str]:
    # One branch more is told rather than counted.
    shown = len(vehicle.branches) if len(vehicle.branches) <= BRANCHES_SHOWN + 1 else BRANCHES_SHOWN
    for branch in vehicle.branches[:shown]:
        name = vehicle.id if branch.rank == 1 else ""
        sequence = short_sequence(list(zip(branch.laterals, branch.modes, strict=True)))
        start = f"  {name:<12}{f'#{branch.rank}':>8}{branch.probability:>13.4g}"
        yield from _folded(
            f"{start}{branch.lanes[-1]:>6}{branch.x[-1]:>11.2f}{branch.margin[-1]:>10.2f}  {sequence}", " " * 64
        )
    rest = vehicle.branches[shown:]
    if rest:
        count = f"{len(rest)} more"
        yield f"  {'':<12}{count:>8}{sum(branch.probability for branch in rest):>13.4g}"
    # What is left of 1 by rounding is no probability.
    pruned = vehicle.pruned if vehicle.pruned > ROUNDING else 0.0
    yield f"  {'':<12}{'pruned':>8}{pruned:>13.4g}"


def _windows(explanation: Explanation) -> Iterator[str]:
    yield "Windows within reach [m], each end as mean of the branch -/+ (safe distance + margin) (* the plan's)"
    yield f"  {'step':>4}{'time s':>8}{'lane':>6}{'from':>10}{'to':>10}  what bounds it"
    for step in explanation.steps:
        head = f"  {step.step:>4}{step.time:>8.2f}"
        if step.reach is None:
            yield f"{head}  no admissible speed"
            continue
        at = f"; windows at {step.ego_speed:.2f} m/s" if explanation.answer.corridors.levelled else ""
        yield f"{head}{'':>6}{step.reach[0]:>10.2f}{step.reach[1]:>10.2f}  reach of the ego{at}"
        for lane in step.lanes:
            if lane.reachable:
                yield from _lane(explanation, step, step.reach, lane)


def _lane(
    explanation: Explanation, step: ExplainedStep, reach: tuple[float, float], lane: ExplainedLane
) -> Iterator[str]:
    here = [window for window in lane.windows if window.low_x <= reach[1] and window.high_x >= reach[0]]
    plan = explanation.answer.plan
    for window in here:
        planned = bool(plan) and plan[step.step - 1].lane == lane.lane and _holds(window, plan[step.step - 1].x)
        yield from _window(lane.lane, window, "*" if planned else " ")
    if not here:
        yield f"{'':>14}{lane.lane:>6}{'':>20}  none; the nearest are"
        # Windows and forbidden stretches alternate, so there is one on either side.
        behind = [window for window in lane.windows if window.high_x < reach[0]][-1:]
        ahead = [window for window in lane.windows if reach[1] < window.low_x < math.inf][:1]
        for window in (*behind, *ahead):
            yield from _window(None, window, " ")


def _holds(window: Window, x: float) -> bool:
    return window.low_x - 2 * DISTANCE_TOLERANCE <= x <= window.high_x + 2 * DISTANCE_TOLERANCE


def _window(lane: int | None, window: Window, mark: str) -> Iterator[str]:
    ends = [_bound("from", window.low, "+"), _bound("to", window.high, "-")]
    told = [end for end in ends if end] or ["nothing"]
    low = "" if window.low is None else f"{window.low.x:.2f}"
    high = "" if window.high is None else f"{window.high.x:.2f}"
    start = f"{'':>12}{mark:>2}{'' if lane is None else lane:>6}{low:>10}{high:>10}  "
    for index, end in enumerate(told):
        yield f"{start if index == 0 else '':<42}{end}"


def _bound(word: str, bound: Bound | None, sign: str) -> str:
    if bound is None:
        return ""
    if not bound.rank:
        return f"{word:<5}the stop line"
    terms = f"{bound.mean:.2f} {sign} ({bound.distance:.2f} + {bound.margin:.2f})"
    return f"{word:<5}{bound.vehicle_id} #{bound.rank}: {terms}"


def _folded(line: str, indent: str) -> Iterator[str]:
    """Break a line at spaces where it is too wide."""
    while len(line) > WIDTH:
        cut = line.rfind(" ", len(indent) + 1, WIDTH + 1)
        if cut < 0:
            break
        yield line[:cut].rstrip()
        line = indent + line[cut + 1 :]
    yield line
