"""What decisions planned and predicted, one row a step, beside what then happened."""

import json

import numpy as np
import pandas as pd

from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import EGO_ID

PLAN_COLUMNS = {
    "run_id": "str",
    "decision_index": "int64",
    "time_s": "float64",
    "status": "str",
    "horizon_step": "int64",
    "plan_lane": "int64",
    "plan_x_m": "float64",
    "lateral": "str",
    "plan_speed_mps": "float64",
}
BRANCH_COLUMNS = {
    "run_id": "str",
    "decision_index": "int64",
    "time_s": "float64",
    "vehicle_id": "str",
    "branch_index": "int64",
    "probability": "float64",
    "horizon_step": "int64",
    "branch_lane": "int64",
    "branch_mode": "str",
    "branch_x_m": "float64",
    "branch_y_m": "float64",
    "x_std_m": "float64",
    "y_std_m": "float64",
}

_PLAN_KEYS = ("step", "lane", "x_m", "lateral", "speed_mps")
# Who moves sideways by less keeps its lane [m/s]; a lane change of 4 m in 4 s has 1 m/s on average.
LATERAL_MOTION = 0.15


def instant(time: pd.Series) -> pd.Series:
    """Return times [s] in whole microseconds: sums of steps that differ in rounding only become equal."""
    return (time * 1e6).round().astype("int64")


def plan_table(decisions: pd.DataFrame) -> pd.DataFrame:
    """Return the plans of a `decisions` table, one row per planned step (`PLAN_COLUMNS`)."""
    rows = [
        (row.run_id, row.decision_index, row.time_s, row.status, *(step[name] for name in _PLAN_KEYS))
        for row in decisions.itertuples()
        for step in json.loads(str(row.plan_json))
    ]
    return pd.DataFrame(rows, columns=list(PLAN_COLUMNS)).astype(PLAN_COLUMNS)


def branch_table(decisions: pd.DataFrame) -> pd.DataFrame:
    """Return the predictions that a `decisions` table shows, one row per branch and step (`BRANCH_COLUMNS`)."""
    rows = [
        (
            row.run_id,
            row.decision_index,
            row.time_s,
            branch["vehicle_id"],
            index,
            branch["probability"],
            k + 1,
            *(branch[name][k] for name in ("lanes", "modes", "x_m", "y_m", "x_std_m", "y_std_m")),
        )
        for row in decisions.itertuples()
        for index, branch in enumerate(json.loads(str(row.branches_json)))
        for k in range(len(branch["lanes"]))
    ]
    return pd.DataFrame(rows, columns=list(BRANCH_COLUMNS)).astype(BRANCH_COLUMNS)


def realised_predictions(decisions: pd.DataFrame, steps: pd.DataFrame, period: float) -> pd.DataFrame:
    """Return the whole predictions beside what their vehicles then did; instants without a record are left out.

    Args:
        decisions: the `decisions` table of one run.
        steps: its `steps` table with all vehicles.
        period: of a planned step [s].

    Returns:
        One row per decision, vehicle and step: run_id, decision_index, time_s, vehicle_id, horizon_step, pruned_prob,
        lane_probs (a tuple, leftmost first), x_mean_m, x_std_m, y_mean_m, y_std_m, x_quantiles_m (a tuple); and x_m,
        y_m, intended_lane as they were.
    """
    told = decisions["prediction_json"] if "prediction_json" in decisions else pd.Series("[]", index=decisions.index)
    rows = [
        (
            row.run_id,
            row.decision_index,
            row.time_s,
            one["vehicle_id"],
            k + 1,
            one["pruned_prob"],
            tuple(one["lane_probs"][k]),
            *(one[name][k] for name in ("x_mean_m", "x_std_m", "y_mean_m", "y_std_m")),
            tuple(one["x_quantiles_m"][k]),
        )
        for row, text in zip(decisions.itertuples(), told.tolist(), strict=True)
        for one in json.loads(text if isinstance(text, str) else "[]")
        for k in range(len(one["x_mean_m"]))
    ]
    names = [
        "run_id", "decision_index", "time_s", "vehicle_id", "horizon_step", "pruned_prob", "lane_probs", "x_mean_m",
        "x_std_m", "y_mean_m", "y_std_m", "x_quantiles_m",
    ]  # fmt: skip
    found = pd.DataFrame(rows, columns=names)
    found["instant"] = instant(found["time_s"].astype("float64") + found["horizon_step"].astype("int64") * period)
    seen = steps[["vehicle_id", "x_m", "y_m", "intended_lane"]].assign(instant=instant(steps["time_s"]))
    return found.merge(seen, on=["vehicle_id", "instant"]).drop(columns="instant")


def realised_branches(decisions: pd.DataFrame, steps: pd.DataFrame, period: float) -> pd.DataFrame:
    """Return the predictions beside what their vehicles then did; rows of instants without a record are left out.

    Args:
        decisions: the `decisions` table of one run.
        steps: its `steps` table with all vehicles.
        period: of a planned step [s].

    Returns:
        `branch_table` with `x_m`, `y_m`, `intended_lane` and `mode` as they were; `same`, whether the vehicle has
        intended the branch's lanes and modes (where its modes are known) at all steps so far; `same_lanes`, likewise of
        the lanes alone.
    """
    branches = branch_table(decisions)
    branches["instant"] = instant(branches["time_s"] + branches["horizon_step"] * period)
    seen = steps[["vehicle_id", "x_m", "y_m", "intended_lane", "mode"]].assign(instant=instant(steps["time_s"]))
    both = branches.merge(seen, on=["vehicle_id", "instant"])
    both = both.sort_values(["decision_index", "branch_index", "horizon_step"], ignore_index=True)
    branch = [both["decision_index"], both["branch_index"]]
    # A vehicle that is lost for an instant has no known sequence from there on.
    seen_so_far = both.groupby(["decision_index", "branch_index"]).cumcount() + 1 == both["horizon_step"]
    lanes = (both["branch_lane"] == both["intended_lane"]) & seen_so_far
    mode = (both["branch_mode"] == both["mode"]) | (both["mode"] == "")
    both["same_lanes"] = lanes.groupby(branch).cummin().astype(bool)
    both["same"] = (lanes & mode).groupby(branch).cummin().astype(bool)
    return both


def with_intents(steps: pd.DataFrame, road: Road, told: frozenset[str] | None) -> pd.DataFrame:
    """Return a trace in which vehicles that told nobody what they intend show it by their motion.

    Background vehicles are recorded with the lane they are in, as cruising. Here each intends the lane that it has
    been moving to since the instant before, and its mode is not known.

    Args:
        steps: the `steps` table of one run.
        road: the lanes.
        told: vehicles whose intentions are recorded; None for all.
    """
    if told is None:
        return steps
    silent = (~steps["vehicle_id"].isin({EGO_ID, *told})).to_numpy(bool)
    seen = steps.loc[silent, ["vehicle_id", "time_s", "y_m"]]
    moved = seen.groupby("vehicle_id")[["time_s", "y_m"]].diff()
    # Whoever was out of sight meanwhile may have done anything.
    speed = (moved["y_m"] / moved["time_s"]).where(moved["time_s"] < 1.5 * moved["time_s"].min(), 0.0)
    speed = speed.where(speed.abs() > LATERAL_MOTION, 0.0)
    lanes, modes = steps["intended_lane"].to_numpy(np.int64, copy=True), steps["mode"].to_numpy(object, copy=True)
    motion = zip(seen["y_m"].tolist(), speed.tolist(), strict=True)
    lanes[silent] = [road.lane_headed_for(y, across) for y, across in motion]
    modes[silent] = ""
    return steps.assign(intended_lane=lanes, mode=pd.Series(modes, index=steps.index, dtype="str"))
