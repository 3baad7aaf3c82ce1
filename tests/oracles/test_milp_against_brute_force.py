"""The decision, MILP and all, against an enumeration written independently from the rules.

The full comparison, 10,000 problems, is analysis/02_solvers_agree.py.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from sumo_hmdp.decision.decide import answer
from sumo_hmdp.decision.problem_file import parse_problem

FIXTURES = sorted((Path(__file__).parent.parent / "fixtures" / "decisions").glob("*.json"))


def compare(brute_force, document):
    expected = brute_force.solve(document)
    found = answer(parse_problem(document))
    assert found.status == expected["status"]
    assert sum(expected["branches"].values()) == len(found.branches.vehicle)
    if found.status == "fallback":
        assert found.plan == ()
        return found
    assert found.objective == pytest.approx(expected["objective"], abs=1e-6)
    assert found.violation == pytest.approx(expected["violation_m"], abs=1e-5)
    # Other sequences may be as good; the one found must be worth what it claims, by the oracle's own count.
    own = brute_force.evaluate(document, [int(s.lateral) for s in found.plan], [int(s.mode) for s in found.plan])
    assert own is not None
    assert own["objective"] == pytest.approx(found.objective, abs=1e-6)
    assert own["violation_m"] == pytest.approx(found.violation, abs=1e-5)
    return found


@pytest.mark.parametrize("path", FIXTURES, ids=lambda path: path.stem)
def test_worked_examples(brute_force, path):
    content = json.loads(path.read_text())
    found = compare(brute_force, content["problem"])
    if content["answer"] is None:
        assert found.status != "optimal"
    else:
        assert found.status == "optimal"
        assert found.objective == pytest.approx(content["answer"]["objective"], abs=1e-6)


def test_there_are_ten_worked_examples():
    assert len(FIXTURES) == 10


@pytest.mark.parametrize("seed", range(3))
def test_random_problems(brute_force, problems, seed):
    rng = np.random.default_rng([2026, seed])
    statuses = {"optimal": 0, "relaxed": 0, "fallback": 0}
    for _ in range(300):
        statuses[str(compare(brute_force, problems.random_problem(rng)).status)] += 1
    # A generator that stops making hard problems would make this test say nothing.
    assert min(statuses.values()) >= 15
