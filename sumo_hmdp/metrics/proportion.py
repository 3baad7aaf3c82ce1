"""Intervals of rates: of independent runs, of plans that share runs, and of the difference between two paired rates."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta, norm, t

from sumo_hmdp.errors import InputError, Problem

Counts = Sequence[int] | NDArray[np.int64]


@dataclass(frozen=True)
class Rate:
    """A measured rate with its interval.

    Attributes:
        hits: how often it happened.
        trials: how often it could have.
        value: hits / trials, NaN without trials.
        low: lower end of the interval.
        high: upper end.
    """

    hits: int
    trials: int
    value: float
    low: float
    high: float


def rate(hits: int, trials: int, level: float = 0.95) -> Rate:
    """Return a rate of independent trials with the interval of Clopper and Pearson (Biometrika 26, 1934).

    Args:
        hits: 0..trials.
        trials: without any, the rate is NaN and the interval all of [0, 1].
        level: confidence level, two-sided, in (0, 1).

    Raises:
        InputError: if an argument is out of its range.
    """
    problems: list[Problem | str] = []
    if not 0 <= hits <= trials:
        problems.append(f"hits must be in 0..trials, got {hits} of {trials}. Count both over the same rows")
    problems += _level_problems(level)
    if problems:
        raise InputError(problems)
    low, high = clopper_pearson(hits, trials, level)
    return Rate(hits, trials, hits / trials if trials else float("nan"), low, high)


def clopper_pearson(hits: float, trials: float, level: float = 0.95) -> tuple[float, float]:
    """Return the ends of the interval; hits and trials need not be whole numbers."""
    tail = (1 - level) / 2
    low = 0.0 if hits <= 0 else float(beta.ppf(tail, hits, trials - hits + 1))
    high = 1.0 if hits >= trials else float(beta.ppf(1 - tail, hits + 1, trials - hits))
    return low, high


@dataclass(frozen=True)
class ProportionInterval:
    """A rate of plans (or steps) whose sampling unit is the run.

    Attributes:
        rate: violations / plans, NaN without plans.
        low: lower end of the interval.
        high: upper end.
        violations: how many plans were violated.
        plans: how many there were.
        runs: runs with at least one plan: the independent observations.
        effective_n: independent plans that would tell as much, from `runs` to `plans`.
        df: degrees of freedom of the variance between runs; 0 where it cannot be estimated.
        note: what the interval rests on, in words.
    """

    rate: float
    low: float
    high: float
    violations: int
    plans: int
    runs: int
    effective_n: float
    df: int
    note: str


def clustered_proportion(
    violations_per_run: Counts, plans_per_run: Counts, confidence: float = 0.95
) -> ProportionInterval:
    """Return the rate of violated plans with an interval whose sampling unit is the run.

    Plans of one run are alike, so n plans of C runs tell less than n independent ones. After Korn and Graubard (Survey
    Methodology 24, 1998), the interval of Clopper and Pearson is taken at the effective sample size

        n_eff = n / max(deff, 1) * (z / t_df)^2,    C_eff <= n_eff <= n,

    where deff is the variance of the rate between runs over the binomial one, and z and t_df are quantiles of the
    normal and of Student's distribution. Two choices make it hold with few runs, as simulation shows
    (analysis/17_coverage.py):

    - df is one less than the number of runs with a violation (or without one in every plan, where these are fewer):
      the runs without any tell nothing of how alike the violations of one run are.
    - C_eff = n^2 / sum(n_i^2) runs of equal weight bound n_eff from below: runs are independent of each other, even
      where all plans of a run agree.

    Runs of one plan each are independent, and the interval is exact. Without a violation (or with nothing else) no
    likeness can be seen, and the bound is that of the number of runs: 0 of 640 plans from 20 runs allows as much as 0
    of 20.

    Args:
        violations_per_run: (C,) violated plans of each run.
        plans_per_run: (C,) plans of each run; runs without any are left out.
        confidence: two-sided, in (0, 1).

    Raises:
        InputError: if the counts do not fit together or the confidence is out of its range.
    """
    hits, trials = np.asarray(violations_per_run, dtype=np.int64), np.asarray(plans_per_run, dtype=np.int64)
    problems = _level_problems(confidence)
    if hits.shape != trials.shape or hits.ndim != 1:
        problems.append(f"there must be as many counts of violations as of plans, got {hits.shape} and {trials.shape}")
    elif (hits < 0).any() or (hits > trials).any():
        problems.append("the violations of a run must be in 0..plans. Count both over the same rows")
    if problems:
        raise InputError(problems)
    hits, trials = hits[trials > 0], trials[trials > 0]
    runs, n, k = len(trials), int(trials.sum()), int(hits.sum())
    if not runs:
        return ProportionInterval(float("nan"), 0.0, 1.0, 0, 0, 0, 0.0, 0, "no plans")
    p = k / n
    df = max(0, min(int((hits > 0).sum()), int((hits < trials).sum())) - 1)
    if trials.max() == 1:
        effective, note = float(n), f"{_count(runs)} of one plan each"
    elif k in {0, n}:
        effective, note = float(runs), f"the bound is that of {_count(runs)}: no likeness within runs can be seen"
    else:
        least = n**2 / float(np.sum(trials.astype(np.float64) ** 2))
        effective = least
        note = f"the interval is that of {_count(runs)}: too few differ to see how alike the plans of one run are"
        if df:
            shrink = float(norm.ppf((1 + confidence) / 2) / t.ppf((1 + confidence) / 2, df)) ** 2
            effective = float(np.clip(n / _design_effect(hits, trials) * shrink, least, n))
            note = f"{_count(runs)} tell what {effective:.0f} independent plans would, with {df} degrees of freedom"
    low, high = clopper_pearson(p * effective, effective, confidence)
    return ProportionInterval(p, low, high, k, n, runs, effective, df, note)


def _count(runs: int) -> str:
    return f"{runs} run{'' if runs == 1 else 's'}"


def _design_effect(hits: NDArray[np.int64], trials: NDArray[np.int64]) -> float:
    """Return the variance of sum(hits) / sum(trials) between two or more runs over the binomial one, at least 1."""
    runs, n = len(trials), int(trials.sum())
    p = hits.sum() / n
    between = runs / (runs - 1) * float(np.sum((hits - p * trials) ** 2)) / n**2
    return max(1.0, between / float(p * (1 - p) / n))


@dataclass(frozen=True)
class PairedRates:
    """The difference between two rates of the same runs, tested and bounded by one score.

    Attributes:
        more: pairs in which it happened in the first alone.
        fewer: pairs in which it happened in the second alone.
        pairs: all pairs.
    """

    more: int
    fewer: int
    pairs: int

    @property
    def difference(self) -> float:
        """First rate less second."""
        return (self.more - self.fewer) / self.pairs

    def p_value(self, difference: float = 0.0) -> float:
        """Return the two-sided p of a difference by Tango's score; that of 0 is McNemar's without a correction."""
        return float(2 * norm.sf(abs(self.score(difference))))

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """Return the differences that the score does not reject at 1 - level (Tango, Stat. Med. 17, 1998).

        It has no width 0: of 0 against 0 in n pairs it is plus and minus z^2 / (n + z^2).
        """
        z = float(norm.ppf((1 + level) / 2))
        return self._end(z, -1.0), self._end(-z, 1.0)

    def score(self, difference: float) -> float:
        """Return the excess of the observed over a true difference, in standard errors of the likeliest such truth."""
        n, d = self.pairs, difference
        excess = self.more - self.fewer - n * d
        if not excess:
            return 0.0
        b = -self.more - self.fewer + (2 * n - self.more + self.fewer) * d
        c = -self.fewer * d * (1 - d)
        root = np.sqrt(max(b * b - 8 * n * c, 0.0))
        # The likeliest rate of `fewer` under this difference; of two equal forms the one without cancellation.
        q = (root - b) / (4 * n) if b <= 0 else -2 * c / (b + root)
        variance = n * (2 * q + d * (1 - d))
        return float(excess / np.sqrt(variance)) if variance > 0 else float(np.copysign(np.inf, excess))

    def _end(self, target: float, bound: float) -> float:
        """Return where the falling score passes a target between the estimate and a bound, by bisection."""
        inner, outer = self.difference, bound
        for _ in range(60):
            middle = (inner + outer) / 2
            if abs(self.score(middle)) <= abs(target):
                inner = middle
            else:
                outer = middle
        return inner


def _level_problems(level: float) -> list[Problem | str]:
    return [] if 0 < level < 1 else [f"level must be in (0, 1), got {level}. Give 0.95 for 95 %"]
