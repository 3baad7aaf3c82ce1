"""Courtesy: who lets in a vehicle that has to leave its lane, and how (docs/formulation.md, eqs. 30 and 31).

Gap creation as in the LMRS: Schakel, Knoop, van Arem, "Integrated lane change model with relaxation and
synchronization", Transportation Research Record 2316, 2012. The driver behind a vehicle that has to change into its
lane follows that vehicle as if it were there already, and brakes no harder for it than comfortably. In Hidas,
"Modelling vehicle interactions in microscopic simulation of merging and weaving", Transportation Research Part C 13,
2005, the followers are asked one after the other, and the first for whom the deceleration is acceptable gives way.

A vehicle asks for room, its indicator is on, whoever drives it, if its lane ends ahead or does not lead where it is
going, and eq. 30 holds. To each one that asks the nearest willing driver in the lane beside, behind its rear bumper,
gives way that can by eq. 31.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.errors import InputError, Problem
from sumo_hmdp.traffic.car_following import FloatArray, accel_behind, own_terms
from sumo_hmdp.traffic.mobil import Vehicles
from sumo_hmdp.traffic.neighbours import find_neighbours

IntArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]

# Who could accelerate by less than this without courtesy waits for its own leader [m/s2].
_CREEPS = 0.1


@dataclass(frozen=True)
class CourtesyRule:
    """What holds for all drivers.

    Attributes:
        share: of drivers who let others in. In the LMRS, and by SUMO's default, all of them do.
        distance: a vehicle asks from this far before the place where it would have to begin to brake comfortably
            [m]. A stated choice: twice the merging room of a lane that ends.
        patience: how long one holds back [s]; then one drives on for as long, so that who asks and does not come
            blocks nobody. A stated choice: time to see the gap, and for a lane change of 4 s.
    """

    share: float = 1.0
    distance: float = 50.0
    patience: float = 10.0

    def __post_init__(self) -> None:
        """Refuse numbers out of their range."""
        problems = []
        if not 0.0 <= self.share <= 1.0:
            problems.append(Problem("share", f"share must be in [0, 1], got {self.share}."))
        for name in ("distance", "patience"):
            if not 0.0 <= getattr(self, name) < np.inf:
                message = f"{name} must be finite and at least 0, got {getattr(self, name)}."
                problems.append(Problem(name, message))
        if problems:
            raise InputError(problems)


@dataclass(frozen=True)
class Approach:
    """Vehicles that may have to leave their lanes, in arrays of shape (n,).

    Attributes:
        x: front bumpers [m].
        speed: [m/s].
        lane: 1 is leftmost.
        decel: comfortable, b [m/s2].
    """

    x: FloatArray
    speed: FloatArray
    lane: IntArray
    decel: FloatArray


def asked_lanes(rule: CourtesyRule, vehicles: Approach, ends: FloatArray, exists: BoolArray) -> IntArray:
    """Return the lane beside in which each vehicle asks for room, 0 where it asks for none, shape (n,).

    It lies toward the nearest lane that goes on farther than the vehicle's own, the left one of two that are as near.

    Args:
        rule: from where on one asks.
        vehicles: n of them.
        ends: x of where each lane ends for a vehicle [m], infinite where it does not, shape (n, lane_count).
        exists: which lanes are there beside it, shape (n, lane_count).
    """
    lane = vehicles.lane
    asked = np.zeros(len(lane), dtype=np.intp)
    own = ends[np.arange(len(lane)), lane - 1]
    braking_way = vehicles.speed**2 / (2.0 * vehicles.decel)
    near = np.flatnonzero(own - vehicles.x <= braking_way + rule.distance)
    if not len(near):
        return asked
    away = np.abs(np.arange(1, ends.shape[1] + 1) - lane[near, None]).astype(np.float64)
    away[~exists[near] | (ends[near] <= own[near, None])] = np.inf
    best = away.argmin(axis=1)
    beside = lane[near] + np.sign(best + 1 - lane[near])
    there = np.isfinite(away.min(axis=1)) & exists[near, beside - 1]
    asked[near[there]] = beside[there]
    return asked


@dataclass(frozen=True)
class Room:
    """Who is slower out of courtesy than its own leader makes it, each driver once, in arrays of shape (k,).

    Attributes:
        driver: number of the vehicle.
        accel: the most that courtesy lets it accelerate [m/s2].
        waits: whether it would accelerate if it were not for courtesy.
    """

    driver: IntArray
    accel: FloatArray
    waits: BoolArray


def give_way(vehicles: Vehicles, asked: IntArray, willing: BoolArray, keep: float, dt: float) -> Room:
    """Return who gives way to those that ask.

    Args:
        vehicles: all n that are on the road.
        asked: the lane in which each asks for room, 0 for none, shape (n,). Who occupies two lanes is seen in both,
            and asks no more.
        willing: who gives way at all, shape (n,).
        keep: how much farther back one stays than behind a leader [m]: the least gap into which somebody may change.
        dt: step [s]. Who stands, or comes to stand in one step by b, need not brake.
    """
    asks = np.flatnonzero((asked > 0) & (vehicles.second_lane == 0))
    rear, own = vehicles.x - vehicles.length, own_terms(vehicles.drivers, vehicles.speed)
    gap = rear[asks] - vehicles.x[:, None] - keep
    driver, request = np.nonzero(willing[:, None] & (vehicles.lane[:, None] == asked[asks]) & (gap > 0.0))
    accel = accel_behind(own[:, driver], gap[driver, request], vehicles.speed[asks[request]])
    needed = np.minimum(-accel, vehicles.speed[driver] / dt)
    able = needed <= vehicles.drivers.decel[driver]
    driver, request, accel = driver[able], request[able], accel[able]
    # Of each request the driver that is farthest ahead, of two that are level the later one in the arrays.
    order = np.lexsort((driver, vehicles.x[driver], request))
    last = np.append(request[order][1:] != request[order][:-1], True)[: len(order)]
    chosen = order[last]
    # Who gives way to two is held back by the one that takes more.
    chosen = chosen[np.lexsort((accel[chosen], driver[chosen]))]
    driver, first = np.unique(driver[chosen], return_index=True)
    accel = accel[chosen[first]]
    free = _behind_leaders(vehicles, rear, own, driver)
    slower = accel < free
    return Room(driver[slower], accel[slower], free[slower] > _CREEPS)


def _behind_leaders(vehicles: Vehicles, rear: FloatArray, own: FloatArray, driver: IntArray) -> FloatArray:
    """Return how drivers accelerate behind the leaders in their own lanes, as `find_neighbours` has them [m/s2]."""
    if not len(driver):
        return np.empty(0)
    lane_count = int(max(vehicles.lane.max(), vehicles.second_lane.max()))
    near = find_neighbours(vehicles.x, vehicles.lane, vehicles.second_lane, lane_count, vehicles.length)
    leader = near.ahead[vehicles.lane[driver] - 1, driver]
    # Its number is that of nobody where there is none.
    gap = np.append(rear, np.inf)[leader] - vehicles.x[driver]
    return accel_behind(own[:, driver], gap, np.append(vehicles.speed, 0.0)[leader])


class Patience:
    """How long each of n drivers has held back.

    Attributes:
        over: whose patience is over, shape (n,): until they have driven on for as long.
    """

    def __init__(self, count: int, patience: float) -> None:
        """Begin with nobody having held back.

        Args:
            count: n.
            patience: how long one holds back [s].
        """
        self._patience = patience
        self._held = np.zeros(count)
        self.over = np.zeros(count, dtype=bool)

    def note(self, held: IntArray, dt: float) -> None:
        """Note a step of dt [s] in which some drivers, by their numbers, have held back, and the others have not."""
        if not len(held) and not self._held.any():
            return
        change = np.full(len(self._held), -dt)
        change[held] = dt
        self._held = np.maximum(0.0, self._held + change)
        self.over = (self._held >= self._patience) | (self.over & (self._held > 0.0))
