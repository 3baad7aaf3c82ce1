"""Worker processes: replaced after some runs, or when they die while they wait, and what they say of a bad job."""

import os
import signal
import time
from dataclasses import replace

import pytest

from sumo_hmdp.study.pool import LocalPool
from sumo_hmdp.study.record import RunStatus
from sumo_hmdp.study.runner import job_of


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
