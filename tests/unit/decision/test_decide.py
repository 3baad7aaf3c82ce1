"""The ways in which a decision can come about: both solvers, deadlines, starts, occupancy, distances, stopping."""

import json
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from sumo_hmdp.decision import decide, optimiser
from sumo_hmdp.decision.decide import SOLVERS, SolversDisagreeError, answer
from sumo_hmdp.decision.fallback import braking_demand
from sumo_hmdp.decision.highs import MilpResult
from sumo_hmdp.decision.occupancy import start_state
from sumo_hmdp.decision.problem import (
    DecisionProblem,
    ManeuverSequence,
    PlannerSettings,
    Preferences,
    RiskAllocation,
)
from sumo_hmdp.decision.problem_file import answer_document, parse_problem, problem_document, read_problem
from sumo_hmdp.decision.risk import RiskBudgetError, shared_tails, tail_probabilities
from sumo_hmdp.domain.distance import DistanceRule, RssParameters, rss_distance
from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.domain.occupancy import LaneState, Occupancy, quintic_progress, quintic_share
from sumo_hmdp.domain.plan import Status
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.prediction.branches import PredictedVehicle, predict
from sumo_hmdp.prediction.dynamics import Noise
from sumo_hmdp.prediction.policy import Policy

FIXTURES = sorted((Path(__file__).parents[2] / "fixtures" / "decisions").glob("*.json"))
KEEP = (0.0, 1.0, 0.0)
STEADY = Policy((KEEP,) * 3, KEEP)


CERTAIN = Noise()


def car(x, speed=20.0, lane=2, policy=STEADY, noise=CERTAIN, **state):
    y = state.pop("y", 4.0 * (2 - lane))
    return PredictedVehicle(VehicleState(f"at{x:g}", x, y, speed, lane, **state), policy, noise)


def problem(*vehicles, ego=None, **changes):
    values = {
        "period": 0.5,
        "horizon_steps": 3,
        "accel": 2.0,
        "speed_min": 0.0,
        "speed_max": 40.0,
        "safe_distance": 20.0,
        "risk_level": 0.05,
        "risk_allocation": RiskAllocation.INDIVIDUAL,
        "sequence_threshold": 1e-6,
        "preferences": Preferences(speed_weight=1.0, desired_speed=20.0, speed_deadband=0.5),
    }
    settings = PlannerSettings(**{**values, **changes})
    return DecisionProblem(Road(3, 4.0), settings, ego or VehicleState("ego", 0.0, 0.0, 20.0, 2), vehicles)


@pytest.mark.parametrize("solver", SOLVERS)
def test_every_solver_says_its_name_and_the_same_cost(solver):
    for path in FIXTURES[:4]:
        found = answer(read_problem(path), solver)
        assert found.solver == solver
        assert found.objective == pytest.approx(json.loads(path.read_text())["answer"]["objective"], abs=1e-6)


def test_solvers_that_differ_stop_the_decision(monkeypatch):
    wrong = replace(decide.SEARCH, best=lambda *_, **__: ManeuverSequence((Lateral.LEFT,) * 3, (Mode.CRUISE,) * 3))
    monkeypatch.setattr(decide, "SEARCH", wrong)
    ego = VehicleState("ego", 0.0, -4.0, 20.0, 3)
    asked = problem(ego=ego)
    with pytest.raises(SolversDisagreeError, match=r"milp says optimal, objective 0\.0.*search says optimal") as caught:
        answer(asked, "both")
    assert caught.value.problem is asked


def test_the_file_form_gives_a_problem_back():
    asked = problem(
        car(
            60.0,
            policy=Policy(((0.0, 0.9, 0.1), (0.1, 0.8, 0.1), (0.2, 0.8, 0.0)), (0.1, 0.8, 0.1)),
            noise=Noise(1, 2, 3, 4),
        ),
        occupancy=Occupancy.SWEPT,
        distance_rule=DistanceRule.RSS,
        risk_allocation=RiskAllocation.MIXTURE,
        stopping=True,
        forbidden_lanes=frozenset({3}),
    )
    start = ManeuverSequence((Lateral.LEFT, Lateral.KEEP, Lateral.KEEP), (Mode.CRUISE,) * 3)
    for form in (asked, replace(asked, start=start)):
        assert parse_problem(json.loads(json.dumps(problem_document(form)))) == form


def test_an_answer_is_json():
    for path in FIXTURES:
        found = answer_document(answer(read_problem(path), "search"))
        assert json.loads(json.dumps(found, allow_nan=False)) == found


def test_a_start_changes_nothing_but_the_way():
    rng = np.random.default_rng(3)
    for path in FIXTURES:
        asked = read_problem(path)
        cold = answer(asked)
        H = asked.settings.horizon_steps
        for _ in range(4):
            modes = np.clip(np.cumsum(rng.integers(-1, 2, H)) + asked.ego.mode, -1, 1)
            start = ManeuverSequence(
                tuple(Lateral(int(a)) for a in rng.integers(-1, 2, H)), tuple(Mode(int(m)) for m in modes)
            )
            warm = answer(replace(asked, start=start))
            assert warm.status is cold.status
            assert warm.objective == pytest.approx(cold.objective, abs=1e-6)


def test_the_best_plan_is_a_start_that_is_used():
    asked = read_problem(FIXTURES[1])
    found = answer(asked)
    compiled_values = []

    def spy(compiled, data, time_limit, start=None):
        compiled_values.append(start)
        return original(compiled, data, time_limit, start)

    original, optimiser.solve = optimiser.solve, spy
    try:
        again = answer(replace(asked, start=found.sequence))
    finally:
        optimiser.solve = original
    assert compiled_values[0] is not None
    assert again.sequence == found.sequence


def stuck(result):
    """Answer as HiGHS does when the time is over."""

    def solve(compiled, data, time_limit, start=None):
        del start
        assert 0.0 < time_limit < 0.5
        return MilpResult("Time limit reached", result(compiled, data))

    return solve


def test_an_enforced_deadline_takes_what_is_known(monkeypatch):
    asked = problem(car(60.0), enforce_deadline=True)
    best = answer(replace(asked, settings=replace(asked.settings, enforce_deadline=False)))
    original = optimiser.solve
    monkeypatch.setattr(optimiser, "solve", stuck(lambda compiled, data: original(compiled, data).values))
    known = answer(asked)
    assert known.status is Status.INCUMBENT
    assert "deadline" in known.reason
    assert known.objective == best.objective
    monkeypatch.setattr(optimiser, "solve", stuck(lambda *_: None))
    nothing = answer(asked)
    assert nothing.status is Status.FALLBACK
    assert "no plan was known when the deadline of 0.5 s came" in nothing.reason


def test_every_solve_of_a_decision_shares_one_deadline(monkeypatch):
    # No plan keeps 200 m: the relaxed plan takes several solves, each of which gets what the others left.
    others = (car(60.0, lane=lane) for lane in (1, 2, 3))
    asked = problem(*others, enforce_deadline=True, safe_distance=200.0)
    original, given = optimiser.solve, []

    def slow(compiled, data, time_limit, start=None, *, presolve=None):
        given.append(time_limit)
        time.sleep(0.02)
        return original(compiled, data, 10.0, start, presolve=presolve)

    monkeypatch.setattr(optimiser, "solve", slow)
    assert answer(asked).status is Status.RELAXED
    assert len(given) > 1
    assert all(later <= sooner - 0.02 for sooner, later in pairwise(given))


def test_a_deadline_of_no_time_is_real():
    compiled = optimiser.compile_model(optimiser.Shape(3, 1, 3, False, False, False, False))
    result = optimiser.solve(compiled, np.zeros(compiled.slot_count), time_limit=0.0)
    assert result.timed_out or result.status == "Infeasible"


def test_a_fallback_brakes_as_hard_as_the_leader_demands():
    # A standing vehicle 12 m ahead at 20 m/s: 7.5 m of gap, 20^2 / 15 is far beyond the 8 m/s2 that there are.
    found = answer(problem(car(12.0, speed=0.0), car(0.0, lane=1), car(0.0, lane=3)))
    assert found.status is Status.FALLBACK
    assert found.brake == 8.0
    assert found.lateral is Lateral.KEEP
    assert found.mode is Mode.DECELERATE
    assert "at12" in found.reason
    # Alone, but too fast for its limit: that is no fallback.
    fast = answer(problem(speed_max=10.0))
    assert (fast.status, fast.mode) == (Status.OPTIMAL, Mode.DECELERATE)


# Lengths of 4.5 m, front bumpers d apart: (4.5 + d) / 8 <= (4.5 - d) / 2 holds up to d = 2.7 m.
@pytest.mark.parametrize(("x", "brake"), [(-0.3, 8.0), (-2.69, 8.0), (-2.71, 2.0), (-4.4, 2.0), (-4.6, 2.0)])
def test_a_fallback_brakes_for_a_vehicle_beside_the_ego_that_is_sooner_ahead_than_behind(x, brake):
    comes_over = car(x, lane=1, policy=Policy(((0.0, 0.0, 1.0), KEEP, KEEP), KEEP))
    stays = car(-1.0, lane=3)
    decision = problem(comes_over, stays)
    branches = predict(decision.vehicles, decision.settings.prediction())
    assert braking_demand(decision, branches) == (brake, f"at{x:g}" if brake == 8.0 else None)


def test_a_relaxed_plan_names_who_is_too_near():
    found = answer(problem(car(15.0), car(-15.0), car(0.0, lane=1), car(0.0, lane=3)))
    assert found.status is Status.RELAXED
    assert found.violation == pytest.approx(3 * 10.0)
    assert "5.00 m too near" in found.reason


@pytest.mark.parametrize("solver", ["milp", "search"])
@pytest.mark.parametrize("ahead", [20.0, 20.0 - 5e-7])
@pytest.mark.parametrize("here", [0.0, -397.1])
def test_what_is_gained_behind_and_lost_ahead_ties(solver, ahead, here):
    # Standing keeps the 20 m ahead, or misses them by less than counts, and lacks 5 m behind. Each metre forward lacks
    # one less behind and one more ahead, so the violation is the same, and standing is free.
    around = [car(here + x, speed=0.0, y=0.0) for x in (ahead, -15.0)]
    stands = Preferences(speed_weight=1.0, desired_speed=0.0, speed_deadband=0.5)
    ego = VehicleState("ego", here, 0.0, 0.0, 2)
    found = answer(
        problem(*around, ego=ego, stopping=True, preferences=stands, forbidden_lanes=frozenset({1, 3})), solver
    )
    assert found.status is Status.RELAXED
    assert found.violation == pytest.approx(3 * 5.0)
    assert found.objective == 0.0
    assert {step.x for step in found.plan} == {here}


# --- occupancy


def test_quintic_and_its_inverse():
    assert quintic_share(0.5) == 0.5
    for share in (0.0, 0.1, 0.725, 1.0):
        assert quintic_share(quintic_progress(share)) == pytest.approx(share, abs=1e-12)


def test_swept_keeps_the_leader_of_the_lane_that_is_left():
    # The leader comes 4 m nearer a step: 24, 20, 16 m; who is in lane 2 at the third is too near, even braking.
    leader = car(28.0, speed=12.0)
    target = answer(problem(leader))
    assert target.status is Status.OPTIMAL
    assert target.plan[-1].lane != 2
    swept = answer(problem(leader, occupancy=Occupancy.SWEPT, lane_change_time=4.0))
    # The body is over lane 2 for four steps.
    assert swept.status is Status.RELAXED
    quick = answer(problem(leader, occupancy=Occupancy.SWEPT, lane_change_time=0.8))
    assert quick.status is Status.OPTIMAL


def test_lane_states_of_a_change_an_abort_and_a_second_change():
    state = LaneState(2).after(Lateral.LEFT, 2)
    assert state == LaneState(1, ((2, 2),))
    assert state.occupied == (1, 2)
    assert state.after(Lateral.KEEP, 2) == LaneState(1, ((2, 1),))
    assert state.after(Lateral.KEEP, 2).after(Lateral.KEEP, 2) == LaneState(1)
    assert state.after(Lateral.RIGHT, 2) == LaneState(2, ((1, 2),))
    assert LaneState(3, ((2, 2),)).after(Lateral.KEEP, 0) == LaneState(3, ((2, 1),))


def test_the_start_state_follows_from_y():
    # A 4 s change clears at share 0.725, which is p = 0.6251. At share 0.55, p = 0.5267: 0.39 s left, under one step.
    half = problem(ego=VehicleState("ego", 0.0, 2.2, 20.0, 1), occupancy=Occupancy.SWEPT)
    assert start_state(half) == LaneState(1, ((2, 1),))
    begun = problem(ego=VehicleState("ego", 0.0, 0.2, 20.0, 1), occupancy=Occupancy.SWEPT)
    # Share 0.05 is p = 0.1893, so 1.74 s are left: three more steps of 0.5 s end over the line.
    assert start_state(begun) == LaneState(1, ((2, 4),))
    assert start_state(problem(ego=begun.ego)) == LaneState(1)


# --- distances


def test_rss_distance_by_hand():
    # rho 1, a 2, b_min 4, b_max 8: 20 + 1 + 22^2 / 8 - 20^2 / 16 = 56.5
    rss = RssParameters(1.0, 2.0, 4.0, 8.0)
    assert rss_distance(np.array([20.0]), np.array([20.0]), rss)[0] == pytest.approx(56.5)
    assert rss_distance(np.array([1.0]), np.array([30.0]), rss)[0] == 0.0


@pytest.mark.parametrize(("gap", "status"), [(2.0 + 1.5 * 20 + 0.01, "optimal"), (2.0 + 1.5 * 20 - 0.5, "optimal")])
def test_time_headway_counts_between_bumpers_at_the_speed_reached(gap, status):
    changes = {"distance_rule": DistanceRule.TIME_HEADWAY, "time_headway": 1.5, "safe_distance": 2.0}
    blocked = (car(0.0, lane=1), car(0.0, lane=3))
    found = answer(problem(car(gap + 4.5), *blocked, **changes))
    assert found.status == status
    # Half a metre too near at 20 m/s is put right by one step of braking: 1 m/s less needs 1.5 m less.
    assert (found.mode is Mode.DECELERATE) == (gap < 32.0)


# --- stopping


def test_without_stopping_a_slow_ego_cannot_brake_and_with_it_can():
    slow = VehicleState("ego", 0.0, 0.0, 0.4, 2)
    blocked = (car(20.1, speed=0.0), car(0.0, lane=1), car(0.0, lane=3))
    assert answer(problem(*blocked, ego=slow)).status is Status.RELAXED
    found = answer(problem(*blocked, ego=slow, stopping=True))
    assert found.status is Status.OPTIMAL
    assert found.mode is Mode.DECELERATE
    # 0.4 m/s stops within 0.4^2 / 4 = 0.04 m, and stands.
    assert [step.speed for step in found.plan] == [0.0, 0.0, 0.0]
    assert found.plan[-1].x == pytest.approx(0.04)


def test_a_standing_ego_starts_again():
    standing = VehicleState("ego", 0.0, 0.0, 0.0, 2, Mode.DECELERATE)
    hurry = Preferences(speed_weight=10.0, desired_speed=20.0, speed_deadband=0.5)
    found = answer(problem(ego=standing, stopping=True, preferences=hurry))
    assert found.status is Status.OPTIMAL
    assert [step.mode for step in found.plan] == [Mode.CRUISE, Mode.ACCELERATE, Mode.ACCELERATE]
    assert found.plan[-1].speed == pytest.approx(2.0)


# --- risk


def test_water_filling_spends_the_budget():
    probability = np.array([0.7, 0.2, 0.06, 0.04])
    for budget in (1e-4, 0.01, 0.05, 0.2):
        tails = shared_tails(probability, budget)
        assert (probability * tails).sum() == pytest.approx(budget)
        assert tails.max() <= 0.5
        # Who is below the cap pays the same.
        paid = (probability * tails)[tails < 0.5]
        assert np.ptp(paid) <= 1e-15
    assert shared_tails(probability, 0.9).tolist() == [0.5] * 4


def uncertain(threshold, allocation, **changes):
    policy = Policy((KEEP,) * 3, (0.1, 0.8, 0.1))
    asked = problem(
        car(80.0, policy=policy), sequence_threshold=threshold, risk_allocation=allocation, risk_level=0.1, **changes
    )
    return predict(asked.vehicles, asked.settings.prediction()), asked.settings


def test_pruned_probability_is_taken_off():
    for allocation, changes in ((RiskAllocation.MIXTURE, {}), (RiskAllocation.UNIFORM, {"account_pruned": True})):
        branches, settings = uncertain(2e-3, allocation, **changes)
        spent = (tail_probabilities(branches, settings) * branches.probability).sum() * 3 + branches.pruned[0]
        assert 0 < branches.pruned[0] < 0.1
        assert spent <= 0.1 + 1e-12


def test_a_budget_that_pruning_has_used_up_is_an_error_with_the_least_risk_level():
    branches, settings = uncertain(0.2, RiskAllocation.MIXTURE)
    with pytest.raises(RiskBudgetError, match=r"sequence_threshold 0\.2") as caught:
        tail_probabilities(branches, settings)
    assert f"{branches.pruned[0]:.6g}" in str(caught.value)


MODES_BACK = [
    # An ego at 25 m/s whose limit is 20: steps of 1 m/s. Braking comes at once, or after the cruising that it needs.
    (Mode.CRUISE, 25.0, (-1, -1, -1)),
    (Mode.DECELERATE, 21.5, (-1, -1, 0)),
    (Mode.ACCELERATE, 22.0, (0, -1, -1)),
]


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize(("mode", "speed", "modes"), MODES_BACK)
def test_an_ego_above_its_top_speed_on_an_empty_road_brakes_to_it(solver, mode, speed, modes):
    ego = VehicleState("ego", 0.0, 0.0, speed, 2, mode)
    found = answer(problem(ego=ego, speed_max=20.0), solver)
    assert found.status is Status.OPTIMAL
    assert tuple(int(step.mode) for step in found.plan) == modes
    assert all(step.speed <= 20.0 or step.mode <= 0 for step in found.plan)


@pytest.mark.parametrize("solver", SOLVERS)
def test_an_ego_below_its_least_speed_speeds_up_to_it(solver):
    ego = VehicleState("ego", 0.0, 0.0, 8.2, 2)
    found = answer(problem(ego=ego, speed_min=10.0), solver)
    assert found.status is Status.OPTIMAL
    assert [step.speed for step in found.plan][:2] == pytest.approx([9.2, 10.2])


@pytest.mark.parametrize("solver", SOLVERS)
def test_an_ego_above_its_top_speed_that_comes_too_near_relaxes_and_still_brakes(solver):
    # 25.5 m from bumper to bumper, to a leader 5 m/s slower: no plan that brakes keeps 30 m.
    found = answer(problem(car(30.0, speed=20.0), ego=VehicleState("ego", 0.0, 0.0, 25.0, 2), speed_max=20.0,
                           safe_distance=30.0, forbidden_lanes=frozenset({1, 3})), solver)  # fmt: skip
    assert found.status is Status.RELAXED
    assert [int(step.mode) for step in found.plan] == [-1, -1, -1]


@pytest.mark.parametrize(
    ("occupancy", "y", "blocker"),
    [
        (Occupancy.SWEPT, 0.0, "at14"),  # intends lane 1, its whole body is in lane 2
        (Occupancy.SWEPT, 1.9, "at14"),  # half way
        (Occupancy.SWEPT, 2.95, None),  # its body has left lane 2
        (Occupancy.TARGET, 0.0, None),  # the paper's rule: what is intended
    ],
)
def test_a_fallback_brakes_for_a_body_in_the_lane_whatever_it_intends(occupancy, y, blocker):
    decision = problem(car(14.0, speed=8.0, lane=1, y=y), occupancy=occupancy)
    branches = predict(decision.vehicles, decision.settings.prediction())
    brake, found = braking_demand(decision, branches)
    # 9.5 m to a vehicle 12 m/s slower: 144 / 19.
    assert (found, brake) == (blocker, pytest.approx(144 / 19) if blocker else 2.0)


def test_a_fallback_of_an_ego_between_two_lanes_brakes_for_both():
    between = VehicleState("ego", 0.0, 2.0, 20.0, 1)
    for occupancy, blocker in ((Occupancy.SWEPT, "at14"), (Occupancy.TARGET, None)):
        decision = problem(car(14.0, speed=8.0), ego=between, occupancy=occupancy)
        branches = predict(decision.vehicles, decision.settings.prediction())
        assert braking_demand(decision, branches)[1] == blocker
