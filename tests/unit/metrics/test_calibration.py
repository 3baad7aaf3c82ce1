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
from sumo_hmdp.metrics.decision_tables import realised_predictions
from sumo_hmdp.prediction.distribution import mixture_quantiles


def frame(*rows):
    """Build whole predictions of a car: (decision, step, lane probabilities, pruned, true lane), more where it says."""
    found = pd.DataFrame(rows, columns=["decision_index", "horizon_step", "lane_probs", "pruned_prob", "intended_lane"])
    rest = {"vehicle_id": "car", "x_mean_m": 0.0, "x_std_m": 1.0, "y_mean_m": 0.0, "y_std_m": 1.0}
    return found.assign(run_id="r", x_m=0.0, y_m=0.0, x_quantiles_m=[(0.0,) * 6] * len(rows), **rest)


def branches_frame(*rows):
    """Build branches of a car from (decision, branch, probability, step, lane, x, std; true x, true lane, same)."""
    names = ["decision_index", "branch_index", "probability", "horizon_step", "branch_lane", "branch_x_m", "x_std_m"]
    names += ["x_m", "intended_lane", "same"]
    rest = {"run_id": "r", "vehicle_id": "car", "branch_y_m": 0.0, "y_m": 0.0, "y_std_m": 1.0}
    return pd.DataFrame(rows, columns=names).assign(**rest)


def test_lanes_by_hand():
    table = lane_scores(
        frame(
            # A tenth was pruned, of which each of three lanes gets a third.
            (0, 1, (0.0, 0.9, 0.0), 0.1, 2),
            (1, 1, (0.0, 0.0, 0.9), 0.1, 1),
            # Certain and wrong: a third of one in a million.
            (0, 2, (1.0, 0.0, 0.0), 0.0, 3),
        )
    ).set_index("horizon_step")
    low, high = 0.1 / 3, 0.9 + 0.1 / 3
    assert table["trial_count"].to_dict() == {1: 2, 2: 1}
    assert table.loc[1, "brier_mean"] == pytest.approx(
        ((1 - high) ** 2 + 2 * low**2 + (1 - low) ** 2 + low**2 + high**2) / 2
    )
    assert table.loc[1, "log_loss_mean"] == pytest.approx(-(math.log(high) + math.log(low)) / 2)
    assert table["impossible_count"].to_dict() == {1: 1, 2: 1}
    assert table.loc[2, "log_loss_mean"] == pytest.approx(math.log(3e6))
    assert table["pruned_mean"].to_dict() == pytest.approx({1: 0.1, 2: 0.0})


def test_coverage_by_hand():
    # Half N(0, 1), half N(10, 1): the middle half of the mixture is from 0 to 10, the middle 90 % from -1.28 to 11.28.
    quantiles = tuple(mixture_quantiles(np.array([[0.0, 10.0]]), np.array([[0.5, 0.5]]), np.ones(1))[0])
    assert quantiles[1:5] == pytest.approx((-1.2816, 0.0, 10.0, 11.2816), abs=1e-3)

    def at(*positions):
        found = frame(*((index, 1, (1.0,), 0.0, 1) for index in range(len(positions))))
        found = found.assign(x_m=positions, x_quantiles_m=[quantiles] * len(found))
        return position_coverage(found).set_index("level")["hit_count"].to_dict()

    assert [at(-0.01, 0.01, 5.0, 9.99, 10.01)[level] for level in (0.5, 0.9)] == [3, 5]
    assert [at(-1.29, -1.28, 11.28, 11.29)[level] for level in (0.5, 0.9)] == [0, 2]


def test_a_prediction_without_spread_is_right_or_wrong():
    found = frame((0, 1, (1.0,), 0.0, 1), (1, 1, (1.0,), 0.0, 1)).assign(x_m=[5.0, 5.1], x_quantiles_m=[(5.0,) * 6] * 2)
    table = position_coverage(found)
    assert table[["hit_count", "trial_count"]].to_numpy().tolist() == [[1, 2]] * 3


def test_runs_are_the_sampling_unit_of_the_intervals():
    rows = [(index, 1, (0.5, 0.5), 0.0, 1) for index in range(200)]
    found = frame(*rows).assign(run_id=["a", "b"] * 100, x_quantiles_m=[(-1.0,) * 3 + (1.0,) * 3] * 200)
    # Two runs whose 100 places were all inside tell what 2 in 2 do.
    assert position_coverage(found)["low_share"].tolist() == pytest.approx([0.025**0.5] * 3)
    assert len(position_nees(found)) == 1


def test_displacements_by_hand():
    rows = [
        # Branch 0 is 1 and 3 m off, branch 1, likelier, 2 and 2.5 m: the least average and final differ in branch.
        (0, 0, 0.4, 1, 2, 1.0, 1.0, 0.0, 2, True), (0, 0, 0.4, 2, 2, 3.0, 1.0, 0.0, 2, True),
        (0, 1, 0.6, 1, 2, 2.0, 1.0, 0.0, 2, True), (0, 1, 0.6, 2, 2, -2.5, 1.0, 0.0, 2, True),
        # Its second step was not recorded.
        (1, 0, 1.0, 1, 2, 99.0, 1.0, 0.0, 2, True),
    ]  # fmt: skip
    assert displacement_errors(branches_frame(*rows)) == {
        "trial_count": 1,
        "ade_best_m": 2.0,
        "fde_best_m": 2.5,
        "ade_likeliest_m": 2.25,
        "fde_likeliest_m": 2.5,
    }
    nothing = displacement_errors(branches_frame())
    assert nothing["trial_count"] == 0
    assert math.isnan(nothing["ade_best_m"])


def world(spread, seed, count=1500, runs=30):
    """Return predictions of two branches and two steps, and a car that follows them with `spread` times their noise."""
    rng = np.random.default_rng(seed)
    parts = []
    x, y, x_std, y_std = ((10.0, 20.0), (10.0, 25.0)), ((0.0, 0.0), (0.0, 4.0)), (1.0, 2.0), (0.1, 0.3)
    p, lanes = np.array([0.7, 0.3]), ((2, 2), (2, 1))
    told = {"vehicle_id": "car", "pruned_prob": 0.0, "lane_probs": [[0.0, 1.0, 0.0], [0.3, 0.7, 0.0]]}
    means = {name: [float(p @ [one[k] for one in at]) for k in (0, 1)] for name, at in (("x", x), ("y", y))}
    told |= {f"{name}_mean_m": means[name] for name in ("x", "y")}
    for name, at, std in (("x", x, x_std), ("y", y, y_std)):
        second = [float(p @ [one[k] ** 2 + std[k] ** 2 for one in at]) for k in (0, 1)]
        told[f"{name}_std_m"] = [math.sqrt(second[k] - means[name][k] ** 2) for k in (0, 1)]
    told["x_quantiles_m"] = [
        mixture_quantiles(np.array([[x[0][k], x[1][k]]]), p[None, :], np.array([x_std[k]]))[0].tolist() for k in (0, 1)
    ]
    for run in range(runs):
        decisions, steps = [], []
        for index in range(count // runs):
            decisions.append(
                {"run_id": f"r{run}", "decision_index": index, "time_s": 2.0 * index}
                | {"prediction_json": json.dumps([told])}
            )
            b = int(rng.random() < 0.3)
            for k in (0, 1):
                place = x[b][k] + spread * x_std[k] * rng.normal(), y[b][k] + spread * y_std[k] * rng.normal()
                steps.append((2.0 * index + 0.6 * (k + 1), "car", *place, lanes[b][k]))
        trace = pd.DataFrame(steps, columns=["time_s", "vehicle_id", "x_m", "y_m", "intended_lane"])
        parts.append(realised_predictions(pd.DataFrame(decisions), trace, 0.6))
    return pd.concat(parts, ignore_index=True)


def test_a_world_as_predicted_is_calibrated():
    realised = world(1.0, seed=1)
    coverage = position_coverage(realised, confidence=0.999)
    assert (coverage["low_share"] <= coverage["level"]).all()
    assert (coverage["high_share"] >= coverage["level"]).all()
    assert len(coverage) == 6
    nees = position_nees(realised, level=0.999)
    assert ((nees["nees_low"] < 2) & (nees["nees_high"] > 2)).all()
    assert nees["trial_count"].tolist() == [1500, 1500]
    scores = lane_scores(realised)
    # p (1 - p) of two lanes, and the entropy.
    assert scores["brier_mean"].tolist() == pytest.approx([0.0, 2 * 0.3 * 0.7], abs=0.03)
    assert scores["log_loss_mean"].tolist() == pytest.approx([0.0, 0.6109], abs=0.03)


@pytest.mark.parametrize(("spread", "sign"), [(2.0, 1), (0.5, -1)])
def test_a_world_that_is_wilder_or_tamer_shows(spread, sign):
    realised = world(spread, seed=2)
    # At the first step both branches are one, so that the mixture has their spread.
    assert position_nees(realised)["nees_mean"].iloc[0] == pytest.approx(2 * spread**2, rel=0.15)
    coverage = position_coverage(realised)
    assert (sign * (coverage["level"] - coverage["coverage_share"]) > 0.02).all()


def test_reliability_by_hand():
    table = lane_reliability(
        frame(
            # 0.7 for lane 2, which is taken, and 0.3 for lane 1.
            (0, 1, (0.3, 0.7, 0.0), 0.0, 2),
            # 0.7 for lane 3, which is not; certain of lane 1, and right.
            (1, 1, (0.0, 0.3, 0.7), 0.0, 2),
            (2, 1, (1.0, 0.0, 0.0), 0.0, 1),
        ),
        edges=(0.0, 0.35, 0.75, 1.0),
    )
    assert table[["low_probability", "high_probability", "hit_count", "trial_count"]].to_numpy().tolist() == [
        [0.0, 0.35, 1, 2],
        [0.35, 0.75, 1, 2],
        [0.75, 1.0, 1, 1],
    ]
    assert table["probability_mean"].tolist() == pytest.approx([0.3, 0.7, 1.0], abs=1e-5)
    assert table["taken_share"].tolist() == [0.5, 0.5, 1.0]
    # One of one: 0.025 at the low end of an exact 95 % interval.
    assert table["low_share"].iloc[-1] == pytest.approx(0.025)


def test_a_world_as_predicted_is_reliable_and_another_is_not():
    realised = world(1.0, seed=4)
    second = realised[realised["horizon_step"] == 2]
    table = lane_reliability(second, confidence=0.999)
    assert table["probability_mean"].tolist() == pytest.approx([0.3, 0.7], abs=1e-5)
    assert ((table["low_share"] < table["probability_mean"]) & (table["probability_mean"] < table["high_share"])).all()
    other = lane_reliability(second.assign(intended_lane=2), confidence=0.999)
    assert (other["taken_share"].tolist(), other["hit_count"].tolist()) == ([0.0, 1.0], [0, 1500])


def test_predictions_that_were_not_recorded_are_none():
    decisions = pd.DataFrame({"run_id": ["r"], "decision_index": [0], "time_s": [0.0]})
    trace = pd.DataFrame(columns=["time_s", "vehicle_id", "x_m", "y_m", "intended_lane"]).astype({"time_s": float})
    assert realised_predictions(decisions, trace, 0.6).empty
