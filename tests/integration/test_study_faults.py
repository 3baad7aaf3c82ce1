"""What a study survives, with real processes: whatever ends a run, a worker or the study, finished runs stay."""

import json
import os
import signal
import subprocess
import time
from pathlib import Path

import pandas as pd
import pytest

import sumo_hmdp


def workers_of(process):
    """Return the processes that a study has started."""
    tasks = Path(f"/proc/{process.pid}/task").glob("*/children")
    return [int(pid) for file in tasks for pid in file.read_text().split()]


def is_alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def wait_for(what, process):
    """Wait until something is the case while a study runs."""
    until = time.monotonic() + 60
    while not (found := what()):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < until
        time.sleep(0.02)
    return found


@pytest.fixture
def start(command):
    """Start a study and go on at once."""
    started = []

    def begin(*arguments, **options):
        process = subprocess.Popen(
            [command, "study", *map(str, arguments)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            **options,
        )
        started.append(process)
        return process

    yield begin
    for process in started:
        process.kill()
        process.communicate()


def ledger_of(folder):
    return [json.loads(line) for line in (folder / "ledger.jsonl").read_text().splitlines() if line]


def test_a_planner_that_hangs_raises_or_crashes_costs_its_own_runs(shell, write_study, faulty, tmp_path):
    faults = ["none", "hang", "raise", "segfault", "kill_once"]
    factors = {
        "planner": ["faulty"], "duration_s": [0.6], "planners.faulty.fault": faults,
        "planners.faulty.marker": [str(tmp_path / "marker")],
    }  # fmt: skip
    study = write_study(tmp_path, factors=factors, seeds=[7], wall_limit_s=3.0)
    out = tmp_path / "out"
    finished = shell("study", study, "--out", out, "--workers", 2, env=faulty)
    assert finished.code == 1
    assert f"some runs did not end well; {out / 'ledger.jsonl'} says why" in finished.err
    assert "5 runs: 2 completed, 1 crashed, 1 failed, 1 timed_out" in finished.out
    runs = sumo_hmdp.load(out).runs.set_index("planners.faulty.fault")
    assert runs["status"].to_dict() == {
        "none": "completed", "hang": "timed_out", "raise": "failed", "segfault": "crashed", "kill_once": "completed",
    }  # fmt: skip
    assert runs["reason"].to_dict() == {
        "none": "", "kill_once": "", "hang": "took longer than 3 s", "raise": "ZeroDivisionError: the planner broke",
        "segfault": "the process ended: signal 11 (Segmentation fault)",
    }  # fmt: skip
    # Nothing is known of what a lost run did; the failed one's counts are those up to where it broke.
    assert runs["decision_count"].isna().to_dict() == {fault: fault in {"hang", "segfault"} for fault in faults}
    assert runs.loc["none", "trace_hash"] == runs.loc["kill_once", "trace_hash"]
    attempts = [(entry["run_id"], entry["attempt"], entry["status"]) for entry in ledger_of(out)]
    names = runs["run_id"]
    assert sorted(attempts) == sorted(
        [(names[fault], n, status) for n in (1, 2)
         for fault, status in (("hang", "timed_out"), ("raise", "failed"), ("segfault", "crashed"))]
        + [(names["kill_once"], 1, "crashed")]
    )  # fmt: skip
    for fault, text in (("hang", "in decide"), ("raise", "ZeroDivisionError"), ("segfault", "Segmentation fault")):
        assert text in (out / "failures" / f"{names[fault]}.txt").read_text()
    # They stay as they are: nothing is run again.
    again = shell("study", study, "--out", out, "--workers", 2, env=faulty)
    assert again.code == 1
    assert again.out.splitlines()[-2:] == finished.out.splitlines()[-2:]
    assert len(ledger_of(out)) == 7


@pytest.fixture(scope="module")
def undisturbed(shell, write_study_once, tmp_path_factory):
    """The hash of a study that nothing has happened to."""
    folder = tmp_path_factory.mktemp("undisturbed")
    return hash_in(shell("study", write_study_once(folder, **LONG), "--out", folder / "out", "--workers", 2).out)


LONG = {"factors": {"planner": ["constant"], "duration_s": [9.0]}, "seeds": {"count": 5}}


def hash_in(out):
    return out.split("study hash: ")[1].split()[0]


def test_a_killed_worker_costs_nothing(start, write_study, undisturbed, tmp_path):
    out = tmp_path / "out"
    process = start(write_study(tmp_path, **LONG), "--out", out, "--workers", 2)
    # A child of the study that has SUMO's files in its hands.
    wait_for(lambda: len(workers_of(process)) == 2, process)
    os.kill(workers_of(process)[0], signal.SIGKILL)
    text, complaint = process.communicate(timeout=120)
    assert (process.returncode, complaint) == (0, "")
    assert hash_in(text) == undisturbed
    assert [entry["status"] for entry in ledger_of(out)] == ["crashed"]


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_a_study_that_is_ended_goes_on(start, call, write_study, undisturbed, tmp_path, how):
    out, scratch = tmp_path / "out", tmp_path / "scratch"
    scratch.mkdir()
    study = write_study(tmp_path, **LONG)
    begun = call("study", study, "--out", out, "--workers", 1, "--limit", 2)
    assert begun.code == 0
    process = start(study, "--out", out, "--workers", 2, env={**os.environ, "TMPDIR": str(scratch)})
    # SUMO's files of a run: it has begun.
    wait_for(lambda: list(scratch.glob("*/sumo-hmdp-*")), process)
    # Both: the second worker may have started after the first was seen.
    workers = wait_for(lambda: len(found := workers_of(process)) == 2 and found, process)
    process.send_signal(how)
    _, complaint = process.communicate(timeout=30)
    if how is signal.SIGKILL:
        assert process.returncode == -9
    else:
        assert process.returncode == 130
        assert complaint.startswith("interrupted; what is finished was kept. Go on with\nsumo-hmdp study ")
    until = time.monotonic() + 30
    while any(map(is_alive, workers)):
        assert time.monotonic() < until
        time.sleep(0.05)
    assert list(scratch.iterdir()) == []
    kept = sumo_hmdp.load(out).runs
    assert len(kept) >= 2
    finished = call("study", study, "--out", out, "--workers", 1)
    assert (finished.code, hash_in(finished.out)) == (0, undisturbed)
    assert set(kept["run_id"]) <= set(sumo_hmdp.load(out).runs["run_id"])
    assert not sumo_hmdp.load(out).runs["run_id"].duplicated().any()


def test_a_damaged_file_is_named_and_its_runs_are_run_again(call, write_study, tmp_path):
    out = tmp_path / "out"
    command = ("study", write_study(tmp_path, trace="all"), "--out", out, "--workers", 1)
    expected = hash_in(call(*command).out)
    file = next((out / "decisions").rglob("*.parquet"))
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(sumo_hmdp.errors.InputError, match=r"must be a whole Parquet file.*Delete it"):
        sumo_hmdp.load(out)
    finished = call(*command)
    assert (finished.code, hash_in(finished.out)) == (0, expected)
    assert len(finished.lines) == 1
    assert finished.lines[-1].startswith(f"{file}: must be a whole Parquet file")
    assert finished.lines[-1].endswith("put aside as .damaged, its runs are run again")
    assert len(sumo_hmdp.load(out).runs) == 4
    assert len(pd.read_parquet(out / "runs")) == 4


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 1 MB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(folder)], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip(f"a small file system cannot be mounted: {mounted.stderr.decode().strip()}")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


def test_a_full_disk_ends_the_study_with_one_line(call, write_study, small_disk, tmp_path):
    out = small_disk / "out"
    study = write_study(tmp_path, trace="all")
    assert call("study", study, "--out", out, "--workers", 1, "--limit", 1).code == 0
    before = sumo_hmdp.load(out)
    filler = small_disk / "filler"
    with pytest.raises(OSError, match="No space"):
        filler.write_bytes(bytes(2_000_000))
    finished = call("study", study, "--out", out, "--workers", 1)
    assert finished.code == 1
    assert len(finished.lines) == 1
    assert "No space left on device" in finished.err
    assert "make room and start again" in finished.err
    for table in ("runs", "decisions", "steps"):
        pd.testing.assert_frame_equal(getattr(sumo_hmdp.load(out), table), getattr(before, table))
    filler.unlink()
    finished = call("study", study, "--out", out, "--workers", 1)
    assert finished.code == 0
    assert "4 runs: 4 completed" in finished.out


def test_of_two_studies_in_one_folder_one_works_and_the_other_says_so(start, write_study, undisturbed, tmp_path):
    out, study = tmp_path / "out", write_study(tmp_path, **LONG)
    both = [start(study, "--out", out, "--workers", 1) for _ in range(2)]
    ended = [(*process.communicate(timeout=300), process.returncode) for process in both]
    (text, complaint, _), (nothing, refusal, _) = sorted(ended, key=lambda one: one[2])
    assert sorted(code for *_, code in ended) == [0, 2]
    assert (hash_in(text), complaint, nothing) == (undisturbed, "", "")
    assert refusal == f"--out: {out} must not be in use by another study; wait for it to end\n"


def test_a_planner_s_words_end_no_study(shell, write_study, faulty, tmp_path):
    factors = {
        "planner": ["faulty"], "duration_s": [0.6], "planners.faulty.fault": ["none", "words"],
    }  # fmt: skip
    study, out = write_study(tmp_path, factors=factors, seeds=[7]), tmp_path / "out"
    finished = shell("study", study, "--out", out, "--workers", 1, env=faulty)
    assert (finished.code, "2 runs: 1 completed, 1 failed" in finished.out) == (1, True)
    # A planner of another package is part of what a cell is: changed, it makes new cells, and that is said.
    module = tmp_path / "faulty_planners.py"
    module.write_text(module.read_text() + "\n# changed\n")
    again = shell("study", study, "--out", out, "--workers", 1, env=faulty)
    assert "left out, for the study does not ask for them at present: 2 runs of 2 cells" in again.err
    assert "the planner faulty has changed: faulty-planners 1.0 (source " in again.err
    retried = shell("study", study, "--out", out, "--workers", 1, "--retry-failed", env=faulty)
    assert "1 run that did not end well is done again" in retried.err
    assert [entry["status"] for entry in ledger_of(out)].count("failed") == 6
