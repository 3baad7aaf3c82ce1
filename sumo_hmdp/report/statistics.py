"""Statistics of a study: what each cell measured (how two cells differ is in comparison.py).

A *cell* is one combination of factors (planner, risk level, density ...); its runs differ in their seed only. Nothing
is dropped in silence: values that are missing or infinite are counted in the result.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
import pandas as pd

from sumo_hmdp.errors import InputError
from sumo_hmdp.metrics.proportion import rate
from sumo_hmdp.report.frames import FloatArray, cells_of, is_binary, numbers, require_columns
from sumo_hmdp.report.mean_test import MeanTest


@dataclass(frozen=True)
class Description:
    """One metric in one cell.

    Attributes:
        count: finite values.
        missing_count: values that are not defined.
        infinite_count: values that the definition makes infinite.
        mean: of the finite values; NaN where any is infinite, as are `std`, `low` and `high`.
        median: of the finite and infinite values.
        std: sample standard deviation.
        low: lower end of the mean's interval; NaN where all values are equal, since they do not tell their spread.
        high: upper end.
    """

    count: int
    missing_count: int
    infinite_count: int
    mean: float
    median: float
    std: float
    low: float
    high: float


def describe(values: FloatArray, level: float = 0.95) -> Description:
    """Describe a sample.

    Args:
        values: (N,) with NaN where not defined.
        level: of the interval of the mean, which is that of `mean_test.MeanTest`.
    """
    known = values[~np.isnan(values)]
    finite = known[np.isfinite(known)]
    infinite = len(known) - len(finite)
    median = _median(known)
    mean = std = low = high = float("nan")
    if len(finite) and not infinite:
        mean = float(finite.mean())
    if len(finite) > 1 and not infinite:
        std = float(finite.std(ddof=1))
        low, high = mean_interval(finite, level)
    return Description(len(finite), len(values) - len(known), infinite, mean, median, std, low, high)


def _median(known: FloatArray) -> float:
    """Return the median; between two infinite values it is infinite, not NaN."""
    if not len(known):
        return float("nan")
    ordered = np.sort(known)
    lower, upper = float(ordered[(len(known) - 1) // 2]), float(ordered[len(known) // 2])
    return lower if lower == upper else (lower + upper) / 2


def mean_interval(values: FloatArray, level: float = 0.95) -> tuple[float, float]:
    """Return the interval of the mean of finite values; NaN with fewer than two, or where all are equal."""
    return MeanTest(values).interval(level)


def summary_table(runs: pd.DataFrame, cell: Sequence[str], metrics: Sequence[str], level: float = 0.95) -> pd.DataFrame:
    """Describe metrics per cell, one row per cell and metric.

    Args:
        runs: a tidy table, one row a run.
        cell: the columns that make a cell.
        metrics: columns of numbers.
        level: of the intervals.

    Returns:
        The cell columns, `metric`, and the fields of `Description`.

    Raises:
        InputError: if a column is missing.
    """
    require_columns(runs, [*cell, *metrics])
    return pd.DataFrame(
        [
            {
                **dict(zip(cell, key, strict=True)),
                "metric": metric,
                **asdict(describe(numbers(part[metric]), level)),
            }
            for key, part in cells_of(runs, cell).items()
            for metric in metrics
        ]
    )


def rate_table(runs: pd.DataFrame, cell: Sequence[str], flags: Sequence[str], level: float = 0.95) -> pd.DataFrame:
    """Return how often something was true, per cell and column, with exact intervals; one row each.

    Args:
        runs: a tidy table, one row a run.
        cell: the columns that make a cell.
        flags: columns of truth values.
        level: of the intervals.

    Returns:
        The cell columns, `metric`, `hits`, `trials`, `missing_count`, `rate`, `low`, `high`.

    Raises:
        InputError: if a column is missing, or holds something else than truth values.
    """
    require_columns(runs, [*cell, *flags])
    wrong = [name for name in flags if not is_binary(runs[name])]
    if wrong:
        raise InputError([f"column {name} must hold truth values. Compare it with a number first" for name in wrong])
    rows = []
    for key, part in cells_of(runs, cell).items():
        for flag in flags:
            values = numbers(part[flag])
            known = values[~np.isnan(values)]
            found = rate(int(known.sum()), len(known), level)
            rows.append(
                {
                    **dict(zip(cell, key, strict=True)),
                    "metric": flag,
                    "hits": found.hits,
                    "trials": found.trials,
                    "missing_count": len(values) - len(known),
                    "rate": found.value,
                    "low": found.low,
                    "high": found.high,
                }
            )
    return pd.DataFrame(rows)
