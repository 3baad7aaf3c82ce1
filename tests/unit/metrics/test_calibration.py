"""Calibration of predictions: by hand, and on a world that is exactly as predicted."""

import json
import math

import numpy as np
import pandas as pd
import pytest

from sumo_hmdp.metrics.calibration import (
    displacement_errors,
    lane_reliability,
    lane_scores,
    position_coverage,
    position_nees,
)
from sumo_hmdp.metrics.decision_tables import realised_branches


def frame(*rows):
    """Build predictions of a car from (decision, branch, probability, step, lane, x, std; true x, true lane, same)."""
    names = ["decision_index", "branch_index", "probability", "horizon_step", "branch_lane", "branch_x_m", "x_std_m"]
    names += ["x_m", "intended_lane", "same"]
    rest = {"run_id": "r", "vehicle_id": "car", "branch_y_m": 0.0, "y_m": 0.0, "y_std_m": 1.0}
    return pd.DataFrame(rows, columns=names).assign(**rest)


def test_lanes_by_hand():
    table = lane_scores(
        frame(
            # 0.6, 0.2 and 0.2 of 1: the lane is taken that has 0.8 of the probability.
            (0, 0, 0.3, 1, 2, 0.0, 1.0, 0.0, 2, True),
            (0, 1, 0.1, 1, 1, 0.0, 1.0, 0.0, 2, False),
            (0, 2, 0.1, 1, 2, 0.0, 1.0, 0.0, 2, False),
            # Certain and wrong at the second step.
            (0, 0, 0.3, 2, 1, 0.0, 1.0, 0.0, 3, False),
            # Certain and right.
            (1, 0, 0.5, 1, 3, 0.0, 1.0, 0.0, 3, True),
        )
    ).set_index("horizon_step")
    assert table["trial_count"].to_dict() == {1: 2, 2: 1}
    assert table.loc[1, "brier_mean"] == pytest.approx((0.2**2 + 0.2**2 + 0.0) / 2)
    assert table.loc[1, "log_loss_mean"] == pytest.approx(-math.log(0.8) / 2)
    assert table.loc[2, ["brier_mean", "log_loss_mean", "impossible_count"]].tolist() == [2.0, math.inf, 1]


def test_coverage_by_hand():
    # Half N(0, 1), half N(10, 1): the middle half of the mixture is from 0 to 10, the middle 90 % from -1.28 to 11.28.
    def at(*positions):
        rows = [
            (index, branch, 0.5, 1, 2, 10.0 * branch, 1.0, x, 2, True)
            for index, x in enumerate(positions)
            for branch in (0, 1)
        ]
        return position_coverage(frame(*rows), (0.5, 0.9)).set_index("level")["hit_count"].to_dict()

    assert at(-0.01, 0.01, 5.0, 9.99, 10.01) == {0.5: 3, 0.9: 5}
    assert at(-1.29, -1.28, 11.28, 11.29) == {0.5: 0, 0.9: 2}


def test_a_prediction_without_spread_is_right_or_wrong():
    table = position_coverage(
        frame((0, 0, 1.0, 1, 2, 5.0, 0.0, 5.0, 2, True), (1, 0, 1.0, 1, 2, 5.0, 0.0, 5.1, 2, True)), (0.95,)
    )
    assert table[["hit_count", "trial_count"]].to_numpy().tolist() == [[1, 2]]


def test_displacements_by_hand():
    rows = [
        # Branch 0 is 1 and 3 m off, branch 1, likelier, 2 and 2.5 m: the least average and final differ in branch.
        (0, 0, 0.4, 1, 2, 1.0, 1.0, 0.0, 2, True), (0, 0, 0.4, 2, 2, 3.0, 1.0, 0.0, 2, True),
        (0, 1, 0.6, 1, 2, 2.0, 1.0, 0.0, 2, True), (0, 1, 0.6, 2, 2, -2.5, 1.0, 0.0, 2, True),
        # Its second step was not recorded.
        (1, 0, 1.0, 1, 2, 99.0, 1.0, 0.0, 2, True),
    ]  # fmt: skip
    assert displacement_errors(frame(*rows)) == {
        "trial_count": 1,
        "ade_best_m": 2.0,
        "fde_best_m": 2.5,
        "ade_likeliest_m": 2.25,
        "fde_likeliest_m": 2.5,
    }
    nothing = displacement_errors(frame())
    assert nothing["trial_count"] == 0
    assert math.isnan(nothing["ade_best_m"])


def world(spread, seed, count=1500):
    """Return predictions of two branches and two steps, and a car that follows them with `spread` times their noise."""
    rng = np.random.default_rng(seed)
    decisions, steps = [], []
    for index in range(count):
        lanes = [[2, 2], [2, 1]]
        branches = [
            {
                "vehicle_id": "car",
                "probability": p,
                "lanes": lanes[b],
                "modes": ["cruise", "cruise"],
                "x_m": [10.0, 20.0 + 5 * b],
                "y_m": [0.0, 4.0 * b],
                "x_std_m": [1.0, 2.0],
                "y_std_m": [0.1, 0.3],
            }
            for b, p in enumerate((0.7, 0.3))
        ]
        decisions.append(
            {"run_id": "r", "decision_index": index, "time_s": 2.0 * index, "branches_json": json.dumps(branches)}
        )
        chosen = int(rng.random() < 0.3)
        for k in (0, 1):
            x = branches[chosen]["x_m"][k] + spread * branches[chosen]["x_std_m"][k] * rng.normal()
            y = branches[chosen]["y_m"][k] + spread * branches[chosen]["y_std_m"][k] * rng.normal()
            steps.append((2.0 * index + 0.6 * (k + 1), "car", x, y, lanes[chosen][k], "cruise"))
    names = ["time_s", "vehicle_id", "x_m", "y_m", "intended_lane", "mode"]
    return realised_branches(pd.DataFrame(decisions), pd.DataFrame(steps, columns=names), 0.6)


def test_a_world_as_predicted_is_calibrated():
    realised = world(1.0, seed=1)
    coverage = position_coverage(realised, confidence=0.999)
    assert (coverage["low_share"] <= coverage["level"]).all()
    assert (coverage["high_share"] >= coverage["level"]).all()
    assert len(coverage) == 6
    nees = position_nees(realised, level=0.999)
    assert ((nees["low_bound"] < nees["nees_mean"]) & (nees["nees_mean"] < nees["high_bound"])).all()
    # Both branches share the first step, which counts once.
    assert nees["trial_count"].tolist() == [1500, 1500]
    scores = lane_scores(realised)
    # p (1 - p) of two lanes, and the entropy.
    assert scores["brier_mean"].tolist() == pytest.approx([0.0, 2 * 0.3 * 0.7], abs=0.03)
    assert scores["log_loss_mean"].tolist() == pytest.approx([0.0, 0.6109], abs=0.03)


@pytest.mark.parametrize(("spread", "sign"), [(2.0, 1), (0.5, -1)])
def test_a_world_that_is_wilder_or_tamer_shows(spread, sign):
    realised = world(spread, seed=2)
    nees = position_nees(realised)
    assert nees["nees_mean"].tolist() == pytest.approx([2 * spread**2] * 2, rel=0.15)
    coverage = position_coverage(realised)
    assert (sign * (coverage["level"] - coverage["coverage_share"]) > 0.03).all()


def test_reliability_by_hand():
    table = lane_reliability(
        frame(
            # 0.7 (two branches) for lane 2, which is taken, and 0.3 for lane 1.
            (0, 0, 0.4, 1, 2, 0.0, 1.0, 0.0, 2, True),
            (0, 1, 0.3, 1, 2, 0.0, 1.0, 0.0, 2, True),
            (0, 2, 0.3, 1, 1, 0.0, 1.0, 0.0, 2, False),
            # 0.7 for lane 3, which is not; certain of lane 1, and right.
            (1, 0, 0.7, 1, 3, 0.0, 1.0, 0.0, 2, False),
            (1, 1, 0.3, 1, 2, 0.0, 1.0, 0.0, 2, True),
            (2, 0, 0.2, 1, 1, 0.0, 1.0, 0.0, 1, True),
        ),
        edges=(0.0, 0.3, 0.7, 1.0),
    )
    assert table[["low_probability", "high_probability", "hit_count", "trial_count"]].to_numpy().tolist() == [
        [0.0, 0.3, 1, 2],
        [0.3, 0.7, 1, 2],
        [0.7, 1.0, 1, 1],
    ]
    assert table["probability_mean"].tolist() == pytest.approx([0.3, 0.7, 1.0])
    assert table["taken_share"].tolist() == [0.5, 0.5, 1.0]
    # One of one: 0.025 at the low end of an exact 95 % interval.
    assert table["low_share"].iloc[-1] == pytest.approx(0.025)


def test_a_world_as_predicted_is_reliable_and_another_is_not():
    realised = world(1.0, seed=4)
    second = realised[realised["horizon_step"] == 2]
    table = lane_reliability(second, confidence=0.999)
    assert table["probability_mean"].tolist() == pytest.approx([0.3, 0.7])
    assert ((table["low_share"] < table["probability_mean"]) & (table["probability_mean"] < table["high_share"])).all()
    other = lane_reliability(second.assign(intended_lane=2), confidence=0.999)
    assert (other["low_share"].iloc[1], other["taken_share"].iloc[0]) == (pytest.approx(1.0, abs=0.01), 0.0)
