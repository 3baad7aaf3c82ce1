"""What a lane change would mean: accelerations, gaps, incentive and safety of many changes at once (eqs. 26 and 27).

The equations are in `mobil.py`, which chooses by them.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.traffic.car_following import FloatArray, IdmVariant, accel_behind, own_terms
from sumo_hmdp.traffic.lane_change import LaneChangeRule, Passing, Vehicles
from sumo_hmdp.traffic.neighbours import IntArray, Neighbours, find_neighbours

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class Weighed:
    """Lane changes as MOBIL sees them, one a column; every array has the shape (m,).

    Attributes:
        stay: acceleration of the changer in its lane [m/s2].
        go: in the new one [m/s2].
        incentive: by the accelerations, without a route [m/s2].
        new_follower: acceleration of the follower that it gets, behind it [m/s2].
        old_follower: of the one that it leaves, behind its leader [m/s2].
        gap_ahead: to the new leader or the lane's end [m], infinite where there is none.
        gap_behind: of the new follower [m], infinite where there is none.
        safe: whether nobody is endangered.
    """

    stay: FloatArray
    go: FloatArray
    incentive: FloatArray
    new_follower: FloatArray
    old_follower: FloatArray
    gap_ahead: FloatArray
    gap_behind: FloatArray
    safe: BoolArray


def weigh_changes(
    vehicles: Vehicles,
    rule: LaneChangeRule,
    changer: int,
    lanes: IntArray,
    lane_end: FloatArray | None,
    lane_count: int,
) -> Weighed:
    """Return what one vehicle's changes into lanes beside its own would mean.

    Args:
        vehicles: all that are on the road.
        rule: what holds.
        changer: its row.
        lanes: each one beside its lane, shape (m,).
        lane_end: as for `choose_lanes`.
        lane_count: of the road.
    """
    # The published code sees vehicles as points along the road when it looks for neighbours.
    length = None if rule.published else vehicles.length
    near = find_neighbours(vehicles.x, vehicles.lane, vehicles.second_lane, lane_count, length)
    scene = LaneScene.of(vehicles, near, lane_count, lane_end, rule.idm)
    side = (lanes > vehicles.lane[changer]).astype(np.intp)
    return weigh(scene, rule, vehicles.politeness, side, np.full(len(lanes), changer, dtype=np.intp))


def accel_in_lanes(
    vehicles: Vehicles, idm: IdmVariant, driver: int, lane_end: FloatArray | None, lane_count: int, *, by_front: bool
) -> FloatArray:
    """Return the acceleration of one vehicle behind its leader, and before the end, in every lane [m/s2].

    Args:
        vehicles: all that are on the road.
        idm: the variant of the model.
        driver: its row.
        lane_end: as for `choose_lanes`.
        lane_count: of the road.
        by_front: whether the leader is the nearest front bumper ahead rather than the nearest rear one.
    """
    length = None if by_front else vehicles.length
    near = find_neighbours(vehicles.x, vehicles.lane, vehicles.second_lane, lane_count, length)
    scene = LaneScene.of(vehicles, near, lane_count, lane_end, idm)
    lane_rows = np.arange(lane_count)
    followers = np.full(lane_count, driver, dtype=np.intp)
    return scene.accel_before_end(scene.accel(followers, near.ahead[:, driver]), followers, lane_rows)


@dataclass(frozen=True)
class LaneScene:
    """The vehicles and, as number n, nobody: a leader infinitely far ahead and a follower infinitely far behind.

    Attributes:
        front: x of the front bumpers [m], shape (n + 1,).
        rear: x of the rear bumpers [m], shape (n + 1,).
        own: what each one's acceleration takes from itself, shape (6, n + 1).
        lane: 1 is leftmost, shape (n,).
        near: who is next to whom.
        end_gap: to the end of each lane [m], shape (lane_count, n + 1), None where no lane ends.
        idm: the variant of the car-following model.
    """

    front: FloatArray
    rear: FloatArray
    own: FloatArray
    lane: IntArray
    near: Neighbours
    end_gap: FloatArray | None
    idm: IdmVariant

    @classmethod
    def of(
        cls, vehicles: Vehicles, near: Neighbours, lane_count: int, lane_end: FloatArray | None, idm: IdmVariant
    ) -> "LaneScene":
        """Return the scene of the vehicles."""
        count = len(vehicles.x)
        front, rear, own = np.full(count + 1, -np.inf), np.full(count + 1, np.inf), np.ones((6, count + 1))
        front[:count] = vehicles.x
        rear[:count] = vehicles.x - vehicles.length
        own[:, :count] = own_terms(vehicles.drivers, vehicles.speed)
        own[5, count] = 0.0
        end_gap = None
        if lane_end is not None:
            end_gap = np.full((lane_count, count + 1), np.inf)
            end_gap[:, :count] = lane_end.T - vehicles.x
        return cls(front, rear, own, vehicles.lane, near, end_gap, idm)

    def accel(self, follower: IntArray, leader: IntArray) -> FloatArray:
        """Return how followers accelerate behind leaders [m/s2], whatever the lane's end."""
        # `take` is three times as fast as indexing here.
        gap = self.rear.take(leader) - self.front.take(follower)
        return accel_behind(self.own.take(follower, axis=1), gap, self.own[5].take(leader), self.idm)

    def accel_before_end(self, accel: FloatArray, follower: IntArray, lane_row: IntArray) -> FloatArray:
        """Return the accelerations [m/s2] of followers that also see where their lane ends."""
        if self.end_gap is None:
            return accel
        before = accel_behind(self.own.take(follower, axis=1), self.end_gap[lane_row, follower], 0.0, self.idm)
        return np.minimum(accel, before)


def weigh(scene: LaneScene, rule: LaneChangeRule, politeness: FloatArray, side: IntArray, changer: IntArray) -> Weighed:
    """Return what every candidate's change would mean."""
    here = scene.lane.take(changer) - 1
    there = here + 2 * side - 1
    # Places in the tables of lanes by vehicles, read row after row.
    place_here, place_there = (lane * len(scene.lane) + changer for lane in (here, there))
    ahead_here, ahead_there = scene.near.ahead.take(place_here), scene.near.ahead.take(place_there)
    old, new = scene.near.behind.take(place_here), scene.near.behind.take(place_there)
    followers = np.array([changer, changer, old, old, new, new])
    leaders = np.array([ahead_here, ahead_there, changer, ahead_here, ahead_there, changer])
    bare = scene.accel(followers, leaders)
    stay, go, old_now, old_then, new_now, new_then = scene.accel_before_end(
        bare, followers, np.array([here, there, here, here, there, there])
    )
    gap_ahead = scene.rear.take(ahead_there) - scene.front.take(changer)
    if scene.end_gap is not None:
        gap_ahead = np.minimum(gap_ahead, scene.end_gap[there, changer])
    gap_behind = scene.rear.take(changer) - scene.front.take(new)
    safe = bare[5] >= -rule.safe_decel
    if rule.published:
        safe &= bare[3] >= -rule.safe_decel
    else:
        safe &= (np.minimum(gap_ahead, gap_behind) >= rule.least_gap) & (go >= np.minimum(-rule.safe_decel, stay))
    if rule.passing is Passing.LEFT_ONLY:
        left = side == 0
        others = np.where(left, new_then - new_now, old_then - old_now)
        own = _own_gain_without_passing(scene, rule, (here, there), changer, bare[:2], np.array([stay, go]))
    else:
        others = new_then - new_now + old_then - old_now
        own = go - stay
    incentive = own + politeness.take(changer) * others + rule.right_bias * (2 * side - 1)
    return Weighed(stay, go, incentive, bare[5], bare[3], gap_ahead, gap_behind, safe)


def _own_gain_without_passing(
    scene: LaneScene,
    rule: LaneChangeRule,
    lanes: tuple[IntArray, IntArray],
    changer: IntArray,
    bare: FloatArray,
    accels: FloatArray,
) -> FloatArray:
    """Return what the changers gain [m/s2] if they may not pass on the right, neither here nor there.

    Args:
        scene: everybody.
        rule: the critical speed.
        lanes: rows of the present and of the new lane.
        changer: who.
        bare: accelerations behind the leaders here and there [m/s2], shape (2, m).
        accels: the same before the ends of the lanes.
    """
    here, there = lanes
    nobody = len(scene.lane)
    leftmost = np.minimum(here, there) - 1
    beyond = np.where(leftmost >= 0, scene.near.ahead[leftmost, changer], nobody)
    to_left = there < here
    # Of the lane to the left of the one here, and of the one there: its leader, and the acceleration behind it.
    leader = np.stack(
        [
            np.where(to_left, scene.near.ahead[there, changer], beyond),
            np.where(to_left, beyond, scene.near.ahead[here, changer]),
        ]
    )
    behind_beyond = scene.accel(changer, beyond)
    behind_left = np.array([np.where(to_left, bare[1], behind_beyond), np.where(to_left, behind_beyond, bare[0])])
    lead_speed = scene.own[5, leader]
    binding = (scene.own[5, changer] > lead_speed) & (lead_speed > rule.critical_speed)
    stay, go = np.where(binding, np.minimum(accels, behind_left), accels)
    gain: FloatArray = go - stay
    return gain
