"""Whether the predictions were as uncertain as they said, step by step of the horizon.

All functions take the predictions of any number of runs beside what happened, as `realised_branches` returns them. The
branches that were recorded of a vehicle are taken as all there is: their probabilities are scaled to a sum of 1.
Instants of one run are alike, so that intervals, which suppose independence, are too narrow; read them as a guide.
"""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy.special import ndtr
from scipy.stats import chi2

from sumo_hmdp.metrics.proportion import rate

KEYS = ["run_id", "decision_index", "vehicle_id", "horizon_step"]


def _weights(realised: pd.DataFrame) -> pd.Series:
    """Return the share of each branch in its vehicle's prediction of a step."""
    return realised["probability"] / realised.groupby(KEYS)["probability"].transform("sum")


def position_coverage(
    realised: pd.DataFrame, levels: Sequence[float] = (0.5, 0.9, 0.95), confidence: float = 0.95
) -> pd.DataFrame:
    """Return how often the position along the road was in the central interval of the branches' mixture.

    It was where the mixture's distribution function at the position is within level / 2 of one half.

    Args:
        realised: predictions beside what happened.
        levels: of the central intervals.
        confidence: of the exact intervals of the shares.

    Returns:
        One row per horizon step and level: horizon_step, level, hit_count, trial_count, coverage_share, low_share,
        high_share.
    """
    z = _standardised(realised["x_m"] - realised["branch_x_m"], realised["x_std_m"])
    below = (_weights(realised) * ndtr(z)).groupby([realised[key] for key in KEYS]).sum()
    rows = []
    for step, values in below.groupby(level="horizon_step"):
        for level in levels:
            # A position that the mixture is certain of lies on the edge of a jump from 0 to 1: that is at its middle.
            found = rate(int((np.abs(values - 0.5) <= level / 2 + 1e-12).sum()), len(values), confidence)
            rows.append((step, level, found.hits, found.trials, found.value, found.low, found.high))
    names = ["horizon_step", "level", "hit_count", "trial_count", "coverage_share", "low_share", "high_share"]
    return pd.DataFrame(rows, columns=names)


def _standardised(error: pd.Series, std: pd.Series) -> pd.Series:
    """Return errors in standard deviations; without any spread 0 where they vanish, else infinite."""
    certain = std == 0
    sure = np.sign(error.where(error.abs() > 1e-6, 0.0)) * np.inf
    return (error / std.where(~certain)).where(~certain, sure.fillna(0.0))


def lane_scores(realised: pd.DataFrame) -> pd.DataFrame:
    """Return how well the intended lanes were foretold.

    Args:
        realised: predictions beside what happened.

    Returns:
        One row per horizon step: horizon_step; trial_count; brier_mean, the mean over trials of the sum over lanes of
        (probability - outcome)^2, from 0 to 2; log_loss_mean, the mean of -ln(probability of the lane), inf where a
        lane without any probability was taken; impossible_count, how often that was.
    """
    lanes = realised.assign(weight=_weights(realised), taken=realised["branch_lane"] == realised["intended_lane"])
    per_lane = lanes.groupby([*KEYS, "branch_lane"], as_index=False).agg(p=("weight", "sum"), taken=("taken", "first"))
    per_lane["square"] = (per_lane["p"] - per_lane["taken"]) ** 2
    per_lane["p_taken"] = per_lane["p"] * per_lane["taken"]
    trials = per_lane.groupby(KEYS, as_index=False).agg(
        square=("square", "sum"), p=("p_taken", "sum"), foreseen=("taken", "any")
    )
    # A lane that no branch goes to has probability 0 and outcome 1.
    trials["brier"] = trials["square"] + (~trials["foreseen"])
    with np.errstate(divide="ignore"):
        trials["log_loss"] = -np.log(trials["p"])
    return trials.groupby("horizon_step", as_index=False).agg(
        trial_count=("brier", "count"),
        brier_mean=("brier", "mean"),
        log_loss_mean=("log_loss", "mean"),
        impossible_count=("foreseen", lambda foreseen: int((~foreseen).sum())),
    )


def lane_reliability(
    realised: pd.DataFrame,
    edges: Sequence[float] = (0.0, 0.05, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0),
    confidence: float = 0.95,
) -> pd.DataFrame:
    """Return how often a lane was taken that had been given a probability, by bins of that probability.

    Args:
        realised: predictions beside what happened.
        edges: of the bins, rising from 0 to 1; a bin has its upper edge.
        confidence: of the exact intervals of the shares.

    Returns:
        One row per bin that was used, over all horizon steps: low_probability, high_probability, probability_mean,
        hit_count, trial_count, taken_share, low_share, high_share.
    """
    lanes = realised.assign(weight=_weights(realised), taken=realised["branch_lane"] == realised["intended_lane"])
    trials = lanes.groupby([*KEYS, "branch_lane"], as_index=False).agg(p=("weight", "sum"), taken=("taken", "first"))
    trials["bin"] = np.clip(np.searchsorted(edges, trials["p"] - 1e-12), 1, len(edges) - 1)
    rows = []
    for bin_, part in trials.groupby("bin"):
        found = rate(int(part["taken"].sum()), len(part), confidence)
        ends = edges[int(str(bin_)) - 1], edges[int(str(bin_))]
        rows.append((*ends, part["p"].mean(), found.hits, found.trials, found.value, found.low, found.high))
    names = ["low_probability", "high_probability", "probability_mean", "hit_count", "trial_count", "taken_share"]
    return pd.DataFrame(rows, columns=[*names, "low_share", "high_share"])


def position_nees(realised: pd.DataFrame, level: float = 0.95) -> pd.DataFrame:
    """Return the normalised squared error of the branch that came true: 2 on average where its spread is right.

    Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), 5.4.2. The error
    along and that across the road are each divided by their spread, so their correlation is left out.

    Args:
        realised: predictions beside what happened; branches without spread along or across are left out.
        level: of the interval in which the mean of independent normal errors lies.

    Returns:
        One row per horizon step: horizon_step, trial_count, nees_mean, low_bound, high_bound.
    """
    true = realised[realised["same"] & (realised["x_std_m"] > 0) & (realised["y_std_m"] > 0)]
    # Branches that differ later only have all come true up to here: one of them stands for the trial.
    true = true.sort_values("probability", ascending=False, kind="stable").drop_duplicates(KEYS)
    along = (true["x_m"] - true["branch_x_m"]) / true["x_std_m"]
    across = (true["y_m"] - true["branch_y_m"]) / true["y_std_m"]
    table = (
        (along**2 + across**2)
        .groupby(true["horizon_step"])
        .agg(["count", "mean"])
        .reset_index()
        .rename(columns={"count": "trial_count", "mean": "nees_mean"})
    )
    count = table["trial_count"].to_numpy()
    table["low_bound"] = chi2.ppf((1 - level) / 2, 2 * count) / count
    table["high_bound"] = chi2.ppf((1 + level) / 2, 2 * count) / count
    return table


def displacement_errors(realised: pd.DataFrame) -> dict[str, float | int]:
    """Return how far the predicted paths were from those driven, over predictions whose whole horizon was recorded.

    Args:
        realised: predictions beside what happened.

    Returns:
        trial_count; ade_best_m and fde_best_m, the mean over trials of the least average and the least final distance
        of any branch; ade_likeliest_m and fde_likeliest_m of the likeliest branch. NaN without a trial.
    """
    horizon = realised["horizon_step"].max()
    distance = np.hypot(realised["x_m"] - realised["branch_x_m"], realised["y_m"] - realised["branch_y_m"])
    trial = ["run_id", "decision_index", "vehicle_id"]
    paths = realised.assign(distance=distance).groupby([*trial, "branch_index"], as_index=False).agg(
        steps=("horizon_step", "count"),
        probability=("probability", "first"),
        average=("distance", "mean"),
        final=("distance", "last"),
    )  # fmt: skip
    paths = paths[paths["steps"] == horizon]
    best = paths.groupby(trial)[["average", "final"]].min()
    likeliest = paths.sort_values("probability", ascending=False, kind="stable").drop_duplicates(trial)
    return {
        "trial_count": len(best),
        "ade_best_m": float(best["average"].mean()),
        "fde_best_m": float(best["final"].mean()),
        "ade_likeliest_m": float(likeliest["average"].mean()),
        "fde_likeliest_m": float(likeliest["final"].mean()),
    }
