"""The test of a mean and its interval, which is the test turned round: the means that it does not reject.

Two tests are asked, and a mean is rejected only where both reject it:

- Student's t, exact for normal values;
- the bootstrap-t (Efron and Tibshirani, An Introduction to the Bootstrap, 1993, 12.5), which takes the distribution of
  (mean - true mean) / standard error from resampled values and so follows their skewness.

The choice rests on simulation (`analysis/17_coverage.py`, docs/studies.md): on log-normal values Student's interval
covers 85 % at n = 20, and so does one from sign flips, which supposes symmetry; the bootstrap-t alone is too narrow
where values are few or tied.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from sumo_hmdp.report.frames import FloatArray

# The least number of resamples, and how many of them must be beyond an end at the strictest level of a comparison.
RESAMPLES, BEYOND = 9999, 5
# What the counts of all resamples may take [bytes].
_MOST_BYTES = 50_000_000
# A spread below this share of the largest value is rounding.
_ROUNDING = 1e-9
# Levels that are equal on paper differ by rounding.
_SLACK = 1e-9
# Sample skewness over the root of n, on which the error of an interval of the mean depends, above which simulated
# intervals held less than they promise (log-normal values with sigma 1 at n = 10, 1.5 at n = 20 and 50).
_SKEWED = 0.4
# Fewer values than these apart from the commonest one tell too little of what the others could be.
FEWEST_APART = 5


def resamples_for(alpha: float) -> int:
    """Return how many resamples a test at a two-sided level needs."""
    return max(RESAMPLES, round(2 * BEYOND / alpha) - 1)


@dataclass(frozen=True)
class MeanTest:
    """A sample whose mean is tested and bounded.

    Attributes:
        values: (N,) finite.
        resamples: of the bootstrap; fewer are taken of samples of many thousands.
        seed: of the bootstrap.
    """

    values: FloatArray
    resamples: int = RESAMPLES
    seed: int = 0

    @property
    def mean(self) -> float:
        """Its mean."""
        return float(self.values.mean())

    @cached_property
    def has_spread(self) -> bool:
        """Whether any two values differ by more than rounding; without spread there is neither test nor interval."""
        if len(self.values) < 2:
            return False
        return bool(np.ptp(self.values) > _ROUNDING * max(float(np.abs(self.values).max()), 1e-300))

    @property
    def is_zero(self) -> bool:
        """Whether every value is 0."""
        return bool(np.all(self.values == 0))

    def p_value(self, mean: float = 0.0) -> float:
        """Return the two-sided p of a mean, the larger of both tests; NaN without spread, but 1 where all are 0."""
        if not self.has_spread:
            return 1.0 if len(self.values) and self.is_zero and mean == 0 else float("nan")
        t = (self.mean - mean) / self._error
        student = float(2 * stats.t.sf(abs(t), len(self.values) - 1))
        below = int(np.searchsorted(self._resampled, t, side="right"))
        above = len(self._resampled) - int(np.searchsorted(self._resampled, t, side="left"))
        bootstrap = 2 * (1 + min(below, above)) / (len(self._resampled) + 1)
        return min(1.0, max(student, bootstrap))

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """Return the means whose p is above 1 - level; NaN without spread."""
        if not self.has_spread:
            return float("nan"), float("nan")
        alpha = (1 - level) * (1 + _SLACK)
        student = float(stats.t.ppf(1 - (1 - level) / 2, len(self.values) - 1))
        # The mean is kept while more than this many resamples are beyond its t on either side.
        beyond = int(alpha * (len(self._resampled) + 1) / 2)
        if beyond < 1:
            return -np.inf, np.inf
        least, most = float(self._resampled[beyond - 1]), float(self._resampled[-beyond])
        return self.mean - max(most, student) * self._error, self.mean - min(least, -student) * self._error

    @property
    def doubt(self) -> str:
        """Why the interval may hold less than it promises, in words; empty where nothing is known against it."""
        if not self.has_spread:
            return ""
        n = len(self.values)
        apart = n - int(np.unique(self.values, return_counts=True)[1].max())
        if apart < FEWEST_APART and n > apart + 1:
            return f"only {apart} of {n} differ from the rest, too few for any interval of a mean to be relied on"
        skewness = abs(float(stats.skew(self.values)))
        if skewness > _SKEWED * np.sqrt(n):
            return f"so skewed that an interval from {n} may hold less often than it says"
        return ""

    @cached_property
    def _error(self) -> float:
        return float(self.values.std(ddof=1)) / float(np.sqrt(len(self.values)))

    @cached_property
    def _resampled(self) -> FloatArray:
        """(R,) rising t of the resamples around this sample's mean; those without spread tell nothing and are left out.

        Sums go value by value, so that they do not depend on how a processor adds a row.
        """
        n = len(self.values)
        counts = _counts(n, max(min(self.resamples, _MOST_BYTES // n), RESAMPLES), self.seed)
        centred = self.values - self.mean
        first, second = np.zeros((2, counts.shape[1]))
        for value, count in zip(centred, counts, strict=True):
            first += value * count
            second += value * value * count
        mean = first / n
        variance = second / n - mean**2
        kept = variance > _ROUNDING**2 * second.max() + 1e-12 * second / n
        return np.sort(mean[kept] / np.sqrt(variance[kept] / (n - 1)))


@lru_cache(maxsize=2)
def _counts(n: int, resamples: int, seed: int) -> NDArray[np.uint16]:
    """Return how often each of n values is in each resample, (n, R)."""
    rng = np.random.default_rng(seed)
    counts = np.empty((n, resamples), dtype=np.uint16)
    for start in range(0, resamples, 1000):
        part = slice(start, min(start + 1000, resamples))
        drawn = rng.integers(0, n, (part.stop - part.start, n)) + n * np.arange(part.stop - part.start)[:, None]
        counts[:, part] = np.bincount(drawn.ravel(), minlength=n * (part.stop - part.start)).reshape(-1, n).T
    return counts
