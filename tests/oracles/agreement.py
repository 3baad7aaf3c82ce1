"""One decision problem, answered by the package's solvers and by the oracle."""

from sumo_hmdp.decision.decide import answer
from sumo_hmdp.decision.problem_file import parse_problem
from sumo_hmdp.decision.risk import RiskBudgetError

OBJECTIVE_TOLERANCE = 1e-6
VIOLATION_TOLERANCE = 1e-5


def package_answer(document, solver):
    """Return the package's answer by a solver, None where the risk budget cannot be met."""
    try:
        return answer(parse_problem(document), solver)
    except RiskBudgetError:
        return None


def disagreements(brute_force, document, solvers):
    """Return (the oracle's status, what the solvers answer otherwise): a list of sentences."""
    expected = brute_force.solve(document)
    found = {solver: package_answer(document, solver) for solver in solvers}
    said = [
        f"{solver}: {sentence}"
        for solver, one in found.items()
        for sentence in _differences(brute_force, document, expected, one)
    ]
    return expected["status"], said


def _differences(brute_force, document, expected, found):
    status = "error" if found is None else str(found.status)
    if status != expected["status"]:
        yield f"status {status}, the oracle {expected['status']}"
        return
    if status == "error":
        return
    kept = {vehicle["id"]: 0 for vehicle in document["vehicles"]}
    for index in found.branches.vehicle:
        kept[document["vehicles"][int(index)]["id"]] += 1
    if kept != expected["branches"]:
        yield f"branches {kept}, the oracle {expected['branches']}"
    if status == "fallback":
        if found.plan:
            yield "a fallback with a plan"
        return
    if abs(found.objective - expected["objective"]) > OBJECTIVE_TOLERANCE:
        yield f"objective {found.objective}, the oracle {expected['objective']}"
    if abs(found.violation - expected["violation_m"]) > VIOLATION_TOLERANCE:
        yield f"violation {found.violation}, the oracle {expected['violation_m']}"
    # Other sequences may be as good; the one found must be worth what it claims, by the oracle's own count.
    own = brute_force.evaluate(document, [int(s.lateral) for s in found.plan], [int(s.mode) for s in found.plan])
    if own is None:
        yield "its plan is not admissible, touches a vehicle or passes through one"
        return
    if abs(own["objective"] - found.objective) > OBJECTIVE_TOLERANCE:
        yield f"its plan costs {own['objective']}, it says {found.objective}"
    if abs(own["violation_m"] - found.violation) > VIOLATION_TOLERANCE:
        yield f"its plan misses {own['violation_m']} m, it says {found.violation}"
