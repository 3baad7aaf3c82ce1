"""Planned steps beside what then happened: who came nearest to what was asked for (docs/guarantees.md).

For every planned step the recorded trace is looked up at the step's instant. A step is *violated* where a vehicle that
the plan kept a distance to, and that takes up a lane which the plan takes up, is then nearer to the ego than the safe
distance. Lanes and distances are those of the planner's own rules (`occupancy`, `distance_rule`), with the ego's
speed as planned and the other's speed and place as they were.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
import pandas as pd

from sumo_hmdp.domain.distance import DistanceRule, RssParameters, SafeDistance
from sumo_hmdp.domain.maneuver import LATERAL_BY_LABEL
from sumo_hmdp.domain.occupancy import LaneChange, Occupancy, bodies_over
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import EGO_ID
from sumo_hmdp.errors import InputError, Problem
from sumo_hmdp.metrics.decision_tables import instant, plan_table, with_intents

# Plans lie on the bounds of their distances, which solvers meet to this many metres.
DISTANCE_SLACK = 1e-5
_FOUND = ["vehicle_id", "distance_m", "required_m"]


class Claim(StrEnum):
    """Which motion of the ego is audited.

    PLANNED: the plan's own, at all its steps: what the model claims.
    EXECUTED: the ego's realised one at the first step, while the plan is still the one carried out.
    """

    PLANNED = "planned"
    EXECUTED = "executed"


@dataclass(frozen=True)
class AuditSettings:
    """What a run's plans were asked for.

    Attributes:
        period: of a planned step [s].
        distance: the safe distance.
        road: the lanes.
        occupancy: which lanes a vehicle takes up.
        lane_change_time: of the ego, for `swept` [s].
        told: vehicles whose intentions are in the trace; of others they are read from their motion. None for all.
    """

    period: float
    distance: SafeDistance
    road: Road
    occupancy: Occupancy = Occupancy.TARGET
    lane_change_time: float = 4.0
    told: frozenset[str] | None = None


def audit_settings(manifest: Mapping[str, Any]) -> AuditSettings | None:
    """Return what a run's manifest says that its plans were asked for, None for a planner without a safe distance.

    Raises:
        InputError: if a rule in it is not known here.
    """
    if manifest.get("safe_distance_m") is None:
        return None
    given: Mapping[str, Any] = manifest.get("parameters", {})
    rule, occupancy = given.get("distance_rule", "fixed"), given.get("occupancy", "target")
    where = manifest.get("run_id", manifest.get("cell", "manifest"))
    problems: list[Problem | str] = [
        f"{name} must be one of {', '.join(known)} for an audit, got {value} ({where}). Leave the run out"
        for name, value, known in (("distance_rule", rule, DistanceRule), ("occupancy", occupancy, Occupancy))
        if value not in list(known)
    ]
    if problems:
        raise InputError(problems)
    default = RssParameters()
    rss = RssParameters(
        given.get("rss_response_time_s", default.response_time),
        given.get("rss_accel_max_mps2", default.accel_max),
        given.get("rss_brake_min_mps2", default.brake_min),
        given.get("rss_brake_max_mps2", default.brake_max),
    )
    configuration = manifest.get("configuration", {})
    background = any(configuration.get(section) is not None for section in ("traffic", "tracks"))
    return AuditSettings(
        period=float(manifest["period_s"]),
        distance=SafeDistance(
            float(manifest["safe_distance_m"]), DistanceRule(rule), given.get("time_headway_s", 0.0), rss
        ),
        road=Road(manifest["lanes"]["count"], manifest["lanes"]["width_m"]),
        occupancy=Occupancy(occupancy),
        lane_change_time=_lane_change_time(manifest),
        told=frozenset(vehicle["id"] for vehicle in configuration["vehicles"]) if background else None,
    )


def _lane_change_time(manifest: Mapping[str, Any]) -> float:
    """Return the planner's own lane-change time where the scenario gives it one, else the ego's [s]."""
    configuration = manifest.get("configuration", {})
    section = configuration.get("planners", {}).get(manifest.get("planner")) or {}
    ego = configuration.get("ego", {})
    return float(section.get("lane_change_time_s", ego.get("lane_change_time_s", AuditSettings.lane_change_time)))


def audit_run(
    decisions: pd.DataFrame, steps: pd.DataFrame, settings: AuditSettings, claim: Claim = Claim.PLANNED
) -> pd.DataFrame:
    """Look every planned step of one run up in its trace.

    Args:
        decisions: the `decisions` table of the run.
        steps: its `steps` table with all vehicles.
        settings: what its plans were asked for.
        claim: which motion of the ego is audited.

    Returns:
        One row per planned step: run_id, decision_index, time_s, status, horizon_step, plan_lane, plan_x_m; observed;
        ego_x_m and ego_speed_mps, those audited; vehicle_id, distance_m and required_m, front bumper to front bumper,
        of the vehicle that lacked most or had least to spare (missing where none shared a lane); violated.
    """
    plan = plan_table(decisions)
    trace = with_intents(steps, settings.road, settings.told)
    trace = trace.assign(instant=instant(trace["time_s"]))
    ego, others = trace[trace["vehicle_id"] == EGO_ID], trace[trace["vehicle_id"] != EGO_ID]
    plan["lanes"] = pd.Series(_planned_lanes(plan, decisions, ego, settings), index=plan.index, dtype="object")
    if claim is Claim.EXECUTED:
        plan = plan[plan["horizon_step"] == 1].reset_index(drop=True)
    plan["instant"] = instant(plan["time_s"] + plan["horizon_step"] * settings.period)
    plan["observed"] = plan["instant"].isin(ego["instant"])
    plan = plan.assign(ego_x_m=plan["plan_x_m"], ego_speed_mps=plan["plan_speed_mps"])
    if claim is Claim.EXECUTED:
        there = ego.set_index("instant")[["x_m", "speed_mps"]].astype("float64").reindex(plan["instant"])
        plan[["ego_x_m", "ego_speed_mps"]] = there.to_numpy()
    plan[_FOUND] = _nearest(plan, _constrained(plan, others, decisions), ego, settings)
    plan["violated"] = plan["distance_m"] < plan["required_m"] - DISTANCE_SLACK
    return plan.drop(columns=["instant", "lanes", "lateral", "plan_speed_mps"])


def _planned_lanes(
    plan: pd.DataFrame, decisions: pd.DataFrame, ego: pd.DataFrame, settings: AuditSettings
) -> list[tuple[int, ...]]:
    """Return the lanes that the ego takes up at each planned step."""
    if settings.occupancy is Occupancy.TARGET or plan.empty:
        return [(lane,) for lane in plan["plan_lane"].tolist()]
    change = LaneChange(settings.road, ego["width_m"].iloc[0], settings.lane_change_time, settings.period)
    y = decisions.set_index("decision_index")["ego_y_m"]
    lanes = []
    for index, steps in plan.groupby("decision_index", sort=False):
        laterals = [LATERAL_BY_LABEL[label] for label in steps["lateral"]]
        state = change.state(int(steps["plan_lane"].iloc[0]) - laterals[0], float(y[index]))
        for lateral in laterals:
            state = state.after(lateral, change.sweep_steps)
            lanes.append(state.occupied)
    return lanes


def _constrained(plan: pd.DataFrame, others: pd.DataFrame, decisions: pd.DataFrame) -> pd.DataFrame:
    """Pair every planned step with the vehicles that were there at its instant and that its plan kept a distance to."""
    both = plan[["instant", "decision_index"]].reset_index(names="row").merge(others, on="instant")
    if "vehicles_json" not in decisions:
        return both
    kept = {
        index: set(json.loads(names))
        for index, names in zip(decisions["decision_index"].tolist(), decisions["vehicles_json"].tolist(), strict=True)
        if isinstance(names, str) and names != "null"
    }
    named = zip(both["decision_index"].tolist(), both["vehicle_id"].tolist(), strict=True)
    # An array, since an empty list would choose no columns instead of no rows.
    return both[np.array([index not in kept or name in kept[index] for index, name in named], dtype=bool)]


def _nearest(plan: pd.DataFrame, both: pd.DataFrame, ego: pd.DataFrame, settings: AuditSettings) -> pd.DataFrame:
    """Return for each row of `plan` the vehicle with the least to spare among those that share a lane."""
    lanes = np.arange(1, settings.road.lane_count + 1)
    taken = both["intended_lane"].to_numpy()[:, None] == lanes
    if settings.occupancy is Occupancy.SWEPT:
        taken |= bodies_over(settings.road, both["y_m"].to_numpy(np.float64), both["width_m"].to_numpy(np.float64))
    planned = np.zeros((len(plan), len(lanes)), dtype=bool)
    for row, mine in zip(planned, plan["lanes"], strict=True):
        row[[lane - 1 for lane in mine]] = True
    both = both[(taken & planned[both["row"].to_numpy(np.int64)]).any(axis=1)]
    own = plan.loc[both["row"], ["ego_x_m", "ego_speed_mps"]].to_numpy(np.float64).T
    x, speed, length = both[["x_m", "speed_mps", "length_m"]].to_numpy(np.float64).T
    ego_length = np.array(ego["length_m"].iloc[0] if len(ego) else np.nan)
    required = np.where(
        own[0] > x,
        settings.distance.ahead(ego_length, own[1], speed),
        settings.distance.behind(length, own[1], speed),
    )
    both = both.assign(distance_m=np.abs(x - own[0]), required_m=required)
    both = both.assign(spare=both["distance_m"] - required).sort_values("spare", kind="stable")
    return both.drop_duplicates("row").set_index("row")[_FOUND].reindex(plan.index)
