"""Stop lines: both solvers against the oracle, the oracle against arithmetic by hand, and recursive feasibility."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from sumo_hmdp.decision.audit import first_breach
from sumo_hmdp.decision.decide import answer
from sumo_hmdp.decision.problem import ManeuverSequence
from sumo_hmdp.decision.problem_file import parse_problem
from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.domain.occupancy import Occupancy
from sumo_hmdp.domain.plan import Status


def differ(one, other):
    return any(one[key] != other[key] for key in ("status", "objective", "violation_m"))


def compare(brute_force, line_problems, agreement, seed, count, solvers, **given):
    """Compare a number of problems; return what those were, of every third, whose lines made a difference."""
    seen = Counter()
    for number in range(count):
        document = line_problems.random_line_problem(np.random.default_rng([seed, number]), **given)
        status, said = agreement.disagreements(brute_force, document, solvers)
        assert not said, f"problem [{seed}, {number}]: {said}"
        # Lines with two places are rare, and seldom does the second one matter: all of these are looked at.
        leaving = any("leaving_x_m" in line for line in document["stop_lines"])
        if number % 3 and not leaving:
            continue
        planner = document["planner"]
        open_road = brute_force.solve(document | {"stop_lines": []})
        closed = brute_force.solve(document)
        if leaving:
            one_place = [{"lanes": line["lanes"], "x_m": line["x_m"]} for line in document["stop_lines"]]
            seen["leaving"] += differ(brute_force.solve(document | {"stop_lines": one_place}), closed)
        if differ(open_road, closed):
            seen.update([f"binding {status}", planner.get("occupancy", "target")])
            seen.update([planner.get("distance_rule", "fixed"), planner["horizon_steps"]])
            seen["stopping"] += planner.get("stopping", False)
    return seen


@pytest.mark.parametrize("chunk", range(2))
def test_search_against_the_oracle(brute_force, line_problems, agreement, chunk):
    seen = compare(brute_force, line_problems, agreement, 3000 + chunk, 200, ["search"])
    # A generator whose lines no longer bind would make this test say nothing.
    assert seen["binding optimal"] >= 8
    assert seen["binding relaxed"] >= 4
    assert seen["leaving"] >= 1
    assert min(seen[rule] for rule in ("target", "swept", "fixed", "time_headway", "rss", "stopping", 2, 3, 4)) >= 1


@pytest.mark.parametrize(("horizon", "count"), [(2, 100), (3, 20), (4, 4)])
def test_milp_against_the_oracle(brute_force, line_problems, agreement, horizon, count):
    seen = compare(brute_force, line_problems, agreement, 4000, count, ["milp"], horizon=horizon)
    assert seen["binding optimal"] + seen["binding relaxed"] >= count // 15


@pytest.mark.parametrize(
    ("speed", "mode", "place"),
    [
        # 10 m/s, 2 m/s2: 25 m; after accelerating one step of 1 s at 10 m/s before.
        (10.0, 0, 25.0),
        (10.0, -1, 25.0),
        (10.0, 1, 35.0),
        # 3 m/s: 2 m in the first step, and 1 / 4 m in the second, in which it comes to rest.
        (3.0, 0, 2.25),
        (0.0, 1, 0.0),
    ],
)
def test_stopping_place_by_hand(brute_force, speed, mode, place):
    problem = {"planner": {"period_s": 1.0, "accel_mps2": 2.0}}
    assert brute_force.stopping_place(problem, 100.0, speed, mode) == pytest.approx(100.0 + place)


def test_braking_appended_keeps_the_lines(line_problems):
    kept = 0
    for number in range(400):
        document = line_problems.random_line_problem(np.random.default_rng([5000, number]))
        document["vehicles"] = []
        document["planner"] |= {"stopping": True, "speed_min_mps": 0.0, "terminal_weight": 0.0}
        problem = parse_problem(document)
        found = answer(problem, "search")
        if found.status is not Status.OPTIMAL or not problem.stop_lines:
            continue
        first, last = found.plan[0], found.plan[-1]
        # In the middle of a lane change y would have to follow the ego's curve.
        turns = problem.settings.occupancy is Occupancy.SWEPT and (
            first.lateral is not Lateral.KEEP or problem.ego.y != problem.road.center_y(problem.ego.lane)
        )
        if turns:
            continue
        braking = Mode(max(last.mode - 1, -1))
        shifted = ManeuverSequence((*found.sequence.laterals[1:], Lateral.KEEP), (*found.sequence.modes[1:], braking))
        y = problem.road.center_y(first.lane)
        moved = replace(problem.ego, x=first.x, y=y, speed=first.speed, lane=first.lane, mode=first.mode)
        following = replace(problem, ego=moved)
        assert first_breach(following, answer(following, "search"), shifted) is None
        kept += 1
    assert kept >= 100
