"""What a cell measured: textbook intervals, and values that are missing or infinite are counted, never dropped."""

import math

import numpy as np
import pandas as pd
import pytest

from sumo_hmdp.errors import InputError
from sumo_hmdp.report.statistics import describe, mean_interval, rate_table, summary_table

INF, NAN = math.inf, math.nan
# Darwin's maize, cross- less self-fertilised, in eighths of an inch: Fisher, Design of Experiments (1935).
DARWIN = np.array([49, -67, 8, 16, 6, 23, 28, 41, 14, 29, 56, 24, 75, 60, -48], dtype=float)


def test_darwins_maize():
    found = describe(DARWIN)
    # Fisher: mean 20.933, t = 2.148 at 14 degrees of freedom, whose 5 % point is 2.145: from 0.03 to 41.84.
    assert found.mean == pytest.approx(20.933, abs=5e-4)
    assert found.mean / (found.std / math.sqrt(15)) == pytest.approx(2.148, abs=5e-4)
    # The two large negative values lean the distribution to the left, and the bootstrap-t follows.
    assert -10 < found.low < 0.0
    assert found.high == pytest.approx(41.84, abs=0.01)
    assert (found.median, found.count) == (24.0, 15)


def test_equal_values_do_not_tell_their_spread():
    assert np.isnan(mean_interval(np.array([2.0, 2.0, 2.0]))).all()
    assert np.isnan(describe(np.array([0.1 + 0.2, 0.3, 0.3])).low)


def test_missing_and_infinite_values_are_counted():
    found = describe(np.array([1.0, 3.0, NAN, INF, INF]))
    assert (found.count, found.missing_count, found.infinite_count) == (2, 1, 2)
    assert np.isnan([found.mean, found.std, found.low, found.high]).all()
    assert found.median == INF
    assert describe(np.array([1.0, 3.0, INF])).median == 3.0
    assert describe(np.array([INF, INF])).median == INF
    assert describe(np.array([1.0, 4.0, NAN])).median == 2.5


@pytest.mark.parametrize("values", [[], [NAN], [NAN, NAN]])
def test_nothing_known(values):
    found = describe(np.array(values))
    assert found.count == 0
    assert np.isnan([found.mean, found.median]).all()


def test_one_value_has_a_mean_and_no_interval():
    found = describe(np.array([7.0]))
    assert found.mean == 7.0
    assert np.isnan([found.std, found.low, found.high]).all()


RUNS = pd.DataFrame(
    {
        "planner": ["a", "a", "a", "b", "b", "b"],
        "risk_level": [0.1, 0.1, 0.1, None, None, None],
        "seed": [0, 1, 2, 0, 1, 2],
        "speed_mean_mps": [10.0, 12.0, 14.0, 20.0, 20.0, None],
        "contact": pd.array([True, False, False, False, None, True], dtype="boolean"),
    }
)


def test_a_table_of_cells_keeps_cells_without_a_risk_level():
    table = summary_table(RUNS, ["planner", "risk_level"], ["speed_mean_mps"])
    assert table["planner"].tolist() == ["a", "b"]
    assert table["mean"].tolist() == [12.0, 20.0]
    assert table["missing_count"].tolist() == [0, 1]
    # t(2) at 97.5 % is 4.3027; the standard error is 2 / sqrt 3.
    assert table["high"][0] == pytest.approx(12 + 4.3027 * 2 / math.sqrt(3), abs=1e-4)


def test_rates_have_exact_intervals_over_what_is_known():
    table = rate_table(RUNS, ["planner"], ["contact"]).set_index("planner")
    assert table.loc["a", ["hits", "trials", "missing_count"]].tolist() == [1, 3, 0]
    assert table.loc["b", ["hits", "trials", "missing_count"]].tolist() == [1, 2, 1]
    # Of 1 in 2 in closed form: 1 - sqrt(0.975) and its mirror image.
    assert table.loc["b", "low"] == pytest.approx(1 - math.sqrt(0.975))
    assert table.loc["b", "high"] == pytest.approx(math.sqrt(0.975))


def test_unknown_columns_are_refused():
    with pytest.raises(InputError, match=r"speed_mean.*did you mean `speed_mean_mps`"):
        summary_table(RUNS, ["planner"], ["speed_mean"])
    with pytest.raises(InputError, match="speed_mean_mps must hold truth values"):
        rate_table(RUNS, ["planner"], ["speed_mean_mps"])
