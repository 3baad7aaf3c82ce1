"""The alternatives of an explanation against an enumeration of all plans that begin with each first action."""

import numpy as np
import pytest

from sumo_hmdp.decision.decide import answer
from sumo_hmdp.decision.explain import explain
from sumo_hmdp.decision.first_actions import Verdict
from sumo_hmdp.decision.problem_file import parse_problem


def explained(content):
    problem = parse_problem(content)
    return explain(problem, answer(problem, "search"))


def best_by_enumeration(brute_force, content, lateral, mode):
    """Return the least violation and then the least cost of all plans that begin with an action, None without any."""
    laterals = [(lateral, then) for then in (-1, 0, 1)]
    modes = [(mode, then) for then in (-1, 0, 1)]
    judged = [brute_force.evaluate(content, list(a), list(b)) for a in laterals for b in modes]
    admissible = [(plan["violation_m"], plan["objective"]) for plan in judged if plan is not None]
    least = min((violation for violation, _ in admissible), default=None)
    if least is None:
        return None
    return least, min(cost for violation, cost in admissible if violation <= least + 1e-6)


def test_every_action_against_the_enumeration(brute_force, problems):
    rng = np.random.default_rng(2026)
    seen = dict.fromkeys(Verdict, 0)
    for _ in range(60):
        content = problems.random_problem(rng, horizon=2)
        found = explained(content)
        for tried in found.actions:
            seen[tried.verdict] += 1
            expected = best_by_enumeration(brute_force, content, int(tried.lateral), int(tried.mode))
            if expected is None:
                assert tried.verdict in {Verdict.CONTACT, Verdict.INADMISSIBLE}
                assert tried.reason
                continue
            assert tried.verdict is (Verdict.SHORT if expected[0] > 1e-6 else Verdict.FEASIBLE)
            assert (tried.violation, tried.objective) == pytest.approx(expected, abs=1e-5)
    # Random problems that never come to this would make the test say nothing.
    assert min(seen.values()) >= 20


def test_contacts_name_somebody(problems):
    rng = np.random.default_rng(7)
    contacts = []
    for _ in range(40):
        found = explained(problems.random_problem(rng, scene="packed", horizon=3))
        contacts += [a.contact for a in found.actions if a.contact is not None]
    assert len(contacts) >= 10
    assert all(contact.vehicle_ids and 1 <= contact.step <= 3 for contact in contacts)
