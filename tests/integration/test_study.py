"""Studies with real processes: the same tables whoever does the runs, and going on where a call has ended."""

import json
import subprocess
import sys

import pandas as pd
import pytest
import yaml

import sumo_hmdp
from sumo_hmdp.study import store
from sumo_hmdp.study.design import load_design
from sumo_hmdp.study.parts import opened
from sumo_hmdp.study.record import RunStatus
from sumo_hmdp.study.recovery import sweep
from sumo_hmdp.study.run import run_facts
from sumo_hmdp.study.runner import Study
from sumo_hmdp.study.worker import Outcome

MIXED = {
    "factors": {"planner": ["hmdp_mpc", "idm_mobil"], "risk_level": [0.01, 0.05], "duration_s": [1.2]},
    "seeds": {"count": 2},
    "solver": "search",
    "trace": "all",
}


def hash_in(finished):
    return finished.out.split("study hash: ")[1].split()[0]


@pytest.fixture(scope="module")
def one_worker(shell, write_study_once, tmp_path_factory):
    """The folder and the hash of a study of three cells done by one process."""
    folder = tmp_path_factory.mktemp("one")
    finished = shell("study", write_study_once(folder, **MIXED), "--out", folder / "out", "--workers", 1)
    assert finished.code == 0, finished.err
    assert "6 runs: 6 completed" in finished.out
    return folder, hash_in(finished)


def test_two_workers_leave_the_same_tables(shell, one_worker, tmp_path):
    folder, expected = one_worker
    finished = shell("study", folder / "study.yaml", "--out", tmp_path / "out", "--workers", 2)
    assert (finished.code, hash_in(finished)) == (0, expected)
    one, two = (sumo_hmdp.load(path).runs.sort_values("run_id") for path in (folder / "out", tmp_path / "out"))
    assert one["trace_hash"].tolist() == two["trace_hash"].tolist()
    assert one["run_id"].tolist() == two["run_id"].tolist()


def test_dask_leaves_the_same_tables(shell, one_worker, tmp_path):
    folder, expected = one_worker
    program = (
        "import sys; from distributed import LocalCluster;"
        "cluster = LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None);"
        "print(cluster.scheduler_address, flush=True); sys.stdin.read(); cluster.close()"
    )
    with subprocess.Popen(
        [sys.executable, "-P", "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        text=True,
    ) as cluster:  # fmt: skip
        address = cluster.stdout.readline().strip()
        finished = shell("study", folder / "study.yaml", "--out", tmp_path / "out", "--dask", address)
        cluster.stdin.close()
        cluster.wait(60)
    # Two seeds show nothing, and the study says so before it runs.
    assert finished.err == ""
    assert "note: no difference between cells can be shown with 2 seeds; it takes 6 at least\n" in finished.out
    assert (finished.code, hash_in(finished)) == (0, expected)


def test_a_single_run_is_the_same_run(call, one_worker, tmp_path):
    """What a study makes of a scenario is what `run` makes of it."""
    folder, _ = one_worker
    results = sumo_hmdp.load(folder / "out")
    row = results.runs[(results.runs["planner"] == "hmdp_mpc") & (results.runs["risk_level"] == 0.01)].iloc[0]
    scenario = tmp_path / "scenario.yaml"
    scenario.write_text(yaml.safe_dump(results.manifests[row["run_id"]]["document"]))
    options = ["--solver", "search", "--epsilon", 0.01, "--planner", "hmdp_mpc", "--out", tmp_path / "single"]
    assert call("run", scenario, *options).code == 0
    assert sumo_hmdp.load(tmp_path / "single").runs["trace_hash"].item() == row["trace_hash"]


def test_the_same_command_goes_on(call, one_worker, tmp_path):
    folder, expected = one_worker
    command = ("study", folder / "study.yaml", "--out", tmp_path / "out", "--workers", 1)
    stopped = call(*command, "--limit", 2)
    assert stopped.code == 0
    assert "2 runs: 2 completed" in stopped.out
    assert "stopped at --limit; go on with\nsumo-hmdp study " in stopped.out
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "out" / "runs").rglob("*.parquet")}
    finished = call(*command)
    assert (finished.code, hash_in(finished)) == (0, expected)
    assert before.items() <= {p: p.stat().st_mtime_ns for p in (tmp_path / "out" / "runs").rglob("*.parquet")}.items()
    again = call(*command)
    assert (again.code, hash_in(again)) == (0, expected)
    assert not sumo_hmdp.load(tmp_path / "out").runs["run_id"].duplicated().any()


def test_a_changed_study_runs_what_is_new_and_keeps_what_is_old(call, write_study, tmp_path):
    out = tmp_path / "out"
    assert call("study", write_study(tmp_path, seeds=[0]), "--out", out, "--workers", 1).code == 0
    old = sumo_hmdp.load(out).runs
    factors = {"planner": ["constant"], "duration_s": [0.9]}
    finished = call("study", write_study(tmp_path, factors=factors, seeds=[0, 1]), "--out", out, "--workers", 1)
    assert finished.code == 0
    note = f"left out, for the study does not ask for them at present: 1 run of 1 cell ({old['cell'].item()})"
    assert finished.lines == [note]
    # What the study asks for is what is read; the rest is named.
    with pytest.warns(UserWarning, match=r"left out.* 1 run of 1 cell"):
        assert sorted(sumo_hmdp.load(out).runs["seed"]) == [0, 1]
    results = store.load(out, everything=True)
    assert results.notes == ()
    runs = results.runs
    assert runs["duration_s"].round(6).tolist().count(0.6) == 1
    assert runs.groupby("cell")["seed"].apply(sorted).map(tuple).to_dict() == {
        old["cell"].item(): (0,), (set(runs["cell"]) - set(old["cell"])).pop(): (0, 1),
    }  # fmt: skip
    # The hash is that of the study as it is now, without what it used to be.
    assert hash_in(finished) == hash_in(
        call("study", tmp_path / "study.yaml", "--out", tmp_path / "fresh", "--workers", 1)
    )


def test_a_dry_run_tells_cells_time_and_disk_and_writes_nothing(call, write_study, tmp_path):
    finished = call("study", write_study(tmp_path, **MIXED), "--out", tmp_path / "out", "--dry-run", "--workers", 3)
    assert finished.code == 0
    assert "1 combinations are the same cell" in finished.out
    assert "3 cells, 6 runs; at most about 0.0 min with 3 workers and 0." in finished.out
    assert "if all runs are like these, which took " in finished.out
    lines = finished.out.splitlines()
    assert [line.strip().rsplit("-", 2)[0] for line in lines[-3:]] == [
        "case2-hmdp_mpc-search-eps0.01", "case2-hmdp_mpc-search-eps0.05", "case2-idm_mobil-search",
    ]  # fmt: skip
    # Names of cells are whole in a file, and what all have in common is said once.
    assert any(lines[-3].strip().rsplit("-", 1)[0] in line for line in lines[:-5])
    assert "duration_s 1.2" in finished.out
    assert not (tmp_path / "out").exists()


def test_a_dry_run_names_every_mistake(call, write_study, tmp_path):
    file = write_study(tmp_path, factors={"ego.sped_mps": [1.0], "planner": ["none"]}, wall_limit_s=-1)
    finished = call("study", file, "--out", tmp_path / "out", "--dry-run")
    assert finished.code == 2
    assert len(finished.lines) == 3
    assert all(line.startswith(f"{file}: ") for line in finished.lines)
    assert call("study", tmp_path / "none.yaml", "--out", tmp_path).lines[0].startswith("must be a study file or name")
    together = call("study", write_study(tmp_path), "--out", tmp_path / "out", "--workers", 2, "--dask", "tcp://a:1")
    assert together.lines == ["--workers: must not go with --dask; leave one of the two out"]
    nobody = call("study", tmp_path / "study.yaml", "--out", tmp_path / "out", "--dask", "nonsense://a")
    assert nobody.code == 2
    assert nobody.lines[0].startswith("--dask: must be a scheduler that answers")


def test_a_study_that_comes_along_is_found_by_its_name(call, tmp_path):
    finished = call("study", "case2_epsilon", "--out", tmp_path / "out", "--dry-run", "--workers", 1)
    assert finished.code == 0
    assert "8 cells, 8 runs" in finished.out


class Table:
    """A pool that answers from a table of values by seed, in an order of its own."""

    def __init__(self, values, backwards):
        self.values, self.backwards, self.waiting, self.seen = values, backwards, [], []

    @property
    def free(self):
        return 3 - len(self.waiting)

    def submit(self, job):
        self.waiting.append(job)
        self.seen.append(job.seed)

    def collect(self, timeout):
        job = self.waiting.pop(-1 if self.backwards else 0)
        facts = run_facts(job.ready(), job.run_id, RunStatus.COMPLETED, "")
        return [Outcome(job.run_id, RunStatus.COMPLETED, row=facts | {"gap_min_m": self.values[job.seed]})]


@pytest.mark.parametrize("backwards", [False, True])
def test_seeds_stop_at_the_end_of_the_batch_in_which_they_are_enough(write_study, tmp_path, backwards):
    # After seeds 0 to 3 the half-width is t(0.975, 3) * 1.155 / 2 = 1.84; after 0 to 5 it is t(0.975, 5) * 0.894 /
    # sqrt(6) = 0.939, after 0 to 7 t(0.975, 7) * 0.756 / sqrt(8) = 0.632. The batch is done although seed 4 would do.
    values = [9.0, 11.0, 9.0, 11.0, 10.0, 10.0, 10.0, 10.0, 10.0, 10.0]
    stopping = {"metric": "gap_min_m", "half_width": 1.0, "seeds_min": 4, "seeds_max": 10, "batch_count": 2}
    design = load_design(write_study(tmp_path, seeds={"first": 0}, stopping=stopping))
    pool = Table(values, backwards)
    with opened(tmp_path / "out") as folder:
        study = Study(design, folder, sweep(folder), pool)
        assert study.run()
        assert sorted(pool.seen) == [0, 1, 2, 3, 4, 5]
        again = Study(design, folder, sweep(folder), pool)
        assert again.run()
        assert len(pool.seen) == 6
        assert again.hash() == study.hash()
    assert sorted(sumo_hmdp.load(tmp_path / "out").runs["seed"]) == [0, 1, 2, 3, 4, 5]


def test_repro_of_a_study_and_of_a_single_run(call, short_case, one_worker, tmp_path):
    folder, _ = one_worker
    run_id = sumo_hmdp.load(folder / "out").runs["run_id"].iloc[0]
    finished = call("repro", folder / "out", run_id)
    assert (finished.code, finished.out[:21]) == (0, "the same: trace hash ")
    assert call("run", short_case(1.2), "--out", tmp_path / "out", "--epsilon", 0.01).code == 0
    single = sumo_hmdp.load(tmp_path / "out").runs["run_id"].item()
    assert call("repro", tmp_path / "out", single).code == 0
    wrong = call("repro", tmp_path / "out", single + "0")
    assert wrong.code == 2
    assert wrong.lines[0].endswith(f"did you mean `{single}`?")
    assert call("repro", tmp_path, single).lines[0].startswith(f"{tmp_path} must be a results directory")


def test_repro_names_the_first_step_that_differs(call, short_case, tmp_path):
    out = tmp_path / "out"
    assert call("run", short_case(1.2), "--out", out).code == 0
    run_id = sumo_hmdp.load(out).runs["run_id"].item()
    steps, runs, manifest = (
        out / kind / f"{run_id}.{end}"
        for kind, end in (("steps", "parquet"), ("runs", "parquet"), ("manifests", "json"))
    )
    frame = pd.read_parquet(steps)
    at = frame.index[(frame["step"] == 4) & (frame["vehicle_id"] == "sv2")]
    frame.loc[at, "speed_mps"] += 0.5
    frame.to_parquet(steps, index=False)
    row = pd.read_parquet(runs)
    row.assign(trace_hash="0" * 64).to_parquet(runs, index=False)
    content = json.loads(manifest.read_text())
    content["versions"]["sumo"] = "1.0"
    manifest.write_text(json.dumps(content))
    finished = call("repro", out, run_id)
    assert finished.code == 1
    assert "not the same: trace hash was 0000000000000000, is " in finished.err
    assert finished.err.strip().endswith("; step 4, sv2 at 0.60 s: speed_mps was 25.5, is 25.0")
    assert finished.out.startswith("other version: sumo 1.0, now ")
    # Without steps only the hashes can be compared.
    frame.iloc[:0].to_parquet(steps, index=False)
    assert "no stored step differs; what differs was not stored" in call("repro", out, run_id).err
    row.assign(trace_hash=None).to_parquet(runs, index=False)
    assert "must have a trace, got none" in call("repro", out, run_id).err
    manifest.unlink()
    row.to_parquet(runs, index=False)
    assert "must be there to do a run again" in call("repro", out, run_id).err
