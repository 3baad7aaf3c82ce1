"""Predictors behind their seam, and the rollout against a loop of scalars; lane centres are at 4, 0 and -4 m."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sumo_hmdp.decision.lane_change_belief import LaneChangeRates, incentive_levels
from sumo_hmdp.decision.planner import HmdpPlanner, UnknownVehicleError
from sumo_hmdp.decision.predictors import Belief, Forecast, PredictorContext, build_predictor, predictor_kinds
from sumo_hmdp.decision.problem import PlannerSettings, RiskAllocation
from sumo_hmdp.decision.problem_file import parse_problem, problem_document
from sumo_hmdp.decision.rollout import FADE_TIME, ROLLOUT_STEP, rollout
from sumo_hmdp.domain.maneuver import Mode
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import Scene, VehicleState
from sumo_hmdp.errors import InputError
from sumo_hmdp.prediction.dynamics import Noise
from sumo_hmdp.prediction.lateral import LaneFollowing
from sumo_hmdp.prediction.policy import Policy, ScheduledPolicy

ROAD = Road(3, 4.0)
SETTINGS = PlannerSettings(
    period=0.8,
    horizon_steps=6,
    accel=2.0,
    speed_min=0.0,
    speed_max=40.0,
    safe_distance=8.0,
    risk_level=0.05,
    risk_allocation=RiskAllocation.JOINT,
    sequence_threshold=1e-3,
)
RATES = LaneChangeRates()
STATED = Policy(((0.01, 0.98, 0.01),) * 3, (0.01, 0.98, 0.01))
BELIEF = Belief(ScheduledPolicy(((0.0, STATED),)), Noise(0.02, 0.02), rates=RATES)
EGO = VehicleState("ego", 190.0, -4.0, 25.0, 3)


def vehicle(name, x, lane, speed, accel=0.0):
    return VehicleState(name, x, ROAD.center_y(lane), speed, lane, accel=accel)


# The car in lane 2 comes up to a slow truck and wants to go left, where somebody faster is level with it for a moment.
TRUCK = replace(vehicle("truck", 230.0, 2, 22.0), length=12.0)
COMING_UP = (vehicle("car", 130.0, 2, 30.0), vehicle("passing", 131.0, 1, 40.0), TRUCK)


def scene(*others, time=0.0):
    return Scene(time, ROAD, EGO, tuple(others))


def forecast(name, shown, belief=BELIEF):
    context = PredictorContext({}, belief, SETTINGS.accel, SETTINGS.period, SETTINGS.horizon_steps)
    predictor = build_predictor(name, context)
    return predictor.predict(shown, predictor.observe(shown, predictor.initial_memory())).vehicles


def test_a_change_becomes_likely_later_along_the_rollout():
    frozen, rolled = (forecast(name, scene(*COMING_UP))["car"].policy for name in ("belief", "idm_rollout"))
    assert frozen.later == ()
    assert rolled.lateral == frozen.lateral
    left = [rolled.at_step(k).lateral[1][0] for k in range(6)]
    assert left == sorted(left)
    assert left[0] == RATES.unsafe
    assert left[-1] == RATES.wanted


def test_the_first_step_is_the_incentive_of_now():
    others = (*COMING_UP, vehicle("right", 170.0, 3, 20.0))
    lanes = [other.lane for other in others]
    now = incentive_levels(ROAD, others, lanes, EGO, 4.8)
    seeing = rollout(ROAD, others, lanes, EGO, (0.8, 6), LaneFollowing()).levels
    blind = rollout(ROAD, others, lanes, None, (0.8, 6), LaneFollowing()).levels
    assert np.array_equal(np.maximum(seeing, blind)[0], now)


def scalar_rollout(x, speed, leader_x, leader_speed, accel, steps):
    """Move a car (33 m/s) behind a truck of 12 m that drives freely (24 m/s), both by IDM, and return all states."""

    def free(v, desired):
        return 1.4 * (1.0 - (v / desired) ** 4)

    def behind(v, desired, gap, lead, time_gap):
        wanted = 2.0 + max(0.0, v * time_gap + v * (v - lead) / (2 * math.sqrt(1.4 * 2.0)))
        return max(free(v, desired) - 1.4 * (wanted / gap) ** 2, -9.0)  # SUMO brakes no harder

    surplus, found = None, []
    for step in range(steps):
        a = behind(speed, 33.0, leader_x - 12.0 - x, leader_speed, 1.2)
        b = free(leader_speed, 24.0)
        surplus = (accel[0] - a, accel[1] - b) if surplus is None else surplus
        fade = math.exp(-step * ROLLOUT_STEP / FADE_TIME)
        a, b = a + surplus[0] * fade, b + surplus[1] * fade
        x, speed = x + speed * ROLLOUT_STEP + a * ROLLOUT_STEP**2 / 2, speed + a * ROLLOUT_STEP
        leader_x += leader_speed * ROLLOUT_STEP + b * ROLLOUT_STEP**2 / 2
        leader_speed += b * ROLLOUT_STEP
        found.append((x, speed, leader_x, leader_speed))
    return found


@pytest.mark.parametrize("accel", [(0.0, 0.0), (-1.0, 0.5)])
def test_the_rollout_asks_the_scenes_that_a_scalar_loop_leads_to(accel):
    for gap in np.linspace(40.0, 160.0, 13):
        car = vehicle("car", 100.0, 2, 33.0, accel[0])
        truck = replace(vehicle("truck", 100.0 + gap + 12.0, 2, 20.0, accel[1]), length=12.0)
        levels, farther, faster = rollout(ROAD, (car, truck), [2, 2], None, (0.8, 6), LaneFollowing())
        states = scalar_rollout(car.x, car.speed, truck.x, truck.speed, accel, 12)[1::2]
        assert [s[0] - car.x - car.speed * 0.8 * k for k, s in enumerate(states, start=1)] == pytest.approx(
            farther[:, 0]
        )
        assert [s[3] - truck.speed for s in states] == pytest.approx(faster[:, 1])
        for k, (x, speed, truck_x, truck_speed) in enumerate(states[:-1], start=1):
            moved = (replace(car, x=x, speed=speed), replace(truck, x=truck_x, speed=truck_speed))
            far = replace(EGO, x=-1e5)
            assert np.array_equal(levels[k], incentive_levels(ROAD, moved, [2, 2], far, 0.0)), (gap, k)


@pytest.mark.parametrize("accel", [0.7, -1.5, -9.0])
def test_a_fading_acceleration_is_that_of_a_fine_integration(accel):
    told = forecast("fading_acceleration", scene(vehicle("v", 20.0, 2, 12.0, accel=accel)))["v"]
    assert told.state.mode is Mode.CRUISE
    dt, x, v, used = 1e-4, 0.0, 0.0, max(accel, -12.0 / (3.0 * (1.0 - math.exp(-1.6))))
    for step in range(48_000):
        a = used * math.exp(-(step + 0.5) * dt / 3.0)
        x, v = x + v * dt + a * dt**2 / 2, v + a * dt
        if (step + 1) % 8_000 == 0:
            assert told.drift[(step + 1) // 8_000 - 1] == pytest.approx((x, v), abs=1e-3)
    # Who may come to rest within the horizon stops by its modes.
    assert forecast("fading_acceleration", scene(vehicle("v", 20.0, 2, 9.0, accel=accel)))["v"].drift == ()


def test_nobody_else_changes_under_constant_velocity():
    told = forecast("constant_velocity", scene(vehicle("v", 20.0, 2, 20.0, accel=-3.0)))["v"]
    assert told.state.mode is Mode.CRUISE
    assert told.policy == Policy(((0.0, 1.0, 0.0),) * 3, (0.0, 1.0, 0.0))
    assert told.noise == BELIEF.noise


def test_fixed_leaves_the_incentive_aside_and_belief_takes_it():
    shown = scene(*COMING_UP)
    assert forecast("fixed", shown)["car"].policy == STATED
    assert forecast("belief", shown, replace(BELIEF, rates=None))["car"].policy.lateral != STATED.lateral
    assert forecast(None, shown, replace(BELIEF, rates=None))["car"].policy == STATED


def test_what_the_predictor_said_is_in_the_decision_file():
    context = PredictorContext({}, BELIEF, SETTINGS.accel, SETTINGS.period, SETTINGS.horizon_steps)
    planner = HmdpPlanner(SETTINGS, {}, BELIEF, predictor=build_predictor("idm_rollout", context))
    problem = planner.problem(scene(*COMING_UP))
    assert any(vehicle.policy.later for vehicle in problem.vehicles)
    assert parse_problem(problem_document(problem)).vehicles == problem.vehicles


class Counting:
    """A predictor of somebody else's: counts what it is shown, and knows nobody."""

    name = "counting"

    def initial_memory(self):
        return 0

    def observe(self, scene, memory):
        return memory + len(scene.others)

    def predict(self, scene, memory):
        return Forecast({}, memory)


def test_a_predictor_sees_whom_the_planner_senses_and_must_know_them():
    planner = HmdpPlanner(SETTINGS, {}, sensing_range=100.0, predictor=Counting())
    near, far = vehicle("near", 200.0, 2, 20.0), vehicle("far", 500.0, 2, 20.0)
    memory = planner.observe(scene(near, far), planner.initial_memory())
    _, memory = planner.decide(scene(far), memory)
    assert memory.predictor == 1
    with pytest.raises(UnknownVehicleError, match="near"):
        planner.decide(scene(near), memory)


def test_unknown_predictors_and_given_in_traffic_are_refused():
    assert {"given", "fixed", "belief", "constant_velocity", "idm_rollout"} <= set(predictor_kinds())
    with pytest.raises(InputError, match="idm_rollout"):
        forecast("idm_rolout", scene())
    with pytest.raises(InputError, match="belief"):
        forecast("given", scene())
