"""The store of a study: readable whatever happened to it, by pandas and by Arrow, and never with half a run."""

import shutil

import duckdb
import pandas as pd
import pytest
from pyarrow import dataset, parquet

import sumo_hmdp
from sumo_hmdp.errors import InputError, SumoHmdpError
from sumo_hmdp.study import parts
from sumo_hmdp.study.files import whole
from sumo_hmdp.study.parts import RunTables, Writer, opened, study_hash
from sumo_hmdp.study.record import tables_hash
from sumo_hmdp.study.recovery import sweep
from sumo_hmdp.study.store import TABLES, writable_folder, write_table


def breaking(monkeypatch, broken, error):
    """Let the writing of one table break off in the middle of its file."""
    real = parts.write_parquet

    def write(path, *content):
        if f"/{broken}/" in str(path):
            with whole(path) as partial:
                partial.write_bytes(b"PAR1 and no more")
                raise error
        real(path, *content)

    monkeypatch.setattr(parts, "write_parquet", write)


class KilledError(BaseException):
    """The process is gone."""


@pytest.fixture
def filled(tiny, tables, tmp_path):
    """Write a store: of each cell two batches, of seeds 0 and 1, and of seed 2."""

    def fill(name="out", batches=((0, 1), (2,))):
        folder = tmp_path / name
        with opened(folder):
            writer = Writer(folder, tiny.cells)
            writer.describe_cells()
            for seeds in batches:
                for cell in tiny.cells:
                    for seed in seeds:
                        writer.add(tables(cell, seed))
                writer.flush()
            assert writer.waiting == 0
        return folder

    return fill


def test_everything_comes_back_in_one_line(filled, tiny):
    results = sumo_hmdp.load(filled())
    assert len(results.runs) == 12
    assert set(results.runs["cell"]) == {cell.id for cell in tiny.cells}
    assert set(results.runs["run_id"]) == {cell.run_id(seed) for cell in tiny.cells for seed in range(3)}
    # Planner is a column of its own already; the other factors are added.
    assert results.runs.groupby("planner")["ego.speed_mps"].unique().map(sorted).to_dict() == {
        "hmdp_mpc": [29.0, 30.0], "idm_mobil": [29.0, 30.0],
    }  # fmt: skip
    # A run that ends early is shorter than its factor says.
    assert results.runs["factors.duration_s"].tolist() == [1.2] * 12
    for frame in (results.decisions, results.steps):
        assert set(frame["run_id"]) == set(results.runs["run_id"])
        assert not frame.duplicated(["run_id", *({"step", "vehicle_id", "decision_index"} & set(frame))]).any()
    manifest = results.manifests[tiny.cells[1].run_id(2)]
    assert (manifest["seed"], manifest["factors"]["ego.speed_mps"]) == (2, 30.0)
    assert manifest["configuration"]["ego"]["speed_mps"] == 30.0


def test_other_tools_read_the_folders_as_they_are(filled, tiny):
    folder = filled()
    expected = {"runs": 12, "decisions": len(sumo_hmdp.load(folder).decisions), "steps": 12 * 9 * 5}
    for table in TABLES:
        found = dataset.dataset(folder / table, format="parquet", partitioning="hive")
        assert found.count_rows() == expected[table]
        one = found.to_table(filter=dataset.field("cell") == tiny.cells[0].id).to_pandas()
        assert set(one["run_id"]) == {tiny.cells[0].run_id(seed) for seed in range(3)}
        frame = pd.read_parquet(folder / table)
        assert len(frame) == expected[table]


def test_duckdb_reads_the_folders(filled, tiny):
    folder = filled()
    runs = duckdb.read_parquet(f"{folder}/runs/*/*.parquet", hive_partitioning=True)
    rows = runs.aggregate("cell, count(*)").fetchall()
    assert sorted(rows) == sorted((cell.id, 3) for cell in tiny.cells)
    for table in TABLES:
        found = duckdb.read_parquet(f"{folder}/{table}/**/*.parquet", hive_partitioning=True)
        assert len(found) == len(pd.read_parquet(folder / table))
        assert "NULL" not in [str(kind).strip('"') for kind in found.types]


def test_polars_reads_the_folders_where_it_is_installed(filled, tiny):
    polars = pytest.importorskip("polars")
    folder = filled()
    for table in TABLES:
        frame = polars.scan_parquet(f"{folder}/{table}/**/*.parquet", hive_partitioning=True).collect()
        assert frame["cell"].n_unique() == len(tiny.cells)
        assert polars.Null not in frame.dtypes


def test_runs_without_tables_leave_rows(tiny, tmp_path):
    """Beside a run that was killed, whose counts are missing and not zero."""
    cell = tiny.cells[0]
    with opened(tmp_path):
        writer = Writer(tmp_path, tiny.cells)
        row = {"run_id": cell.run_id(0), "scenario": "case2", "planner": "p", "solver": "s", "seed": 0,
               "status": "crashed", "reason": "signal 9", "reproducible": True}  # fmt: skip
        writer.add(RunTables(cell.id, row, traceback="Fatal error"))
        writer.flush()
    results = sumo_hmdp.load(tmp_path)
    assert results.runs["status"].tolist() == ["crashed"]
    assert results.runs["contact_count"].isna().all()
    assert (len(results.steps), len(results.decisions)) == (0, 0)
    assert (tmp_path / "failures" / f"{cell.run_id(0)}.txt").read_text() == "Fatal error"


@pytest.mark.parametrize("growing", [False, True])
@pytest.mark.parametrize("broken", parts.COLUMNS)
def test_a_run_counts_from_its_row_on(tiny, tables, tmp_path, monkeypatch, broken, growing):
    """Killed while each of the three files is written, into a new file or one that takes more runs in."""
    writer = Writer(tmp_path, tiny.cells)
    for seed in (0, 1):
        writer.add(tables(tiny.cells[0], seed))
    writer.flush()
    before = sumo_hmdp.load(tmp_path)
    with monkeypatch.context() as patch:
        breaking(patch, broken, KilledError())
        writer = writer if growing else Writer(tmp_path, tiny.cells)
        writer.add(tables(tiny.cells[0], 2))
        with pytest.raises(KilledError):
            writer.flush()
    after = sumo_hmdp.load(tmp_path)
    for table in TABLES:
        pd.testing.assert_frame_equal(getattr(after, table), getattr(before, table))
    # Some of the new run is there, unless it was the first file that broke; a reader of the whole folder sees it.
    written = [t for t in TABLES if tiny.cells[0].run_id(2) in set(pd.read_parquet(tmp_path / t)["run_id"])]
    assert written == [t for t in TABLES if list(parts.COLUMNS).index(t) < list(parts.COLUMNS).index(broken)]
    assert list(tmp_path.rglob("*.partial")) != []
    assert sweep(tmp_path).run_ids == set(before.runs["run_id"])
    assert list(tmp_path.rglob("*.partial")) == []
    for table in TABLES:
        found = pd.read_parquet(tmp_path / table)
        assert len(found) == len(getattr(before, table))
        assert set(found["run_id"]) == set(before.runs["run_id"])


@pytest.mark.parametrize("growing", [False, True])
@pytest.mark.parametrize("broken", parts.COLUMNS)
def test_a_full_disk_leaves_what_was_there(tiny, tables, tmp_path, monkeypatch, broken, growing):
    writable_folder(tmp_path)
    writer = Writer(tmp_path, tiny.cells)
    if growing:
        writer.add(tables(tiny.cells[0], 0))
        writer.flush()
    writer.add(tables(tiny.cells[0], 2))
    with monkeypatch.context() as patch:
        breaking(patch, broken, OSError(28, "No space left on device"))
        with pytest.raises(SumoHmdpError, match=r"No space left on device.*make room and start again"):
            writer.flush()
    assert list(tmp_path.rglob("*.partial")) == []
    assert len(sumo_hmdp.load(tmp_path).runs) == growing
    # What could not be written still waits, and what was written of it is not there twice.
    writer.flush()
    assert len(sumo_hmdp.load(tmp_path).runs) == 1 + growing
    for table in TABLES:
        assert not pd.read_parquet(tmp_path / table).astype(str).duplicated().any()


def test_a_file_takes_runs_in_until_it_is_large_enough(tiny, tables, tmp_path, monkeypatch):
    monkeypatch.setattr(parts, "RUNS_PER_FILE", 3)
    writer = Writer(tmp_path, tiny.cells)
    for seed in range(7):
        writer.add(tables(tiny.cells[0], seed))
        writer.flush()
    files = [parquet.ParquetFile(file) for file in (tmp_path / "runs").glob("*/*.parquet")]
    assert sorted(file.metadata.num_rows for file in files) == [1, 3, 3]
    for table in TABLES:
        assert len(list((tmp_path / table).glob("*/*.parquet"))) == 3
    everything = frozenset(tiny.cells[0].run_id(seed) for seed in range(7))
    assert sweep(tmp_path).run_ids == everything
    assert set(sumo_hmdp.load(tmp_path).decisions["run_id"]) == everything
    # A file of many steps is large enough sooner.
    monkeypatch.setattr(parts, "BYTES_PER_FILE", 1)
    writer = Writer(tmp_path / "large", tiny.cells)
    for seed in range(2):
        writer.add(tables(tiny.cells[0], seed))
        writer.flush()
    assert len(list((tmp_path / "large" / "runs").glob("*/*.parquet"))) == 2


def damage(file):
    """Flip the last bytes of a column's values: the file's end, with its table of contents, stays as it was."""
    column = parquet.ParquetFile(file).metadata.row_group(0).column(0)
    end = (column.dictionary_page_offset or column.data_page_offset) + column.total_compressed_size
    content = bytearray(file.read_bytes())
    for at in range(end - 4, end):
        content[at] ^= 0xFF
    file.write_bytes(bytes(content))


@pytest.mark.parametrize("table", TABLES)
@pytest.mark.parametrize("how", [damage, lambda file: file.write_bytes(b"no Parquet"), lambda file: file.unlink()])
def test_a_damaged_file_is_named_and_its_runs_are_not_finished(filled, tiny, table, how):
    folder = filled()
    file = min((folder / table).glob("cell=*/*.parquet"))
    lost = set(pd.read_parquet(folder / "runs" / file.relative_to(folder / table))["run_id"])
    how(file)
    if file.exists():
        with pytest.raises(InputError, match=r"must be a whole Parquet file.*Delete it") as caught:
            sumo_hmdp.load(folder)
        assert str(file) in str(caught.value)
    everything = {cell.run_id(seed) for cell in tiny.cells for seed in range(3)}
    finished = sweep(folder)
    assert finished.run_ids == everything - lost
    if table != "runs" or file.exists():
        assert len(finished.damaged) == (0 if table == "runs" and not file.exists() else 1)
        assert str(file) in "".join(finished.damaged)
    assert len(sumo_hmdp.load(folder).runs) == 12 - len(lost)
    assert sweep(folder).damaged == ()


def test_the_hash_is_of_content_and_not_of_batches_or_clocks(filled, tiny, tables, tmp_path):
    everything = frozenset(cell.run_id(seed) for cell in tiny.cells for seed in range(3))
    one = study_hash(filled("one"), everything)
    assert study_hash(filled("two", batches=((2,), (1,), (0,))), everything) == one
    some = frozenset(list(everything)[:-1])
    assert study_hash(tmp_path / "one", some) != one
    folder = tmp_path / "three"
    changes = (("wall_time_s", 99.0, True), ("gap_min_m", 1.0, False), ("tables_hash", "other", False))
    for column, value, same in changes:
        with opened(folder):
            writer = Writer(folder, tiny.cells)
            for cell in tiny.cells:
                for seed in range(3):
                    table = tables(cell, seed)
                    writer.add(RunTables(cell.id, {**table.row, column: value}, table.steps, table.decisions))
            writer.flush()
        assert (study_hash(folder, everything) == one) is same
        shutil.rmtree(folder)


def test_the_hash_of_a_run_s_tables_is_of_their_rows_but_for_the_clock(tiny, tables):
    table = tables(tiny.cells[0], 0)
    whole = tables_hash(table.decisions, table.steps)
    assert tables_hash(table.decisions.assign(solve_time_ms=9.0), table.steps) == whole
    changed = [
        (table.decisions.assign(plan_json="{}"), table.steps), (table.decisions, table.steps.iloc[1:]),
        (table.decisions, table.steps.iloc[::-1]), (table.decisions.iloc[:0], table.steps),
        (table.steps, table.decisions), (table.decisions.assign(run_id="other"), table.steps),
    ]  # fmt: skip
    assert len({whole, *(tables_hash(*frames) for frames in changed)}) == 1 + len(changed)


def test_two_studies_do_not_share_a_folder(tmp_path):
    with opened(tmp_path), pytest.raises(InputError, match="must not be in use"), opened(tmp_path):
        pass
    with opened(tmp_path):
        pass


def test_single_runs_and_studies_do_not_share_a_folder(tmp_path):
    write_table(tmp_path, "runs", "a", pd.DataFrame({"run_id": ["a"]}))
    with pytest.raises(InputError, match="single runs"), opened(tmp_path):
        pass
