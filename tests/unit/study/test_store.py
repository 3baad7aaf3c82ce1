"""Files that are whole or not there, and names of runs that do not run into each other."""

import os
from types import SimpleNamespace

import pandas as pd
import pytest

from sumo_hmdp.errors import InputError
from sumo_hmdp.study.run import run_id_of
from sumo_hmdp.study.store import TABLES, discard, load, table_path, write_manifest, write_table, write_text


def test_a_table_that_cannot_be_finished_leaves_the_old_one(tmp_path, monkeypatch):
    def full(number):
        raise OSError(28, "No space left on device")

    write_table(tmp_path, "runs", "a", pd.DataFrame({"run_id": ["a"]}))
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        write_table(tmp_path, "runs", "a", pd.DataFrame({"run_id": ["a"], "more": [1]}))
    assert list((tmp_path / "runs").iterdir()) == [tmp_path / "runs" / "a.parquet"]
    assert load(tmp_path).runs["run_id"].tolist() == ["a"]


def test_a_text_is_replaced_whole(tmp_path):
    write_text(tmp_path / "below" / "a.txt", "one\n")
    write_text(tmp_path / "below" / "a.txt", "two\n")
    assert [path.name for path in (tmp_path / "below").iterdir()] == ["a.txt"]
    assert (tmp_path / "below" / "a.txt").read_text() == "two\n"


def test_only_runs_with_a_row_are_read(tmp_path):
    for run_id in ("a", "b"):
        write_manifest(tmp_path, run_id, {"run_id": run_id})
        for table in TABLES:
            write_table(tmp_path, table, run_id, pd.DataFrame({"run_id": [run_id], "number": [1.0]}))
    table_path(tmp_path, "runs", "a").unlink()
    results = load(tmp_path)
    assert results.manifests == {"b": {"run_id": "b"}}
    assert [frame["run_id"].tolist() for frame in (results.runs, results.decisions, results.steps)] == [["b"]] * 3


def test_an_empty_table_beside_a_full_one_keeps_the_types(tmp_path):
    full = pd.DataFrame({"run_id": ["a"], "lane": [2]})
    for run_id, frame in (("a", full), ("b", full.iloc[:0])):
        write_table(tmp_path, "runs", run_id, full.assign(run_id=run_id))
        write_table(tmp_path, "steps", run_id, frame)
    assert load(tmp_path).steps.dtypes.astype(str).to_dict() == {"run_id": "str", "lane": "int64"}


def test_discarding_one_run_leaves_the_others(tmp_path):
    for run_id in ("a", "b"):
        for table in TABLES:
            write_table(tmp_path, table, run_id, pd.DataFrame({"run_id": [run_id]}))
        write_text(tmp_path / f"{run_id}.html", "page")
        write_text(tmp_path / "failures" / f"{run_id}.txt", "trace")
        write_text(tmp_path / "decision_files" / run_id / "0000.json", "{}")
    discard(tmp_path, "a")
    left = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()}
    assert left == {
        "b.html", "failures/b.txt", "decision_files/b/0000.json", *(f"{table}/b.parquet" for table in TABLES),
    }  # fmt: skip


def test_a_folder_without_results_is_refused(tmp_path):
    with pytest.raises(InputError, match="must be a results directory"):
        load(tmp_path)


def test_every_difference_between_runs_is_in_their_names():
    def name(**changes):
        given = {
            "scenario": "case2",
            "planner_name": "p",
            "solver": "milp",
            "seed": 0,
            "parameters": {"risk_level": 0.05},
        }
        return run_id_of(SimpleNamespace(**given | changes))

    names = [
        name(),
        name(scenario="case1"),
        name(planner_name="q"),
        name(solver="search"),
        name(seed=1),
        name(parameters={"risk_level": 0.0500000001}),
        name(parameters={}),
    ]
    assert len(set(names)) == len(names)
    assert name() == "case2-p-eps0.05-seed0"
