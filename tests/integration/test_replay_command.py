"""`sumo-hmdp replay` and `video` on results of single runs and of studies, whatever was kept of them."""

import base64
import json
import re
import shutil
import zlib

import pandas as pd
import pytest
from PIL import Image

import sumo_hmdp


@pytest.fixture(scope="module")
def study(shell, write_study_once, tmp_path_factory):
    """Case 2 for 1.8 s, by the planner and by the rules, without steps of anybody."""
    folder = tmp_path_factory.mktemp("bare")
    file = write_study_once(
        folder,
        factors={"planner": ["hmdp_mpc", "idm_mobil"], "duration_s": [1.8]},
        seeds={"count": 2},
        solver="search",
        trace="none",
    )
    assert shell("study", file, "--out", folder / "out", "--workers", "1").code == 0
    return folder / "out"


@pytest.fixture(scope="module")
def planned(study):
    runs = sumo_hmdp.load(study).runs
    return runs[runs["planner"] == "hmdp_mpc"]["run_id"].iloc[0]


def data_of(page):
    (text,) = re.findall(r'id="replay-data">([^<]+)<', page.read_text(encoding="utf-8"))
    return json.loads(zlib.decompress(base64.b64decode(text)))


def test_a_run_without_steps_is_done_again(call, study, planned, tmp_path):
    results = sumo_hmdp.load(study)
    assert results.steps.empty

    finished = call("replay", study, planned, "--out", tmp_path / "run.html")

    assert finished.code == 0
    assert "the same, bit for bit" in finished.out
    data = data_of(tmp_path / "run.html")
    # The same run, with everything kept, has the positions; the study has the solve times.
    document = results.manifests[planned]["document"]
    file = tmp_path / "case2.yaml"
    file.write_text(json.dumps(document))
    assert call("run", file, "--solver", "search", "--out", tmp_path / "out").code == 0
    steps = sumo_hmdp.load(tmp_path / "out").steps
    for vehicle in data["vehicles"]:
        rows = steps[steps["vehicle_id"] == vehicle["id"]]
        assert vehicle["x_m"] == [round(x, 3) for x in rows["x_m"]]
    assert {vehicle["id"] for vehicle in data["vehicles"]} == set(steps["vehicle_id"])
    decisions = results.decisions[results.decisions["run_id"] == planned]
    assert [one["solve_time_ms"] for one in data["decisions"]] == pytest.approx(decisions["solve_time_ms"], abs=1e-3)
    assert all(one["branches"] for one in data["decisions"])
    weighs_nine_actions(data["decisions"])
    assert "actions_json" not in results.decisions


def weighs_nine_actions(decisions):
    """The solver's answer is the best of what was tried, at the solver's own cost, and all else has its reason."""
    assert decisions
    for one in decisions:
        actions = one["actions"]
        assert [(action["lateral"], action["mode"]) for action in actions] == [
            (lateral, mode) for lateral in ("left", "keep", "right") for mode in ("accelerate", "cruise", "decelerate")
        ]
        (chosen,) = [action for action in actions if action["chosen"]]
        assert (chosen["lateral"], chosen["mode"], one["status"]) == (one["lateral"], one["mode"], "optimal")
        costs = [action["objective"] for action in actions if action["verdict"] == "feasible"]
        assert min(costs) == pytest.approx(one["objective"], abs=1e-4)
        assert chosen["objective"] == pytest.approx(one["objective"], abs=1e-4)
        assert all(action["reason"] for action in actions if action["verdict"] != "feasible")
    reasons = " ".join(action["reason"] for one in decisions for action in one["actions"])
    assert re.search(r"at step \d+ is \d+\.\d\d m too near", reasons)


def test_stored_steps_are_shown_as_they_are(call, tmp_path, monkeypatch):
    assert call("run", "case3", "--solver", "search", "--out", tmp_path).code == 0
    run_id = sumo_hmdp.load(tmp_path).runs["run_id"].iloc[0]
    page = tmp_path / "replays" / f"{run_id}.html"

    finished = call("replay", tmp_path, run_id)

    assert (finished.out, finished.err) == (f"page: {page}\n", "")
    first = data_of(tmp_path / f"{run_id}.html")
    assert data_of(page) == first
    weighs_nine_actions(first["decisions"])

    # Where the run is another one now, what was stored is shown, and nothing that belongs to the other.
    file = tmp_path / "runs" / f"{run_id}.parquet"
    pd.read_parquet(file).assign(trace_hash="0" * 64).to_parquet(file, index=False)
    finished = call("replay", tmp_path, run_id)
    assert (finished.code, finished.out) == (0, f"page: {page}\n")
    (line,) = finished.lines
    assert line.startswith("the page does not say why other first actions were not taken: ")
    other = data_of(page)
    assert other["vehicles"] == first["vehicles"]
    assert {str(one["actions"]) for one in other["decisions"]} == {"None"}
    monkeypatch.setattr("sumo_hmdp.study.again.execute", None)
    assert call("video", tmp_path, run_id, tmp_path / "run.gif", "--speed", "5", "--width", "400").code == 0
    with Image.open(tmp_path / "run.gif") as film:
        assert film.width == 400
        assert film.n_frames > 5


def test_unknown_runs_get_the_nearest_names(call, study, planned):
    finished = call("replay", study, planned.replace("seed0", "seed7"))

    assert finished.code == 2
    (line,) = finished.lines
    assert line.startswith(f"RUN_ID: must be a run in {study}, got")
    assert planned in line
    assert call("replay", study / "runs", planned).code == 2


def test_another_run_is_refused(call, study, planned, tmp_path):
    copy = tmp_path / "study"
    shutil.copytree(study, copy)
    (file,) = (copy / "runs").glob("cell=*hmdp_mpc*/*.parquet")
    pd.read_parquet(file).assign(trace_hash="0" * 64).to_parquet(file, index=False)

    finished = call("replay", copy, planned)

    assert finished.code == 1
    assert f"{planned} cannot be shown: its other vehicles were not stored, and doing it again gives" in finished.err
    assert not (copy / "replays").exists()


def test_the_report_of_a_study_without_steps_says_that_it_did_runs_again(call, study):
    assert call("report", study).code == 0
    page = (study / "report" / "report.html").read_text(encoding="utf-8")

    assert page.count('<script type="text/plain" id="replay-') == 4
    assert "These runs were done again for this page" in page
    assert call("report", study).code == 0
    assert (study / "report" / "report.html").read_text(encoding="utf-8") == page


def test_bad_files_are_named_before_anything_is_done(call, study, planned, tmp_path):
    assert call("replay", study, planned, "--out", tmp_path / "run.pdf").lines[0].startswith("--out: must end in .html")
    assert "must end in .mp4 or .gif" in call("video", study, planned, tmp_path / "run.avi").lines[0]
    (tmp_path / "file").write_text("")
    wrong = call("replay", study, planned, "--out", tmp_path / "file" / "run.html")
    assert (wrong.code, len(wrong.lines)) == (2, 1)
