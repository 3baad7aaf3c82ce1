"""Runs that break off: whatever happens in the middle, what was recorded up to there is kept and says why."""

import os
import signal
import subprocess
import time
from dataclasses import dataclass, replace
from typing import Any

import pandas as pd
import pytest

import sumo_hmdp
import sumo_hmdp.study.run
from sumo_hmdp.decision import registry
from sumo_hmdp.errors import InputError

BREAK_AT = 3.0
RUN_ID = "case2-breaking-eps0.05-seed0"


@dataclass(frozen=True)
class Breaking:
    """The usual planner until it breaks."""

    inner: Any
    error: BaseException

    @property
    def period(self):
        return self.inner.period

    def initial_memory(self):
        return self.inner.initial_memory()

    def decide(self, scene, memory):
        if scene.time > BREAK_AT - 1e-9:
            raise self.error
        return self.inner.decide(scene, memory)


@pytest.fixture
def breaking(monkeypatch, short_case):
    """Write a scenario whose planner raises an error at 3 s."""

    def write(error):
        kind = replace(
            registry.HMDP_MPC,
            name="breaking",
            build=lambda parameters, context: Breaking(registry.HMDP_MPC.build(parameters, context), error),
        )
        monkeypatch.setattr(registry, "BUILT_IN", (*registry.BUILT_IN, kind))
        return short_case(6.0, "hmdp_mpc", "breaking")

    return write


def check_partial(folder, status):
    results = sumo_hmdp.load(folder)
    row = results.runs.iloc[0]
    assert (row["run_id"], row["status"]) == (RUN_ID, status)
    # Decisions at 0, 0.6, ..., 2.4 s, and the instants before 3 s.
    assert results.decisions["time_s"].tolist() == pytest.approx([0.0, 0.6, 1.2, 1.8, 2.4])
    assert results.steps["time_s"].max() == pytest.approx(2.85)
    assert (row["duration_s"], row["decision_count"]) == (pytest.approx(2.85), 5)
    assert results.manifests[RUN_ID]["status"] == status
    assert results.manifests[RUN_ID]["reason"] == row["reason"]
    return row


@pytest.mark.parametrize(
    "error",
    [RuntimeError("the planner\nbroke"), InputError(["a number must be finite, got NaN"]), MemoryError()],
    ids=lambda error: type(error).__name__,
)
def test_a_planner_that_raises_leaves_its_record_and_a_traceback(call, breaking, tmp_path, error):
    out = tmp_path / "out"
    finished = call("run", breaking(error), "--out", out)
    assert finished.code == 1
    assert "failed" in finished.out
    row = check_partial(out, "failed")
    assert row["reason"].startswith(type(error).__name__)
    traceback = out / "failures" / f"{RUN_ID}.txt"
    assert str(traceback) in finished.err
    assert len(finished.lines) == 1
    text = traceback.read_text()
    assert text.startswith("Traceback")
    assert "raise self.error" in text
    assert (out / f"{RUN_ID}.html").is_file()


def test_ctrl_c_leaves_the_record(call, breaking, tmp_path):
    finished = call("run", breaking(KeyboardInterrupt()), "--out", tmp_path / "out")
    assert (finished.code, finished.lines) == (130, ["interrupted; everything up to here was kept"])
    assert check_partial(tmp_path / "out", "interrupted")["reason"] == "interrupted by the user"
    assert not (tmp_path / "out" / "failures").exists()


def test_a_run_that_works_again_takes_the_traceback_away(call, breaking, tmp_path, monkeypatch):
    out = tmp_path / "out"
    scenario = breaking(RuntimeError("broke"))
    assert call("run", scenario, "--out", out).code == 1
    monkeypatch.setattr(registry, "BUILT_IN", (*registry.BUILT_IN[:-1], replace(registry.HMDP_MPC, name="breaking")))
    assert call("run", scenario, "--out", out).code == 0
    assert list((out / "failures").iterdir()) == []
    assert sumo_hmdp.load(out).runs["status"].tolist() == ["completed"]


def test_a_full_disk_is_one_line(call, short_case, tmp_path, monkeypatch):
    def no_space(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("sumo_hmdp.study.run.write_manifest", no_space)
    finished = call("run", short_case(3.0), "--out", tmp_path / "out")
    assert (finished.code, finished.out, len(finished.lines)) == (1, "", 1)
    assert "No space left on device" in finished.err
    # Without its row in `runs` the half-written run does not exist.
    results = sumo_hmdp.load(tmp_path / "out")
    assert (len(results.runs), len(results.steps), results.manifests) == (0, 0, {})


@pytest.fixture
def endless(command, short_case, tmp_path):
    """Start a run of 225 s, as long as the road is, and wait until SUMO has its files."""
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    started = []

    def start():
        scenario = short_case(225.0)
        process = subprocess.Popen(
            [command, "run", str(scenario), "--out", str(tmp_path / "out")],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ, "TMPDIR": str(scratch)},
        )  # fmt: skip
        started.append(process)
        while not list(scratch.glob("sumo-hmdp-*/*")):
            assert process.poll() is None, process.stderr.read()
            time.sleep(0.01)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


def test_sigint_to_the_real_command_keeps_the_record(endless, tmp_path):
    process = endless()
    process.send_signal(signal.SIGINT)
    _, complaint = process.communicate(timeout=60)
    assert process.returncode == 130
    assert complaint == "interrupted; everything up to here was kept\n"
    results = sumo_hmdp.load(tmp_path / "out")
    assert results.runs["status"].tolist() == ["interrupted"]
    assert results.runs["decision_count"].item() == len(results.decisions)
    assert list((tmp_path / "scratch").iterdir()) == []


def test_sigkill_leaves_the_folder_readable(call, endless, short_case, tmp_path):
    out = tmp_path / "out"
    assert call("run", short_case(3.0), "--out", out, "--seed", 1).code == 0
    process = endless()
    process.kill()
    process.wait(timeout=60)
    results = sumo_hmdp.load(out)
    assert results.runs["seed"].tolist() == [1]
    assert set(results.steps["run_id"]) == set(results.runs["run_id"]) == set(results.manifests)


def test_what_a_killed_process_leaves_is_not_taken_for_tables(call, short_case, tmp_path):
    """Killed between two tables, or within one, of the second run."""
    out = tmp_path / "out"
    for seed in (1, 2):
        assert call("run", short_case(3.0), "--out", out, "--seed", seed).code == 0
    killed = "case2-hmdp_mpc-eps0.05-seed2"
    (out / "runs" / f"{killed}.parquet").unlink()
    (out / "decisions" / f"{killed}.parquet").replace(out / "decisions" / f".{killed}.parquet.77.partial")
    (out / "decisions" / f".{killed}.parquet.77.partial").write_bytes(b"PAR1 and no more")
    results = sumo_hmdp.load(out)
    for frame in (results.runs, results.decisions, results.steps):
        assert set(frame["run_id"]) == {"case2-hmdp_mpc-eps0.05-seed1"}
    assert len(pd.read_parquet(out / "decisions")) == 5


def test_the_row_of_a_run_is_away_while_it_is_rewritten(call, short_case, tmp_path, monkeypatch):
    """Else a process killed between the new tables and the new row would leave two runs mixed."""
    out = tmp_path / "out"
    assert call("run", short_case(3.0), "--out", out).code == 0
    rows = []
    write = sumo_hmdp.study.run.write_table

    def observe(folder, table, run_id, frame):
        rows.append((table, list((folder / "runs").glob("*.parquet")) != []))
        write(folder, table, run_id, frame)

    monkeypatch.setattr("sumo_hmdp.study.run.write_table", observe)
    assert call("run", short_case(3.0), "--out", out).code == 0
    assert rows == [("steps", False), ("decisions", False), ("runs", False)]
    assert len(sumo_hmdp.load(out).runs) == 1
