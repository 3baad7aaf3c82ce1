"""Which lane changes the planner believes in: by MOBIL's incentive, with the ego in the scene and without it."""

import pytest

from sumo_hmdp.decision.lane_change_belief import LaneChangeRates, lane_change_policies
from sumo_hmdp.domain.maneuver import ManeuverState, Mode
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import EGO_ID, Scene, VehicleState

ROAD = Road(3, 4.0)
RATES = LaneChangeRates(unsafe=0.001, unwanted=0.002, undecided=0.01, wanted=0.1, ending=0.3)
LONGITUDINAL = (0.1, 0.8, 0.1)
HORIZON = 4.8


def vehicle(name, x, lane, speed):
    return VehicleState(name, x, ROAD.center_y(lane), speed, lane, Mode.CRUISE, length=5.0, width=1.8)


def lateral(ego, *others, rates=RATES, of="v"):
    """Return P(left), P(keep), P(right) of one vehicle in its lane."""
    scene = Scene(0.0, ROAD, ego, others)
    read = {other.id: ManeuverState(other.lane, Mode.CRUISE) for other in others}
    policy = lane_change_policies(scene, read, rates, LONGITUDINAL, HORIZON)[of]
    assert policy.longitudinal == LONGITUDINAL
    return policy.lateral[read[of].lane - 1]


# A slow leader 30 m ahead, nobody else: both sides are better, and to overtake pays.
SLOW = vehicle("slow", 130.0, 2, 20.0)
FAR = vehicle(EGO_ID, -400.0, 2, 30.0)


def test_a_vehicle_behind_a_slow_one_wants_to_change():
    assert lateral(FAR, vehicle("v", 95.0, 2, 30.0), SLOW) == (0.1, pytest.approx(0.8), 0.1)


def test_a_vehicle_with_a_free_road_does_not():
    left, _, right = lateral(FAR, vehicle("v", 95.0, 2, 33.0))
    assert left == right == RATES.undecided


def test_a_change_into_a_vehicle_beside_is_unsafe():
    left, _, right = lateral(FAR, vehicle("v", 95.0, 2, 30.0), SLOW, vehicle("beside", 94.0, 1, 30.0))
    assert (left, right) == (RATES.unsafe, RATES.wanted)


def test_the_ego_that_will_have_left_is_no_wall():
    """It is level with the vehicle, but 10 m/s faster: 48 m ahead when the horizon ends."""
    left, _, _ = lateral(vehicle(EGO_ID, 95.0, 1, 40.0), vehicle("v", 95.0, 2, 30.0), SLOW)
    assert left == RATES.wanted


def test_the_ego_that_stays_level_is_seen():
    """In a queue everybody beside the ego would otherwise be believed to drive into it."""
    queue = vehicle("leader", 102.0, 2, 0.0)
    left, _, right = lateral(vehicle(EGO_ID, 95.0, 1, 0.0), vehicle("v", 95.0, 2, 0.0), queue)
    assert (left, right) == (RATES.unsafe, RATES.wanted)
    without, _, _ = lateral(FAR, vehicle("v", 95.0, 2, 0.0), queue)
    assert without == RATES.wanted


def test_lanes_that_end_are_left_and_not_entered():
    rates = LaneChangeRates(0.001, 0.002, 0.01, 0.1, ending=0.3, ending_lanes=(3,))
    left, _, _ = lateral(FAR, vehicle("v", 95.0, 3, 30.0), rates=rates)
    assert left == 0.3
    _, _, right = lateral(FAR, vehicle("v", 95.0, 2, 30.0), SLOW, rates=rates)
    assert right == rates.unsafe
    # Where there is no room, a vehicle cannot leave it either.
    left, _, _ = lateral(FAR, vehicle("v", 95.0, 3, 30.0), vehicle("beside", 94.0, 2, 30.0), rates=rates)
    assert left == rates.unsafe


def test_in_all_other_lanes_the_floor_holds():
    scene = Scene(0.0, ROAD, FAR, (vehicle("v", 95.0, 2, 30.0), SLOW))
    read = {"v": ManeuverState(2, Mode.CRUISE)}
    policy = lane_change_policies(scene, read, RATES, LONGITUDINAL, HORIZON)["v"]
    assert policy.lateral[0] == policy.lateral[2] == (0.001, 0.998, 0.001)
