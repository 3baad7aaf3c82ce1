"""Both theorems of the paper, in worlds that move exactly as predicted, over long random runs."""

from dataclasses import replace

import numpy as np
import pytest

from sumo_hmdp.decision.audit import Cause, audit
from sumo_hmdp.decision.decide import answer
from sumo_hmdp.decision.problem import (
    DecisionProblem,
    PlannerSettings,
    Preferences,
    RiskAllocation,
)
from sumo_hmdp.domain.distance import DistanceRule
from sumo_hmdp.domain.maneuver import Mode
from sumo_hmdp.domain.occupancy import Occupancy
from sumo_hmdp.domain.plan import Status
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.prediction.branches import PredictedVehicle
from sumo_hmdp.prediction.dynamics import Noise
from sumo_hmdp.prediction.policy import Policy

ROAD = Road(3, 4.0)
KEEP = (0.0, 1.0, 0.0)


def settings(rng, **changes):
    period = float(rng.choice([0.5, 0.6, 0.8]))
    preferences = Preferences(
        speed_weight=float(rng.choice([0.5, 3.1])),
        desired_speed=float(rng.uniform(12, 35)),
        speed_deadband=float(2.0 * period / 2 * rng.uniform(1.0, 2.0)),
        lane_weight=float(rng.choice([0.0, 0.3])),
        goal_lane=[None, 1, 2, 3][rng.integers(4)],
        terminal_weight=float(rng.choice([1.0, 1.5])),
    )
    values = {
        "period": period,
        "horizon_steps": int(rng.integers(2, 6)),
        "accel": 2.0,
        "speed_min": 0.0,
        "speed_max": 60.0,
        "safe_distance": float(rng.uniform(8, 40)),
        "risk_level": 0.05,
        "risk_allocation": RiskAllocation.INDIVIDUAL,
        "sequence_threshold": 1e-5,
        "preferences": preferences,
    }
    return PlannerSettings(**{**values, **changes})


def advance_ego(problem, found):
    step = found.plan[0]
    return replace(problem.ego, x=step.x, speed=step.speed, lane=step.lane, mode=step.mode, y=ROAD.center_y(step.lane))


@pytest.mark.parametrize("seed", range(12))
def test_without_traffic_the_cost_falls_by_at_least_the_stage_cost_until_the_goal(seed):
    rng = np.random.default_rng([1, seed])
    config = settings(rng)
    likes = config.preferences
    ego = VehicleState(
        "ego", 0.0, 0.0, float(rng.uniform(8, 45)), int(rng.integers(1, 4)), Mode(int(rng.integers(-1, 2)))
    )
    problem = DecisionProblem(ROAD, config, ego, ())
    before = None
    for _ in range(60):
        found = answer(problem, "search")
        checked = audit(problem, found, before)
        assert found.status is Status.OPTIMAL
        if before is not None:
            assert checked.shifted_feasible, checked.shifted_reason
            assert found.objective <= checked.objective_bound + 1e-7
        before = problem, found
        problem = replace(problem, ego=advance_ego(problem, found))
    assert found.objective == pytest.approx(0.0, abs=1e-9)
    assert abs(problem.ego.speed - likes.desired_speed) <= likes.speed_deadband + 1e-6
    assert problem.ego.mode is Mode.CRUISE
    assert likes.goal_lane in {None, problem.ego.lane}


def random_traffic(rng, deterministic):
    vehicles = []
    for i in range(int(rng.integers(2, 6))):
        lane = int(rng.integers(1, 4))
        mode = Mode.CRUISE if rng.random() < 0.7 else Mode.DECELERATE
        longitudinal = KEEP if deterministic else (0.1, 0.8, 0.1)
        lateral = (KEEP,) * 3 if deterministic else ((0.0, 0.95, 0.05), (0.05, 0.9, 0.05), (0.05, 0.95, 0.0))
        state = VehicleState(
            f"sv{i}", float(rng.uniform(-150, 250)), ROAD.center_y(lane), float(rng.uniform(10, 30)), lane, mode
        )
        vehicles.append(PredictedVehicle(state, Policy(lateral, longitudinal), Noise()))
    return tuple(vehicles)


def follow_a_branch(rng, problem, found):
    """Move every vehicle exactly along the first step of one of its retained branches."""
    branches = found.branches
    moved = []
    for index, vehicle in enumerate(problem.vehicles):
        rows = np.flatnonzero(branches.vehicle == index)
        row = int(rng.choice(rows, p=branches.probability[rows] / branches.probability[rows].sum()))
        lane = int(branches.lanes[row, 0])
        state = replace(
            vehicle.state,
            x=float(branches.x[row, 0]),
            speed=float(branches.speed[row, 0]),
            lane=lane,
            mode=Mode(int(branches.modes[row, 0])),
            y=ROAD.center_y(lane),
        )
        moved.append(replace(vehicle, state=state))
    return tuple(moved)


@pytest.mark.parametrize("deterministic", [True, False])
@pytest.mark.parametrize("seed", range(10))
def test_the_shifted_plan_stays_feasible_in_traffic_that_moves_as_predicted(seed, deterministic):
    rng = np.random.default_rng([2, seed, deterministic])
    # Without a threshold nothing is pruned, so what the vehicles do is always something that was predicted.
    config = settings(rng, sequence_threshold=1e-30, horizon_steps=3)
    ego = VehicleState("ego", 0.0, 0.0, 20.0, 2, Mode.CRUISE)
    problem = DecisionProblem(ROAD, config, ego, random_traffic(rng, deterministic))
    before, checks, falls = None, 0, 0
    for _ in range(40):
        found = answer(problem, "search")
        checked = audit(problem, found, before)
        if checked.shifted_feasible is False:
            # Nothing was planned beyond the horizon: only there may the baseline's action meet traffic.
            assert checked.shifted_reason.startswith(Cause.BASELINE), checked.shifted_reason
        if checked.shifted_feasible:
            checks += 1
            assert found.status is Status.OPTIMAL
            assert found.objective <= checked.objective_bound + 1e-7
            falls += found.objective < checked.objective_bound + 1e-7
        if found.status is Status.FALLBACK:
            break
        before = problem, found
        problem = replace(problem, ego=advance_ego(problem, found), vehicles=follow_a_branch(rng, problem, found))
    assert falls == checks


def one_follower(x, **state):
    noise = state.pop("noise", Noise())
    policy = state.pop("policy", Policy((KEEP,) * 3, KEEP))
    return PredictedVehicle(VehicleState("sv", x, 0.0, state.pop("speed", 20.0), 2, **state), policy, noise)


def two_decisions(first, second, ego_x=None, **changes):
    rng = np.random.default_rng(0)
    likes = Preferences(desired_speed=20.0, speed_deadband=1.0, terminal_weight=1.0)
    config = settings(rng, preferences=likes, period=0.5, horizon_steps=3, safe_distance=30.0, **changes)
    ego = VehicleState("ego", 0.0, 0.0, 20.0, 2)
    problem = DecisionProblem(ROAD, config, ego, first)
    found = answer(problem, "search")
    following = replace(problem, ego=advance_ego(problem, found), vehicles=second)
    if ego_x is not None:
        following = replace(following, ego=replace(following.ego, x=ego_x))
    return audit(following, answer(following, "search"), (problem, found))


def test_a_shifted_plan_that_fails_says_why():
    # As predicted: the leader cruises from 35 m to 45 m ahead of where it was.
    assert two_decisions((one_follower(35.0),), (one_follower(45.0),)).shifted_feasible
    noise = two_decisions((one_follower(35.0),), (one_follower(38.0),))
    assert noise.shifted_feasible is False
    assert noise.shifted_reason == "noise: step 1, sv 2.00 m too near"
    new = two_decisions((), (one_follower(35.0),))
    assert new.shifted_reason.startswith("new_vehicle: step 1, sv 5.00 m too near")
    other = two_decisions((one_follower(35.0),), (one_follower(39.5, mode=Mode.DECELERATE, speed=10.0),))
    assert other.shifted_reason.startswith("other_maneuver")
    tracking = two_decisions((one_follower(35.0),), (one_follower(45.0),), ego_x=17.0)
    assert tracking.shifted_reason.startswith("tracking: step 1, sv 2.00 m too near")


def test_a_branch_that_was_pruned_is_named():
    policy = Policy((KEEP,) * 3, (0.01, 0.99, 0.0))
    first = (one_follower(35.0, policy=policy),)
    # It decelerates after all, with a probability of 0.01 that the threshold had dropped.
    second = (one_follower(39.5, policy=policy, mode=Mode.DECELERATE, speed=19.0),)
    checked = two_decisions(first, second, sequence_threshold=0.5)
    assert checked.shifted_reason.startswith("pruned_branch")


def test_nothing_is_said_without_a_plan_before():
    rng = np.random.default_rng(0)
    problem = DecisionProblem(ROAD, settings(rng), VehicleState("ego", 0.0, 0.0, 20.0, 2), ())
    found = answer(problem, "search")
    checked = audit(problem, found, None)
    assert checked.shifted_feasible is None
    assert checked.objective_bound is None
    assert checked.stage_cost is not None
    relaxed = replace(found, status=Status.RELAXED)
    assert audit(problem, found, (problem, relaxed)).shifted_feasible is None


@pytest.mark.parametrize("occupancy", list(Occupancy))
@pytest.mark.parametrize("rule", list(DistanceRule))
def test_an_answer_is_feasible_by_the_audit_s_own_count(occupancy, rule):
    rng = np.random.default_rng([3, list(Occupancy).index(occupancy), list(DistanceRule).index(rule)])
    from sumo_hmdp.decision.audit import first_breach  # noqa: PLC0415

    optimal = 0
    for _ in range(60):
        config = settings(
            rng, occupancy=occupancy, distance_rule=rule, safe_distance=10.0, stopping=bool(rng.integers(2))
        )
        ego = VehicleState("ego", 0.0, float(rng.uniform(-4, 4)), float(rng.uniform(0, 25)), 2)
        problem = DecisionProblem(ROAD, config, ego, random_traffic(rng, deterministic=False))
        found = answer(problem, "search")
        if found.status is Status.OPTIMAL:
            optimal += 1
            assert first_breach(problem, found, found.sequence) is None
        elif found.status is Status.RELAXED:
            assert first_breach(problem, found, found.sequence) is not None
    assert optimal >= 10
