"""Whom the planner minds, how it takes vehicles that stand, what it shows; lane centres are at 4, 0 and -4 m."""

from dataclasses import replace

import pytest

from sumo_hmdp.decision.planner import SHOWN_BRANCHES, Belief, HmdpPlanner, shown_branches
from sumo_hmdp.decision.problem import DecisionProblem, PlannerSettings, RiskAllocation
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import Scene, VehicleState
from sumo_hmdp.prediction.branches import PredictedVehicle, predict
from sumo_hmdp.prediction.dynamics import Noise
from sumo_hmdp.prediction.policy import Policy, ScheduledPolicy

SETTINGS = PlannerSettings(
    period=0.6,
    horizon_steps=2,
    accel=3.0,
    speed_min=0.0,
    speed_max=14.0,
    safe_distance=8.0,
    risk_level=0.05,
    risk_allocation=RiskAllocation.INDIVIDUAL,
    sequence_threshold=1e-3,
)
NOISE = Noise(0.02, 0.03, 0.05, 0.06)
POLICY = ScheduledPolicy(((0.0, Policy(((0.0, 1.0, 0.0),) * 3, (0.1, 0.8, 0.1))),))
ROAD = Road(3, 4.0)


def planner(**changes):
    return HmdpPlanner(SETTINGS, {}, Belief(POLICY, NOISE), **({"yields_to_followers": False} | changes))


def vehicle(name="v", x=-20.0, y=0.0, lateral_speed=0.0, speed=10.0):
    return VehicleState(name, x, y, speed, ROAD.lane_at(y), lateral_speed=lateral_speed)


def minded(other, ego_y=0.0, **changes):
    ego = VehicleState("ego", 0.0, ego_y, 10.0, 2)
    return planner(**changes).problem(Scene(0.0, ROAD, ego, (other,))).vehicles


@pytest.mark.parametrize(
    ("y", "lateral_speed", "counts"),
    [
        # In the ego's lane, on the way into it, and on the way out of it with a part of the body still inside.
        (0.0, 0.0, False),
        (3.5, -1.0, False),
        (2.5, 1.0, False),
        # In another lane, and out of the ego's: from 1.1 m beside the centre of lane 1 on.
        (4.0, 0.0, True),
        (3.0, 1.0, True),
    ],
)
def test_who_comes_from_behind(y, lateral_speed, counts):
    other = vehicle(y=y, lateral_speed=lateral_speed)
    assert bool(minded(other)) == counts
    assert minded(other, yields_to_followers=True)
    # Ahead everybody counts.
    assert minded(vehicle(x=20.0, y=y, lateral_speed=lateral_speed))


def test_both_lanes_of_an_ego_that_changes_count_as_its_own():
    # Its body is over lanes 1 and 2 from 1.1 m beside a lane's centre on.
    assert not minded(vehicle(y=4.0), ego_y=1.2)
    assert minded(vehicle(y=4.0), ego_y=1.0)
    assert minded(vehicle(y=-4.0), ego_y=1.2)


@pytest.mark.parametrize(("speed", "noise"), [(0.0, Noise(0.02)), (0.49, Noise(0.02)), (0.51, NOISE)])
def test_who_stands_does_not_drift(speed, noise):
    (predicted,) = minded(vehicle(x=20.0, speed=speed))
    assert predicted.noise == noise


def test_a_vehicle_with_a_belief_of_its_own_keeps_its_noise():
    told = HmdpPlanner(SETTINGS, {"v": Belief(POLICY, NOISE)})
    scene = Scene(0.0, ROAD, VehicleState("ego", 0.0, 0.0, 10.0, 2), (vehicle(x=20.0, speed=0.0),))
    assert told.problem(scene).vehicles[0].noise == NOISE


def test_branches_are_shown_with_every_sequence_of_lanes_before_a_second_one():
    """Two steps of a vehicle that may do anything: seven sequences of lanes, each with several of modes."""
    settings = replace(SETTINGS, sequence_threshold=1e-9)
    policy = Policy(((0.05, 0.9, 0.05),) * 3, (0.1, 0.8, 0.1))
    anything = PredictedVehicle(vehicle(x=50.0), policy, NOISE)
    branches = predict([anything], settings.prediction())
    problem = DecisionProblem(ROAD, settings, VehicleState("ego", 0.0, 0.0, 10.0, 2), (anything,))
    shown = shown_branches(problem, branches)
    everything = {tuple(lanes) for lanes in branches.lanes.tolist()}
    assert len(everything) == 7
    assert len(branches.vehicle) > SHOWN_BRANCHES == len(shown)
    assert {branch.lanes for branch in shown} == everything
    probabilities = [branch.probability for branch in shown]
    assert probabilities == sorted(probabilities, reverse=True)
    assert probabilities[0] == branches.probability.max()
