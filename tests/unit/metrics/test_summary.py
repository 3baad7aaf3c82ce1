"""Gap, time to collision and lane changes against tables worked by hand; None where a number is not defined."""

import math

import pandas as pd
import pytest

from sumo_hmdp.domain.plan import PLANNED_STATUSES
from sumo_hmdp.metrics.catalogue import METRICS
from sumo_hmdp.metrics.summary import run_metrics

ALL = METRICS.all
SIZE = {"ego": (4.0, 2.0), "car": (4.5, 1.8), "truck": (10.0, 2.5)}


def steps_of(*rows):
    """Build a steps table from (time, vehicle, x, y, speed)."""
    names = ["time_s", "vehicle_id", "x_m", "y_m", "speed_mps", "length_m", "width_m"]
    others = {"heading_rad": 0.0, "accel_mps2": 0.0, "lane": 1, "intended_lane": 1}
    return pd.DataFrame([(*row, *SIZE[row[1]]) for row in rows], columns=names).assign(**others)


def decisions_of(*rows):
    """Build a decisions table from (time, status, lateral, violation, solve time)."""
    names = ["time_s", "status", "lateral", "violation_m", "solve_time_ms"]
    return pd.DataFrame(list(rows), columns=names).astype({"violation_m": float, "solve_time_ms": float})


def test_a_run_by_hand():
    steps = steps_of(
        (0.0, "ego", 100.0, 0.0, 20.0),
        (0.0, "car", 144.5, 0.0, 15.0),  # gap 40, closing 5: 8 s
        (0.6, "ego", 112.0, 0.0, 22.0),
        (0.6, "car", 153.5, 0.0, 15.0),  # gap 37, closing 7: 5.286 s
        (1.2, "ego", 125.0, 4.0, 24.0),
        (1.2, "car", 129.6, 0.0, 1.0),  # gap 0.1, but in another lane
        (1.8, "ego", 140.0, 0.0, 18.0),
        (1.8, "car", 154.5, 0.0, 30.0),  # gap 10, opening: no time to collision
    )
    decisions = decisions_of(
        (0.0, "optimal", "keep", 0.0, 10.0),
        (0.6, "incumbent", "left", 0.0, 30.0),
        (1.2, "relaxed", "right", 2.5, 20.0),
        (1.8, "fallback", "keep", None, 1.0),
    )
    row = run_metrics(steps, decisions)
    assert row["duration_s"] == 1.8
    assert row["distance_m"] == 40.0
    assert row["speed_mean_mps"] == 21.0
    assert row["gap_min_m"] == 10.0
    assert row["ttc_min_s"] == pytest.approx(37 / 7)
    assert (row["lane_change_count"], row["lane_change_first_s"]) == (2, 0.6)
    assert [row[f"{status}_share"] for status in PLANNED_STATUSES] == [0.25] * 4
    assert row["violation_max_m"] == 2.5
    assert (row["solve_time_median_ms"], row["solve_time_max_ms"]) == (15.0, 30.0)
    assert row["decision_count"] == 4


def test_a_vehicle_that_is_touched_while_closing_has_no_time_left():
    row = run_metrics(
        steps_of((0.0, "ego", 100.0, 0.0, 20.0), (0.0, "car", 102.0, 0.0, 15.0)),
        decisions_of((0.0, "optimal", "keep", 0.0, 1.0)),
    )
    assert (row["gap_min_m"], row["ttc_min_s"]) == (-2.5, 0.0)


@pytest.mark.parametrize("speed", [20.0, 25.0])
def test_without_closing_a_collision_is_infinitely_far(speed):
    row = run_metrics(
        steps_of((0.0, "ego", 100.0, 0.0, 20.0), (0.0, "car", 150.0, 0.0, speed)),
        decisions_of((0.0, "optimal", "keep", 0.0, 1.0)),
    )
    assert row["ttc_min_s"] == math.inf
    assert row["gap_min_m"] == 45.5


def test_alone_on_the_road_nothing_of_others_is_defined():
    row = run_metrics(steps_of((0.0, "ego", 1.0, 0.0, 5.0)), decisions_of((0.0, "fallback", "keep", None, 1.0)))
    undefined = {name for name, value in row.items() if value is None}
    of_others = {name for name in ALL if name.startswith(("gap", "time_gap", "ttc", "mttc", "drac", "pet", "braking"))}
    of_two_instants = {name for name in ALL if name.startswith(("jerk", "yaw", "lateral_accel"))}
    alone = {"lane_change_first_s", "violation_max_m", "time_loss_s", "tet_spkm", "tit_s2pkm"}
    alone |= {"plan_violation_rate", "step_violation_rate"}
    alone |= {"distance_shortfall_max_m"}
    assert len(of_others) == 9
    assert undefined == of_others | of_two_instants | alone
    assert row["distance_m"] == 0.0


def test_a_run_that_broke_before_its_first_instant_has_counts_only():
    row = run_metrics(steps_of(), decisions_of())
    assert {name: value for name, value in row.items() if value is not None} == {
        "lane_change_count": 0,
        "lane_change_abort_count": 0,
        "near_miss_count": 0,
        "decision_count": 0,
    }


def test_a_rule_is_neither_optimal_nor_a_departure_from_it():
    row = run_metrics(
        steps_of((0.0, "ego", 1.0, 0.0, 5.0)),
        decisions_of((0.0, "rule", "left", None, 1.0), (0.6, "rule", "keep", None, 1.0)),
    )
    assert [row[f"{status}_share"] for status in PLANNED_STATUSES] == [None] * 4
    assert (row["decision_count"], row["lane_change_count"]) == (2, 1)
