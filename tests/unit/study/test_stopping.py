"""Half-widths against tables of statistics, and the rule in every cell."""

import math

import pandas as pd
import pytest

from sumo_hmdp.study.schema import StoppingFile
from sumo_hmdp.study.stopping import half_width, is_enough, metric_problem


def runs(values, statuses=None):
    return pd.DataFrame(
        {"seed": range(len(values)), "status": statuses or ["completed"] * len(values), "gap_min_m": values}
    )


def test_a_mean_by_hand():
    # Mean 3, deviation sqrt(2.5); t(0.975, 4) = 2.776 from the tables.
    assert half_width(runs([1.0, 2.0, 3.0, 4.0, 5.0]), "gap_min_m", 0.95) == pytest.approx(
        2.776 * math.sqrt(2.5 / 5), rel=2e-4
    )
    # t(0.95, 1) = 6.314.
    assert half_width(runs([1.0, 3.0]), "gap_min_m", 0.9) == pytest.approx(6.314, rel=1e-4)


def test_a_rate_by_hand():
    # Wilson for 2 of 10 at 95 % is (0.057, 0.510).
    statuses = ["contact"] * 2 + ["completed"] * 8
    assert half_width(runs([0.0] * 10, statuses), "contact_rate", 0.95) == pytest.approx((0.510 - 0.057) / 2, abs=5e-4)


def test_what_failed_or_is_missing_does_not_count():
    whole = runs([1.0, 2.0, 4.0])
    more = runs([1.0, 99.0, 2.0, None, 4.0], ["completed", "failed", "contact", "completed", "completed"])
    assert half_width(more, "gap_min_m", 0.95) == half_width(whole, "gap_min_m", 0.95)
    assert math.isinf(half_width(runs([1.0]), "gap_min_m", 0.95))
    assert math.isinf(half_width(runs([1.0], ["failed"]), "contact_rate", 0.95))


def test_the_order_of_the_runs_makes_no_difference():
    frame = runs([0.1, 0.7, 1.3, 1e-9, 1e9, 0.3])
    assert half_width(frame, "gap_min_m", 0.95) == half_width(frame.iloc[::-1], "gap_min_m", 0.95)


def test_every_cell_must_be_narrow_enough():
    rule = StoppingFile(metric="gap_min_m", half_width=2.0, seeds_max=9)
    narrow, wide = runs([1.0, 2.0, 3.0, 4.0, 5.0]), runs([1.0, 20.0, 30.0])
    assert is_enough([narrow, narrow], rule)
    assert not is_enough([narrow, wide], rule)


def test_metrics_to_stop_by():
    assert [metric_problem(name) for name in ("contact_rate", "gap_min_m", "lane_change_count")] == [""] * 3
    assert "did you mean `contact_rate`" in metric_problem("contact_rte")
    assert "machine's speed" in metric_problem("wall_time_s")
    assert "known metric" in metric_problem("seed")
