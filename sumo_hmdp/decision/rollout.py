"""Lane changes that become likely later: the MOBIL incentive asked again at each step of an IDM rollout.

Most distances that fall short in traffic are lane changes that begin within the horizon, not at its start, since the
incentive grows as a vehicle comes up to a slower one. So all vehicles are rolled out by the predictor's own IDM,
each in the lane that it intends, and the incentive of each step gives the probability of starting a change in it
(docs/formulation.md, eq. 45). As for the incentive of now, the larger rate of those with and without the ego
counts.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sumo_hmdp.decision.lane_change_belief import (
    LaneChangeRates,
    change_levels,
    lane_rows,
    larger_if_clear,
    seen_vehicles,
)
from sumo_hmdp.domain.maneuver import ManeuverState
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import Scene, VehicleState
from sumo_hmdp.prediction.branches import Drift
from sumo_hmdp.prediction.dynamics import FloatArray
from sumo_hmdp.prediction.lateral import LaneFollowing, centers_of
from sumo_hmdp.prediction.policy import Policy, Probabilities
from sumo_hmdp.traffic.car_following import SUMO_IDM
from sumo_hmdp.traffic.incentive import LaneScene
from sumo_hmdp.traffic.lane_change import Vehicles
from sumo_hmdp.traffic.neighbours import IntArray, find_neighbours

# Longest step of the rollout [s]: IDM's reactions take seconds.
ROLLOUT_STEP = 0.4
# In which what a measured acceleration differs from the mean driver's IDM falls to 1/e [s].
FADE_TIME = 3.0


def rollout_policies(
    scene: Scene,
    read: Mapping[str, ManeuverState],
    rates: LaneChangeRates,
    longitudinal: Probabilities,
    horizon: tuple[float, int],
    following: LaneFollowing,
) -> dict[str, tuple[Policy, Drift]]:
    """Return a policy that differs from step to step, and the drift, of each vehicle whose maneuver was read.

    Args:
        scene: the ego and all others.
        read: lane intent and mode of the vehicles in question, by id.
        rates: of lane changes.
        longitudinal: distribution over the next mode, for all.
        horizon: period of a step [s] and number of steps H.
        following: how long a lane change takes.
    """
    others = [other for other in scene.others if other.id in read]
    lanes = [read[other.id].lane for other in others]
    rolled = rollout(scene.road, others, lanes, scene.ego, horizon, following)
    blind = rollout(scene.road, others, lanes, None, horizon, following)
    levels = larger_if_clear(rolled.levels, blind.levels, others, scene.ego, horizon[0] * horizon[1])
    count, found = scene.road.lane_count, {}
    for row, (other, lane) in enumerate(zip(others, lanes, strict=True)):
        tables = [
            lane_rows(count, lane, rates.of(lane, left, 0), rates.of(lane, right, 1), rates.unsafe)
            for left, right in levels[:, row].tolist()
        ]
        # Steps at the end that are alike are one table, so that equal policies are equal.
        while len(tables) > 1 and tables[-1] == tables[-2]:
            tables.pop()
        drift = np.column_stack([rolled.x[:, row], rolled.speed[:, row]])
        found[other.id] = Policy(tables[0], longitudinal, tuple(tables[1:])), tuple(map(tuple, drift.tolist()))
    return found


class Rollout(NamedTuple):
    """Where a rollout leads n vehicles.

    Attributes:
        levels: how much they want to change left and right at the start of each step, 0..3, (H, n, 2).
        x: how much farther they are after each step than at the speed of now, (H, n) [m].
        speed: how much faster than now, (H, n) [m/s].
    """

    levels: IntArray
    x: FloatArray
    speed: FloatArray


def rollout(
    road: Road,
    others: Sequence[VehicleState],
    lanes: Sequence[int],
    ego: VehicleState | None,
    horizon: tuple[float, int],
    following: LaneFollowing,
) -> Rollout:
    """Roll n vehicles out, each in the lane that it intends (docs/formulation.md, eq. 46).

    Args:
        road: the lanes.
        others: the vehicles, n of them.
        lanes: that each intends.
        ego: None leaves it out of the scene.
        horizon: period of a step [s] and number of steps H.
        following: how long a lane change takes.
    """
    period, steps = horizon
    n = len(others)
    vehicles = seen_vehicles(road, others, lanes, ego)
    y = np.array([state.y for state in [*others, *([] if ego is None else [ego])]])
    to_go = centers_of(road, vehicles.lane.astype(np.int64)) - y
    measured = np.array([other.accel for other in others])
    surplus: FloatArray | None = None
    substeps = int(np.ceil(period / ROLLOUT_STEP - 1e-9))
    dt, found = period / substeps, []
    start, moved, faster = vehicles, [], []
    for k in range(steps + 1):
        if k:
            for part in range(substeps):
                accel = idm_accels(vehicles, road.lane_count)
                if surplus is None:
                    surplus = np.zeros(len(accel))
                    surplus[:n] = measured - accel[:n]
                time = (k - 1) * period + part * dt
                accel = accel + surplus * np.exp(-time / FADE_TIME)
                speed = np.maximum(vehicles.speed + accel * dt, 0.0)
                vehicles = replace(vehicles, x=vehicles.x + (vehicles.speed + speed) / 2 * dt, speed=speed)
            moved.append((vehicles.x - start.x - k * period * start.speed)[:n])
            faster.append((vehicles.speed - start.speed)[:n])
            reach = following.change_speed(road) * k * period
            here = _lanes_at(road, y + np.clip(to_go, -reach, reach))
            vehicles = replace(vehicles, second_lane=np.where(here != vehicles.lane, here, 0))
        if k < steps:
            found.append(change_levels(vehicles, n, road.lane_count))
    return Rollout(np.stack(found), np.stack(moved), np.stack(faster))


def idm_accels(vehicles: Vehicles, lane_count: int) -> FloatArray:
    """Return how each vehicle accelerates behind its leaders in the lanes that it takes up [m/s2], (n,)."""
    near = find_neighbours(vehicles.x, vehicles.lane, vehicles.second_lane, lane_count, vehicles.length)
    scene = LaneScene.of(vehicles, near, lane_count, None, SUMO_IDM)
    rows = np.arange(len(vehicles.x))
    accel = scene.accel(rows, near.ahead[vehicles.lane - 1, rows])
    other = np.where(vehicles.second_lane > 0, vehicles.second_lane, vehicles.lane)
    return np.minimum(accel, scene.accel(rows, near.ahead[other - 1, rows]))


def _lanes_at(road: Road, y: FloatArray) -> IntArray:
    return np.array([road.lane_at(value) for value in y.tolist()], dtype=np.intp)
