"""The same run gives the same bits: again in one process, and in two processes at once."""

import json
import subprocess
from pathlib import Path

import pytest

import sumo_hmdp
from sumo_hmdp.scenario.load import RunOptions, load_scenario
from sumo_hmdp.study.run import execute

CASE2 = Path(__file__).parents[2] / "scenarios" / "case2.yaml"


def hashes_of(record):
    return record.row["trace_hash"], record.manifest["trace_hash"]


def test_twice_in_one_process(short_case):
    first, second = (execute(load_scenario(short_case(9.0), RunOptions(seed=3))) for _ in range(2))
    assert first.status == second.status == "completed"
    assert hashes_of(first) == hashes_of(second)
    timed = ["solve_time_ms"]
    assert first.steps.equals(second.steps)
    assert first.decisions.drop(columns=timed).equals(second.decisions.drop(columns=timed))
    assert first.documents == second.documents


def test_another_run_has_another_hash(short_case):
    one = execute(load_scenario(short_case(3.0), RunOptions()))
    other = execute(load_scenario(short_case(3.0, "x_m: 150.0", "x_m: 150.000001"), RunOptions()))
    assert one.row["trace_hash"] != other.row["trace_hash"]


def test_in_two_processes_at_once(command, tmp_path):
    folders = [tmp_path / "a", tmp_path / "b"]
    processes = [
        subprocess.Popen([command, "run", str(CASE2), "--out", str(folder)], stdout=subprocess.DEVNULL)
        for folder in folders
    ]
    assert [process.wait(timeout=120) for process in processes] == [0, 0]
    hashes = {sumo_hmdp.load(folder).runs["trace_hash"].item() for folder in folders}
    manifests = [json.loads(next((folder / "manifests").iterdir()).read_text())["trace_hash"] for folder in folders]
    assert hashes == set(manifests)
    assert len(hashes) == 1


def test_into_one_folder_at_once(command, tmp_path, short_case):
    arguments = [command, "run", str(short_case(3.0)), "--out", str(tmp_path / "out"), "--seed"]
    processes = [subprocess.Popen([*arguments, str(seed)], stdout=subprocess.DEVNULL) for seed in (1, 2)]
    assert [process.wait(timeout=120) for process in processes] == [0, 0]
    runs = sumo_hmdp.load(tmp_path / "out").runs
    assert runs["seed"].tolist() == [1, 2]
    # Nothing is left to chance in this scenario, so the seed changes nothing.
    assert runs["trace_hash"].nunique() == 1


@pytest.mark.parametrize("solver", ["milp", "search"])
def test_the_hash_does_not_depend_on_being_watched(short_case, solver):
    ready = load_scenario(short_case(3.0), RunOptions(solver=solver))
    seen = []
    watched = execute(ready, seen.append)
    assert len(seen) == 21
    again = execute(load_scenario(short_case(3.0), RunOptions(solver=solver)))
    assert hashes_of(watched) == hashes_of(again)
