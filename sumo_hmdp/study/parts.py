"""Writing the store of a study: Parquet folders partitioned by cell, which are readable at every instant.

Some runs of one cell are one file of the same name in each table, which takes more runs in until it is large enough.
The one in `runs` is replaced last and vouches for the others: rows of runs that it does not have do not count, and are
taken away when the study goes on.
"""

import fcntl
import hashlib
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from sumo_hmdp.errors import InputError, SumoHmdpError
from sumo_hmdp.study.design import Cell
from sumo_hmdp.study.files import FULL, unreadable, write_sealed, write_text
from sumo_hmdp.study.record import DECISION_COLUMNS, RUN_COLUMNS, STEP_COLUMNS, timeless
from sumo_hmdp.study.run import run_manifest
from sumo_hmdp.study.store import (
    TABLES,
    cell_of,
    cell_path,
    read_cell,
    run_files,
    traceback_path,
    writable_folder,
)
from sumo_hmdp.study.tables import read_table, write_parquet
from sumo_hmdp.study.versions import Versions, write_versions

COLUMNS = {
    "steps": STEP_COLUMNS,
    "decisions": DECISION_COLUMNS,
    "runs": RUN_COLUMNS | {"tables_hash": "str", "trace": "str"},
}  # in the order of writing
# A file takes more runs in below both: few files to open, and little to write again for each batch.
RUNS_PER_FILE, BYTES_PER_FILE = 200, 8_000_000
# What says where and in how much detail a run was done, but not what came of it.
_NOT_HASHED = ("versions_hash", "trace")


@dataclass(frozen=True)
class RunTables:
    """What one run leaves in the store.

    Attributes:
        cell_id: its cell.
        row: its row of `runs`.
        steps: its rows of `steps`; None for none.
        decisions: its rows of `decisions`; None for none.
        traceback: why it failed, empty if it did not.
        versions: what it was made with; empty where that is not known.
    """

    cell_id: str
    row: Mapping[str, Any]
    steps: pd.DataFrame | None = None
    decisions: pd.DataFrame | None = None
    traceback: str = ""
    versions: Versions = field(default_factory=dict)


@contextmanager
def opened(folder: Path) -> Iterator[Path]:
    """Make or open the store of a study and keep other studies out of it meanwhile.

    Raises:
        InputError: if it cannot be written, is in use, or holds single runs.
    """
    writable_folder(folder)
    if any(cell_of(file) is None for file in run_files(folder)):
        raise InputError([f"--out: {folder} must be empty or a study's, got one with single runs. Choose another"])
    path = folder / ".lock"
    try:
        lock = path.open("a", encoding="utf-8")
    except IsADirectoryError:
        raise InputError(
            [f"--out: {path} must be a file, got a directory. Remove it, or choose another --out"]
        ) from None
    except OSError as error:
        raise unreadable(path, error) from None
    with lock:
        try:
            # The system lets go of it however the process ends.
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError([f"--out: {folder} must not be in use by another study; wait for it to end"]) from None
        except OSError as error:
            message = f"--out: {folder} must be on a disk with locks, got: {error.strerror}. Choose another"
            raise InputError([message]) from None
        yield folder


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

    def describe_cells(self) -> None:
        """Write what each cell is, where the store does not say so already."""
        for cell in self._cells.values():
            path = cell_path(self._folder, cell.id)
            content = run_manifest(cell.ready) | {"cell": cell.id, "factors": cell.factors, "document": cell.document}
            if path.exists():
                before = read_cell(self._folder, cell.id)
                # With which versions it was begun stays on record; each run has its own.
                content["versions"] = before["versions"]
                if before["factors"] == dict(cell.factors):
                    continue
            with disk():
                write_sealed(path, content)

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
        for versions in {id(run.versions): run.versions for run in runs if run.versions}.values():
            write_versions(self._folder, versions)
        rows = [dict(run.row) for run in runs]
        frames = {
            "steps": _joined([run.steps for run in runs], "steps"),
            "decisions": _joined([run.decisions for run in runs], "decisions"),
            "runs": pd.DataFrame(rows, columns=list(COLUMNS["runs"])).astype(COLUMNS["runs"]),
        }
        file, count = self._growing.get(cell_id), len(runs)
        if file is None:
            file = self._free_name(cell_id, "\n".join(run.row["run_id"] for run in runs))
        elif (self._folder / "runs" / file).is_file():
            before = self._vouched(file)
            frames = {table: _joined([before[table], frame], table) for table, frame in frames.items()}
            count += len(before["runs"])
        self._growing[cell_id] = file
        for table in COLUMNS:
            write_parquet(self._folder / table / file, frames[table], count)
        if count >= RUNS_PER_FILE or sum((self._folder / t / file).stat().st_size for t in TABLES) >= BYTES_PER_FILE:
            del self._growing[cell_id]

    def _free_name(self, cell_id: str, names: str) -> Path:
        """Return a name that no table has: a file of these first runs may be there, with others that it took in."""
        while True:
            names += "\n"
            file = Path(f"cell={cell_id}", f"{hashlib.sha256(names.encode()).hexdigest()[:16]}.parquet")
            if not any((self._folder / table / file).exists() for table in TABLES):
                return file

    def _vouched(self, file: Path) -> dict[str, pd.DataFrame]:
        """Return the rows of a file that this writer began; what a full disk left behind its row in `runs` is not."""
        frames = {table: read_table(self._folder / table / file) for table in COLUMNS}
        kept = frames["runs"]["run_id"]
        return {table: frame[frame["run_id"].isin(kept)] for table, frame in frames.items()}


def drop_runs(folder: Path, run_ids: Collection[str]) -> None:
    """Take runs out of a store, so that they are done again. Their rows in `runs`, which vouch for the rest, go first.

    Raises:
        SumoHmdpError: if the disk takes no more; then they count as finished still, or are gone.
    """
    with disk():
        for file in run_files(folder):
            runs = read_table(folder / "runs" / file)
            kept = runs[~runs["run_id"].isin(run_ids)]
            if len(kept) == len(runs):
                continue
            for table in reversed(COLUMNS):
                path = folder / table / file
                if kept.empty:
                    path.unlink(missing_ok=True)
                    continue
                frame = kept if table == "runs" else read_table(path)
                write_parquet(path, frame[frame["run_id"].isin(kept["run_id"])], len(kept))
            for name in set(runs["run_id"]) - set(kept["run_id"]):
                traceback_path(folder, name).unlink(missing_ok=True)


def _joined(frames: list[pd.DataFrame | None], table: str) -> pd.DataFrame:
    filled = [frame for frame in frames if frame is not None and len(frame)]
    if filled:
        return pd.concat(filled, ignore_index=True)
    return pd.DataFrame(columns=list(COLUMNS[table])).astype(COLUMNS[table])


@contextmanager
def disk() -> Iterator[None]:
    """Turn what the disk refuses into an error that says what to do."""
    try:
        yield
    except OSError as error:
        remedy = "make room" if error.errno in FULL else "correct that"
        message = f"the results cannot be written: {error}. What was written is whole; {remedy} and start again"
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
        frame = timeless(read_table(folder / "runs" / file)).drop(columns=list(_NOT_HASHED), errors="ignore")
        numbers = pd.util.hash_pandas_object(frame, index=False)
        lines += [f"{run_id} {n}" for run_id, n in zip(frame["run_id"], numbers, strict=True) if run_id in run_ids]
    return hashlib.sha256("\n".join(sorted(lines)).encode()).hexdigest()
