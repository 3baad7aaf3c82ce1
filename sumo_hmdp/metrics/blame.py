"""Why a planned distance fell short: predictor, pruning, planner, tracking, or the risk that was taken."""

from enum import StrEnum

import numpy as np
import pandas as pd
from scipy.special import ndtri

from sumo_hmdp.domain.scene import EGO_ID
from sumo_hmdp.metrics.decision_tables import branch_table, instant, realised_branches, with_intents
from sumo_hmdp.metrics.planned_distances import AuditSettings, Claim
from sumo_hmdp.metrics.risk_audit import KEEPING

# A plan accepts that a vehicle leaves its branch's interval at the risk level; far beyond it the prediction was wrong.
INTERVAL_LEVEL = 0.999
# Without noise a branch is met to rounding only [m].
POSITION_SLACK = 1e-6
_TRUTHS = ("in_interval", "kept", "lanes_kept")


class Blame(StrEnum):
    """The first of these that is true of a violation.

    PLANNER: the plan was relaxed or a fallback, and said so.
    TRACKING: the ego was not where the plan put it after its first step (only where the executed position is audited).
    UNSEEN: the vehicle was not among those predicted.
    UNKNOWN: the vehicle did what no branch shown says, but branches of its lanes or modes were not all recorded.
    PRUNING: the vehicle did what no retained branch says.
    PREDICTOR: the vehicle was outside the position intervals of all branches.
    CHANCE: none of these: the risk that the plan took.
    """

    PLANNER = "planner"
    TRACKING = "tracking"
    UNSEEN = "unseen"
    UNKNOWN = "unknown"
    PRUNING = "pruning"
    PREDICTOR = "predictor"
    CHANCE = "chance"


def prediction_hits(
    decisions: pd.DataFrame, steps: pd.DataFrame, period: float, level: float = INTERVAL_LEVEL
) -> pd.DataFrame:
    """Tell for each decision, vehicle and step whether any branch shown held the vehicle.

    Args:
        decisions: the `decisions` table of one run.
        steps: its `steps` table with all vehicles.
        period: of a planned step [s].
        level: of the central position interval of a branch.

    Returns:
        decision_index, vehicle_id, horizon_step; in_interval: it was in the interval of x of some branch; kept: some
        branch has the lanes and modes that it intended up to this step; lanes_kept: likewise of the lanes alone.
    """
    both = realised_branches(decisions, steps, period)
    reach = float(ndtri((1 + level) / 2)) * both["x_std_m"] + POSITION_SLACK
    both["in_interval"] = (both["x_m"] - both["branch_x_m"]).abs() <= reach
    keys = ["decision_index", "vehicle_id", "horizon_step"]
    return both.groupby(keys, as_index=False).agg(
        in_interval=("in_interval", "any"), kept=("same", "any"), lanes_kept=("same_lanes", "any")
    )


def _lanes_shown(branches: pd.DataFrame) -> pd.Series:
    """Tell by decision and vehicle whether all sequences of lanes that were retained are among the branches shown.

    They are if two have the same lanes, since the likeliest of each sequence come first.
    """
    branch = branches.groupby(["decision_index", "vehicle_id", "branch_index"])["branch_lane"].agg(tuple)
    return branch.groupby(["decision_index", "vehicle_id"]).agg(lambda lanes: lanes.nunique() < len(lanes))


def tracking_errors(audited: pd.DataFrame, steps: pd.DataFrame, period: float) -> pd.Series:
    """Return by decision_index how far along the road the ego was from its plan after the first step [m].

    Args:
        audited: planned steps of one run, as `audit_run` returns them.
        steps: the `steps` table of the run.
        period: of a planned step [s].
    """
    ego = steps[steps["vehicle_id"] == EGO_ID]
    where = pd.Series(ego["x_m"].to_numpy(), index=instant(ego["time_s"]))
    first = audited[audited["horizon_step"] == 1]
    error = (instant(first["time_s"] + period).map(where) - first["plan_x_m"]).abs()
    return pd.Series(error.to_numpy(), index=first["decision_index"].to_numpy(), dtype="float64")


def blame_violations(
    audited: pd.DataFrame,
    decisions: pd.DataFrame,
    steps: pd.DataFrame,
    settings: AuditSettings,
    claim: Claim = Claim.PLANNED,
    tracking_tolerance: float = 0.5,
) -> pd.DataFrame:
    """Say why the violated steps of one run were violated, each by the vehicle that was nearest to what was asked for.

    Args:
        audited: as `audit_run` returns it for the same claim.
        decisions: the `decisions` table of the run.
        steps: its `steps` table with all vehicles.
        settings: as of the audit.
        claim: as of the audit.
        tracking_tolerance: how far the ego may be from its plan after the first step [m].

    Returns:
        The violated rows of `audited` with `in_interval`, `kept`, `lanes_kept` (missing for a vehicle that was not
        predicted), `tracking_error_m` and `blame`.
    """
    seen = with_intents(steps, settings.road, settings.told)
    hits = prediction_hits(decisions, seen, settings.period).astype(dict.fromkeys(_TRUTHS, "boolean"))
    found = audited[audited["violated"]].merge(hits, on=["decision_index", "vehicle_id", "horizon_step"], how="left")
    errors = tracking_errors(audited, steps, settings.period)
    found["tracking_error_m"] = found["decision_index"].map(errors).astype("float64")
    branches = branch_table(decisions)
    shown = branches.groupby("decision_index")["branch_index"].nunique()
    lanes_shown = set(_lanes_shown(branches).loc[lambda all_: all_.astype(bool)].index)
    retained = decisions.set_index("decision_index")["branch_count"]
    all_shown = retained.eq(shown, fill_value=0)
    none_shown = (retained > 0) & ~retained.index.isin(shown.index)
    in_interval, kept, lanes_kept = (found[name].fillna(value=False) for name in _TRUTHS)
    pairs = zip(found["decision_index"].tolist(), found["vehicle_id"].tolist(), strict=True)
    other_lanes = ~lanes_kept & np.array([pair in lanes_shown for pair in pairs], dtype=bool)
    causes = {
        Blame.PLANNER: ~found["status"].isin(KEEPING),
        Blame.TRACKING: (found["tracking_error_m"] > tracking_tolerance) & (claim is Claim.EXECUTED),
        Blame.UNSEEN: found["kept"].isna() & ~found["decision_index"].map(none_shown).astype(bool),
        Blame.UNKNOWN: ~kept & ~other_lanes & ~found["decision_index"].map(all_shown).astype(bool),
        Blame.PRUNING: ~kept,
        Blame.PREDICTOR: ~in_interval,
    }
    conditions = [condition.to_numpy(dtype=bool) for condition in causes.values()]
    found["blame"] = np.select(conditions, [str(cause) for cause in causes], str(Blame.CHANCE))
    return found
