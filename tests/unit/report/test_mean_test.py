"""The test of a mean: its interval is the test turned round, and both hold what they promise."""

import itertools

import numpy as np
import pytest
from scipy import stats

from sumo_hmdp.report.mean_test import MeanTest, resamples_for


@pytest.mark.parametrize("level", [0.95, 0.99, 0.999])
@pytest.mark.parametrize("n", [6, 12, 40])
def test_the_interval_holds_exactly_the_means_that_are_not_rejected(level, n):
    rng = np.random.default_rng(n)
    test = MeanTest(rng.lognormal(size=n), resamples_for(1 - level))
    low, high = test.interval(level)
    width = high - low
    for end, outwards in ((low, -1), (high, 1)):
        assert test.p_value(end - outwards * 1e-6 * width) > (1 - level) * (1 - 1e-6)
        assert test.p_value(end + outwards * 1e-6 * width) <= (1 - level) * (1 + 1e-6)


def test_resamples_against_all_that_there_are():
    """With five values there are 5^5 equally likely resamples; the bootstrap's p is their share, but for chance."""
    values = np.array([0.1, 0.4, 0.5, 1.1, 3.0])
    t = (values.mean() - 2.5) / (values.std(ddof=1) / np.sqrt(5))
    found = []
    for chosen in itertools.product(values, repeat=5):
        resample = np.array(chosen)
        if np.ptp(resample) > 0:
            found.append((resample.mean() - values.mean()) / (resample.std(ddof=1) / np.sqrt(5)))
    share = 2 * min(np.mean(np.array(found) <= t), np.mean(np.array(found) >= t))
    # Skewed to the right, a mean far above the sample's is less unlikely than Student's distribution says.
    assert share > 2 * stats.t.sf(-t, 4)
    assert MeanTest(values, 49999).p_value(2.5) == pytest.approx(share, abs=0.01)


def test_it_rejects_no_more_than_student():
    rng = np.random.default_rng(2)
    for _ in range(50):
        values = rng.normal(size=9)
        assert MeanTest(values).p_value() >= stats.ttest_1samp(values, 0.0).pvalue - 1e-12


def test_the_same_twice_and_in_any_unit():
    values = np.random.default_rng(5).gamma(2.0, size=20)
    low, high = MeanTest(values).interval()
    assert MeanTest(values.copy()).interval() == (low, high)
    assert MeanTest(1e6 * values + 3.0).interval() == pytest.approx((1e6 * low + 3.0, 1e6 * high + 3.0))


@pytest.mark.parametrize(("values", "p"), [([0.0] * 7, 1.0), ([0.1] * 7, np.nan), ([0.1 + 0.2, 0.3, 0.3], np.nan)])
def test_without_spread(values, p):
    test = MeanTest(np.array(values))
    assert np.array_equal(test.p_value(), p, equal_nan=True)
    assert np.isnan(test.interval()).all()
    assert test.doubt == ""


def test_resamples_that_are_all_alike_leave_a_finite_interval():
    low, high = MeanTest(np.array([0.0] * 19 + [1.0])).interval()
    # Student's, as the resamples tell nothing more: t(19) = 2.093 times 0.05.
    assert (low, high) == pytest.approx((0.05 - 2.093 * 0.05, 0.05 + 2.093 * 0.05), abs=1e-4)


@pytest.mark.parametrize(
    ("draw", "mean", "promised"),
    [
        (lambda rng: rng.normal(size=20), 0.0, 0.93),
        (lambda rng: rng.lognormal(0.0, 0.5, size=20), np.exp(0.125), 0.90),
        (lambda rng: rng.lognormal(0.0, 1.0, size=20), np.exp(0.5), 0.90),
    ],
    ids=["normal", "log-normal 0.5", "log-normal 1"],
)
def test_intervals_hold_what_they_promise(draw, mean, promised):
    """Of log-normal values with sigma 1 Student's interval holds 85 %, as does the BCa bootstrap."""
    rng = np.random.default_rng(12)
    held = 0
    for _ in range(500):
        low, high = MeanTest(draw(rng)).interval()
        held += low <= mean <= high
    assert held / 500 >= promised - 2 * np.sqrt(promised * (1 - promised) / 500)
