"""What to do where every plan means contact: brake in lane, as hard as needed (docs/formulation.md, eq. 15)."""

import numpy as np

from sumo_hmdp.domain.occupancy import LaneState
from sumo_hmdp.hmdp.branches import Branches
from sumo_hmdp.planning.problem import DecisionProblem
from sumo_hmdp.planning.stop_lines import nearest_line

# The hardest braking that is asked of the vehicle [m/s2]; a dry road gives about this much to a passenger car.
MAX_BRAKE = 8.0


def braking_demand(problem: DecisionProblem, branches: Branches) -> tuple[float, str | None]:
    """Return the deceleration to brake with [m/s2] and what demands it.

    A vehicle counts if a branch of it is ahead of the ego and intends the ego's lane at some step. Against its
    speed there, the ego needs closing_speed^2 / (2 gap); at least the nominal magnitude of the modes, at most
    `MAX_BRAKE`, which also answers a gap that is gone. A stop line in the ego's lane counts like a vehicle that stands.
    """
    ego, demand, blocker = problem.ego, problem.settings.accel, None
    in_lane = branches.lanes == ego.lane
    for index, vehicle in enumerate(problem.vehicles):
        mine = branches.vehicle == index
        if vehicle.state.x <= ego.x or not in_lane[mine].any():
            continue
        gap = vehicle.state.x - vehicle.state.length - ego.x
        slowest = float(np.min(branches.speed[mine][in_lane[mine]]))
        closing_speed = max(0.0, ego.speed - slowest)
        needed = MAX_BRAKE if gap <= 0 else min(MAX_BRAKE, closing_speed**2 / (2 * gap))
        if needed > demand:
            demand, blocker = needed, vehicle.state.id
    line = nearest_line(ego, problem.stop_lines, LaneState(ego.lane))
    if line is not None:
        gap = line.x - ego.x
        needed = MAX_BRAKE if gap <= 0 else min(MAX_BRAKE, ego.speed**2 / (2 * gap))
        if needed > demand:
            demand, blocker = needed, f"the stop line at {line.x:.2f} m"
    return demand, blocker
