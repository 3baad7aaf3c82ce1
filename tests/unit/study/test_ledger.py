"""The ledger, and what becomes of runs that do not end well, with a pool that answers as the test wants."""

import errno

import pytest

import sumo_hmdp
from sumo_hmdp.errors import SumoHmdpError
from sumo_hmdp.study.ledger import Ledger, read_ledger
from sumo_hmdp.study.parts import opened
from sumo_hmdp.study.record import RunStatus
from sumo_hmdp.study.recovery import sweep
from sumo_hmdp.study.run import run_facts
from sumo_hmdp.study.runner import Study
from sumo_hmdp.study.worker import Outcome


def test_attempts_are_counted_over_calls_and_torn_lines_are_skipped(tmp_path):
    assert read_ledger(tmp_path) == []
    crashed = Outcome("a", RunStatus.CRASHED, "signal 9", wall_time=1.23456)
    Ledger(tmp_path).note(crashed)
    with (tmp_path / "ledger.jsonl").open("a") as file:
        file.write('{"run_id": "b", "att')
    ledger = Ledger(tmp_path)
    assert (ledger.attempts("a"), ledger.attempts("b")) == (1, 0)
    ledger.note(crashed)
    assert Ledger(tmp_path).attempts("a") == 2
    entries = read_ledger(tmp_path)
    assert [(e["run_id"], e["attempt"], e["status"], e["wall_time_s"]) for e in entries] == [
        ("a", 1, "crashed", 1.235),
        ("a", 2, "crashed", 1.235),
    ]


class Answers:
    """A pool that gives each run its answers one after the other."""

    def __init__(self, **answers):
        self.answers = {seed: list(statuses) for seed, statuses in answers.items()}
        self.jobs = []

    @property
    def free(self):
        return 1 - len(self.jobs)

    def submit(self, job):
        self.jobs.append(job)

    def collect(self, timeout):
        job = self.jobs.pop()
        answer = self.answers[f"seed{job.seed}"].pop(0)
        if isinstance(answer, BaseException):
            raise answer
        status, reason, *number = answer
        row = run_facts(job.ready(), job.run_id, status, reason) if status is RunStatus.COMPLETED else None
        text = "Fatal" if row is None else ""
        return [Outcome(job.run_id, status, reason, row, traceback=text, error_number=next(iter(number), None))]


DONE = (RunStatus.COMPLETED, "")
HANGS = (RunStatus.TIMED_OUT, "took longer than 1 s")


@pytest.fixture
def study(tiny, tmp_path):
    """Make a study of one cell on answers."""
    file = tiny.file.model_copy(update={"name": "one"})
    design = type(tiny)(file, tiny.cells[:1], ((0, 1, 2),))

    def make(**answers):
        return Study(design, tmp_path, sweep(tmp_path), Answers(**answers))

    with opened(tmp_path):
        yield make


def statuses(folder):
    return sumo_hmdp.load(folder).runs.set_index("seed")["status"].to_dict()


def test_a_run_is_tried_twice(study, tmp_path):
    work = study(seed0=[DONE], seed1=[HANGS, DONE], seed2=[HANGS, HANGS])
    assert work.run()
    assert statuses(tmp_path) == {0: "completed", 1: "completed", 2: "timed_out"}
    assert work.counts() == {"completed": 2, "timed_out": 1}
    assert len(read_ledger(tmp_path)) == 3
    assert (tmp_path / "failures" / f"{work.design.cells[0].run_id(2)}.txt").read_text() == "Fatal"
    # The row of a lost run has its own seed.
    assert sumo_hmdp.load(tmp_path).runs["seed"].tolist() == [0, 1, 2]


def test_what_is_finished_is_written_when_the_user_ends_the_study(study, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        study(seed0=[DONE], seed1=[HANGS], seed2=[KeyboardInterrupt()]).run()
    assert statuses(tmp_path) == {0: "completed"}
    # One attempt was made already, so one is left.
    study(seed1=[HANGS], seed2=[DONE]).run()
    assert statuses(tmp_path) == {0: "completed", 1: "timed_out", 2: "completed"}


def test_a_disk_that_is_full_for_a_worker_is_no_fault_of_the_run(study, tmp_path):
    full = (RunStatus.FAILED, "OSError: [Errno 28] No space left on device", errno.ENOSPC)
    with pytest.raises(SumoHmdpError, match=r"No space left on device.*Make room"):
        study(seed0=[DONE], seed1=[full]).run()
    assert statuses(tmp_path) == {0: "completed"}
    assert read_ledger(tmp_path) == []


def test_a_planner_that_speaks_of_a_full_disk_blocks_nothing(study, tmp_path):
    """Only the system's number says that the disk is full."""
    words = (RunStatus.FAILED, "RuntimeError: table of errors: [Errno 28] No space left on device")
    assert study(seed0=[words, words], seed1=[DONE], seed2=[DONE]).run()
    assert statuses(tmp_path) == {0: "failed", 1: "completed", 2: "completed"}


def test_runs_that_are_asked_for_anew_have_all_their_attempts(tmp_path):
    crashed = Outcome("a", RunStatus.CRASHED, "signal 9")
    for _ in range(2):
        Ledger(tmp_path).note(crashed)
    Ledger(tmp_path).ask_again(["a"], "--retry-failed")
    assert Ledger(tmp_path).attempts("a") == 0


def test_lines_that_are_no_entries_are_passed_over(tmp_path):
    lines = (
        '{"run_id": "a", "status": "failed"}',
        '{"status": "failed"}',
        "[]",
        '{"run_id": 3, "status": "failed"}',
        "7",
    )
    (tmp_path / "ledger.jsonl").write_bytes("\n".join(lines).encode() + b"\n\xff\xfe{}\n" + b"[" * 100_000)
    assert [entry["run_id"] for entry in read_ledger(tmp_path)] == ["a"]
    assert Ledger(tmp_path).attempts("a") == 1
