"""A study that changes between two calls: what is shown is what its file asks for, and the rest is named."""

import json
import os
import shutil

import duckdb
import pandas as pd
import pytest
import yaml

import sumo_hmdp
from sumo_hmdp.errors import InputError
from sumo_hmdp.report.study_comparison import compare_study
from sumo_hmdp.report.study_data import read_study
from sumo_hmdp.study import files, machine, store
from sumo_hmdp.study.asked import write_asked
from sumo_hmdp.study.design import load_design
from sumo_hmdp.study.files import DamagedFileError
from sumo_hmdp.study.ledger import Ledger
from sumo_hmdp.study.parts import RunTables, Writer, opened, study_hash
from sumo_hmdp.study.record import RunStatus
from sumo_hmdp.study.recovery import sweep
from sumo_hmdp.study.resume import changes, kept_text, take_back
from sumo_hmdp.study.run import run_facts
from sumo_hmdp.study.runner import asked_of
from sumo_hmdp.study.tables import read_table, write_parquet
from sumo_hmdp.study.versions import write_versions

SPEEDS = {"slow": {"ego.speed_mps": 20.0}, "fast": {"ego.speed_mps": 30.0}}
MADE_WITH = machine.versions("constant")


@pytest.fixture
def study(tmp_path):
    """Write a study file and what its command would leave, with rows whose speed is that of the ego's start."""
    out = tmp_path / "out"

    def write(pace=SPEEDS, seeds=(0, 1), name="pace", trace="none", status=RunStatus.COMPLETED, versions=MADE_WITH):
        file = tmp_path / "study.yaml"
        content = {"name": "changing", "scenarios": ["case2"], "seeds": list(seeds), "trace": trace}
        factors = {"planner": ["constant"], "duration_s": [0.6], name: pace}
        file.write_text(yaml.safe_dump(content | {"factors": factors}, sort_keys=False))
        design = load_design(file)
        asked = asked_of(design, design.seeds)
        with opened(out):
            finished = sweep(out)
            writer = Writer(out, design.cells)
            writer.describe_cells()
            left, told = take_back(out, finished, asked, retry_failed=False)
            said = [*told, *changes(out, left, asked)]
            write_asked(out, asked)
            for cell in design.cells:
                for seed in seeds:
                    run_id = cell.run_id(seed)
                    if run_id not in left.run_ids:
                        row = run_facts(cell.ready, run_id, status, "") | {
                            "seed": seed, "speed_mean_mps": cell.ready.episode.ego.speed, "contact_count": 0,
                            "trace": trace, "versions_hash": write_versions(out, versions), "trace_hash": "0",
                        }  # fmt: skip
                        writer.add(RunTables(cell.id, row))
            writer.flush()
        return out, design, said

    return write


def speeds(folder, factor="pace"):
    runs = sumo_hmdp.load(folder).runs
    return {level: set(some) for level, some in runs.groupby(factor)["speed_mean_mps"]}


def test_levels_that_exchange_their_names_exchange_them_for_old_runs_too(study):
    out, _, _ = study()
    assert speeds(out) == {"slow": {20.0}, "fast": {30.0}}
    study({"slow": SPEEDS["fast"], "fast": SPEEDS["slow"]}, seeds=range(8))
    assert speeds(out) == {"slow": {30.0}, "fast": {20.0}}
    found = compare_study(out, ["speed_mean_mps"])
    assert dict(zip(found.means["cell"], found.means["mean"], strict=True)) == {"pace=fast": 20.0, "pace=slow": 30.0}
    assert {cell.context for cell in read_study(out).cells} == {"pace=fast", "pace=slow"}


def test_renamed_levels_and_factors_leave_no_column_behind(study):
    study()
    out, design, said = study({"walk": SPEEDS["slow"], "run": SPEEDS["fast"]}, name="gait", seeds=range(3))
    assert said == []
    runs = sumo_hmdp.load(out).runs
    assert "pace" not in runs
    assert speeds(out, "gait") == {"walk": {20.0}, "run": {30.0}}
    assert [len(cell.manifest["factors"]) for cell in read_study(out).cells] == [3, 3]
    assert runs["cell"].nunique() == len(design.cells)


def test_fewer_seeds_and_levels_are_what_everybody_reads(study):
    study(seeds=range(10))
    out, design, said = study({"slow": SPEEDS["slow"]}, seeds=range(3))
    (line,) = said
    gone = "left out, for the study does not ask for them at present: 10 runs of 1 cell ("
    assert line.startswith(gone)
    assert line.endswith(" and 7 runs of 7 seeds (3, 4, 5, ...)")
    with pytest.warns(UserWarning, match="left out"):
        assert len(sumo_hmdp.load(out).runs) == 3
    data = read_study(out)
    assert (len(data.runs), len(data.cells), data.notes) == (3, 1, (line,))
    assert line in compare_study(out, ["speed_mean_mps"]).notes
    assert len(store.load(out, everything=True).runs) == 20
    # The labels of the cell that is gone are those that it had.
    assert set(store.load(out, everything=True).runs["pace"]) == {"slow", "fast"}
    assert study_hash(out, frozenset(data.runs["run_id"])) != study_hash(out, sweep(out).run_ids)
    assert [cell.id for cell in data.cells] == [cell.id for cell in design.cells]


def test_more_detail_is_done_again_and_less_is_kept(study):
    study()
    out, _, said = study(trace="all")
    assert said == ["4 runs with `trace: none` are done again with `trace: all`"]
    assert set(sumo_hmdp.load(out).runs["trace"]) == {"all"}
    _, _, said = study(trace="ego")
    assert said[0].startswith("4 runs keep what `trace: all` stored, more than `trace: ego` asks for")
    assert set(sumo_hmdp.load(out).runs["trace"]) == {"all"}


def test_runs_that_were_lost_are_done_again_on_demand(study):
    out, design, _ = study(status=RunStatus.CRASHED)
    asked, names = asked_of(design, design.seeds), {cell.run_id(seed) for cell in design.cells for seed in (0, 1)}
    finished, told = take_back(out, sweep(out), asked, retry_failed=False)
    assert (finished.run_ids, told) == (names, ("4 runs did not end well and are not done again; --retry-failed does",))
    finished, told = take_back(out, finished, asked, retry_failed=True)
    assert (finished.run_ids, told) == (set(), ("4 runs that did not end well are done again",))
    assert sweep(out).run_ids == set()
    assert [Ledger(out).attempts(name) for name in names] == [0] * 4


def test_runs_that_are_done_again_do_not_overwrite_a_file_of_the_same_name(study):
    out, design, _ = study(seeds=(0,))
    study(seeds=(0, 1))
    cell = design.cells[0]
    # The first run's file has taken another one in.
    first, second = (file for file in store.run_files(out) if store.cell_of(file) == cell.id)
    rows = pd.concat([read_table(out / "runs" / file) for file in (first, second)])
    named = first if cell.run_id(0) in set(read_table(out / "runs" / first)["run_id"]) else second
    write_parquet(out / "runs" / named, rows[rows["seed"] == 1], 1)
    for table in store.TABLES:
        (out / table / (second if named == first else first)).unlink()
    study(seeds=(0, 1))
    assert len(sumo_hmdp.load(out).runs) == 4


def test_runs_that_stand_twice_are_refused_and_set_aside(study):
    out, _, _ = study()
    file = out / "runs" / store.run_files(out)[0]
    for table in store.TABLES:
        shutil.copy(out / table / store.run_files(out)[0], out / table / file.parent.name / "zz.parquet")
    with pytest.raises(DamagedFileError, match=r"zz.parquet: must hold runs of its own, got .* has\. Delete it"):
        sumo_hmdp.load(out)
    (line,) = sweep(out).damaged
    assert "zz.parquet: must hold runs of its own" in line
    assert len(sumo_hmdp.load(out).runs) == 4


@pytest.mark.parametrize("name", ["../../../tmp/x", "a/b", "\0", "", "other-seed0"])
def test_stored_names_are_checked_before_they_name_files(study, tmp_path, name):
    out, _, _ = study()
    part = store.run_files(out)[0]
    rows = read_table(out / "runs" / part)
    write_parquet(out / "runs" / part, rows.assign(run_id=[name, *rows["run_id"][1:]]), len(rows))
    with pytest.raises(DamagedFileError, match="must hold the run"):
        sumo_hmdp.load(out)
    assert len(sweep(out).damaged) == 1
    # Of a single run the file's own name counts.
    write_parquet(tmp_path / "single" / "runs" / "a.parquet", pd.DataFrame({"run_id": [name]}))
    with pytest.raises(DamagedFileError, match="must hold the run 'a'"):
        sumo_hmdp.load(tmp_path / "single")


@pytest.mark.parametrize("place", ["runs", "steps", "cells", "study.json", "ledger.jsonl"])
def test_what_the_system_does_not_give_out_is_not_damaged(study, monkeypatch, place):
    out, _, _ = study()
    Ledger(out).ask_again(["a"], "")
    before = sorted(str(path) for path in out.rglob("*"))
    real = files.Path.read_bytes

    def refuse(path):
        if place in str(path):
            raise PermissionError(13, "Permission denied", str(path))
        return real(path)

    monkeypatch.setattr(files.Path, "read_bytes", refuse)
    with pytest.raises(InputError, match=r"cannot be read: Permission denied\. Nothing was changed") as caught:
        sweep(out)
    assert not isinstance(caught.value, DamagedFileError)
    assert sorted(str(path) for path in out.rglob("*")) == before


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_a_folder_that_may_not_be_read_is_not_taken_for_empty(study):
    out, _, _ = study()
    folder = next((out / "runs").glob("cell=*"))
    folder.chmod(0)
    try:
        with pytest.raises(InputError, match="Permission denied"):
            sweep(out)
    finally:
        folder.chmod(0o755)
    assert len(sweep(out).run_ids) == 4


@pytest.mark.parametrize("make", [lambda lock: lock.mkdir(), lambda lock: lock.write_text("another")])
def test_a_foreign_lock_is_one_line(tmp_path, make):
    make(tmp_path / ".lock")
    if (tmp_path / ".lock").is_dir():
        with pytest.raises(InputError, match=r"must be a file, got a directory"), opened(tmp_path):
            pass
    else:
        with opened(tmp_path):
            assert (tmp_path / ".lock").read_text() == "another"


def test_other_versions_are_named_in_resumed_and_mixed_studies(study):
    study(versions={"sumo_hmdp": "0.1.0", "sumo_hmdp_source": "aaaa", "cpu": "a"})
    out, _, said = study(seeds=range(3), versions={"sumo_hmdp": "0.1.0", "sumo_hmdp_source": "bbbb", "cpu": "a"})
    (line,) = said
    assert line.startswith("4 runs of constant had other versions than those to come: ")
    assert "sumo_hmdp_source aaaa, now " in line
    with pytest.warns(UserWarning, match="made with different versions") as warned:
        sumo_hmdp.load(out)
    expected = "made with different versions: sumo_hmdp_source aaaa (4 runs), bbbb (2 runs)"
    assert str(warned[0].message) == expected
    assert read_study(out).notes == (expected,)
    assert compare_study(out, ["speed_mean_mps"]).notes[0] == expected
    # The hash is of what was driven, not of the machine.
    names = frozenset(read_study(out).runs["run_id"])
    before = study_hash(out, names)
    part = store.run_files(out)[0]
    rows = read_table(out / "runs" / part)
    write_parquet(
        out / "runs" / part, rows.assign(versions_hash=rows["versions_hash"].iloc[-1], trace="all"), len(rows)
    )
    assert study_hash(out, names) == before


def test_the_kept_file_runs_from_where_it_is_kept(tmp_path):
    (tmp_path / "in").mkdir()
    shutil.copy(store.Path(__file__).parents[3] / "scenarios" / "case3.yaml", tmp_path / "in" / "my scene.yaml")
    file = tmp_path / "in" / "study.yaml"
    text = "# mine\nname: a\nscenarios: [my scene.yaml, 'case2']  # two\nseeds: {count: 1}\n"
    file.write_text(text)
    kept = tmp_path / "out" / "study.yaml"
    kept.parent.mkdir()
    kept.write_text(kept_text(file, "search"))
    path = tmp_path / "in" / "my scene.yaml"
    assert kept.read_text() == text.replace("my scene.yaml", str(path)) + "solver: search\n"
    assert [c.id for c in load_design(kept).cells] == [c.id for c in load_design(file, "search").cells]
    # What needs no change keeps its bytes; what cannot be changed in place is written anew.
    file.write_text("name: a\nscenarios: [case2]\nseeds: {count: 1}\n")
    assert kept_text(file, None) == file.read_text()
    file.write_text("name: a\nscenarios: [&x my scene.yaml]\ndescription: *x\nseeds: {count: 1}\n")
    assert yaml.safe_load(kept_text(file, None))["scenarios"] == [str(path)]
    assert yaml.safe_load(kept_text(file, None))["description"] == "my scene.yaml"


def test_other_tools_join_the_labels_themselves(study):
    out, _, _ = study()
    query = f"""
        SELECT c.factors.pace AS pace, avg(speed_mean_mps) FROM read_parquet('{out}/runs/*/*.parquet', hive_partitioning = true) r
        JOIN (SELECT unnest(cells) AS c FROM read_json('{out}/study.json')) ON r.cell = c.cell GROUP BY ALL
    """  # noqa: S608, E501 - our own folder; as the documentation has it
    assert dict(duckdb.sql(query).fetchall()) == {"slow": 20.0, "fast": 30.0}


def test_any_change_of_a_description_is_noticed(study):
    out, design, _ = study()
    path = store.cell_path(out, design.cells[0].id)
    content = json.loads(path.read_text())
    path.write_text(json.dumps(content | {"planner": "other"}))
    with pytest.raises(DamagedFileError, match=r"must be as it was written"):
        sumo_hmdp.load(out)
    assert str(path) in "".join(sweep(out).damaged)
    assert study()[2] == []
    assert sumo_hmdp.load(out).manifests[design.cells[0].run_id(0)]["planner"] == "constant"
