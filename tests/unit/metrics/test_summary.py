"""Gap, time to collision and lane changes against tables worked by hand; None where a number is not defined."""

import pandas as pd
import pytest

from sumo_hmdp.metrics.summary import gaps_to_ego, run_metrics

SIZE = {"ego": (4.0, 2.0), "car": (4.5, 1.8), "truck": (10.0, 2.5)}


def steps_of(*rows):
    """Build a steps table from (time, vehicle, x, y, speed)."""
    names = ["time_s", "vehicle_id", "x_m", "y_m", "speed_mps", "length_m", "width_m"]
    return pd.DataFrame([(*row, *SIZE[row[1]]) for row in rows], columns=names)


def decisions_of(*rows):
    """Build a decisions table from (time, status, lateral, violation, solve time)."""
    names = ["time_s", "status", "lateral", "violation_m", "solve_time_ms"]
    return pd.DataFrame(list(rows), columns=names).astype({"violation_m": float, "solve_time_ms": float})


def test_the_gap_is_bumper_to_bumper_ahead_and_behind():
    gaps = gaps_to_ego(
        steps_of(
            (0.0, "ego", 100.0, 0.0, 20.0),
            (0.0, "car", 150.0, 0.0, 15.0),  # rear at 145.5
            (0.0, "truck", 80.0, 0.0, 30.0),  # front at 80, the ego's rear at 96
        )
    ).set_index("vehicle_id")
    assert gaps["gap_m"].to_dict() == pytest.approx({"car": 45.5, "truck": 16.0})
    # Positive when approaching: the ego comes up on the car, the truck on the ego.
    assert gaps["closing_speed_mps"].to_dict() == pytest.approx({"car": 5.0, "truck": 10.0})


def test_vehicles_that_overlap_along_the_road_have_a_negative_gap():
    gaps = gaps_to_ego(steps_of((0.0, "ego", 100.0, 0.0, 20.0), (0.0, "car", 103.0, 1.0, 20.0)))
    assert gaps["gap_m"].tolist() == pytest.approx([-1.5])


@pytest.mark.parametrize(("y", "counted"), [(1.89, True), (-1.89, True), (1.91, False), (4.0, False)])
def test_only_bodies_that_overlap_across_the_road_have_a_gap(y, counted):
    # Half widths 1.0 m and 0.9 m.
    gaps = gaps_to_ego(steps_of((0.0, "ego", 100.0, 0.0, 20.0), (0.0, "car", 150.0, y, 15.0)))
    assert len(gaps) == counted


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
        (0.6, "optimal", "left", 0.0, 30.0),
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
    assert (row["optimal_share"], row["relaxed_share"], row["fallback_share"]) == (0.5, 0.25, 0.25)
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
def test_without_closing_there_is_no_time_to_collision(speed):
    row = run_metrics(
        steps_of((0.0, "ego", 100.0, 0.0, 20.0), (0.0, "car", 150.0, 0.0, speed)),
        decisions_of((0.0, "optimal", "keep", 0.0, 1.0)),
    )
    assert row["ttc_min_s"] is None
    assert row["gap_min_m"] == 45.5


def test_alone_on_the_road_nothing_of_others_is_defined():
    row = run_metrics(steps_of((0.0, "ego", 1.0, 0.0, 5.0)), decisions_of((0.0, "fallback", "keep", None, 1.0)))
    undefined = {name for name, value in row.items() if value is None}
    assert undefined == {"gap_min_m", "ttc_min_s", "lane_change_first_s", "violation_max_m"}
    assert row["distance_m"] == 0.0


def test_a_run_that_broke_before_its_first_instant_has_counts_only():
    row = run_metrics(steps_of(), decisions_of())
    assert {name: value for name, value in row.items() if value is not None} == {
        "lane_change_count": 0,
        "decision_count": 0,
    }


def test_a_rule_is_neither_optimal_nor_a_departure_from_it():
    row = run_metrics(
        steps_of((0.0, "ego", 1.0, 0.0, 5.0)),
        decisions_of((0.0, "rule", "left", None, 1.0), (0.6, "rule", "keep", None, 1.0)),
    )
    assert (row["optimal_share"], row["relaxed_share"], row["fallback_share"]) == (None, None, None)
    assert (row["decision_count"], row["lane_change_count"]) == (2, 1)
