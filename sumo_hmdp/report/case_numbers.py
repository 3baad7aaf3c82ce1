"""Measures of the paper's cases, taken from runs: when, where, how near, and how likely to go wrong."""

from collections.abc import Iterable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.domain.scene import EGO_ID
from sumo_hmdp.report.case_data import CaseBranch, CaseDecision, CaseRun, Motion

# Worlds drawn for a joint probability; its standard error is at most 0.5 / sqrt of this.
WORLDS = 40_000
# An ego this near its lane's centre has arrived [m].
ARRIVED = 0.05
Bools = NDArray[np.bool_]


def overtakes_at(front: Motion, back: Motion) -> float | None:
    """Return when one vehicle's front first is ahead of another's [s], None if never."""
    ahead = np.flatnonzero(front.x > back.x)
    return float(front.times[ahead[0]]) if len(ahead) else None


def hardest_decel(motion: Motion) -> float:
    """Return the largest deceleration [m/s2], 0 if it never brakes."""
    return max(0.0, -float(motion.accel.min()))


def mean_speed(motion: Motion) -> float:
    """Return the distance covered over the time it took [m/s]."""
    return float((motion.x[-1] - motion.x[0]) / (motion.times[-1] - motion.times[0]))


def lane_at(run: CaseRun, motion: Motion, time: float) -> int:
    """Return the lane in which a vehicle's middle is."""
    y = float(motion.y[motion.index(time)])
    return min(range(1, run.lane_count + 1), key=lambda lane: abs(run.center_y(lane) - y))


def arrives_at(run: CaseRun, decision: CaseDecision) -> float | None:
    """Return when the ego is on the centre of the lane that a decision chose [s], None if never."""
    ego = run.ego
    there = (ego.times >= decision.time) & (np.abs(ego.y - run.center_y(decision.lane)) < ARRIVED)
    return float(ego.times[there][0]) if there.any() else None


def least_distance(run: CaseRun) -> float:
    """Return the least distance between front bumpers to a vehicle in the lane that the ego intends [m].

    At all instants; the paper's constraint keeps it above the safe distance at the ends of steps only.
    """
    return _least_distance(run, [(float(time), run.decision_at(float(time)).lane) for time in run.ego.times])


def least_distance_at_ends(run: CaseRun) -> float:
    """Return the same at the ends of steps only, in the lane that the ego intended during the step [m]."""
    return _least_distance(run, [(after.time, before.lane) for before, after in pairwise(run.decisions)])


def _least_distance(run: CaseRun, moments: Iterable[tuple[float, int]]) -> float:
    ego, least = run.ego, np.inf
    for time, lane in moments:
        at = ego.index(time)
        for vehicle_id, motion in run.motions.items():
            if vehicle_id != EGO_ID and at < len(motion.times) and lane_at(run, motion, time) == lane:
                least = min(least, abs(float(motion.x[at] - ego.x[at])))
    return float(least)


def worst_joint_probability(run: CaseRun, seed: int = 0) -> float:
    """Return the largest probability, over the decisions, that any distance falls short within the horizon.

    It is that of the paper's joint constraint: every branch that was kept, at every step, for every vehicle. A
    vehicle's branches share its noise, a random walk that is drawn `WORLDS` times; vehicles are independent. Holds
    where the noise moves positions only and all branches were recorded.

    Args:
        run: a run with the fixed safe distance.
        seed: of the worlds.
    """
    horizon = max(len(decision.plan) for decision in run.decisions)
    worst = 0.0
    for index, decision in enumerate(run.decisions):
        if decision.plan:
            normals = np.random.default_rng([seed, index]).standard_normal((WORLDS, horizon))
            worst = max(worst, _joint_probability(run, decision, normals))
    return worst


def _joint_probability(run: CaseRun, decision: CaseDecision, normals: NDArray[np.float64]) -> float:
    safe = 1.0
    for shift, vehicle_id in enumerate(dict.fromkeys(branch.vehicle_id for branch in decision.branches)):
        # Another vehicle, other worlds.
        own = np.roll(normals, 7919 * shift, axis=0)
        short = np.zeros(len(normals), dtype=np.bool_)
        for branch in decision.branches:
            if branch.vehicle_id == vehicle_id:
                short |= _falls_short(decision, branch, run.safe_distance or 0.0, own)
        safe *= 1.0 - float(short.mean())
    return 1.0 - safe


def _falls_short(decision: CaseDecision, branch: CaseBranch, distance: float, normals: NDArray[np.float64]) -> Bools:
    """Return in which worlds the distance to a branch falls short at any step, on the side where the plan is."""
    variances = np.square(np.array(branch.x_std))
    steps = np.sqrt(np.maximum(np.diff(variances, prepend=0.0), 0.0))
    deviation = np.cumsum(normals * steps, axis=1)
    short = np.zeros(len(normals), dtype=np.bool_)
    for k, point in enumerate(decision.plan):
        if point.lane == branch.lanes[k]:
            ahead = point.x - branch.x[k]
            side = 1.0 if ahead > 0 else -1.0
            short |= side * deviation[:, k] > abs(ahead) - distance
    return short
