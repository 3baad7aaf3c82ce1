"""MOBIL for the traffic: who changes lanes, of all vehicles of a step at once (docs/formulation.md, eqs. 26 and 27).

Kesting, Treiber, Helbing, "General lane-changing model MOBIL for car-following models", Transportation Research
Record 1999, 2007. With a the acceleration now and a' the one after the change, of the changer c, of the follower n
that it gets and of the follower o that it leaves, a change is wanted if

    any side:   a'(c) - a(c) + politeness [a'(n) - a(n) + a'(o) - a(o)] + bias > threshold,
    left only:  to the left   a'(c) - e(c)  + politeness [a'(n) - a(n)] + bias > threshold + right_bias,
                to the right  e'(c) - a(c)  + politeness [a'(o) - a(o)] + bias > threshold - right_bias,

where e is the acceleration of somebody who may not pass on the right (see `Passing`). It is safe if the new follower
need not brake harder than safe_decel, nor, unless it does so already, the changer, and there is room for its body.
`LaneChangeRule` can also be the rule of the code published with the paper, which asks for other things.
"""

import numpy as np

from sumo_hmdp.traffic.car_following import FloatArray
from sumo_hmdp.traffic.incentive import BoolArray, LaneScene, weigh
from sumo_hmdp.traffic.lane_change import LaneChangeRule, Passing, Vehicles
from sumo_hmdp.traffic.neighbours import IntArray, find_neighbours

__all__ = ["LaneChangeRule", "Passing", "Vehicles", "choose_lanes"]


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
    scene = LaneScene.of(vehicles, near, lane_count, lane_end, rule.idm)
    weighed = weigh(scene, rule, vehicles.politeness, side, changer)
    incentive = np.where(weighed.safe, weighed.incentive, -np.inf)
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


def _without_conflicts(
    scene: LaneScene, rule: LaneChangeRule, moves: IntArray, movers: IntArray, incentive: FloatArray
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
