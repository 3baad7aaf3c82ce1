"""The risk that was taken against the risk that was asked for (docs/guarantees.md).

For every planned step the recorded trace is looked up at the step's instant. A step is *violated* where a vehicle in
the planned lane is then nearer to the ego than the safe distance, front bumper to front bumper. Rates are per step,
plan and run; their denominators are never mixed:

- step: planned steps whose instant was recorded;
- plan: plans all of whose steps were recorded, and violated ones that a contact cut short;
- run: runs with such a plan.

The verdict on a rate of optimal plans, first match, with the interval of `metrics.proportion`:

- `violated`: its lower end is above the risk level;
- `too few data`: so few trials that the interval of no violation at all would still reach above the risk level;
- `conservative`: its upper end is below half the risk level;
- `consistent`: otherwise.

`no claim` stands where the planner claims nothing: plans that are not optimal, rates per run, no risk level. What a
rate per plan is asked for is what `uniform` and `mixture` claim; `individual` claims less, even per step.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
import pandas as pd

from sumo_hmdp.domain.scene import EGO_ID
from sumo_hmdp.errors import InputError, Problem
from sumo_hmdp.metrics.decision_tables import instant, plan_table
from sumo_hmdp.metrics.proportion import Rate, design_effect, rate

# Plans lie on the bounds of their distances, which solvers meet to this many metres.
DISTANCE_SLACK = 1e-5
# These plans keep every distance; the others say themselves that they do not.
KEEPING = ("optimal", "incumbent")


class Claim(StrEnum):
    """Which position of the ego is audited.

    PLANNED: the plan's own, at all its steps: what the model claims.
    EXECUTED: the ego's realised one at the first step, while the plan is still the one carried out.
    """

    PLANNED = "planned"
    EXECUTED = "executed"


class Verdict(StrEnum):
    """What a rate says of the risk level; the rule is in the module's docstring."""

    VIOLATED = "violated"
    TOO_FEW = "too few data"
    CONSERVATIVE = "conservative"
    CONSISTENT = "consistent"
    NO_CLAIM = "no claim"


@dataclass(frozen=True)
class AuditSettings:
    """What a run's plans were asked for.

    Attributes:
        period: of a planned step [s].
        safe_distance: between front bumpers [m].
        lane_columns: of `steps`; a vehicle is in the lanes that any of them names. `lane` is where its front bumper
            is; `intended_lane` is what plans under `occupancy: target` are asked for.
    """

    period: float
    safe_distance: float
    lane_columns: tuple[str, ...] = ("lane",)


def audit_settings(manifest: Mapping[str, Any]) -> AuditSettings | None:
    """Return what a run's manifest says that its plans were asked for, None for a planner without a safe distance.

    Raises:
        InputError: if its distance rule is not `fixed`, whose distance alone is known from the manifest.
    """
    if manifest.get("safe_distance_m") is None:
        return None
    rule = manifest.get("parameters", {}).get("distance_rule", "fixed")
    if rule != "fixed":
        where = manifest.get("run_id", "manifest")
        raise InputError([f"distance_rule must be fixed for an audit, got {rule} ({where}). Leave the run out"])
    return AuditSettings(period=float(manifest["period_s"]), safe_distance=float(manifest["safe_distance_m"]))


def audit_run(
    decisions: pd.DataFrame, steps: pd.DataFrame, settings: AuditSettings, claim: Claim = Claim.PLANNED
) -> pd.DataFrame:
    """Look every planned step of one run up in its trace.

    Args:
        decisions: the `decisions` table of the run.
        steps: its `steps` table with all vehicles.
        settings: what its plans were asked for.
        claim: which position of the ego is audited.

    Returns:
        One row per planned step: run_id, decision_index, time_s, status, horizon_step, plan_lane, plan_x_m; observed;
        ego_x_m, the audited position; vehicle_id and distance_m of the nearest vehicle in the planned lane (missing
        where there is none); violated.
    """
    plan = plan_table(decisions)
    if claim is Claim.EXECUTED:
        plan = plan[plan["horizon_step"] == 1].reset_index(drop=True)
    plan["instant"] = instant(plan["time_s"] + plan["horizon_step"] * settings.period)
    trace = steps.assign(instant=instant(steps["time_s"]))
    ego = trace[trace["vehicle_id"] == EGO_ID].set_index("instant")["x_m"]
    plan["observed"] = plan["instant"].isin(ego.index)
    plan["ego_x_m"] = plan["plan_x_m"] if claim is Claim.PLANNED else plan["instant"].map(ego).astype("float64")
    nearest = _nearest(plan, trace[trace["vehicle_id"] != EGO_ID], settings.lane_columns)
    plan[["vehicle_id", "distance_m"]] = nearest
    plan["violated"] = plan["distance_m"] < settings.safe_distance - DISTANCE_SLACK
    return plan.drop(columns="instant")


def _nearest(plan: pd.DataFrame, others: pd.DataFrame, lane_columns: Sequence[str]) -> pd.DataFrame:
    """Return the nearest vehicle in the planned lane and its distance for each row of `plan`."""
    rows = plan[["instant", "plan_lane", "ego_x_m"]].reset_index(names="row")
    both = rows.merge(others[["instant", "vehicle_id", "x_m", *lane_columns]], on="instant")
    shared = np.zeros(len(both), dtype=bool)
    for column in lane_columns:
        shared |= (both[column] == both["plan_lane"]).to_numpy()
    both = both[shared]
    both = both.assign(distance_m=(both["x_m"] - both["ego_x_m"]).abs()).sort_values("distance_m", kind="stable")
    return both.drop_duplicates("row").set_index("row")[["vehicle_id", "distance_m"]].reindex(plan.index)


def audit_results(
    decisions: pd.DataFrame,
    steps: pd.DataFrame,
    manifests: Mapping[str, Mapping[str, Any]],
    claim: Claim = Claim.PLANNED,
) -> pd.DataFrame:
    """Audit every run of a study whose planner keeps a safe distance; rows as of `audit_run`.

    Args:
        decisions: the `decisions` table.
        steps: the `steps` table with all vehicles.
        manifests: by run id.
        claim: which position of the ego is audited.

    Raises:
        InputError: naming every run that was recorded without its surrounding vehicles or cannot be audited.
    """
    problems: list[Problem | str] = []
    parts = []
    steps_by_run = dict(list(steps.groupby("run_id"))) if len(steps) else {}
    for run_id, manifest in manifests.items():
        try:
            settings = audit_settings(manifest)
        except InputError as error:
            problems.extend(error.problems)
            continue
        rows = decisions[decisions["run_id"] == run_id]
        if settings is None or rows.empty:
            continue
        trace = steps_by_run.get(run_id, steps.iloc[:0])
        alone = set(trace["vehicle_id"]) == {EGO_ID}
        if trace.empty or (alone and rows["branch_count"].any()):
            problems.append(
                f"run {run_id} must have all vehicles in its steps to be audited. Record it with --trace all"
            )
            continue
        parts.append(audit_run(rows, trace, settings, claim))
    if problems:
        raise InputError(problems)
    return (
        pd.concat(parts, ignore_index=True) if parts else audit_run(decisions.iloc[:0], steps, AuditSettings(1.0, 0.0))
    )


def violation_rates(
    audited: pd.DataFrame, runs: pd.DataFrame, by: Sequence[str] = (), level: float = 0.95
) -> pd.DataFrame:
    """Return violation rates per step, plan and run with their verdicts.

    Trials of one run are alike, since plans overlap; so the intervals of steps and plans widen by the design effect
    that is seen between runs (none is seen in a single run, nor without a violation).

    Args:
        audited: as `audit_run` returns it.
        runs: the `runs` table: run_id, status, risk_level, and the columns named in `by`.
        by: columns of `runs` to group by, such as planner or density; `horizon_step` gives rates per step alone.
        level: of the intervals.

    Returns:
        One row per group, status and unit: the columns of `by`, `status`, `risk_level`, `per` (step, plan, run),
        `violation_count`, `trial_count`, `run_count`, `violation_rate`, `low_rate`, `high_rate`, `design_effect`,
        `verdict`.

    Raises:
        InputError: if a column is missing.
    """
    factors = [name for name in by if name != "horizon_step"]
    missing = [name for name in ("run_id", "status", "risk_level", *factors) if name not in runs]
    if missing:
        raise InputError([f"column {name} must be in the table of runs" for name in missing])
    named = list(dict.fromkeys([*factors, "risk_level"]))
    ended = runs.set_index("run_id")["status"]
    rows = audited.merge(runs[["run_id", *named]], on="run_id")
    rows["cut_by_contact"] = rows["run_id"].map(ended) == "contact"
    keys = list(dict.fromkeys([*by, "status", "risk_level"]))
    units = ("step",) if "horizon_step" in by else ("step", "plan", "run")
    found = []
    for key, group in rows.groupby(keys, dropna=False, sort=True):
        for unit in units:
            trials = _trials(group, unit)
            measured = _rate_of(trials, level)
            risk_level = float(group["risk_level"].iloc[0])
            claimed = unit != "run" and group["status"].iloc[0] in KEEPING
            found.append(
                {
                    **dict(zip(keys, key, strict=True)),
                    "per": unit,
                    "violation_count": measured.hits,
                    "trial_count": measured.trials,
                    "run_count": trials["run_id"].nunique(),
                    "violation_rate": measured.value,
                    "low_rate": measured.low,
                    "high_rate": measured.high,
                    "design_effect": measured.design_effect,
                    "verdict": str(judge(measured, risk_level, level) if claimed else Verdict.NO_CLAIM),
                }
            )
    return pd.DataFrame(found)


def _trials(group: pd.DataFrame, unit: str) -> pd.DataFrame:
    """Return one row per trial: run_id and violated."""
    if unit == "step":
        return group.loc[group["observed"], ["run_id", "violated"]]
    plans = group.groupby(["run_id", "decision_index"], as_index=False).agg(
        complete=("observed", "all"), violated=("violated", "any"), cut=("cut_by_contact", "first")
    )
    plans = plans[plans["complete"] | (plans["violated"] & plans["cut"])]
    if unit == "plan":
        return plans[["run_id", "violated"]]
    return plans.groupby("run_id", as_index=False).agg(violated=("violated", "any"))


def _rate_of(trials: pd.DataFrame, level: float) -> Rate:
    per_run = trials.groupby("run_id")["violated"].agg(["sum", "count"])
    hits, counts = per_run["sum"].to_numpy(dtype=np.int64), per_run["count"].to_numpy(dtype=np.int64)
    return rate(int(hits.sum()), int(counts.sum()), level, design_effect(hits, counts))


def judge(measured: Rate, risk_level: float, level: float = 0.95) -> Verdict:
    """Return what a measured rate says of the risk level that was asked for (the rule is the module's)."""
    if np.isnan(risk_level):
        return Verdict.NO_CLAIM
    if measured.low > risk_level:
        return Verdict.VIOLATED
    if not measured.trials or rate(0, measured.trials, level, measured.design_effect).high > risk_level:
        return Verdict.TOO_FEW
    if measured.high < risk_level / 2:
        return Verdict.CONSERVATIVE
    return Verdict.CONSISTENT
