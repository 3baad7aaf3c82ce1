"""Worker processes: replaced after some runs, or when they die while they wait, and what they say of a bad job."""

import os
import shutil
import signal
import subprocess
import tempfile
import time
from dataclasses import replace
from multiprocessing import Pipe
from pathlib import Path

import pytest

from sumo_hmdp.study import pool as pool_module
from sumo_hmdp.study.pool import LocalPool, PoolLostError, _Worker
from sumo_hmdp.study.record import RunStatus
from sumo_hmdp.study.runner import job_of
from sumo_hmdp.study.worker import Outcome


@pytest.fixture
def pool():
    made = LocalPool(1, runs_per_worker=2)
    yield made
    made.close()


def do(pool, job):
    assert pool.free == 1
    pool.submit(job)
    assert pool.free == 0
    while not (outcomes := pool.collect(1.0)):
        pass
    (outcome,) = outcomes
    return outcome


def test_processes_are_replaced(pool, tiny):
    assert pool.collect(0.1) == []
    job = job_of(tiny, tiny.cells[-1], 5)
    processes, outcomes = [], []
    for _ in range(3):
        outcomes.append(do(pool, job))
        processes.append(pool._workers[0].process.pid)
    assert [outcome.status for outcome in outcomes] == [RunStatus.COMPLETED] * 3
    assert (processes[0], len(set(processes))) == (processes[1], 2)
    assert outcomes[0].row["seed"] == 5
    assert (len(outcomes[0].steps), len(outcomes[0].decisions) > 0) == (0, True)
    # A job that cannot be assembled ends as a failed run, in the process that goes on.
    bad = do(pool, replace(job, planner="none"))
    assert (bad.status, bad.row, bad.traceback[:9]) == (RunStatus.FAILED, None, "Traceback")
    assert "must be a known planner" in bad.reason
    # One that has died while it waited is found out before it gets a job.
    os.kill(pool._workers[0].process.pid, signal.SIGKILL)
    pool._workers[0].done = 0
    while pool._workers[0].process.poll() is None:
        time.sleep(0.01)
    assert do(pool, job).status is RunStatus.COMPLETED


def test_a_process_that_is_stopped_is_ended_at_the_limit(pool, tiny):
    job = job_of(tiny, tiny.cells[-1], 0)
    assert do(pool, job).status is RunStatus.COMPLETED
    worker = pool._workers[0].process
    os.kill(worker.pid, signal.SIGSTOP)
    outcome = do(pool, replace(job, wall_limit=0.5))
    assert (outcome.status, outcome.reason) == (RunStatus.TIMED_OUT, "took longer than 0.5 s")
    assert worker.poll() == -signal.SIGKILL


def test_a_worker_whose_folder_was_removed_is_a_lost_worker(pool, tiny):
    job = job_of(tiny, tiny.cells[-1], 0)
    assert do(pool, job).status is RunStatus.COMPLETED
    worker = pool._workers[0]
    shutil.rmtree(worker.scratch)
    # It is replaced before it gets a job.
    assert do(pool, job).status is RunStatus.COMPLETED
    assert pool._workers[0] is not worker
    # Removed while it works, it costs the run one attempt.
    pool.submit(job)
    while not pool._workers[0].awake:
        pool.collect(0.1)
    shutil.rmtree(pool._workers[0].scratch)
    while not (outcomes := pool.collect(1.0)):
        pass
    assert outcomes[0].status in {RunStatus.CRASHED, RunStatus.COMPLETED}
    assert do(pool, job).status is RunStatus.COMPLETED


def test_a_run_whose_folder_was_removed_is_not_blamed(pool, tiny):
    job = job_of(tiny, tiny.cells[-1], 0)
    pool.submit(job)
    worker = pool._workers[0]
    ours, theirs = Pipe()
    # The process says that it failed, as it does when SUMO's files have gone.
    worker.connection, real = ours, worker.connection
    theirs.send(Outcome(job.run_id, RunStatus.FAILED, "FileNotFoundError: no such file"))
    shutil.rmtree(worker.scratch)
    (outcome,) = pool.collect(5.0)
    real.close()
    assert (outcome.status, outcome.reason) == (RunStatus.CRASHED, "its folder for temporary files was removed")
    assert pool.free == 1


def test_time_in_which_the_parent_was_stopped_does_not_count(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(pool_module.time, "monotonic", lambda: now[0])
    waiting = LocalPool(1, _looked=now[0])
    assert waiting._now() == 0.0
    now[0] += 0.5
    assert waiting._now() == 0.5
    now[0] += 3600.0
    assert waiting._now() == 0.5 + pool_module.LOOK_MAX


def test_what_a_planner_has_started_ends_with_its_worker(pool, tmp_path):
    # Instead of a worker a shell that has ended, whose child goes on.
    program = ["sh", "-c", "sleep 600 >/dev/null & echo $!"]
    process = subprocess.Popen(program, start_new_session=True, stdout=subprocess.PIPE, text=True)
    with process.stdout as pipe:
        child = Path(f"/proc/{pipe.readline().strip()}/stat")
    assert child.exists()
    pool._workers.append(_Worker(process, Pipe()[0], tmp_path / "scratch"))
    pool.close()
    until = time.monotonic() + 30
    while child.exists() and child.read_text().rsplit(")", 1)[1].split()[0] != "Z":
        assert time.monotonic() < until
        time.sleep(0.01)


def test_without_a_place_for_temporary_files_one_line_says_so(tiny, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "gone"))
    with pytest.raises(PoolLostError, match=r"no folder for temporary files can be made.*TMPDIR"):
        LocalPool(1).submit(job_of(tiny, tiny.cells[-1], 0))
