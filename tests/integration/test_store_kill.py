"""A store whose writer is killed at any instant: what it said was written is there, and everything can be read."""

import multiprocessing
import os
import random
import signal
import time

import pandas as pd
import pytest

import sumo_hmdp
from sumo_hmdp.study import parts, runner
from sumo_hmdp.study.design import load_design
from sumo_hmdp.study.parts import RunTables, Writer, opened
from sumo_hmdp.study.record import DECISION_COLUMNS, STEP_COLUMNS, RunStatus
from sumo_hmdp.study.recovery import sweep
from sumo_hmdp.study.run import run_facts
from sumo_hmdp.study.runner import Study
from sumo_hmdp.study.store import TABLES
from sumo_hmdp.study.worker import run_job

ROWS = 300
STUDY = (
    "name: kill\nscenarios: [case2]\nfactors: {planner: [constant], duration_s: [0.6, 0.9]}\nseeds: {count: 100000}\n"
)


def rows_of(columns, run_id):
    frame = pd.DataFrame({name: [0] * ROWS for name in columns}, columns=list(columns)).astype(columns)
    return frame.assign(run_id=run_id)


def write_for_ever(folder, design, first, told):
    """Write a batch of one run of each cell after the other, and tell what is on the disk."""
    with opened(folder):
        writer = Writer(folder, design.cells)
        writer.describe_cells()
        for seed in range(first, 100_000):
            names = [cell.run_id(seed) for cell in design.cells]
            for cell, run_id in zip(design.cells, names, strict=True):
                row = run_facts(cell.ready, run_id, RunStatus.COMPLETED, "") | {"seed": seed}
                steps, decisions = (rows_of(columns, run_id) for columns in (STEP_COLUMNS, DECISION_COLUMNS))
                writer.add(RunTables(cell.id, row, steps, decisions))
            writer.flush()
            told.send(names)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_writer_that_is_killed_at_any_instant_leaves_a_readable_store(tmp_path, monkeypatch, seed):
    # Small files, so that kills fall on new ones, on growing ones and on full ones.
    monkeypatch.setattr(parts, "RUNS_PER_FILE", 4)
    (tmp_path / "study.yaml").write_text(STUDY)
    design, folder = load_design(tmp_path / "study.yaml"), tmp_path / "out"
    instants = random.Random(seed)  # noqa: S311 - no secret
    written, first = set(), 0
    for _ in range(6):
        # A copy of this process: it begins at once.
        context = multiprocessing.get_context("fork")
        ours, theirs = context.Pipe(duplex=False)
        process = context.Process(target=write_for_ever, args=(folder, design, first, theirs))
        process.start()
        theirs.close()
        written.update(ours.recv())
        time.sleep(instants.uniform(0.0, 0.3))
        os.kill(process.pid, signal.SIGKILL)
        process.join()
        while ours.poll():
            try:
                written.update(ours.recv())
            except EOFError:
                break
        results = sumo_hmdp.load(folder)
        names = results.runs["run_id"]
        assert written <= set(names)
        assert not names.duplicated().any()
        # Other tools read the folders as they are, and have every run that counts.
        for table in TABLES:
            frame = pd.read_parquet(folder / table)
            assert set(names) <= set(frame["run_id"])
        for frame in (results.decisions, results.steps):
            assert frame["run_id"].value_counts().to_dict() == dict.fromkeys(names, ROWS)
        # At most one run of each cell was lost; going on takes away what is left of it.
        assert len(set(names) - written) <= len(design.cells)
        assert sweep(folder).run_ids == set(names)
        for table in TABLES:
            assert set(pd.read_parquet(folder / table)["run_id"]) == set(names)
        assert sweep(folder).damaged == ()
        assert list(folder.rglob("*.partial")) == []
        written, first = set(names), int(results.runs["seed"].max()) + 1
    assert len(written) >= 12


REAL = "name: real\nscenarios: [case2]\nfactors: {planner: [constant], duration_s: [0.6, 0.9]}\nseeds: {count: 15}\n"


class Here:
    """Real runs, one after the other, in the process that may be killed."""

    def __init__(self):
        self.jobs = []

    @property
    def free(self):
        return 1 - len(self.jobs)

    def submit(self, job):
        self.jobs.append(job)

    def collect(self, timeout):
        return [run_job(self.jobs.pop())]


def go_on(folder, file, told):
    design = load_design(file)
    with opened(folder):
        finished = sweep(folder)
        Writer(folder, design.cells).describe_cells()
        study = Study(design, folder, finished, Here(), on_progress=lambda progress: told.send(progress.done))
        study.run()
        told.send(study.hash())


def test_a_study_that_is_killed_ten_times_has_the_hash_of_an_undisturbed_one(tmp_path, monkeypatch):
    """Runs are done and written the whole time: a batch is one run, so that kills fall on both."""
    monkeypatch.setattr(runner, "FLUSH_RUNS", 1)
    file = tmp_path / "study.yaml"
    file.write_text(REAL)
    context, chance = multiprocessing.get_context("fork"), random.Random(3)  # noqa: S311 - no secret

    def begin(folder):
        ours, theirs = context.Pipe(duplex=False)
        process = context.Process(target=go_on, args=(folder, file, theirs))
        process.start()
        theirs.close()
        return process, ours

    def finish(folder):
        process, pipe = begin(folder)
        while not isinstance(found := pipe.recv(), str):
            pass
        process.join()
        return found

    expected = finish(tmp_path / "undisturbed")
    done = 0
    for kill in range(10):
        process, pipe = begin(tmp_path / "killed")
        # Runs are being done: two more than those that were there when it began, at most.
        first = pipe.recv()
        assert first >= done
        for _ in range(chance.randrange(3)):
            pipe.recv()
        time.sleep(chance.uniform(0.0, 0.1))
        os.kill(process.pid, signal.SIGKILL)
        process.join()
        assert process.exitcode == -signal.SIGKILL, kill
        done = len(sweep(tmp_path / "killed").rows)
    assert done < 30
    assert finish(tmp_path / "killed") == expected
    assert not sumo_hmdp.load(tmp_path / "killed").runs["run_id"].duplicated().any()
