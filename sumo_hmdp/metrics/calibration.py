"""Whether the predictions were as uncertain as they said, step by step of the horizon.

Scores are of the whole predictive distribution: of all branches, not of the few that are written down to be shown.
They take the predictions of any number of runs beside what happened, as `realised_predictions` returns them.

- Places: the mixture of all branches that were kept, as if what was pruned were spread like them.
- Lanes: what was pruned is spread evenly over all lanes of the road, and no less than `LEAST_MASS`, so that the log
  loss is finite; a lane that no branch led to is counted all the same.

Instants of one run are alike: the run is the sampling unit of every interval.
"""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import t

from sumo_hmdp.metrics.proportion import ProportionInterval, clustered_proportion

# What is spread over all lanes at least: a prediction that is certain can lose no more than by one in a million.
LEAST_MASS = 1e-6
# A place on the end of an interval without width is inside it [m]; what is written down has six digits.
_EDGE = 1e-3
# Which of the recorded quantiles are the ends of which central interval.
LEVELS = {0.5: (2, 3), 0.9: (1, 4), 0.95: (0, 5)}


def position_coverage(realised: pd.DataFrame, confidence: float = 0.95) -> pd.DataFrame:
    """Return how often the position along the road was in the central 50, 90 and 95 % intervals of the prediction.

    Args:
        realised: predictions beside what happened.
        confidence: of the intervals of the shares.

    Returns:
        One row per horizon step and level: horizon_step, level, hit_count, trial_count, coverage_share, low_share,
        high_share.
    """
    rows = []
    for step, part in realised.groupby("horizon_step"):
        quantiles = np.array(part["x_quantiles_m"].tolist(), dtype=np.float64)
        x = part["x_m"].to_numpy(np.float64)
        for level, (low, high) in LEVELS.items():
            inside = (quantiles[:, low] - _EDGE <= x) & (x <= quantiles[:, high] + _EDGE)
            found = _share(inside, part["run_id"], confidence)
            rows.append((step, level, found.violations, found.plans, found.rate, found.low, found.high))
    names = ["horizon_step", "level", "hit_count", "trial_count", "coverage_share", "low_share", "high_share"]
    return pd.DataFrame(rows, columns=names)


def _share(hit: NDArray[np.bool_], runs: pd.Series, confidence: float) -> ProportionInterval:
    per_run = pd.Series(hit).groupby(runs.to_numpy()).agg(["sum", "count"])
    return clustered_proportion(per_run["sum"].to_numpy(np.int64), per_run["count"].to_numpy(np.int64), confidence)


def lane_probabilities(realised: pd.DataFrame) -> NDArray[np.float64]:
    """Return the probability of each lane, (N, L): what was pruned is spread evenly over all of them."""
    kept = np.array(realised["lane_probs"].tolist(), dtype=np.float64)
    spread = np.maximum(realised["pruned_prob"].to_numpy(np.float64), LEAST_MASS)[:, None]
    whole: NDArray[np.float64] = kept / kept.sum(axis=1, keepdims=True) * (1 - spread) + spread / kept.shape[1]
    return whole


def lane_scores(realised: pd.DataFrame) -> pd.DataFrame:
    """Return how well the intended lanes were foretold.

    Args:
        realised: predictions beside what happened.

    Returns:
        One row per horizon step: horizon_step; trial_count; brier_mean, the mean over trials of the sum over lanes of
        (probability - outcome)^2, from 0 to 2; log_loss_mean, the mean of -ln(probability of the lane), finite;
        impossible_count, how often a lane was taken that no branch led to; pruned_mean, the mean probability that was
        pruned and is spread over all lanes.
    """
    p = lane_probabilities(realised)
    lane = realised["intended_lane"].to_numpy(np.int64) - 1
    taken = np.eye(p.shape[1])[lane]
    kept = np.array(realised["lane_probs"].tolist(), dtype=np.float64)
    trials = pd.DataFrame(
        {
            "horizon_step": realised["horizon_step"].to_numpy(),
            "brier": ((p - taken) ** 2).sum(axis=1),
            "log_loss": -np.log((p * taken).sum(axis=1)),
            "impossible": (kept * taken).sum(axis=1) == 0,
            "pruned": realised["pruned_prob"].to_numpy(np.float64),
        }
    )
    return trials.groupby("horizon_step", as_index=False).agg(
        trial_count=("brier", "count"),
        brier_mean=("brier", "mean"),
        log_loss_mean=("log_loss", "mean"),
        impossible_count=("impossible", "sum"),
        pruned_mean=("pruned", "mean"),
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
        confidence: of the intervals of the shares.

    Returns:
        One row per bin that was used, over all horizon steps, of the lanes that some branch led to:
        low_probability, high_probability, probability_mean, hit_count, trial_count, taken_share, low_share, high_share.
    """
    p = lane_probabilities(realised)
    led = np.array(realised["lane_probs"].tolist(), dtype=np.float64) > 0
    taken = np.arange(1, p.shape[1] + 1) == realised["intended_lane"].to_numpy(np.int64)[:, None]
    runs = np.broadcast_to(realised["run_id"].to_numpy(object)[:, None], p.shape)
    trials = pd.DataFrame({"p": p[led], "taken": taken[led], "run_id": runs[led]})
    trials["bin"] = np.clip(np.searchsorted(edges, trials["p"] - 1e-9), 1, len(edges) - 1)
    rows = []
    for bin_, part in trials.groupby("bin"):
        found = _share(part["taken"].to_numpy(bool), part["run_id"], confidence)
        ends = edges[int(str(bin_)) - 1], edges[int(str(bin_))]
        rows.append((*ends, part["p"].mean(), found.violations, found.plans, found.rate, found.low, found.high))
    names = ["low_probability", "high_probability", "probability_mean", "hit_count", "trial_count", "taken_share"]
    return pd.DataFrame(rows, columns=[*names, "low_share", "high_share"])


def position_nees(realised: pd.DataFrame, level: float = 0.95) -> pd.DataFrame:
    """Return the normalised squared error of the prediction: 2 on average where mean and spread are right.

    Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), 5.4.2, with mean and
    variance of the whole mixture. The error along and that across the road are each divided by their spread, so their
    correlation is left out.

    Args:
        realised: predictions beside what happened; those without spread along or across are left out.
        level: of the interval of the mean, Student's over the means of the runs.

    Returns:
        One row per horizon step: horizon_step, trial_count, nees_mean, nees_low, nees_high; the ends are NaN with fewer
        than two runs.
    """
    known = realised[(realised["x_std_m"] > 0) & (realised["y_std_m"] > 0)]
    along = (known["x_m"] - known["x_mean_m"]) / known["x_std_m"]
    across = (known["y_m"] - known["y_mean_m"]) / known["y_std_m"]
    squares = (along**2 + across**2).astype("float64")
    rows = []
    for step, part in squares.groupby(known["horizon_step"]):
        means = part.groupby(known["run_id"].loc[part.index]).mean().to_numpy(np.float64)
        half = float("nan")
        if len(means) > 1:
            half = float(t.ppf((1 + level) / 2, len(means) - 1) * means.std(ddof=1) / np.sqrt(len(means)))
        rows.append((step, len(part), float(part.mean()), float(means.mean()) - half, float(means.mean()) + half))
    return pd.DataFrame(rows, columns=["horizon_step", "trial_count", "nees_mean", "nees_low", "nees_high"])


def displacement_errors(realised: pd.DataFrame) -> dict[str, float | int]:
    """Return how far the predicted paths were from those driven, over predictions whose whole horizon was recorded.

    Args:
        realised: branches beside what happened, as `realised_branches` returns them: those that were written down, of
            each sequence of lanes the likeliest and then the likeliest of the others.

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
