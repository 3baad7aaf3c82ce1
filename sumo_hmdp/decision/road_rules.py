"""What the road forbids in a decision: lane changes at a step, and speeds in a lane at a step.

Both are made from what the ego may reach, not from where a single plan is, so that they are fixed before a solver
starts; that is on the careful side. A solver asks `banned_moves` and `top_speeds`, whoever has a plan in hand
`keeps_rules`.
"""

import math
from functools import lru_cache

import numpy as np

from sumo_hmdp.decision.problem import SPEED_TOLERANCE, DecisionProblem, PlannerSettings
from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.domain.road_rules import RoadRules
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.prediction.dynamics import FloatArray

Moves = frozenset[tuple[int, int]]

# The braking before a lower limit, as a share of the modes' deceleration: speeds fall in whole steps, and a mode needs
# a step to turn.
_SHARE = 0.5


def banned_moves(problem: DecisionProblem) -> tuple[Moves, ...]:
    """Return the lane changes that each step 1..H may not begin, as pairs of the lane left and the lateral action.

    A change that begins with step k lasts its `lane_change_time`. It is banned if any x that the ego's body may be at
    meanwhile lies where that line must not be crossed: from its rear bumper after the hardest braking to its front
    bumper after the strongest acceleration of the modes.
    """
    return _banned(problem.rules, problem.ego, problem.settings)


@lru_cache(maxsize=16)
def _banned(rules: RoadRules, ego: VehicleState, settings: PlannerSettings) -> tuple[Moves, ...]:
    if not rules.no_change:
        return (frozenset(),) * settings.horizon_steps
    found = []
    for k in range(settings.horizon_steps):
        begins = k * settings.period
        x_from = least_x(ego, settings, begins) - ego.length
        x_to = greatest_x(ego, settings, begins + settings.lane_change_time)
        met = (rule for rule in rules.no_change if rule.x_begin < x_to and x_from < rule.x_end)
        found.append(frozenset((rule.lane, int(rule.lateral)) for rule in met))
    return tuple(found)


def top_speeds(problem: DecisionProblem) -> FloatArray | None:
    """Return the greatest speed at the end of each step in each lane, (H, lanes) [m/s]; None where no limit is near.

    It is the speed from which every limit ahead is met with half the modes' deceleration, at the farthest x that the
    ego may be at; in its own lane never below what it can come down to by then: one that is too fast has a plan. Not to
    be written to.
    """
    if not problem.rules.speed_zones:
        return None
    return _tops(problem.rules, problem.ego, problem.settings, problem.road.lane_count)


@lru_cache(maxsize=16)
def _tops(rules: RoadRules, ego: VehicleState, settings: PlannerSettings, lane_count: int) -> FloatArray:
    tops = np.full((settings.horizon_steps, lane_count), math.inf)
    for k in range(1, settings.horizon_steps + 1):
        x_far = greatest_x(ego, settings, k * settings.period)
        for zone in rules.speed_zones:
            # One that is passed on the way counts too.
            if ego.x < zone.x_end:
                way = max(0.0, zone.x_begin - x_far)
                top = math.sqrt(zone.speed**2 + 2.0 * _SHARE * settings.accel * way)
                tops[k - 1, zone.lane - 1] = min(tops[k - 1, zone.lane - 1], top)
        tops[k - 1, ego.lane - 1] = max(tops[k - 1, ego.lane - 1], slowest(ego, settings, k))
    tops.flags.writeable = False
    return tops


def slowest(ego: VehicleState, settings: PlannerSettings, step: int) -> float:
    """Return the least speed that the ego can have come down to by the end of a step [m/s]."""
    speed_step = settings.accel * settings.period
    fewest = max(0, step - (ego.mode is Mode.ACCELERATE))
    floor = settings.speed_min
    if ego.speed - fewest * speed_step >= floor - SPEED_TOLERANCE:
        return ego.speed - fewest * speed_step
    if settings.stopping and floor <= 0.0:
        return 0.0
    return ego.speed - speed_step * math.floor((ego.speed - floor + SPEED_TOLERANCE) / speed_step)


def least_x(ego: VehicleState, settings: PlannerSettings, time: float) -> float:
    """Return where an ego is that brakes as its modes do, until it rests [m]."""
    braking = min(time, ego.speed / settings.accel)
    return ego.x + ego.speed * braking - 0.5 * settings.accel * braking**2


def greatest_x(ego: VehicleState, settings: PlannerSettings, time: float) -> float:
    """Return where an ego is that accelerates as its modes do, up to its top speed [m]."""
    gaining = min(time, max(0.0, settings.speed_max - ego.speed) / settings.accel)
    gained = settings.accel * gaining
    return ego.x + ego.speed * time + gained * (time - 0.5 * gaining)


def keeps_rules(problem: DecisionProblem, step: int, lane: int, lateral: Lateral, speed: float) -> bool:
    """Tell whether a step may be taken as far as the road's rules go.

    Args:
        problem: the decision problem.
        step: 1..H.
        lane: that is intended before it.
        lateral: its action.
        speed: at its end [m/s].
    """
    if (lane, int(lateral)) in banned_moves(problem)[step - 1]:
        return False
    tops = top_speeds(problem)
    return tops is None or bool(speed <= tops[step - 1, lane + lateral - 1] + SPEED_TOLERANCE)


def rules_ahead(rules: RoadRules, ego: VehicleState, settings: PlannerSettings) -> RoadRules:
    """Return the rules that may matter to a decision: what is behind, too far ahead or above the top speed is none."""
    horizon = settings.horizon_steps * settings.period
    brake = max(0.0, settings.speed_max**2) / (2.0 * _SHARE * settings.accel)
    sight = greatest_x(ego, settings, horizon)
    reach = greatest_x(ego, settings, horizon + settings.lane_change_time)
    zones = tuple(
        zone
        for zone in rules.speed_zones
        if zone.speed < settings.speed_max and ego.x < zone.x_end and zone.x_begin < sight + brake
    )
    bans = tuple(r for r in rules.no_change if ego.x - ego.length < r.x_end and r.x_begin < reach)
    return RoadRules(zones, bans)
