"""How likely a vehicle of which nobody says anything starts a lane change: base rates by its MOBIL incentive.

A driver changes lanes when it gains by it and nobody is endangered. The predictor weighs each vehicle's changes by its
own IDM and MOBIL, once with the ego in the scene and once without, and takes the larger rate: the ego may have left a
lane by the time that the vehicle enters it, so it must not see itself as a wall (docs/adr/0046). A vehicle that at the
speeds of now will still be level with the ego when the horizon ends is taken to see it, or in a queue everybody beside
the ego would be believed to drive into it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sumo_hmdp.domain.maneuver import ManeuverState
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import Scene, VehicleState
from sumo_hmdp.prediction.dynamics import FloatArray
from sumo_hmdp.prediction.policy import Policy, Probabilities
from sumo_hmdp.traffic.car_following import Drivers
from sumo_hmdp.traffic.incentive import LaneScene, weigh
from sumo_hmdp.traffic.lane_change import LaneChangeRule, Vehicles
from sumo_hmdp.traffic.neighbours import IntArray, find_neighbours

# Vehicles longer than this are taken for trucks [m].
TRUCK_LENGTH = 8.0
# What the predictor takes drivers to be like, whose parameters it cannot see: the mean cars and trucks of the traffic.
CAR_SPEED, TRUCK_SPEED = 33.0, 24.0
CAR_TIME_GAP, TRUCK_TIME_GAP = 1.2, 1.6
POLITENESS = 0.2
LEAST_GAP = 2.0


@dataclass(frozen=True)
class LaneChangeRates:
    """Probabilities of starting a change to one side in a period, by the incentive for it.

    The defaults were counted in recorded traffic that no test uses (analysis/16_lane_change_rates.py).

    Attributes:
        unsafe: where MOBIL finds the change unsafe, or there is no room; the floor of all rates.
        unwanted: incentive below `UNDECIDED`.
        undecided: incentive from there to `WANTED`.
        wanted: incentive above it.
        ending: from a lane that ends toward one that does not, where the change is safe.
        ending_lanes: lanes that end within the road, an acceleration lane say. Vehicles must leave them, and enter
            them with the floor's rate only.
    """

    unsafe: float = 0.0005
    unwanted: float = 0.001
    undecided: float = 0.0135
    wanted: float = 0.065
    ending: float = 0.26
    ending_lanes: tuple[int, ...] = ()

    def of(self, lane: int, level: int, side: int) -> float:
        """Return the rate of changes from a lane to the left (side 0) or right (side 1), at a level of incentive."""
        ends, target_ends = lane in self.ending_lanes, lane + 2 * side - 1 in self.ending_lanes
        if level == 0 or (target_ends and not ends):
            return self.unsafe
        if ends and not target_ends:
            return self.ending
        return (self.unsafe, self.unwanted, self.undecided, self.wanted)[level]


# Incentives at which the rate changes [m/s2].
UNDECIDED, WANTED = -0.5, 0.2


def lane_change_policies(
    scene: Scene,
    read: Mapping[str, ManeuverState],
    rates: LaneChangeRates,
    longitudinal: Probabilities,
    horizon: float,
) -> dict[str, Policy]:
    """Return a policy for each vehicle whose maneuver was read.

    Args:
        scene: the ego and all others.
        read: lane intent and mode of the vehicles in question, by id.
        rates: of lane changes.
        longitudinal: distribution over the next mode, for all.
        horizon: of the prediction [s].
    """
    if not read:
        return {}
    others = [other for other in scene.others if other.id in read]
    lanes = [read[other.id].lane for other in others]
    level = incentive_levels(scene.road, others, lanes, scene.ego, horizon)
    return {
        other.id: _policy(
            scene.road.lane_count, lane, rates.of(lane, left, 0), rates.of(lane, right, 1), rates.unsafe, longitudinal
        )
        for other, lane, (left, right) in zip(others, lanes, level.tolist(), strict=True)
    }


@lru_cache(maxsize=1024)
def _policy(lane_count: int, lane: int, left: float, right: float, floor: float, longitudinal: Probabilities) -> Policy:
    """Return a policy: the rates of now in the present lane, the floor in every other."""
    return Policy(lane_rows(lane_count, lane, left, right, floor), longitudinal)


def lane_rows(lane_count: int, lane: int, left: float, right: float, floor: float) -> tuple[Probabilities, ...]:
    """Return lateral probabilities of each lane: rates to the left and right in one lane, the floor in every other."""
    other = (floor, 1.0 - 2 * floor, floor)
    here = (left, 1.0 - left - right, right)
    return tuple(here if row == lane else other for row in range(1, lane_count + 1))


def incentive_levels(
    road: Road, others: Sequence[VehicleState], lanes: Sequence[int], ego: VehicleState, horizon: float
) -> IntArray:
    """Return how much vehicles want to change left and right, 0 (unsafe) to 3 (wanted), (n, 2).

    It is the larger of that with the ego in the scene and that without it, except for vehicles that stay level with
    the ego.

    Args:
        road: the lanes.
        others: the vehicles, n of them.
        lanes: that each intends.
        ego: the ego.
        horizon: of the prediction [s].
    """
    return larger_if_clear(_levels(road, others, lanes, ego), _levels(road, others, lanes, None), others, ego, horizon)


def larger_if_clear(
    seeing: IntArray, blind: IntArray, others: Sequence[VehicleState], ego: VehicleState, horizon: float
) -> IntArray:
    """Return the larger level of those with and without the ego, except for vehicles that stay level with it.

    Args:
        seeing: levels with the ego in the scene, (..., n, 2).
        blind: levels without it, likewise.
        others: the vehicles, n of them.
        ego: the ego.
        horizon: of the prediction [s].
    """
    clear = np.array([not _stays_level(other, ego, horizon) for other in others], dtype=bool)
    return np.where(clear[:, None], np.maximum(blind, seeing), seeing)


def _stays_level(other: VehicleState, ego: VehicleState, horizon: float) -> bool:
    """Tell whether, at the speeds of now, a vehicle ends the horizon nearer to the ego than the least gap."""
    ahead = other.x - ego.x + (other.speed - ego.speed) * horizon
    return ahead - other.length < LEAST_GAP and -ahead - ego.length < LEAST_GAP


def _levels(road: Road, others: Sequence[VehicleState], lanes: Sequence[int], ego: VehicleState | None) -> IntArray:
    return change_levels(seen_vehicles(road, others, lanes, ego), len(others), road.lane_count)


def seen_vehicles(
    road: Road, others: Sequence[VehicleState], lanes: Sequence[int], ego: VehicleState | None
) -> Vehicles:
    """Return vehicles with the drivers that they are taken to have, the ego last; None leaves it out."""
    states = [*others, *([] if ego is None else [ego])]
    intended = np.array([*lanes, *([] if ego is None else [ego.lane])], dtype=np.intp)
    x, y, speed, length = np.array([(s.x, s.y, s.speed, s.length) for s in states]).T
    here = np.array([road.lane_at(value) for value in y.tolist()], dtype=np.intp)
    return Vehicles(
        x,
        speed,
        intended,
        np.where(here != intended, here, 0),
        length,
        np.full(len(x), POLITENESS),
        _drivers(speed, length),
    )


def change_levels(vehicles: Vehicles, count: int, lane_count: int) -> IntArray:
    """Return how much vehicles want to change left and right, 0 (unsafe) to 3 (wanted), (count, 2).

    Args:
        vehicles: all that are in the scene.
        count: how many of them, the first ones, are asked about.
        lane_count: of the road.
    """
    rule, level = LaneChangeRule(), np.zeros((count, 2), dtype=np.intp)
    near = find_neighbours(vehicles.x, vehicles.lane, vehicles.second_lane, lane_count, vehicles.length)
    lane_scene = LaneScene.of(vehicles, near, lane_count, None, rule.idm)
    for side in (0, 1):
        there = vehicles.lane[:count] + 2 * side - 1
        # Who is changing lanes finishes that first.
        free = (there >= 1) & (there <= lane_count) & (vehicles.second_lane[:count] == 0)
        changer = np.flatnonzero(free)
        if not len(changer):
            continue
        weighed = weigh(lane_scene, rule, vehicles.politeness, np.full(len(changer), side, dtype=np.intp), changer)
        wants = 1 + (weighed.incentive > UNDECIDED).astype(np.intp) + (weighed.incentive > WANTED)
        level[changer, side] = np.where(weighed.safe, wants, 0)
    return level


def _drivers(speed: FloatArray, length: FloatArray) -> Drivers:
    """Return what drivers are taken to be like; nobody wants to be slower than it is."""
    truck, ones = length > TRUCK_LENGTH, np.ones(len(speed))
    return Drivers(
        desired_speed=np.maximum(speed, np.where(truck, TRUCK_SPEED, CAR_SPEED)),
        min_gap=LEAST_GAP * ones,
        time_gap=np.where(truck, TRUCK_TIME_GAP, CAR_TIME_GAP),
        accel=1.4 * ones,
        decel=2.0 * ones,
        exponent=4.0 * ones,
    )
