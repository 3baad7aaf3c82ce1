"""What bounds a plan, against the violations of the brute-force prototype and against numbers worked by hand."""

import numpy as np
import pytest

from sumo_hmdp.decision.decide import answer
from sumo_hmdp.decision.explain import explain
from sumo_hmdp.decision.plan_bounds import plan_bounds
from sumo_hmdp.decision.problem_file import parse_problem


def bounds_of(content):
    problem = parse_problem(content)
    found = answer(problem, "search")
    return found, list(plan_bounds(problem, found))


@pytest.mark.parametrize("scene", [None, "packed"])
def test_what_is_missing_adds_up_to_the_violation(brute_force, problems, scene):
    rng = np.random.default_rng(18)
    kinds = {"kept": 0, "missing": 0}
    for _ in range(30):
        content = problems.random_problem(rng, horizon=2, **({} if scene is None else {"scene": scene}))
        found, bounds = bounds_of(content)
        assert len({(bound.step, bound.ahead) for bound in bounds}) == len(bounds)
        if not found.plan:
            assert bounds == []
            continue
        laterals, modes = ([int(getattr(step, name)) for step in found.plan] for name in ("lateral", "mode"))
        judged = brute_force.evaluate(content, laterals, modes)
        missing = sum(max(0.0, -bound.room) for bound in bounds)
        assert missing == pytest.approx(judged["violation_m"], abs=1e-5)
        kinds["missing" if missing > 1e-6 else "kept"] += 1
    assert kinds["kept"] >= 5
    assert scene is None or kinds["missing"] >= 3


def test_rooms_end_where_the_windows_of_the_explanation_end(problems):
    """An explanation takes each lane alone; a plan that is over two lanes can only have less room."""
    rng = np.random.default_rng(4)
    alike = 0
    for _ in range(40):
        problem = parse_problem(problems.random_problem(rng, scene="dense", horizon=3))
        found = answer(problem, "search")
        if found.violation != 0.0:
            continue
        steps = explain(problem, found).steps
        for bound in plan_bounds(problem, found):
            planned = found.plan[bound.step - 1]
            windows = steps[bound.step - 1].lanes[planned.lane - 1].windows
            (window,) = (one for one in windows if one.low_x - 1e-6 <= planned.x <= one.high_x + 1e-6)
            room = window.high_x - planned.x if bound.ahead else planned.x - window.low_x
            assert bound.room <= room + 1e-6
            alike += bound.room == pytest.approx(room, abs=1e-6)
    assert alike >= 40
