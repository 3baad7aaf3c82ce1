"""Exact intervals of rates against published tables and closed forms."""

import numpy as np
import pytest
from scipy.stats import binomtest

from sumo_hmdp.errors import InputError
from sumo_hmdp.metrics.proportion import design_effect, rate


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
        rate(5, 3, 1.0, 0.5)
    assert len(caught.value.problems) == 3


def test_runs_whose_trials_all_agree_count_as_one_trial_each():
    # Ten runs of 40 trials, in five of them all hit: 400 trials tell what ten tell.
    trials = np.full(10, 40)
    hits = np.array([40, 0] * 5)
    effect = design_effect(hits, trials)
    assert effect == pytest.approx(40 * 10 / 9)
    wide, narrow = rate(200, 400, design_effect=effect), rate(200, 400)
    ten = rate(5, 10)
    assert wide.low == pytest.approx(ten.low, abs=0.02)
    assert wide.high - wide.low > 3 * (narrow.high - narrow.low)


def test_independent_trials_have_no_design_effect():
    rng = np.random.default_rng(3)
    effects = [design_effect(rng.binomial(50, 0.2, size=200), np.full(200, 50)) for _ in range(20)]
    assert np.mean(effects) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(("hits", "trials"), [([3], [5]), ([0, 0], [5, 5]), ([5, 5], [5, 5]), ([], [])])
def test_where_it_cannot_be_seen_it_is_one(hits, trials):
    assert design_effect(np.array(hits, dtype=int), np.array(trials, dtype=int)) == 1.0
