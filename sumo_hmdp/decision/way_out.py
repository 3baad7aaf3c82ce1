"""The way out at the end of a plan: from its last state, braking must keep the distance to every vehicle ahead.

Beyond the horizon a vehicle is taken to go on at its speed, and the ego to brake with the acceleration of its modes,
after one period of cruising if it accelerates. So it comes nearer to a vehicle of speed u by

    e = max(0, v - u)^2 / (2 accel) + T max(0, v - u) [the ego accelerates]

and the place of the vehicle must be at least d_b + e ahead (docs/formulation.md, eq. 35). What the horizon itself does
not charge of that is added to the risk of the plan. Without it a higher risk level makes plans that end too fast behind
a vehicle, and the decisions after them have nothing left that keeps the risk.
"""

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtr

from sumo_hmdp.decision.distance import clearance_to
from sumo_hmdp.decision.encounters import FAR, deviations_of, vehicle_places
from sumo_hmdp.decision.graph import GraphStep
from sumo_hmdp.decision.problem import DISTANCE_TOLERANCE, DecisionProblem
from sumo_hmdp.prediction.branches import PredictedVehicle
from sumo_hmdp.prediction.dynamics import FloatArray


def way_out_risk(
    problem: DecisionProblem, vehicles: Sequence[PredictedVehicle], last: GraphStep, taken: FloatArray
) -> FloatArray:
    """Return the risk of having no way out, by footprint and motion at the end of the horizon, (U, M) (eq. 35).

    Args:
        problem: the decision problem.
        vehicles: V of them.
        last: the last step of the graph.
        taken: probability that each takes up a lane of each footprint there, (V, U).
    """
    found = np.zeros((taken.shape[1], len(last.x)))
    for vehicle, lanes in zip(vehicles, taken, strict=True):
        if lanes.any():
            found += lanes[:, None] * _without_way_out(problem, vehicle, last)
    return found


def _without_way_out(problem: DecisionProblem, vehicle: PredictedVehicle, last: GraphStep) -> FloatArray:
    """Return the probability that the distance behind a vehicle is kept, and that of the way out is not, (M,)."""
    settings, state = problem.settings, vehicle.state
    T, H, accel = settings.period, settings.horizon_steps, settings.accel
    places = vehicle_places(problem, vehicle, by_speed=True).steps[-1]
    mean = state.x + state.speed * H * T + accel * T**2 / 2 * places.point
    speed = state.speed + accel * T * places.speed
    if vehicle.drift:
        farther, more_speed = vehicle.drift[-1]
        mean, speed = mean + farther, np.maximum(speed + more_speed, 0.0)
    faster = np.maximum(last.speed[:, None] - speed, 0.0)
    accelerates = (last.motions.mode > 0)[:, None]
    extra = faster**2 / (2 * accel) + T * faster * accelerates
    length = np.array(state.length)
    behind = clearance_to(problem, length, speed, np.zeros(1), last.speed[:, None]).behind - DISTANCE_TOLERANCE
    short = last.x[:, None] + behind - mean
    std = float(deviations_of(vehicle.noise, T, H)[-1])
    if std == 0.0:
        return np.asarray(((short <= 0) & (short + extra > 0)) @ places.place_probability, dtype=np.float64)
    near = np.flatnonzero(((short < FAR * std) & (short + extra > -FAR * std) & (extra > 0)).ravel())
    lost = np.zeros(short.size)
    low, more = short.ravel()[near], extra.ravel()[near]
    lost[near] = ndtr((low + more) / std) - ndtr(low / std)
    return np.asarray(lost.reshape(short.shape) @ places.place_probability, dtype=np.float64)
