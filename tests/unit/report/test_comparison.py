"""Two cells on common seeds: textbook tests, Holm's correction, and no more false alarms than promised."""

import dataclasses
import math

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom

from sumo_hmdp.errors import InputError
from sumo_hmdp.report.comparison import (
    Wording,
    compare_cells,
    compare_pairs,
    holm,
    mcnemar,
    rank_biserial,
    variance_saved,
    verdict,
    wilcoxon,
)

INF, NAN = math.inf, math.nan
# Darwin's maize, cross- less self-fertilised, in eighths of an inch: Fisher, Design of Experiments (1935).
DARWIN = np.array([49, -67, 8, 16, 6, 23, 28, 41, 14, 29, 56, 24, 75, 60, -48], dtype=float)
SPEED = Wording("mean speed", "m/s", "faster", "slower")


def frame(**cells):
    """Build a tidy table of one metric from lists by cell; seeds count up."""
    return pd.DataFrame(
        [
            {"planner": name, "seed": seed, "x_m": value}
            for name, values in cells.items()
            for seed, value in enumerate(values)
        ]
    )


def pairs(first, second, **options):
    return compare_pairs(pd.Series(first, dtype=float), pd.Series(second, dtype=float), "x_m", resamples=999, **options)


def test_darwins_maize_by_ranks():
    # The negative ranks are 10 (48) and 14 (67): T- = 24 of 120. Exact p: scipy's own example of the same data.
    assert wilcoxon(DARWIN) == pytest.approx(0.041259765625)
    assert rank_biserial(DARWIN) == pytest.approx((96 - 24) / 120)
    found = pairs(DARWIN, np.zeros(15))
    assert found.difference == pytest.approx(20.933, abs=5e-4)
    # Fisher's t = 2.148 is d_z times the root of 15.
    assert found.cohen_dz == pytest.approx(2.148 / math.sqrt(15), abs=2e-4)
    assert found.low < found.difference < found.high


def test_mcnemar_by_hand():
    # One against eight discordant pairs: 2 (1 + 9) / 2^9.
    assert mcnemar(np.array([1.0] + [-1.0] * 8 + [0.0] * 20)) == pytest.approx(20 / 512)
    assert mcnemar(np.zeros(4)) == 1.0
    found = pairs([1, 1, 1, 1, 1, 1, 0], [0, 0, 0, 0, 0, 0, 0], binary=True)
    assert (found.test, found.p_value, found.difference) == ("mcnemar", 2 / 64, 6 / 7)


def test_holm_on_a_worked_example():
    # Sorted 0.005, 0.01, 0.03, 0.04 times 4, 3, 2, 1, never falling.
    assert holm(np.array([0.01, 0.04, 0.03, 0.005])) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm(np.array([0.6, NAN, 0.7]))[[0, 2]] == pytest.approx([1.0, 1.0])
    assert np.isnan(holm(np.array([0.6, NAN])))[1]
    assert len(holm(np.array([]))) == 0


def test_common_seeds_save_what_they_share():
    # The second is the first plus one: nothing is left of the variance.
    assert variance_saved(np.array([1.0, 2.0, 3.0]), np.array([2.0, 3.0, 4.0])) == 1.0
    # Opposed: var of the difference is 4, of each 1.
    assert variance_saved(np.array([1.0, 2.0, 3.0]), np.array([3.0, 2.0, 1.0])) == pytest.approx(-1.0)
    rng = np.random.default_rng(0)
    assert variance_saved(rng.normal(size=4000), rng.normal(size=4000)) == pytest.approx(0.0, abs=0.05)


def test_pairs_that_are_left_out_are_counted():
    first = pd.Series({0: 1.0, 1: NAN, 2: 3.0, 3: INF, 4: 5.0})
    second = pd.Series({0: 0.0, 1: 1.0, 2: 1.0, 3: 1.0, 7: 1.0, 8: 1.0})
    found = compare_pairs(first, second, "x_m")
    counts = (found.pair_count, found.unpaired_count, found.missing_count, found.infinite_count)
    assert counts == (2, 3, 1, 1)
    assert found.difference == 1.5
    assert "left out: 3 runs without a partner, 1 pairs with a missing value, 1 pairs with an infinite" in verdict(
        found, SPEED
    )


@pytest.mark.parametrize("count", [0, 1])
def test_hardly_any_pairs(count):
    found = pairs([1.0] * count, [2.0] * count)
    assert np.isnan([found.low, found.cohen_dz, found.variance_saved]).all()
    assert verdict(found, SPEED).startswith(f"too few data: {count} pairs")


def test_equal_cells_have_p_one():
    found = pairs([1.0, 2.0, 3.0], [1.0, 2.0, 3.0])
    assert (found.p_value, found.difference, found.low, found.high) == (1.0, 0.0, 0.0, 0.0)
    assert np.isnan([found.rank_biserial, found.cohen_dz]).all()


def test_every_two_cells_or_all_against_one():
    table = frame(a=[1.0, 2.0], b=[2.0, 3.0], c=[4.0, 6.0])
    found = compare_cells(table, ["planner"], ["x_m"])
    assert [(c.first, c.second, c.difference) for c in found] == [("a", "b", -1.0), ("a", "c", -3.5), ("b", "c", -2.5)]
    found = compare_cells(table, ["planner"], ["x_m"], reference=("b",))
    assert [(c.first, c.second, c.difference) for c in found] == [("a", "b", -1.0), ("c", "b", 2.5)]
    # Two comparisons with p = 0.5 each: Holm doubles.
    assert {c.p_adjusted for c in found} == {1.0}


def test_mistakes_are_named():
    table = frame(a=[1.0, 2.0], b=[2.0, 3.0])
    with pytest.raises(InputError, match=r"the reference must be a cell, got d. Cells: a; b"):
        compare_cells(table, ["planner"], ["x_m"], reference=("d",))
    with pytest.raises(InputError, match=r"cell a must have one run a seed, got several of seed \[1\]"):
        compare_cells(table.assign(seed=1), ["planner"], ["x_m"])
    with pytest.raises(InputError, match=r"column x_n must be in the table. did you mean `x_m`"):
        compare_cells(table, ["planner"], ["x_n"])


def test_truth_values_are_compared_by_mcnemar():
    table = frame(a=[1.0] * 9, b=[0.0] * 8 + [1.0])
    table["x_m"] = table["x_m"].astype(bool)
    (found,) = compare_cells(table, ["planner"], ["x_m"])
    assert (found.test, found.p_value) == ("mcnemar", 2 / 2**8)


def test_no_more_false_alarms_than_promised():
    """Three metrics, three cells that differ in nothing: a study with any finding at all is a false alarm."""
    rng = np.random.default_rng(2026)
    metrics = ["u", "v", "w"]
    alarms = 0
    for _ in range(200):
        common = np.tile(rng.exponential(size=(20, 3)), (3, 1))
        values = common + rng.standard_t(3, size=(60, 3))
        table = pd.DataFrame(values, columns=metrics).assign(
            planner=np.repeat(list("abc"), 20), seed=list(range(20)) * 3
        )
        found = compare_cells(table, ["planner"], metrics, reference=("a",), resamples=9)
        alarms += any(c.p_adjusted <= 0.05 for c in found)
    assert alarms <= binom.ppf(0.999, 200, 0.05)


def test_a_true_difference_is_found():
    rng = np.random.default_rng(5)
    common = rng.normal(25, 5, size=50)
    found = pairs(common + 0.8 + rng.normal(0, 1, 50), common + rng.normal(0, 1, 50))
    assert found.low < 0.8 < found.high
    assert found.p_value < 0.05
    assert found.variance_saved > 0.9


@pytest.fixture
def shown():
    found = pairs([1.0, 2.0, 3.0, 4.0, 5.0, 6.0], [0.0] * 6)
    return dataclasses.replace(
        found, first="hmdp_mpc", second="idm_mobil", pair_count=50, difference=0.8, low=0.5, high=1.1, p_adjusted=0.002
    )


def test_verdicts_in_words(shown):
    evidence = "(95 % interval 0.5 to 1.1, 50 pairs, p = 0.002 after Holm)"
    assert verdict(shown, SPEED) == f"hmdp_mpc is 0.8 m/s faster than idm_mobil {evidence}"
    assert verdict(shown, Wording("mean speed", "m/s")) == (
        f"hmdp_mpc has a mean speed 0.8 m/s higher than idm_mobil {evidence}"
    )
    slower = dataclasses.replace(shown, difference=-0.8, low=-1.1, high=-0.5)
    assert verdict(slower, SPEED) == f"hmdp_mpc is 0.8 m/s slower than idm_mobil {evidence}"
    assert "20 % lower" in verdict(dataclasses.replace(slower, difference=-0.2), Wording("contact rate", "%"))
    assert "p < 0.001" in verdict(dataclasses.replace(shown, p_adjusted=1e-6), SPEED)
    large = dataclasses.replace(shown, difference=1234.0)
    assert "1234 m longer" in verdict(large, Wording("distance", "m", "longer", "shorter"))


def test_verdicts_that_show_nothing(shown):
    unclear = dataclasses.replace(shown, low=-0.2, p_adjusted=0.4)
    assert verdict(unclear, SPEED) == (
        "no difference in mean speed shown between hmdp_mpc and idm_mobil: 0.8 m/s "
        "(95 % interval -0.2 to 1.1, 50 pairs, p = 0.4 after Holm)"
    )
    balanced = dataclasses.replace(shown, difference=0.0, low=-0.2)
    assert verdict(balanced, SPEED).startswith("hmdp_mpc and idm_mobil differ in mean speed, but not in its mean")
