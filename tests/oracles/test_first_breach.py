"""The first breach of any sequence of maneuvers against a loop over steps and branches, in problems of every rule."""

from collections import Counter

import numpy as np

from sumo_hmdp.decision.audit import first_breach
from sumo_hmdp.decision.decide import answer, make_plan
from sumo_hmdp.decision.distance import safe_clearance
from sumo_hmdp.decision.occupancy import lanes_now, occupied_lanes, start_state, sweep_steps
from sumo_hmdp.decision.problem import ManeuverSequence
from sumo_hmdp.decision.problem_file import parse_problem
from sumo_hmdp.decision.risk import RiskBudgetError
from sumo_hmdp.domain.maneuver import Lateral, Mode


def breaches_by_step(problem, found, sequence):
    """Yield (step, {row: metres}, {rows passed through}) for each step of a sequence."""
    branches, occupied = found.branches, occupied_lanes(problem, found.branches)
    state = start_state(problem)
    vehicles = [branches.vehicles[v].state for v in branches.vehicle]
    now = lanes_now(problem, branches)[branches.vehicle]
    shared = [any(lanes[lane - 1] for lane in state.occupied) for lanes in now]
    ahead = [problem.ego.x > v.x for v in vehicles]
    for k, step in enumerate(make_plan(problem, found.lattice, sequence)):
        state = state.after(step.lateral, sweep_steps(problem))
        safe = safe_clearance(problem, branches, found.margin, step.speed)
        short, passed = {}, set()
        for row in range(len(vehicles)):
            shares = any(occupied[row, k, lane - 1] for lane in state.occupied)
            is_ahead = step.x > branches.x[row, k]
            asked = (safe.ahead if is_ahead else safe.behind)[row, k]
            if shares and asked - abs(step.x - branches.x[row, k]) > 1e-6:
                short[row] = asked - abs(step.x - branches.x[row, k])
            if shares and shared[row] and is_ahead != ahead[row]:
                passed.add(row)
            shared[row], ahead[row] = shares, is_ahead
        yield k + 1, short, passed


def random_sequence(problem, rng):
    """Return maneuvers that keep to the lanes and change the mode by one level at most."""
    lane, mode, laterals, modes = problem.ego.lane, int(problem.ego.mode), [], []
    for _ in range(problem.settings.horizon_steps):
        laterals.append(Lateral(int(rng.choice([step for step in (-1, 0, 1) if problem.road.has_lane(lane + step)]))))
        modes.append(Mode(int(rng.choice([m for m in (-1, 0, 1) if abs(m - mode) <= 1]))))
        lane, mode = lane + laterals[-1], int(modes[-1])
    return ManeuverSequence(tuple(laterals), tuple(modes))


def test_the_first_breach_is_that_of_a_loop_over_steps_and_branches(general_problems):
    seen = Counter()
    for number in range(50):
        rng = np.random.default_rng([91, number])
        problem = parse_problem(general_problems.random_general_problem(rng))
        try:
            found = answer(problem, "search")
        except RiskBudgetError:
            continue
        for _ in range(4):
            sequence = random_sequence(problem, rng)
            breach = first_breach(problem, found, sequence)
            steps = breaches_by_step(problem, found, sequence)
            step, short, passed = next(((k, s, p) for k, s, p in steps if s or p), (None, {}, set()))
            if breach is None:
                assert step is None
                seen["none"] += 1
            elif breach.row is None:
                assert step is None or step >= breach.step
                seen["limits"] += 1
            elif passed:
                assert (breach.step, breach.metres) == (step, 0.0)
                assert breach.row in passed
                seen["passed"] += 1
            else:
                assert breach.step == step
                assert abs(short[breach.row] - max(short.values())) < 1e-9
                assert abs(breach.metres - max(short.values())) < 1e-9
                seen["short"] += 1
    assert min(seen[kind] for kind in ("none", "limits", "passed", "short")) >= 10
