"""How two cells of a study differ on the same seeds, and the verdict in words.

One quantity is tested and printed: the mean difference of pairs with a common seed (`mean_test`), or the difference of
two rates (`PairedRates`). Each interval is its test turned round. Of several comparisons Holm's correction decides;
their intervals are all at the one level 1 - a with which that correction ended,

    a = significance / (m - r + 1), or significance / m where r = 0,

m being the number of comparisons and r how many of them are shown. A p-value that was rejected is at most a, one that
was not is above it, so an interval leaves 0 out exactly where Holm's correction shows a difference.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import pandas as pd

from sumo_hmdp.errors import InputError
from sumo_hmdp.metrics.proportion import PairedRates, clopper_pearson
from sumo_hmdp.report.frames import Cell, FloatArray, by_seed, cell_label, cells_of, is_binary, require_columns
from sumo_hmdp.report.mean_test import RESAMPLES, MeanTest, resamples_for
from sumo_hmdp.report.sample_size import FEWEST_PAIRS, pairs_for_difference

# A level and the p-value that is equal to it on paper differ by rounding.
_SLACK = 1e-9


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
        difference: mean of first - second, or difference of two rates.
        low: lower end of its interval, which leaves 0 out exactly where a difference is shown; NaN where all pairs
            differ alike.
        high: upper end.
        level: of the interval, which follows from the correction for all comparisons together.
        test: `mean` (Student's t and the bootstrap-t together) or `rate` (Tango's score, of truth values).
        p_value: two-sided, of that test; NaN where all pairs differ alike, but 1 where none differs.
        p_adjusted: after Holm's correction over all comparisons.
        cohen_dz: mean over standard deviation of the differences.
        variance_saved: 1 - var(first - second) / (var first + var second): what the common seeds save.
        doubt: why the interval may hold less than its level, in words; empty where nothing is known against it.
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
    variance_saved: float
    doubt: str

    @property
    def enough(self) -> bool:
        """Whether there are pairs enough to say anything."""
        return self.pair_count >= FEWEST_PAIRS

    @property
    def alike(self) -> bool:
        """Whether all pairs differ alike, by anything but 0, so that there is neither test nor interval."""
        return self.enough and bool(np.isnan(self.p_value))

    @property
    def shown(self) -> bool:
        """Whether a difference is shown."""
        return self.enough and (self.low > 0 or self.high < 0)


@dataclass(frozen=True)
class Pairs:
    """One metric of two cells, seed by seed.

    Attributes:
        metric: the column.
        first: name of the first cell.
        second: name of the second.
        one: (N,) values of the first with a finite value in both.
        two: (N,) of the second.
        binary: whether they are truth values.
        unpaired_count: seeds that only one of the cells has.
        missing_count: pairs left out since a value is not defined.
        infinite_count: pairs left out since a value is infinite.
        resamples: of the bootstrap.
    """

    metric: str
    first: str
    second: str
    one: FloatArray
    two: FloatArray
    binary: bool
    unpaired_count: int
    missing_count: int
    infinite_count: int
    resamples: int = RESAMPLES

    @property
    def test(self) -> MeanTest | PairedRates:
        """The test of their difference."""
        differences = self.one - self.two
        if self.binary:
            return PairedRates(int((differences > 0).sum()), int((differences < 0).sum()), len(differences))
        # What two computed values differ by in rounding is no difference.
        scale = max(float(np.abs(self.one).max()), float(np.abs(self.two).max()))
        return MeanTest(np.where(np.abs(differences) > 1e-12 * scale, differences, 0.0), self.resamples)


def pair_up(first: pd.Series, second: pd.Series, metric: str, names: tuple[str, str], *, binary: bool) -> Pairs:
    """Return the pairs of two series by seed, and how many there are not."""
    common = first.index.intersection(second.index)
    a, b = first.loc[common].to_numpy(dtype=np.float64), second.loc[common].to_numpy(dtype=np.float64)
    missing = np.isnan(a) | np.isnan(b)
    infinite = ~missing & (np.isinf(a) | np.isinf(b))
    known = ~missing & ~infinite
    unpaired = len(first) + len(second) - 2 * len(common)
    return Pairs(metric, *names, a[known], b[known], binary, unpaired, int(missing.sum()), int(infinite.sum()))


def compare_all(
    pairs: Sequence[Pairs], level: float = 0.95, on_done: Callable[[], None] | None = None
) -> tuple[Comparison, ...]:
    """Compare, with Holm's correction over everything that is given.

    Args:
        pairs: of all comparisons.
        level: 1 - the chance that any difference is shown where none is.
        on_done: called after each.
    """
    significance = 1 - level
    if pairs:
        pairs = [replace(one, resamples=resamples_for(significance / len(pairs))) for one in pairs]
    p_values = np.array([one.test.p_value() if len(one.one) else np.nan for one in pairs])
    adjusted = holm(p_values)
    tested, shown = int((~np.isnan(p_values)).sum()), int((adjusted <= significance * (1 + _SLACK)).sum())
    last = significance / max(tested - shown + bool(shown), 1)
    found = []
    for one, p_value, p_adjusted in zip(pairs, p_values, adjusted, strict=True):
        found.append(_comparison(one, float(p_value), float(p_adjusted), 1 - last))
        if on_done is not None:
            on_done()
    return tuple(found)


def _comparison(pairs: Pairs, p_value: float, p_adjusted: float, level: float) -> Comparison:
    differences, nan = pairs.one - pairs.two, float("nan")
    several = len(differences) > 1
    test = pairs.test if several else None
    low, high = test.interval(level) if test is not None else (nan, nan)
    return Comparison(
        metric=pairs.metric,
        first=pairs.first,
        second=pairs.second,
        pair_count=len(differences),
        unpaired_count=pairs.unpaired_count,
        missing_count=pairs.missing_count,
        infinite_count=pairs.infinite_count,
        difference=float(differences.mean()) if len(differences) else nan,
        low=low,
        high=high,
        level=level,
        test="rate" if pairs.binary else "mean",
        p_value=p_value,
        p_adjusted=p_adjusted,
        cohen_dz=_ratio(float(differences.mean()), float(differences.std(ddof=1))) if several else nan,
        variance_saved=variance_saved(pairs.one, pairs.two),
        doubt=test.doubt if isinstance(test, MeanTest) else "",
    )


def compare_cells(
    runs: pd.DataFrame,
    cell: Sequence[str],
    metrics: Sequence[str],
    reference: Cell | None = None,
    level: float = 0.95,
    seed: str = "seed",
) -> tuple[Comparison, ...]:
    """Compare cells pair by pair on common seeds, with Holm's correction over everything that is compared.

    Args:
        runs: a tidy table, one row a run.
        cell: the columns that make a cell.
        metrics: columns of numbers or truth values.
        reference: the cell that all others are compared with; without one, every two are compared.
        level: 1 - the chance that any difference is shown where none is.
        seed: the column that makes pairs.

    Raises:
        InputError: if a column or the reference is missing, or a cell has several runs of one seed.
    """
    return compare_all(cell_pairs(runs, cell, metrics, reference, seed), level)


def cell_pairs(
    runs: pd.DataFrame, cell: Sequence[str], metrics: Sequence[str], reference: Cell | None = None, seed: str = "seed"
) -> list[Pairs]:
    """Return what `compare_cells` compares.

    Raises:
        InputError: as it does.
    """
    require_columns(runs, [*cell, *metrics, seed])
    cells = cells_of(runs, cell)
    if reference is not None and reference not in cells:
        known = "; ".join(cell_label(key) for key in cells)
        raise InputError([f"the reference must be a cell, got {cell_label(reference)}. Cells: {known}"])
    both = combinations(cells, 2) if reference is None else ((key, reference) for key in cells if key != reference)
    found = []
    for first, second in both:
        names = cell_label(first), cell_label(second)
        for metric in metrics:
            one, two = (
                by_seed(cells[key], metric, seed, name) for key, name in zip((first, second), names, strict=True)
            )
            found.append(pair_up(one, two, metric, names, binary=is_binary(runs[metric])))
    return found


def compare_pairs(
    first: pd.Series,
    second: pd.Series,
    metric: str,
    names: tuple[str, str] = ("first", "second"),
    binary: bool = False,  # noqa: FBT001, FBT002 - a property of the data
    level: float = 0.95,
) -> Comparison:
    """Compare one metric of two cells, each a series by seed."""
    return compare_all([pair_up(first, second, metric, names, binary=binary)], level)[0]


def holm(p_values: FloatArray) -> FloatArray:
    """Return p-values adjusted for their number (Holm, Scand. J. Statist. 6, 1979); NaN stays and does not count."""
    adjusted = np.full(len(p_values), np.nan)
    known = np.flatnonzero(~np.isnan(p_values))
    order = known[np.argsort(p_values[known], kind="stable")]
    steps = np.arange(len(order), 0, -1) * p_values[order]
    adjusted[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return adjusted


def variance_saved(first: FloatArray, second: FloatArray) -> float:
    """Return the share of the variance of a difference of means that common seeds save; negative where they cost."""
    if len(first) < 2:
        return float("nan")
    return 1 - _ratio(float(np.var(first - second, ddof=1)), float(np.var(first, ddof=1) + np.var(second, ddof=1)))


def _ratio(top: float, bottom: float) -> float:
    return top / bottom if bottom > 0 else float("nan")


def pairs_needed(c: Comparison) -> float:
    """Return how many pairs would show a difference as large as the one seen; NaN where that cannot be told."""
    if c.test != "mean" or not c.difference or np.isnan(c.cohen_dz):
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


def verdict(comparison: Comparison, wording: Wording) -> str:
    """Return what a comparison shows in one sentence.

    Args:
        comparison: of two cells.
        wording: of its metric.
    """
    c = comparison
    left_out = _left_out(c)
    if not c.enough:
        return (
            f"too few data: {c.pair_count} pairs of {c.first} and {c.second} with a {wording.quantity}, "
            f"{FEWEST_PAIRS} are needed{left_out}"
        )
    doubt = f"; {c.doubt}" if c.doubt else ""
    if np.isnan(c.low):
        others = f"{100 * clopper_pearson(0, c.pair_count)[1]:.2g} % of all seeds may do otherwise{left_out}"
        if not c.alike:
            alike = f"equal in all {c.pair_count} pairs, without spread for an interval; up to {others}"
            return f"no difference in {wording.quantity} shown between {c.first} and {c.second}: {alike}"
        told = _told(c, wording)
        return f"{told} in each of {c.pair_count} pairs alike, without spread for a test or an interval; up to {others}"
    turned = c.shown and c.difference < 0
    low, high = (-c.high, -c.low) if turned else (c.low, c.high)
    evidence = (
        f"({100 * c.level:.4g} % interval {wording.amount(low)} to {wording.amount(high)}, {c.pair_count} pairs, "
        f"{_p(c.p_adjusted)} after Holm{left_out}{doubt})"
    )
    if not c.shown:
        amount = wording.amount(c.difference) + wording.suffix
        return f"no difference in {wording.quantity} shown between {c.first} and {c.second}: {amount} {evidence}"
    return f"{_told(c, wording)} {evidence}"


def _told(c: Comparison, wording: Wording) -> str:
    amount = wording.amount(abs(c.difference)) + wording.suffix
    word = wording.more if c.difference > 0 else wording.less
    if word:
        return f"{c.first} is {amount} {word} than {c.second}"
    comparative = "higher" if c.difference > 0 else "lower"
    return f"{c.first} has a {wording.quantity} {amount} {comparative} than {c.second}"


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
