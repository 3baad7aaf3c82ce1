"""The store of a study: Parquet folders partitioned by cell, which are readable at every instant.

Some runs of one cell are one file of the same name in each table, which takes more runs in until it is large enough.
The one in `runs` is replaced last and vouches for the others: rows of runs that it does not have do not count, and are
taken away when the study goes on.
"""

import fcntl
import hashlib
import json
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
from pyarrow import parquet

from sumo_hmdp.errors import InputError, SumoHmdpError
from sumo_hmdp.study.design import Cell
from sumo_hmdp.study.record import DECISION_COLUMNS, RUN_COLUMNS, STEP_COLUMNS, timeless
from sumo_hmdp.study.run import run_manifest
from sumo_hmdp.study.store import (
    RUN_COUNT,
    TABLES,
    cell_of,
    read_table,
    read_vouched,
    run_count,
    run_files,
    traceback_path,
    whole,
    writable_folder,
    write_text,
)

COLUMNS = {
    "steps": STEP_COLUMNS,
    "decisions": DECISION_COLUMNS,
    "runs": RUN_COLUMNS | {"tables_hash": "str", "factors_json": "str"},
}  # in the order of writing
# A file takes more runs in below both: few files to open, and little to write again for each batch.
RUNS_PER_FILE, BYTES_PER_FILE = 200, 8_000_000


@dataclass(frozen=True)
class RunTables:
    """What one run leaves in the store.

    Attributes:
        cell_id: its cell.
        row: its row of `runs`.
        steps: its rows of `steps`; None for none.
        decisions: its rows of `decisions`; None for none.
        traceback: why it failed, empty if it did not.
    """

    cell_id: str
    row: Mapping[str, Any]
    steps: pd.DataFrame | None = None
    decisions: pd.DataFrame | None = None
    traceback: str = ""


@dataclass(frozen=True)
class Finished:
    """What a store holds already.

    Attributes:
        rows: the rows of `runs` with their cells.
        damaged: what was found broken and put aside, for people.
    """

    rows: pd.DataFrame
    damaged: tuple[str, ...]

    @property
    def run_ids(self) -> frozenset[str]:
        """The names of the finished runs."""
        return frozenset(self.rows["run_id"])


@contextmanager
def opened(folder: Path) -> Iterator[Path]:
    """Make or open the store of a study and keep other studies out of it meanwhile.

    Raises:
        InputError: if it cannot be written, is in use, or holds single runs.
    """
    writable_folder(folder)
    if any(cell_of(file) is None for file in run_files(folder)):
        raise InputError([f"--out: {folder} must be empty or a study's, got one with single runs. Choose another"])
    with (folder / ".lock").open("w", encoding="utf-8") as lock:
        try:
            # The system lets go of it however the process ends.
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise InputError([f"--out: {folder} must not be in use by another study; wait for it to end"]) from None
        yield folder


def sweep(folder: Path) -> Finished:
    """Read what is finished; put damaged files aside and take away what no row of `runs` vouches for.

    Of `decisions` and `steps` only the footers are read, so that a large study goes on at once. Damage inside of them
    is found by whoever reads them.
    """
    damaged, rows = [], []
    for file in run_files(folder):
        try:
            runs = read_table(folder / "runs" / file)
            for table in ("steps", "decisions"):
                if run_count(folder / table / file) not in {None, len(runs)}:
                    _write_part(folder / table / file, read_vouched(folder, table, file), len(runs))
        except InputError as error:
            damaged.append(f"{error.lines()[0].split('. Delete')[0]}; put aside as .damaged, its runs are run again")
            for table in reversed(COLUMNS):
                path = folder / table / file
                if path.is_file():
                    path.replace(path.with_name(f".{path.name}.damaged"))
        else:
            rows.append(runs.assign(cell=cell_of(file)))
    vouched = {str(file) for file in run_files(folder)}
    for table in TABLES:
        for path in (folder / table).glob("cell=*/*"):
            unfinished = path.suffix == ".parquet" and str(path.relative_to(folder / table)) not in vouched
            if unfinished or path.suffix == ".partial":
                path.unlink()
    empty = pd.DataFrame(columns=list(COLUMNS["runs"])).astype(COLUMNS["runs"]).assign(cell="")
    return Finished(pd.concat(rows, ignore_index=True) if rows else empty, tuple(damaged))


class Writer:
    """The only writer of a store: gathers runs by cell and writes a batch of them at a time.

    Args:
        folder: the store.
        cells: by their names.
    """

    def __init__(self, folder: Path, cells: Iterable[Cell]) -> None:
        self._folder = folder
        self._cells = {cell.id: cell for cell in cells}
        self._waiting: dict[str, list[RunTables]] = defaultdict(list)
        self._growing: dict[str, Path] = {}

    def describe_cells(self) -> list[str]:
        """Write what each cell is; return in which cells the versions of the software are not those of before."""
        changed = []
        for cell in self._cells.values():
            path = self._folder / "cells" / f"{cell.id}.json"
            content = run_manifest(cell.ready) | {"cell": cell.id, "factors": cell.factors, "document": cell.document}
            if path.is_file():
                before = json.loads(path.read_text(encoding="utf-8"))
                if before["versions"] != content["versions"]:
                    changed.append(cell.id)
                    # What the finished runs were made with stays on record.
                    content["versions_before"] = [*before.get("versions_before", []), before["versions"]]
                else:
                    continue
            with disk():
                write_text(path, json.dumps(content, indent=1, default=str) + "\n")
        return changed

    def add(self, tables: RunTables) -> None:
        """Take a run; it is written with the next batch."""
        self._waiting[tables.cell_id].append(tables)

    @property
    def waiting(self) -> int:
        """How many runs are not written yet."""
        return sum(map(len, self._waiting.values()))

    def flush(self) -> None:
        """Write everything that waits.

        Raises:
            SumoHmdpError: if the disk takes no more; what is written already stays whole.
        """
        for cell_id, runs in list(self._waiting.items()):
            if runs:
                with disk():
                    self._write(cell_id, runs)
            del self._waiting[cell_id]

    def _write(self, cell_id: str, runs: list[RunTables]) -> None:
        runs = sorted(runs, key=lambda run: run.row["seed"])
        for run in runs:
            if run.traceback:
                write_text(traceback_path(self._folder, run.row["run_id"]), run.traceback)
        factors = json.dumps(dict(self._cells[cell_id].factors), sort_keys=True)
        rows = [{**run.row, "factors_json": factors} for run in runs]
        frames = {
            "steps": _joined([run.steps for run in runs], "steps"),
            "decisions": _joined([run.decisions for run in runs], "decisions"),
            "runs": pd.DataFrame(rows, columns=list(COLUMNS["runs"])).astype(COLUMNS["runs"]),
        }
        file, count = self._growing.get(cell_id), len(runs)
        if file is None:
            names = "\n".join(run.row["run_id"] for run in runs)
            file = Path(f"cell={cell_id}", f"{hashlib.sha256(names.encode()).hexdigest()[:16]}.parquet")
        elif (self._folder / "runs" / file).is_file():
            before = {table: read_vouched(self._folder, table, file) for table in COLUMNS}
            frames = {table: _joined([before[table], frame], table) for table, frame in frames.items()}
            count += len(before["runs"])
        self._growing[cell_id] = file
        for table in COLUMNS:
            _write_part(self._folder / table / file, frames[table], count)
        if count >= RUNS_PER_FILE or sum((self._folder / t / file).stat().st_size for t in TABLES) >= BYTES_PER_FILE:
            del self._growing[cell_id]


def _write_part(path: Path, frame: pd.DataFrame, run_count: int) -> None:
    table = pa.Table.from_pandas(frame, preserve_index=False)
    table = table.replace_schema_metadata({**table.schema.metadata, RUN_COUNT: str(run_count).encode()})
    with whole(path) as partial:
        parquet.write_table(table, partial, write_page_checksum=True)


def _joined(frames: list[pd.DataFrame | None], table: str) -> pd.DataFrame:
    filled = [frame for frame in frames if frame is not None and len(frame)]
    if filled:
        return pd.concat(filled, ignore_index=True)
    return pd.DataFrame(columns=list(COLUMNS[table])).astype(COLUMNS[table])


@contextmanager
def disk() -> Iterator[None]:
    """Turn a disk that takes no more into an error that says what to do."""
    try:
        yield
    except OSError as error:
        message = f"the results cannot be written: {error}. What was written is whole; make room and start again"
        raise SumoHmdpError(message) from error


def study_hash(folder: Path, run_ids: frozenset[str]) -> str:
    """Return a hash of everything in the tables of some runs that does not depend on the clock.

    Only `runs` is read: its column `tables_hash` stands for the rest.

    Args:
        folder: the store.
        run_ids: the runs.
    """
    lines = []
    for file in run_files(folder):
        frame = timeless(read_table(folder / "runs" / file))
        numbers = pd.util.hash_pandas_object(frame, index=False)
        lines += [f"{run_id} {n}" for run_id, n in zip(frame["run_id"], numbers, strict=True) if run_id in run_ids]
    return hashlib.sha256("\n".join(sorted(lines)).encode()).hexdigest()
