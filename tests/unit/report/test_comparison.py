"""Two cells on common seeds: textbook tests, Holm's correction, and no more false alarms than promised."""

import dataclasses
import math

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom, norm

from sumo_hmdp.errors import InputError
from sumo_hmdp.report.comparison import (
    Wording,
    compare_all,
    compare_cells,
    compare_pairs,
    holm,
    pair_up,
    variance_saved,
    verdict,
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
    return compare_pairs(pd.Series(first, dtype=float), pd.Series(second, dtype=float), "x_m", **options)


def test_darwins_maize():
    found = pairs(DARWIN, np.zeros(15))
    assert found.difference == pytest.approx(20.933, abs=5e-4)
    # Fisher's t = 2.148 is d_z times the root of 15; his p is 4.97 %, and the bootstrap-t's is larger.
    assert found.cohen_dz == pytest.approx(2.148 / math.sqrt(15), abs=2e-4)
    assert 0.0497 < found.p_value < 0.15
    assert found.low < 0 < found.difference < found.high
    assert not found.shown


def test_rates_are_compared_by_the_score():
    found = pairs([1, 1, 1, 1, 1, 1, 0], [0, 0, 0, 0, 0, 0, 0], binary=True)
    # McNemar's z is the root of 6.
    assert (found.test, found.difference) == ("rate", 6 / 7)
    assert found.p_value == pytest.approx(2 * norm.sf(math.sqrt(6)))
    assert found.shown


def test_nothing_against_nothing_is_not_an_interval_of_no_width():
    found = pairs([0] * 12, [0] * 12, binary=True)
    assert (found.p_value, found.difference) == (1.0, 0.0)
    # The square of z over twelve more than it.
    assert (found.low, found.high) == pytest.approx((-0.2425, 0.2425), abs=1e-4)


@pytest.mark.parametrize("seed", range(40))
def test_verdicts_and_intervals_never_contradict_each_other(seed):
    """Families of every size and strength: what Holm's correction shows is what leaves 0 out, and nothing else."""
    rng = np.random.default_rng(seed)
    family = []
    for _ in range(rng.integers(1, 9)):
        n, shift = int(rng.integers(6, 30)), rng.choice([0.0, 0.5, 1.0, 2.0])
        if rng.random() < 0.3:
            one, two = (rng.random(n) < p for p in (0.1 + 0.4 * (shift > 0), 0.1))
            binary = True
        else:
            one, two, binary = rng.lognormal(size=n) - 1.5 + shift, rng.normal(size=n), False
        both = (pd.Series(np.asarray(values, dtype=float)) for values in (one, two))
        family.append(pair_up(*both, "x_m", ("a", "b"), binary=binary))
    found = compare_all(family)
    assert len({one.level for one in found}) == 1
    assert found[0].level >= 0.95 - 1e-12
    for one in found:
        assert one.shown == (one.p_adjusted <= 0.05) == (not one.low <= 0 <= one.high)
        assert one.low < one.high


def test_the_level_follows_from_the_correction_by_hand():
    # Two of four are shown, then none of two, then the one that there is.
    strong, weak = np.arange(8.0) + 20, np.array([1.0, -1.0, 2.0, -2.0, 1.0, -1.0, 2.0, -2.1])
    none = pd.Series(np.zeros(8))

    def level(*samples):
        return compare_all([pair_up(pd.Series(s), none, "x_m", ("a", "b"), binary=False) for s in samples])[0].level

    assert level(strong, weak, strong, weak) == pytest.approx(1 - 0.05 / 3)
    assert level(weak, weak) == pytest.approx(1 - 0.05 / 2)
    assert level(strong) == pytest.approx(0.95)


def test_pairs_that_all_differ_alike_have_neither_test_nor_interval():
    found = pairs([1.1, 2.1, 3.1, 4.1, 5.1, 6.1], [1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    assert found.alike
    assert not found.shown
    assert np.isnan([found.p_value, found.low, found.high]).all()
    # Clopper and Pearson of 0 in 6.
    assert verdict(found, SPEED) == (
        "first is 0.1 m/s faster than second in each of 6 pairs alike, without spread for a test or an interval; up to "
        "46 % of all seeds may do otherwise"
    )
    equal = pairs([1.0, 2.0, 3.0, 4.0, 5.0, 6.0], [1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    assert (equal.p_value, equal.alike, equal.shown) == (1.0, False, False)
    assert verdict(equal, SPEED) == (
        "no difference in mean speed shown between first and second: equal in all 6 pairs, without spread for an "
        "interval; up to 46 % of all seeds may do otherwise"
    )


def test_a_sentence_says_where_no_method_keeps_its_promise():
    few = pairs([0.0] * 18 + [3.0, 4.0], [0.0] * 20)
    assert "only 2 of 20 differ from the rest" in verdict(few, SPEED)
    skewed = pairs([0.1, 0.2, 0.15, 0.12, 0.3, 0.25, 0.22, 0.18, 0.11, 9.0], [0.0] * 10)
    assert "so skewed that an interval from 10 may hold less often than it says" in verdict(skewed, SPEED)
    assert pairs(DARWIN, np.zeros(15)).doubt == ""


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


def test_every_two_cells_or_all_against_one():
    table = frame(a=[1.0, 2.0], b=[2.0, 3.0], c=[4.0, 6.0])
    found = compare_cells(table, ["planner"], ["x_m"])
    assert [(c.first, c.second, c.difference) for c in found] == [("a", "b", -1.0), ("a", "c", -3.5), ("b", "c", -2.5)]
    found = compare_cells(table, ["planner"], ["x_m"], reference=("b",))
    assert [(c.first, c.second, c.difference) for c in found] == [("a", "b", -1.0), ("c", "b", 2.5)]
    assert [c.p_adjusted for c in found if not np.isnan(c.p_value)] == [found[1].p_value]


def test_mistakes_are_named():
    table = frame(a=[1.0, 2.0], b=[2.0, 3.0])
    with pytest.raises(InputError, match=r"the reference must be a cell, got d. Cells: a; b"):
        compare_cells(table, ["planner"], ["x_m"], reference=("d",))
    with pytest.raises(InputError, match=r"cell a must have one run a seed, got several of seed \[1\]"):
        compare_cells(table.assign(seed=1), ["planner"], ["x_m"])
    with pytest.raises(InputError, match=r"column x_n must be in the table. did you mean `x_m`"):
        compare_cells(table, ["planner"], ["x_n"])


def test_truth_values_are_compared_as_rates():
    table = frame(a=[1.0] * 9, b=[0.0] * 8 + [1.0])
    table["x_m"] = table["x_m"].astype(bool)
    (found,) = compare_cells(table, ["planner"], ["x_m"])
    assert (found.test, found.p_value) == ("rate", pytest.approx(2 * norm.sf(math.sqrt(8))))


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
        found = compare_cells(table, ["planner"], metrics, reference=("a",))
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
        found, first="hmdp_mpc", second="idm_mobil", pair_count=50, difference=0.8, low=0.5, high=1.1, p_adjusted=0.002,
        level=1 - 0.05 / 6,
    )  # fmt: skip


def test_verdicts_in_words(shown):
    evidence = "(99.17 % interval 0.5 to 1.1, 50 pairs, p = 0.002 after Holm)"
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
        "(99.17 % interval -0.2 to 1.1, 50 pairs, p = 0.4 after Holm)"
    )
