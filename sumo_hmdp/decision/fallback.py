"""What to do where every plan means contact: brake in lane, as hard as needed (docs/formulation.md, eq. 15)."""

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.decision.occupancy import lanes_along, occupied_lanes, shares_lane, start_state
from sumo_hmdp.decision.problem import DecisionProblem
from sumo_hmdp.decision.stop_lines import nearest_line
from sumo_hmdp.domain.maneuver import Lateral
from sumo_hmdp.domain.occupancy import LaneState, Occupancy
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.prediction.branches import Branches

# The hardest braking that is asked of the vehicle [m/s2]; a dry road gives about this much to a passenger car.
MAX_BRAKE = 8.0


def braking_demand(problem: DecisionProblem, branches: Branches) -> tuple[float, str | None]:
    """Return the deceleration to brake with [m/s2] and what demands it.

    A vehicle counts if it is ahead of the ego or beside it, and a branch of it takes up a lane at some step which the
    ego, keeping its lane, takes up then: the lanes that are intended, and under `swept` those that bodies are over, now
    as well. Who is ahead demands closing_speed^2 / (2 gap) against its speed there, and who is beside the ego the most,
    unless the ego is sooner before it than behind it (`_sooner_behind`); at least the nominal magnitude of the modes,
    at most `MAX_BRAKE`, which also answers a gap that is gone. A stop line in the ego's lane counts like a vehicle that
    stands.
    """
    ego, demand, blocker = problem.ego, problem.settings.accel, None
    now, in_lane = _shared(problem, branches)
    for index, vehicle in enumerate(problem.vehicles):
        mine = branches.vehicle == index
        other = vehicle.state
        ahead = other.x > ego.x
        speeds = branches.speed[mine][in_lane[mine]].tolist() + [other.speed] * bool(now[index])
        if not speeds or not (ahead or _sooner_behind(ego, other, problem.settings.accel)):
            continue
        gap = other.x - other.length - ego.x
        closing_speed = max(0.0, ego.speed - min(speeds))
        needed = MAX_BRAKE if gap <= 0 else min(MAX_BRAKE, closing_speed**2 / (2 * gap))
        if needed > demand:
            demand, blocker = needed, other.id
    line = nearest_line(ego, problem.stop_lines, LaneState(ego.lane))
    if line is not None:
        gap = line.x - ego.x
        needed = MAX_BRAKE if gap <= 0 else min(MAX_BRAKE, ego.speed**2 / (2 * gap))
        if needed > demand:
            demand, blocker = needed, f"the stop line at {line.x:.2f} m"
    return demand, blocker


def _shared(problem: DecisionProblem, branches: Branches) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Tell who takes up a lane that the ego takes up while it keeps its lane: vehicles now, (V,), and branches, (B, H).

    By the paper's rule only what is intended counts, which a vehicle may give up with its first step.
    """
    own = lanes_along(problem, (Lateral.KEEP,) * problem.settings.horizon_steps)
    later = np.asarray((occupied_lanes(problem, branches) & own).any(axis=2))
    if problem.settings.occupancy is Occupancy.TARGET:
        return np.zeros(len(problem.vehicles), dtype=bool), later
    return shares_lane(problem, branches, start_state(problem)), later


def _sooner_behind(ego: VehicleState, other: VehicleState, accel: float) -> bool:
    """Tell whether a vehicle is beside the ego, and the ego is sooner behind it, braking hard, than before it.

    From equal speeds a way w takes sqrt(2 w / a), with a = MAX_BRAKE or accel.

    Args:
        ego: the ego.
        other: a vehicle whose front bumper is not ahead of the ego's.
        accel: with which the ego would get before it [m/s2].
    """
    to_behind, to_before = ego.x - (other.x - other.length), other.x - (ego.x - ego.length)
    return to_before > 0.0 and to_behind / MAX_BRAKE <= to_before / accel
