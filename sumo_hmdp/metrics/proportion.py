"""Exact intervals of a rate, and how much less repeated measurements of one run tell than independent ones."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta

from sumo_hmdp.errors import InputError


@dataclass(frozen=True)
class Rate:
    """A measured rate with its interval.

    Attributes:
        hits: how often it happened.
        trials: how often it could have.
        value: hits / trials, NaN without trials.
        low: lower end of the interval.
        high: upper end.
        design_effect: by how much the trials count less than independent ones, >= 1.
    """

    hits: int
    trials: int
    value: float
    low: float
    high: float
    design_effect: float = 1.0


def rate(hits: int, trials: int, level: float = 0.95, design_effect: float = 1.0) -> Rate:
    """Return a rate with the two-sided interval of Clopper and Pearson (Biometrika 26, 1934).

    With a design effect above 1, hits and trials are both divided by it first (Korn and Graubard, Survey Methodology
    24, 1998): what n correlated trials tell is what n / design_effect independent ones would.

    Args:
        hits: 0..trials.
        trials: without any, the rate is NaN and the interval all of [0, 1].
        level: confidence level, in (0, 1).
        design_effect: >= 1.

    Raises:
        InputError: if an argument is out of its range.
    """
    problems = []
    if not 0 <= hits <= trials:
        problems.append(f"hits must be in 0..trials, got {hits} of {trials}. Count both over the same rows")
    if not 0 < level < 1:
        problems.append(f"level must be in (0, 1), got {level}. Give 0.95 for 95 %")
    if not design_effect >= 1:
        problems.append(f"design_effect must be at least 1, got {design_effect}. Give 1 for independent trials")
    if problems:
        raise InputError(problems)
    tail = (1 - level) / 2
    k, n = hits / design_effect, trials / design_effect
    low = 0.0 if hits == 0 else float(beta.ppf(tail, k, n - k + 1))
    high = 1.0 if hits == trials else float(beta.ppf(1 - tail, k + 1, n - k))
    return Rate(hits, trials, hits / trials if trials else float("nan"), low, high, float(design_effect))


def design_effect(hits: NDArray[np.int64], trials: NDArray[np.int64]) -> float:
    """Return how much wider the variance of a rate is than with independent trials, at least 1.

    The variance of the ratio sum(hits) / sum(trials) between clusters, over the binomial variance p (1 - p) / n.

    Args:
        hits: (C,) of each cluster, such as a run.
        trials: (C,) of each cluster, > 0.

    Returns:
        1 where it cannot be seen: with fewer than two clusters, or a rate of 0 or 1.
    """
    clusters, n = len(trials), int(np.sum(trials))
    p = np.sum(hits) / n if n else 0.0
    if clusters < 2 or not 0 < p < 1:
        return 1.0
    residual = hits - p * trials
    between = clusters / (clusters - 1) * float(np.sum(residual**2)) / n**2
    return max(1.0, between / float(p * (1 - p) / n))
