"""How many runs: published tables, and the smallest number is the smallest."""

import numpy as np
import pytest
from scipy import stats

from sumo_hmdp.errors import InputError
from sumo_hmdp.metrics.proportion import PairedRates, rate
from sumo_hmdp.report.sample_size import (
    pairs_for_difference,
    pairs_for_rates,
    runs_for_half_width,
    runs_for_no_violation,
)


# Two-sided paired t-test at 5 %: Faul et al., G*Power 3, Behav. Res. Methods 39 (2007), and Cohen's table 2.4.1.
@pytest.mark.parametrize(
    ("effect", "power", "pairs"), [(0.5, 0.8, 34), (0.2, 0.8, 199), (0.8, 0.8, 15), (0.5, 0.95, 54)]
)
def test_pairs_as_published(effect, power, pairs):
    assert pairs_for_difference(2.0, 2.0 * effect, power=power) == pairs


def test_the_power_is_that_of_simulated_tests():
    rng = np.random.default_rng(1)
    n = pairs_for_difference(1.0, 0.6)
    found = stats.ttest_1samp(rng.normal(0.6, 1.0, size=(20000, n)), 0.0, axis=1).pvalue < 0.05
    assert 0.79 < found.mean() < 0.84


def test_the_least_number_of_runs():
    # t(15) at 97.5 % is 2.1314: 2.1314 * 1 / 4 = 0.533; with 15 runs 2.1448 / 3.873 = 0.554.
    assert runs_for_half_width(1.0, 0.54) == 16
    assert runs_for_half_width(0.001, 100.0) == 2
    # For many runs the normal quantile: (1.96 * 10 / 0.5)^2 = 1536.6, and two more for t.
    assert runs_for_half_width(10.0, 0.5) == pytest.approx(1539, abs=1)


def test_what_cannot_be_is_refused():
    with pytest.raises(InputError, match="std must be above 0, got 0"):
        pairs_for_difference(0.0, 1.0)
    with pytest.raises(InputError, match="no study of up to 1000000 runs is large enough"):
        runs_for_half_width(1.0, 1e-6)
    assert pairs_for_difference(1.0, 0.01) == pytest.approx(78491, rel=1e-3)


def test_runs_in_which_no_violation_shows_something():
    # 1 - 0.025^(1/n): 0.0506 for 71 runs, 0.0499 for 72; the rule of three would say 60.
    assert [runs_for_no_violation(eps) for eps in (0.05, 0.025, 0.2)] == [72, 146, 17]
    for eps in (0.01, 0.1):
        n = runs_for_no_violation(eps)
        assert rate(0, n).high <= eps < rate(0, n - 1).high


def test_pairs_in_which_a_rate_can_differ():
    for comparisons in (1, 8, 16, 100):
        n = pairs_for_rates(comparisons)
        assert PairedRates(n, 0, n).p_value() * comparisons <= 0.05
        assert n == 6 or PairedRates(n - 1, 0, n - 1).p_value() * comparisons > 0.05
