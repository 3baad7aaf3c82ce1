"""When a study has seeds enough: the half-width of a confidence interval, of a mean or of a rate."""

import math
from collections.abc import Sequence

import pandas as pd
from scipy import stats

from sumo_hmdp.study.record import RUN_COLUMNS, WALL_CLOCK_COLUMNS
from sumo_hmdp.study.schema import StoppingFile
from sumo_hmdp.validation import nearest

RATE = "contact_rate"


def metric_problem(metric: str) -> str:
    """Return what is wrong with a metric to stop by, empty if nothing is."""
    if metric in WALL_CLOCK_COLUMNS:
        return f"must not depend on the machine's speed, got {metric!r}; choose another"
    numbers = [name for name, kind in RUN_COLUMNS.items() if kind in {"int64", "Int64", "float64"} and name != "seed"]
    known = [name for name in (RATE, *numbers) if name not in WALL_CLOCK_COLUMNS]
    return "" if metric in known else f"must be a known metric, got {metric!r}; {nearest(metric, known)}"


def half_width(runs: pd.DataFrame, metric: str, confidence: float) -> float:
    """Return the half-width of a metric's confidence interval, infinite where there is too little to tell.

    Of a mean by Student's distribution, of the rate of runs with contact by Wilson's interval. Runs that failed count
    for neither.

    Args:
        runs: rows of the `runs` table of one cell.
        metric: a numeric column, or `contact_rate`.
        confidence: of the interval, between 0 and 1.
    """
    ended = runs[runs["status"].isin(["completed", "contact"])]
    if metric == RATE:
        if ended.empty:
            return math.inf
        contacts = int((ended["status"] == "contact").sum())
        interval = stats.binomtest(contacts, len(ended)).proportion_ci(confidence, method="wilson")
        return float(interval.high - interval.low) / 2
    # In the order of the seeds, so that rounding does not depend on which run came first.
    values = ended.sort_values("seed")[metric].dropna().astype("float64")
    if len(values) < 2:
        return math.inf
    return float(stats.t.ppf((1 + confidence) / 2, len(values) - 1) * values.std(ddof=1) / math.sqrt(len(values)))


def is_enough(cells: Sequence[pd.DataFrame], rule: StoppingFile) -> bool:
    """Tell whether the rule is met in every cell."""
    return all(half_width(runs, rule.metric, rule.confidence) <= rule.half_width for runs in cells)
