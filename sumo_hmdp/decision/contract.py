"""What the closed loop asks of any planner, also of somebody else's; a planner that breaks it ends its run at once."""

import math
from typing import Any

from sumo_hmdp.domain.plan import Decision, Planner
from sumo_hmdp.domain.road import Road
from sumo_hmdp.errors import SumoHmdpError


class PlannerError(SumoHmdpError):
    """A planner answered what no vehicle can do."""


def steps_per_decision(planner: Planner[Any], dt: float) -> int:
    """Return how many control steps there are between two decisions.

    Raises:
        PlannerError: if it is no whole number of them.
    """
    steps = planner.period / dt
    if not (steps > 0.5 and math.isfinite(steps) and abs(steps - round(steps)) < 1e-6):
        raise PlannerError(f"the planner's period must be a multiple of dt ({dt:g} s), got {planner.period:g} s")
    return round(steps)


def require_decision(decision: object, road: Road) -> None:
    """Make sure that a decision can be carried out.

    Raises:
        PlannerError: if it is none, if its lane is not on the road, or its acceleration no finite number.
    """
    if not isinstance(decision, Decision):
        raise PlannerError(f"decide must return a Decision and the memory, got {decision!r}")
    lane, accel = decision.command.lane, decision.command.accel
    if not road.has_lane(lane) or lane != int(lane):
        raise PlannerError(f"command.lane must be 1..{road.lane_count}, got {lane} (at {decision.time:g} s)")
    if not math.isfinite(accel):
        raise PlannerError(f"command.accel must be a finite number, got {accel} m/s2 (at {decision.time:g} s)")
    for name, value in decision.notes.items():
        finite = isinstance(value, int | float) and math.isfinite(value)
        if not isinstance(name, str) or not (finite or isinstance(value, str)):
            what = "notes must map names to finite numbers, true or false, or text"
            raise PlannerError(f"{what}, got {name!r}: {value!r} (at {decision.time:g} s)")
