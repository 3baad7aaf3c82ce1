"""Intervals of rates against published tables, closed forms, brute force and simulation."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import binomtest, multinomial, norm

from sumo_hmdp.errors import InputError
from sumo_hmdp.metrics.proportion import PairedRates, clustered_proportion, rate


# Newcombe, Two-sided confidence intervals for the single proportion, Stat. Med. 17 (1998), table I, method 5.
@pytest.mark.parametrize(
    ("hits", "trials", "low", "high"),
    [(81, 263, 0.2527, 0.3676), (15, 148, 0.0579, 0.1617), (0, 20, 0.0000, 0.1684), (1, 29, 0.0009, 0.1776)],
)
def test_published_intervals(hits, trials, low, high):
    found = rate(hits, trials)
    assert (found.low, found.high) == pytest.approx((low, high), abs=6e-5)


@pytest.mark.parametrize("trials", [1, 7, 300])
def test_ends_of_the_scale_in_closed_form(trials):
    assert rate(0, trials, 0.9).high == pytest.approx(1 - 0.05 ** (1 / trials))
    assert rate(trials, trials, 0.9).low == pytest.approx(0.05 ** (1 / trials))
    assert (rate(0, trials).low, rate(trials, trials).high) == (0.0, 1.0)


def test_the_same_as_scipy_by_another_way():
    for trials in range(1, 12):
        for hits in range(trials + 1):
            interval = binomtest(hits, trials).proportion_ci(0.95, method="exact")
            found = rate(hits, trials)
            assert (found.low, found.high) == pytest.approx((interval.low, interval.high))


def test_without_trials_nothing_is_known():
    found = rate(0, 0)
    assert np.isnan(found.value)
    assert (found.low, found.high) == (0.0, 1.0)


def test_every_mistake_is_listed():
    with pytest.raises(InputError) as caught:
        rate(5, 3, 1.0)
    assert len(caught.value.problems) == 2


@pytest.mark.parametrize(("runs", "high"), [(20, 0.1684), (10, 0.3085)])
def test_no_violation_bounds_what_the_number_of_runs_bounds(runs, high):
    # Newcombe's 0 in 20, and 1 - 0.025^(1/10); the 32 plans of each run tell nothing of how alike they are.
    found = clustered_proportion([0] * runs, [32] * runs)
    assert (found.violations, found.plans, found.runs, found.effective_n, found.df) == (0, 32 * runs, runs, runs, 0)
    assert (found.low, found.high) == pytest.approx((0.0, high), abs=1e-4)
    assert f"that of {runs} runs" in found.note
    every = clustered_proportion([32] * runs, [32] * runs)
    assert (every.low, every.high) == pytest.approx((1 - high, 1.0), abs=1e-4)


def test_runs_whose_plans_all_agree_count_as_one_plan_each():
    found, ten = clustered_proportion([40, 0] * 5, [40] * 10), rate(5, 10)
    assert found.effective_n == 10
    assert (found.low, found.high) == pytest.approx((ten.low, ten.high))


def test_runs_of_one_plan_each_are_independent():
    found, exact = clustered_proportion([1, 0, 0, 1, 0], [1] * 5), rate(2, 5)
    assert (found.low, found.high) == (exact.low, exact.high)


def test_the_effective_number_by_hand():
    # p = 0.1; four runs have a violation, so there are three degrees of freedom, whose t is 3.18245.
    few = clustered_proportion([5, 3, 0, 0, 0, 0, 0, 0, 6, 6], [20] * 10)
    assert (few.df, few.runs) == (3, 10)
    p, residuals = 0.1, np.array([3, 1, *[-2] * 6, 4, 4])
    deff = 10 / 9 * (residuals**2).sum() / 200**2 / (p * (1 - p) / 200)
    assert few.effective_n == pytest.approx(200 / deff * (1.95996 / 3.18245) ** 2, rel=1e-4)
    # With one degree of freedom t is 12.706, and less would be left than the ten runs.
    assert clustered_proportion([8, 2, *[0] * 8], [20] * 10).effective_n == 10
    # Unequal runs: (40 + 10)^2 / (40^2 + 10^2).
    assert clustered_proportion([3, 0], [40, 10]).effective_n == pytest.approx(2500 / 1700)


def test_runs_without_plans_do_not_count_and_none_at_all_tells_nothing():
    assert clustered_proportion([0, 0, 1], [5, 0, 5]) == clustered_proportion([0, 1], [5, 5])
    nothing = clustered_proportion([0, 0], [0, 0])
    assert np.isnan(nothing.rate)
    assert (nothing.low, nothing.high, nothing.runs) == (0.0, 1.0, 0)


def test_counts_that_do_not_fit_are_refused():
    with pytest.raises(InputError) as caught:
        clustered_proportion([6], [5], 95)
    assert len(caught.value.problems) == 2
    with pytest.raises(InputError, match="as many counts"):
        clustered_proportion([1, 2], [5])


@pytest.mark.parametrize("correlation", [0.0, 0.1, 0.3])
@pytest.mark.parametrize("rate_", [0.01, 0.05, 0.1])
def test_intervals_of_plans_hold_what_they_promise(rate_, correlation):
    """Twenty runs of 32 plans, correlated by a beta distribution; 61 to 93 % before runs were the sampling unit."""
    rng = np.random.default_rng(7)
    spread = 1 / correlation - 1 if correlation else np.inf
    held = 0
    for _ in range(600):
        true = rng.beta(rate_ * spread, (1 - rate_) * spread, 20) if correlation else np.full(20, rate_)
        found = clustered_proportion(rng.binomial(32, true), [32] * 20)
        held += found.low <= rate_ <= found.high
    assert held / 600 >= 0.93 - 2 * np.sqrt(0.93 * 0.07 / 600)


def test_paired_rates_by_brute_force():
    """The score's variance is that of the likeliest truth with the difference, found here by a search."""
    for more, fewer, pairs, difference in ((12, 2, 50, 0.06), (3, 0, 12, 0.3), (0, 1, 44, -0.1), (0, 0, 20, 0.1)):

        def unlikely(q, more=more, fewer=fewer, pairs=pairs, difference=difference):
            chances = np.array([q + difference, q, 1 - 2 * q - difference])
            counts = np.array([more, fewer, pairs - more - fewer])
            return -float(np.sum(counts[counts > 0] * np.log(np.maximum(chances[counts > 0], 1e-300))))

        low, high = max(0.0, -difference), (1 - difference) / 2
        q = minimize_scalar(unlikely, bounds=(low, high), method="bounded", options={"xatol": 1e-12}).x
        variance = pairs * (2 * q + difference - difference**2)
        z = (more - fewer - pairs * difference) / np.sqrt(variance)
        assert PairedRates(more, fewer, pairs).score(difference) == pytest.approx(z, rel=1e-4)


def test_nothing_against_nothing_has_an_interval():
    z = norm.ppf(0.975)
    low, high = PairedRates(0, 0, 20).interval()
    assert (low, high) == pytest.approx((-(z**2) / (20 + z**2), z**2 / (20 + z**2)))
    assert PairedRates(0, 0, 20).p_value() == 1.0
    # All pairs differ: the lower end is not 1, the upper one cannot be more.
    low, high = PairedRates(20, 0, 20).interval()
    assert low < 0.7
    assert high == pytest.approx(1.0)


def test_the_test_of_paired_rates_is_mcnemars_and_never_contradicts_the_interval():
    assert PairedRates(8, 1, 30).p_value() == pytest.approx(2 * norm.sf(7 / 3))
    for more in range(13):
        for fewer in range(13 - more):
            found = PairedRates(more, fewer, 12)
            for level in (0.95, 0.99):
                low, high = found.interval(level)
                assert (low <= 0 <= high) == (found.p_value() >= 1 - level)
                assert low < high
                for end in (low, high):
                    assert abs(end) > 1 - 1e-9 or found.p_value(end) == pytest.approx(1 - level, rel=1e-6)


@pytest.mark.parametrize("one", [0.01, 0.05, 0.1])
@pytest.mark.parametrize("two", [0.01, 0.05, 0.1])
def test_paired_rates_hold_what_they_promise(one, two):
    """Every outcome of 20 seeds with its probability: no simulation, and half of what is common is shared."""
    both = one * two + 0.5 * (min(one, two) - one * two)
    chances = np.array([one - both, two - both, 1 - one - two + 2 * both])
    held = sum(
        multinomial.pmf([more, fewer, 20 - more - fewer], 20, chances)
        for more in range(21)
        for fewer in range(21 - more)
        if PairedRates(more, fewer, 20).p_value(one - two) >= 0.05
    )
    assert held >= 0.93
