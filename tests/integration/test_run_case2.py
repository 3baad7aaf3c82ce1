"""One real run of Case 2 by the real command: what it leaves, and what the ego does."""

import json
from importlib.metadata import version
from itertools import pairwise

import pandas as pd
import pyarrow.dataset
import pytest

import sumo_hmdp
from sumo_hmdp.study.record import DECISION_COLUMNS, RUN_COLUMNS, STEP_COLUMNS

RUN_ID = "case2-hmdp_mpc-eps0.05-seed0"
SAFE_DISTANCE = 75.0
LATERAL = {"left": -1, "keep": 0, "right": 1}


@pytest.fixture(scope="module")
def folder(shell, tmp_path_factory):
    folder = tmp_path_factory.mktemp("a place") / "of results"
    finished = shell("run", "case2", "--out", folder, "--dump-decisions")
    assert finished.code == 0, finished.err
    assert finished.err == ""
    assert f"tables: {folder}    page: {folder / RUN_ID}.html" in finished.out
    return folder


@pytest.fixture(scope="module")
def results(folder):
    return sumo_hmdp.load(folder)


@pytest.mark.parametrize(
    ("table", "columns"), [("runs", RUN_COLUMNS), ("decisions", DECISION_COLUMNS), ("steps", STEP_COLUMNS)]
)
def test_the_tables_are_plain_parquet_with_the_columns_that_are_promised(folder, results, table, columns):
    frame = pd.read_parquet(folder / table)
    assert list(frame.columns) == list(columns)
    assert frame.dtypes.astype(str).to_dict() == columns
    assert pyarrow.dataset.dataset(folder / table).count_rows() == len(frame) == len(getattr(results, table))
    assert set(frame["run_id"]) == {RUN_ID}


def test_the_minimum_of_columns_is_there(results):
    minimum = {
        "decisions": "run_id time_s status lateral mode lane objective violation_m solve_time_ms",
        "steps": "run_id time_s vehicle_id x_m y_m speed_mps accel_mps2 lane",
    }
    for table, names in minimum.items():
        frame = getattr(results, table)
        assert set(names.split()) <= set(frame.columns)
    assert not results.steps.isna().to_numpy().any()


def test_there_is_a_row_for_every_vehicle_at_every_instant(results):
    steps = results.steps
    assert set(steps["vehicle_id"]) == {"ego", "sv1", "sv2", "truck1", "truck2"}
    times = steps.groupby("vehicle_id")["time_s"].agg(["min", "max", "nunique", "size"])
    assert (times["size"] == 301).all()
    assert (times["nunique"] == 301).all()
    assert times["max"].tolist() == pytest.approx([45.0] * 5)


def test_the_manifest_says_what_was_run_with_what(results):
    manifest = results.manifests[RUN_ID]
    assert manifest["versions"].keys() >= {"sumo_hmdp", "sumo", "highs", "pyomo", "numpy"}
    assert manifest["versions"]["sumo_hmdp"] == version("sumo-hmdp")
    assert manifest["versions"]["pyomo"] == version("pyomo")
    assert all(manifest["versions"].values())
    assert (manifest["seed"], manifest["risk_level"], manifest["status"]) == (0, 0.05, "completed")
    assert manifest["configuration"]["ego"]["x_m"] == 35.0
    assert manifest["parameters"]["safe_distance_m"] == SAFE_DISTANCE
    assert manifest["trace_hash"] == results.runs["trace_hash"].item()
    assert len(manifest["trace_hash"]) == 64


def test_the_page_stands_alone(folder):
    page = (folder / f"{RUN_ID}.html").read_text(encoding="utf-8")
    assert "<html" in page
    assert RUN_ID in page


def test_every_decision_can_be_answered_again_from_its_file(folder, results, shell):
    files = sorted((folder / "decision_files" / RUN_ID).glob("*.json"))
    assert len(files) == len(results.decisions) == 75
    finished = shell("decide", *files)
    assert (finished.code, finished.err) == (0, "")
    answers = [json.loads(line) for line in finished.out.splitlines()]
    assert len(answers) == 75
    for row, again in zip(results.decisions.itertuples(), answers, strict=True):
        assert again["status"] == row.status, row.decision_index
        assert again["reason"] == row.reason
        assert again["objective"] == pytest.approx(row.objective, abs=1e-6)
        assert again["violation_m"] == pytest.approx(row.violation_m, abs=1e-6)


def test_the_ego_overtakes_in_the_left_lane_without_contact_or_fallback(results):
    run = results.runs.iloc[0]
    assert (run["status"], run["reason"], run["contact_count"], run["fallback_share"]) == ("completed", "", 0, 0.0)
    assert set(results.decisions["status"]) <= {"optimal", "relaxed"}
    by_vehicle = {name: rows.set_index("time_s") for name, rows in results.steps.groupby("vehicle_id")}
    lead = by_vehicle["ego"]["x_m"] - by_vehicle["sv2"]["x_m"]
    assert lead.iloc[0] < 0 < lead.iloc[-1]
    # While the two bodies are side by side, the ego's is in lane 1.
    beside = by_vehicle["ego"][lead.abs() < 4.5]
    assert len(beside)
    assert set(beside["lane"]) == {1}
    assert set(by_vehicle["ego"]["lane"]) <= {1, 2}


def test_a_decision_that_starts_too_near_in_its_lane_says_so(results):
    """A vehicle within the safe distance in the lane that the ego intends as a decision comes: relaxed, with a reason.

    The lane that a decision chooses counts from the end of its first step on, as in the paper.
    """
    near = 0
    for decision in results.decisions.itertuples():
        scene = results.steps[results.steps["time_s"] == decision.time_s]
        ego = scene[scene["vehicle_id"] == "ego"].iloc[0]
        assert ego["intended_lane"] == decision.lane - LATERAL[decision.lateral]
        others = scene[(scene["vehicle_id"] != "ego") & (scene["lane"] == ego["intended_lane"])]
        distance = (others["x_m"] - ego["x_m"]).abs()
        if (distance < SAFE_DISTANCE).any():
            near += 1
            assert (decision.status, bool(decision.reason)) == ("relaxed", True), (decision.time_s, distance.min())
    if near == 0:
        # Then nobody was ever nearer, and every decision is the undisturbed optimum.
        assert set(results.decisions["status"]) == {"optimal"}


def test_the_decisions_follow_the_rules_of_the_maneuvers(results):
    level = {"decelerate": -1, "cruise": 0, "accelerate": 1}
    decisions = list(results.decisions.itertuples())
    assert [d.decision_index for d in decisions] == list(range(75))
    assert [d.time_s for d in decisions] == pytest.approx([0.6 * k for k in range(75)])
    for before, after in pairwise(decisions):
        assert after.lane - before.lane == LATERAL[after.lateral]
        assert abs(level[after.mode] - level[before.mode]) <= 1


def test_the_first_lane_change_is_printed_beside_the_paper_s(call, short_case, tmp_path):
    finished = call("run", short_case(7.2), "--solver", "search", "--out", tmp_path / "out")
    assert "6.00 s (published 5.85, +0.15 s)" in " ".join(finished.out.replace("│", " ").split())
