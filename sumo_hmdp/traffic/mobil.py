"""MOBIL for the traffic: who changes lanes, of all vehicles of a step at once (docs/formulation.md, eqs. 26 and 27).

Kesting, Treiber, Helbing, "General lane-changing model MOBIL for car-following models", Transportation Research
Record 1999, 2007. With a the acceleration now and a' the one after the change, of the changer c, of the follower n
that it gets and of the follower o that it leaves, a change is wanted if

    any side:   a'(c) - a(c) + politeness [a'(n) - a(n) + a'(o) - a(o)] + bias > threshold,
    left only:  to the left   a'(c) - e(c)  + politeness [a'(n) - a(n)] + bias > threshold + right_bias,
                to the right  e'(c) - a(c)  + politeness [a'(o) - a(o)] + bias > threshold - right_bias,

where e is the acceleration of somebody who may not pass on the right (see `Passing`). It is safe if the new follower
need not brake harder than safe_decel. `decision/mobil.py` is the published baseline's variant, for the ego alone.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.errors import InputError
from sumo_hmdp.traffic.car_following import Drivers, FloatArray, accel_behind, own_terms
from sumo_hmdp.traffic.neighbours import IntArray, Neighbours, find_neighbours

BoolArray = NDArray[np.bool_]


class Passing(StrEnum):
    """Where one may pass slower vehicles.

    ANY_SIDE: the paper's symmetric rule.
    LEFT_ONLY: the paper's asymmetric, European rule. A vehicle that is faster than the leader in the lane to its left
        accelerates no more than it would behind that leader, unless that one is at most critical_speed fast.
        The paper has two lanes; with more the rule holds in every lane that has one to its left.
    """

    ANY_SIDE = "any_side"
    LEFT_ONLY = "left_only"


@dataclass(frozen=True)
class LaneChangeRule:
    """What holds for all drivers.

    The threshold and safe_decel are the defaults that other implementations quote from the paper; the other numbers are
    stated choices.

    Attributes:
        passing: where one may pass.
        threshold: incentive above which one changes [m/s2].
        safe_decel: how hard the new follower may have to brake, positive [m/s2]. The changer itself too, unless it
            brakes harder already: a bias must not send anybody against the new leader.
        right_bias: added to the incentive to go right, taken from that to go left [m/s2], such as 0.3 with
            LEFT_ONLY. It keeps right only where it is above the threshold.
        critical_speed: up to which traffic in the left lane is congested and may be passed on the right [m/s].
        least_gap: to the new leader and to the new follower [m].
    """

    passing: Passing = Passing.ANY_SIDE
    threshold: float = 0.1
    safe_decel: float = 4.0
    right_bias: float = 0.0
    critical_speed: float = 60.0 / 3.6
    least_gap: float = 2.0

    def __post_init__(self) -> None:
        """Refuse numbers that are not finite, or below 0."""
        names = ("threshold", "safe_decel", "right_bias", "critical_speed", "least_gap")
        values = {name: getattr(self, name) for name in names}
        problems = [
            f"{name} must be finite and at least 0, got {value}."
            for name, value in values.items()
            if not 0 <= value < np.inf
        ]
        if problems:
            raise InputError(problems)


@dataclass(frozen=True)
class Vehicles:
    """The n vehicles of a step, the ego included; every array has the shape (n,).

    Attributes:
        x: front bumpers [m].
        speed: [m/s].
        lane: 1 is leftmost.
        second_lane: the other lane that a vehicle occupies while it changes, 0 for none.
        length: [m].
        politeness: weight of what the followers gain or lose.
        drivers: how they follow; for the ego, how others believe it does.
    """

    x: FloatArray
    speed: FloatArray
    lane: IntArray
    second_lane: IntArray
    length: FloatArray
    politeness: FloatArray
    drivers: Drivers


def choose_lanes(
    vehicles: Vehicles,
    rule: LaneChangeRule,
    allowed: BoolArray,
    may_change: BoolArray,
    bias: FloatArray | None = None,
    lane_end: FloatArray | None = None,
) -> IntArray:
    """Return who changes lanes now: -1 to the left, 0 not, +1 to the right, shape (n,).

    Everybody decides on the same scene. Of two whose changes would bring them too near each other the one with the
    larger incentive goes, the earlier one in the arrays if they are equal, and the other waits. With equal
    incentives for both sides the left one is taken. Vehicles that occupy two lanes go on as they are.

    Args:
        vehicles: all that are on the road.
        rule: what holds for all of them.
        allowed: lanes that each may drive in, shape (n, lane_count); a lane that is not there is not allowed.
        may_change: who decides at all, shape (n,), such as those whose last change is long enough ago.
        bias: added to the incentive [m/s2], shape (n, 2), left and right: what a route needs.
        lane_end: x [m] of where a lane ends for a vehicle, infinite where it does not, shape (n, lane_count).
            It is seen as a standing leader without length.
    """
    lane_count = allowed.shape[1]
    near = find_neighbours(vehicles.x, vehicles.lane, vehicles.second_lane, lane_count, vehicles.length)
    side, changer = _candidates(vehicles, allowed, may_change)
    moves = np.zeros(len(vehicles.x), dtype=np.intp)
    if not len(changer):
        return moves
    scene = _Scene.of(vehicles, near, lane_count, lane_end)
    incentive = _incentives(scene, rule, vehicles.politeness, side, changer)
    if bias is not None:
        incentive = incentive + bias[changer, side]
    wanted = np.flatnonzero(incentive > rule.threshold)
    if not len(wanted):
        return moves
    best = np.full((2, len(moves)), -np.inf)
    best[side[wanted], changer[wanted]] = incentive[wanted]
    most = best.max(axis=0)
    movers = np.flatnonzero(most > -np.inf)
    moves[movers] = 2 * best[:, movers].argmax(axis=0) - 1
    return _without_conflicts(scene, rule, moves, movers, most)


def _candidates(vehicles: Vehicles, allowed: BoolArray, may_change: BoolArray) -> tuple[IntArray, IntArray]:
    """Return every change that may be thought of: side, 0 left and 1 right, and vehicle."""
    count, lane_count = allowed.shape
    # A column on either side, so that no lane's neighbour is the lane at the other end.
    open_lanes = np.zeros((count, lane_count + 2), dtype=bool)
    open_lanes[:, 1:-1] = allowed
    everybody = np.arange(count)
    open_sides = np.array([open_lanes[everybody, vehicles.lane - 1], open_lanes[everybody, vehicles.lane + 1]])
    side, changer = np.nonzero(open_sides & may_change & (vehicles.second_lane == 0))
    return side, changer


@dataclass(frozen=True)
class _Scene:
    """The vehicles and, as number n, nobody: a leader infinitely far ahead and a follower infinitely far behind.

    Attributes:
        front: x of the front bumpers [m], shape (n + 1,).
        rear: x of the rear bumpers [m], shape (n + 1,).
        own: what each one's acceleration takes from itself, shape (6, n + 1).
        lane: 1 is leftmost, shape (n,).
        near: who is next to whom.
        end_gap: to the end of each lane [m], shape (lane_count, n + 1), None where no lane ends.
    """

    front: FloatArray
    rear: FloatArray
    own: FloatArray
    lane: IntArray
    near: Neighbours
    end_gap: FloatArray | None

    @classmethod
    def of(cls, vehicles: Vehicles, near: Neighbours, lane_count: int, lane_end: FloatArray | None) -> "_Scene":
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
        return cls(front, rear, own, vehicles.lane, near, end_gap)

    def accel(self, follower: IntArray, leader: IntArray) -> FloatArray:
        """Return how followers accelerate behind leaders [m/s2], whatever the lane's end."""
        # `take` is three times as fast as indexing here.
        gap = self.rear.take(leader) - self.front.take(follower)
        return accel_behind(self.own.take(follower, axis=1), gap, self.own[5].take(leader))

    def accel_before_end(self, accel: FloatArray, follower: IntArray, lane_row: IntArray) -> FloatArray:
        """Return the accelerations [m/s2] of followers that also see where their lane ends."""
        if self.end_gap is None:
            return accel
        return np.minimum(accel, accel_behind(self.own.take(follower, axis=1), self.end_gap[lane_row, follower], 0.0))


def _incentives(
    scene: _Scene, rule: LaneChangeRule, politeness: FloatArray, side: IntArray, changer: IntArray
) -> FloatArray:
    """Return the incentive of every candidate [m/s2], minus infinity where the change is not safe."""
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
    safe = (np.minimum(gap_ahead, gap_behind) >= rule.least_gap) & (bare[5] >= -rule.safe_decel)
    safe &= go >= np.minimum(-rule.safe_decel, stay)
    if rule.passing is Passing.LEFT_ONLY:
        left = side == 0
        others = np.where(left, new_then - new_now, old_then - old_now)
        own = _own_gain_without_passing(scene, rule, (here, there), changer, bare[:2], np.array([stay, go]))
    else:
        others = new_then - new_now + old_then - old_now
        own = go - stay
    incentive = own + politeness.take(changer) * others + rule.right_bias * (2 * side - 1)
    return np.where(safe, incentive, -np.inf)


def _own_gain_without_passing(
    scene: _Scene,
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


def _without_conflicts(
    scene: _Scene, rule: LaneChangeRule, moves: IntArray, movers: IntArray, incentive: FloatArray
) -> IntArray:
    """Return the moves of the movers without those that would come too near to one with a larger incentive."""
    target = scene.lane[movers] + moves[movers]
    if len(set(target.tolist())) == len(target):
        return moves
    ranking = np.argsort(-incentive[movers], kind="stable")
    movers, target = movers[ranking], target[ranking]
    rank = scene.near.rank[movers]
    rear, front = np.nonzero((target[:, None] == target) & (rank[:, None] < rank))
    gap = scene.rear[movers[front]] - scene.front[movers[rear]]
    near = (gap < rule.least_gap) | (scene.accel(movers[rear], movers[front]) < -rule.safe_decel)
    goes = np.ones(len(movers), dtype=bool)
    # Few pairs are left, in the order of whose turn it is.
    for first, second in sorted(zip(*np.sort([rear[near], front[near]], axis=0), strict=True)):
        goes[second] &= not goes[first]
    moves[movers[~goes]] = 0
    return moves
