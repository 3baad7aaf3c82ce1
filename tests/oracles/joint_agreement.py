"""One decision problem under the rule `joint`, answered by the package's solvers and by the oracle."""

from sumo_hmdp.decision.deadline import Deadline
from sumo_hmdp.decision.joint import choose
from sumo_hmdp.decision.problem_file import parse_problem
from sumo_hmdp.decision.situation import Situation

COST_TOLERANCE = 1e-6
RISK_TOLERANCE = 1e-8
# Search; MILP with bounds of the search; MILP that shares nothing but the graph and its weights.
WAYS = {"search": ("search", True), "milp": ("milp", True), "milp, every arc": ("milp", False)}


def chosen(document, way):
    """Return what the package chooses by one of `WAYS`, however long it takes."""
    solver, reduced = WAYS[way]
    return choose(Situation(parse_problem(document)), solver, Deadline(), reduced=reduced)


def plan_of(choice):
    """Return the plan as the oracle writes it: (lateral action, mode) of each step."""
    return tuple((int(a), int(m)) for a, m in zip(choice.sequence.laterals, choice.sequence.modes, strict=True))


def disagreements(document, expected, ways=tuple(WAYS)):
    """Return what the package answers otherwise than the oracle, and otherwise by one way than by another.

    Arguments: document (the problem), expected (what brute_joint.solve says of it), ways (names of `WAYS`).
    Returns the choices by way and a list of sentences.
    """
    choices = {way: chosen(document, way) for way in ways}
    said = [f"{way}: {sentence}" for way, choice in choices.items() for sentence in _differences(expected, choice)]
    first = choices[ways[0]]
    said += [
        f"{way}: {choices[way].sequence}, {ways[0]}: {first.sequence}"
        for way in ways[1:]
        if choices[way].status is not first.status or choices[way].sequence != first.sequence
    ]
    return choices, said


def _differences(expected, choice):
    status, told = str(choice.status), expected["status"]
    if (status == "optimal") != (told == "optimal"):
        yield f"status {status}, the oracle {told}"
        return
    if told == "none":
        # No plan keeps the stop lines: those beyond them have a risk that the oracle does not count.
        return
    least = min(1.0, expected["risk_least"])
    if abs(choice.risk.least - least) > RISK_TOLERANCE:
        yield f"least risk {choice.risk.least}, the oracle {least}"
    if told != "optimal":
        return
    if abs(choice.plan.cost - expected["objective"]) > COST_TOLERANCE:
        yield f"cost {choice.plan.cost}, the oracle {expected['objective']}"
    if abs(choice.plan.resource + choice.risk.dropped - expected["risk_taken"]) > RISK_TOLERANCE:
        yield f"risk {choice.plan.resource}, the oracle {expected['risk_taken']}"
    if plan_of(choice) != tuple(expected["sequence"]):
        yield f"plan {plan_of(choice)}, the oracle {expected['sequence']}"
    names = {*expected["by_vehicle"], *choice.risk.by_vehicle}
    for name in sorted(names):
        found, asked = choice.risk.by_vehicle.get(name, 0.0), expected["by_vehicle"].get(name, 0.0)
        if abs(found - asked) > RISK_TOLERANCE:
            yield f"{name} adds {found}, the oracle {asked}"
