"""How two cells of a study differ on the same seeds, and the verdict in words."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import pandas as pd
from scipy import stats

from sumo_hmdp.errors import InputError
from sumo_hmdp.report.frames import Cell, FloatArray, by_seed, cell_label, cells_of, is_binary, require_columns
from sumo_hmdp.report.sample_size import pairs_for_difference
from sumo_hmdp.report.statistics import RESAMPLES, bootstrap_interval

# With five pairs the Wilcoxon test's smallest p is 2 / 2^5, above 5 %: nothing could ever be shown.
FEWEST_PAIRS = 6


@dataclass(frozen=True)
class Comparison:
    """How one cell differs from another on the same seeds.

    Attributes:
        metric: the column.
        first: the cell that is compared.
        second: the cell it is compared with.
        pair_count: pairs with two finite values.
        unpaired_count: seeds that only one of the cells has.
        missing_count: pairs left out since a value is not defined.
        infinite_count: pairs left out since a value is infinite.
        difference: mean of first - second.
        low: lower end of its BCa interval.
        high: upper end.
        level: of the interval.
        test: `wilcoxon` (signed rank) or `mcnemar` (exact, of truth values).
        p_value: two-sided, of that test.
        p_adjusted: after Holm's correction over all comparisons of a table; `p_value` before.
        cohen_dz: mean over standard deviation of the differences.
        rank_biserial: (T+ - T-) / (T+ + T-) over the ranks of the differences that are not zero.
        variance_saved: 1 - var(first - second) / (var first + var second): what the common seeds save.
    """

    metric: str
    first: str
    second: str
    pair_count: int
    unpaired_count: int
    missing_count: int
    infinite_count: int
    difference: float
    low: float
    high: float
    level: float
    test: str
    p_value: float
    p_adjusted: float
    cohen_dz: float
    rank_biserial: float
    variance_saved: float


def compare_cells(
    runs: pd.DataFrame,
    cell: Sequence[str],
    metrics: Sequence[str],
    reference: Cell | None = None,
    level: float = 0.95,
    seed: str = "seed",
    resamples: int = RESAMPLES,
) -> tuple[Comparison, ...]:
    """Compare cells pair by pair on common seeds, with Holm's correction over everything that is compared.

    Args:
        runs: a tidy table, one row a run.
        cell: the columns that make a cell.
        metrics: columns of numbers or truth values.
        reference: the cell that all others are compared with; without one, every two are compared.
        level: of the intervals.
        seed: the column that makes pairs.
        resamples: of the bootstrap.

    Raises:
        InputError: if a column or the reference is missing, or a cell has several runs of one seed.
    """
    require_columns(runs, [*cell, *metrics, seed])
    cells = cells_of(runs, cell)
    if reference is not None and reference not in cells:
        known = "; ".join(cell_label(key) for key in cells)
        raise InputError([f"the reference must be a cell, got {cell_label(reference)}. Cells: {known}"])
    pairs = combinations(cells, 2) if reference is None else ((key, reference) for key in cells if key != reference)
    found = []
    for first, second in pairs:
        names = cell_label(first), cell_label(second)
        for metric in metrics:
            one, two = (by_seed(cells[key], metric, seed, cell_label(key)) for key in (first, second))
            found.append(compare_pairs(one, two, metric, names, is_binary(runs[metric]), level, resamples))
    adjusted = holm(np.array([comparison.p_value for comparison in found]))
    return tuple(replace(item, p_adjusted=float(p)) for item, p in zip(found, adjusted, strict=True))


def compare_pairs(
    first: pd.Series,
    second: pd.Series,
    metric: str,
    names: tuple[str, str] = ("first", "second"),
    binary: bool = False,  # noqa: FBT001, FBT002 - a property of the data
    level: float = 0.95,
    resamples: int = RESAMPLES,
) -> Comparison:
    """Compare one metric of two cells, each a series by seed."""
    common = first.index.intersection(second.index)
    a, b = first.loc[common].to_numpy(dtype=np.float64), second.loc[common].to_numpy(dtype=np.float64)
    missing = np.isnan(a) | np.isnan(b)
    infinite = ~missing & (np.isinf(a) | np.isinf(b))
    a, b = a[~missing & ~infinite], b[~missing & ~infinite]
    differences = a - b
    nan = float("nan")
    low, high = bootstrap_interval(differences, level, 0, resamples) if len(a) > 1 else (nan, nan)
    p_value = (mcnemar(differences) if binary else wilcoxon(differences)) if len(a) else nan
    return Comparison(
        metric=metric,
        first=names[0],
        second=names[1],
        pair_count=len(a),
        unpaired_count=len(first) + len(second) - 2 * len(common),
        missing_count=int(missing.sum()),
        infinite_count=int(infinite.sum()),
        difference=float(differences.mean()) if len(a) else nan,
        low=low,
        high=high,
        level=level,
        test="mcnemar" if binary else "wilcoxon",
        p_value=p_value,
        p_adjusted=p_value,
        cohen_dz=_ratio(float(differences.mean()), float(differences.std(ddof=1))) if len(a) > 1 else nan,
        rank_biserial=rank_biserial(differences),
        variance_saved=variance_saved(a, b),
    )


def wilcoxon(differences: FloatArray) -> float:
    """Return the two-sided p of Wilcoxon's signed-rank test; 1 where no two values differ."""
    if not np.any(differences):
        return 1.0
    return float(stats.wilcoxon(differences, zero_method="wilcox", method="auto").pvalue)


def mcnemar(differences: FloatArray) -> float:
    """Return the two-sided p of McNemar's exact test on differences -1, 0, 1 of truth values."""
    more, fewer = int(np.sum(differences > 0)), int(np.sum(differences < 0))
    return float(stats.binomtest(more, more + fewer, 0.5).pvalue) if more + fewer else 1.0


def holm(p_values: FloatArray) -> FloatArray:
    """Return p-values adjusted for their number (Holm, Scand. J. Statist. 6, 1979); NaN stays and does not count."""
    adjusted = np.full(len(p_values), np.nan)
    known = np.flatnonzero(~np.isnan(p_values))
    order = known[np.argsort(p_values[known], kind="stable")]
    steps = np.arange(len(order), 0, -1) * p_values[order]
    adjusted[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return adjusted


def rank_biserial(differences: FloatArray) -> float:
    """Return the matched-pairs rank-biserial correlation (Kerby, Compr. Psychol. 3, 2014), NaN without a difference."""
    some = differences[differences != 0]
    if not len(some):
        return float("nan")
    ranks = stats.rankdata(np.abs(some))
    return float(np.sum(ranks * np.sign(some)) / np.sum(ranks))


def variance_saved(first: FloatArray, second: FloatArray) -> float:
    """Return the share of the variance of a difference of means that common seeds save; negative where they cost."""
    if len(first) < 2:
        return float("nan")
    return 1 - _ratio(float(np.var(first - second, ddof=1)), float(np.var(first, ddof=1) + np.var(second, ddof=1)))


def _ratio(top: float, bottom: float) -> float:
    return top / bottom if bottom > 0 else float("nan")


def pairs_needed(c: Comparison) -> float:
    """Return how many pairs would show a difference as large as the one seen; NaN where that cannot be told."""
    if c.test != "wilcoxon" or not c.difference or np.isnan(c.cohen_dz):
        return float("nan")
    try:
        return pairs_for_difference(abs(c.difference / c.cohen_dz), abs(c.difference))
    except InputError:
        return float("nan")


@dataclass(frozen=True)
class Wording:
    """How a verdict speaks of a metric.

    Attributes:
        quantity: what it measures, such as `mean speed`.
        unit: printed after numbers, empty for none; `%` takes numbers times 100.
        more: of a cell with the larger value, such as `faster`; empty for "has a higher QUANTITY".
        less: of a cell with the smaller value.
    """

    quantity: str
    unit: str = ""
    more: str = ""
    less: str = ""

    def amount(self, value: float) -> str:
        """Return a number with two significant digits at least, without its unit."""
        value = 100 * value if self.unit == "%" else value
        return f"{value:.2g}" if abs(value) < 100 else f"{value:.0f}"

    @property
    def suffix(self) -> str:
        """The unit after a blank."""
        return f" {self.unit}" if self.unit else ""


def verdict(comparison: Comparison, wording: Wording, significance: float = 0.05) -> str:
    """Return what a comparison shows in one sentence.

    Args:
        comparison: of two cells, with its p-value adjusted.
        wording: of its metric.
        significance: a difference is shown where the adjusted p-value is at most this.
    """
    c = comparison
    left_out = _left_out(c)
    if c.pair_count < FEWEST_PAIRS or np.isnan(c.p_adjusted):
        return (
            f"too few data: {c.pair_count} pairs of {c.first} and {c.second} with a {wording.quantity}, "
            f"{FEWEST_PAIRS} are needed{left_out}"
        )
    numbers = (
        f"({100 * c.level:g} % interval {{low}} to {{high}}, {c.pair_count} pairs, "
        f"{_p(c.p_adjusted)} after Holm{left_out})"
    )
    if c.p_adjusted > significance:
        evidence = numbers.format(low=wording.amount(c.low), high=wording.amount(c.high))
        amount = wording.amount(c.difference) + wording.suffix
        return f"no difference in {wording.quantity} shown between {c.first} and {c.second}: {amount} {evidence}"
    if c.difference == 0:
        evidence = numbers.format(low=wording.amount(c.low), high=wording.amount(c.high))
        return f"{c.first} and {c.second} differ in {wording.quantity}, but not in its mean {evidence}"
    low, high = (c.low, c.high) if c.difference > 0 else (-c.high, -c.low)
    evidence = numbers.format(low=wording.amount(low), high=wording.amount(high))
    amount = wording.amount(abs(c.difference)) + wording.suffix
    word = wording.more if c.difference > 0 else wording.less
    if word:
        return f"{c.first} is {amount} {word} than {c.second} {evidence}"
    comparative = "higher" if c.difference > 0 else "lower"
    return f"{c.first} has a {wording.quantity} {amount} {comparative} than {c.second} {evidence}"


def _left_out(c: Comparison) -> str:
    parts = [
        f"{count} {what}"
        for count, what in (
            (c.unpaired_count, "runs without a partner"),
            (c.missing_count, "pairs with a missing value"),
            (c.infinite_count, "pairs with an infinite value"),
        )
        if count
    ]
    return f"; left out: {', '.join(parts)}" if parts else ""


def _p(value: float) -> str:
    return "p < 0.001" if value < 0.001 else f"p = {value:.2g}"
