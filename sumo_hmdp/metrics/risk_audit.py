"""The risk that was taken against the risk that was asked for (docs/guarantees.md).

`planned_distances` says when a planned step is *violated*. Rates are per step, plan and run; their denominators are
never mixed:

- step: planned steps whose instant was recorded;
- plan: plans all of whose steps were recorded, and violated ones that a contact cut short;
- run: runs with such a plan.

An *event* is a row of consecutive plans that were violated by a common vehicle: one lane change of a neighbour can
violate every plan whose horizon it falls into.

The verdict on a rate of optimal plans, first match, with the interval of `metrics.proportion.clustered_proportion`,
whose sampling unit is the run:

- `violated`: its lower end is above the risk level;
- `too few data`: so little was seen that no violation at all, in as many effective trials, would still leave the risk
  level possible; without a violation these are the runs, so that an epsilon of 0.05 takes 72 runs;
- `conservative`: its upper end is below half the risk level;
- `consistent`: otherwise.

`no claim` stands where the planner claims nothing: plans that are not optimal, rates per run, no risk level. What a
rate per plan is asked for is what `uniform` and `mixture` claim; `individual` claims less, even per step.
"""

from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Any

import numpy as np
import pandas as pd

from sumo_hmdp.domain.distance import SafeDistance
from sumo_hmdp.domain.plan import Status
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import EGO_ID
from sumo_hmdp.errors import InputError, Problem
from sumo_hmdp.metrics.planned_distances import AuditSettings, Claim, audit_run, audit_settings
from sumo_hmdp.metrics.proportion import ProportionInterval, clopper_pearson, clustered_proportion

# These plans keep every distance; the others say themselves that they do not.
KEEPING = tuple(status for status in Status if status.keeps_distances)


class Verdict(StrEnum):
    """What a rate says of the risk level; the rule is in the module's docstring."""

    VIOLATED = "violated"
    TOO_FEW = "too few data"
    CONSERVATIVE = "conservative"
    CONSISTENT = "consistent"
    NO_CLAIM = "no claim"


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
        claim: which motion of the ego is audited.

    Returns:
        The rows of all runs; empty where no planner keeps a safe distance.

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
    nothing = AuditSettings(1.0, SafeDistance(0.0), Road(1, 4.0))
    return pd.concat(parts, ignore_index=True) if parts else audit_run(decisions.iloc[:0], steps.iloc[:0], nothing)


def violation_rates(
    audited: pd.DataFrame, runs: pd.DataFrame, by: Sequence[str] = (), level: float = 0.95
) -> pd.DataFrame:
    """Return violation rates per step, plan and run with their verdicts.

    Trials of one run are alike, since plans overlap; so runs are the sampling unit of every interval, and their number
    stands beside each verdict.

    Args:
        audited: as `audit_run` returns it.
        runs: the `runs` table: run_id, status, risk_level, and the columns named in `by`.
        by: columns of `runs` to group by, such as planner or density; `horizon_step` gives rates per step alone.
        level: of the intervals.

    Returns:
        One row per group, status and unit: the columns of `by`, `status`, `risk_level`, `per` (step, plan, run),
        `violation_count`, `event_count` (those of the row's violations), `trial_count`, `run_count`,
        `violation_rate`, `low_rate`, `high_rate`; `effective_count`, the independent trials that would tell as much,
        and `df_count`, the degrees of freedom behind it; `verdict`.

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
        events = event_count(group)
        for unit in units:
            trials = trials_of(group, unit)
            measured = _interval_of(trials, level)
            risk_level = float(group["risk_level"].iloc[0])
            claimed = unit != "run" and group["status"].iloc[0] in KEEPING
            found.append(
                {
                    **dict(zip(keys, key, strict=True)),
                    "per": unit,
                    "violation_count": measured.violations,
                    "event_count": events,
                    "trial_count": measured.plans,
                    "run_count": measured.runs,
                    "violation_rate": measured.rate,
                    "low_rate": measured.low,
                    "high_rate": measured.high,
                    "effective_count": measured.effective_n,
                    "df_count": measured.df,
                    "verdict": str(judge(measured, risk_level, level) if claimed else Verdict.NO_CLAIM),
                }
            )
    return pd.DataFrame(found)


def event_count(group: pd.DataFrame) -> int:
    """Count the rows of consecutive plans that were violated by a common vehicle.

    Args:
        group: as `audit_run` returns it.
    """
    causes: dict[tuple[str, int], set[str]] = {}
    violated = group[group["violated"]]
    named = zip(violated["run_id"], violated["decision_index"].tolist(), violated["vehicle_id"], strict=True)
    for run_id, decision, vehicle in named:
        causes.setdefault((run_id, decision), set()).add(vehicle)
    return sum(causes.get((run_id, decision - 1), set()).isdisjoint(v) for (run_id, decision), v in causes.items())


def trials_of(group: pd.DataFrame, unit: str) -> pd.DataFrame:
    """Return one row per trial: run_id and violated.

    Args:
        group: as `audit_run` returns it, with `cut_by_contact`: whether its run ended in contact.
        unit: step, plan or run.
    """
    if unit == "step":
        return group.loc[group["observed"], ["run_id", "violated"]]
    plans = group.groupby(["run_id", "decision_index"], as_index=False).agg(
        complete=("observed", "all"), violated=("violated", "any"), cut=("cut_by_contact", "first")
    )
    plans = plans[plans["complete"] | (plans["violated"] & plans["cut"])]
    if unit == "plan":
        return plans[["run_id", "violated"]]
    return plans.groupby("run_id", as_index=False).agg(violated=("violated", "any"))


def _interval_of(trials: pd.DataFrame, level: float) -> ProportionInterval:
    per_run = trials.groupby("run_id")["violated"].agg(["sum", "count"])
    return clustered_proportion(per_run["sum"].to_numpy(np.int64), per_run["count"].to_numpy(np.int64), level)


def judge(measured: ProportionInterval, risk_level: float, level: float = 0.95) -> Verdict:
    """Return what a measured rate says of the risk level that was asked for (the rule is the module's)."""
    if np.isnan(risk_level):
        return Verdict.NO_CLAIM
    if measured.low > risk_level:
        return Verdict.VIOLATED
    if clopper_pearson(0, measured.effective_n, level)[1] > risk_level:
        return Verdict.TOO_FEW
    if measured.high < risk_level / 2:
        return Verdict.CONSERVATIVE
    return Verdict.CONSISTENT
