"""Tables on disk: Parquet files, each written whole or not at all, and reading them back."""

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from pyarrow import parquet
from pyarrow.lib import ArrowException

from sumo_hmdp.documents import read_json
from sumo_hmdp.errors import InputError

SCHEMA_VERSION = 1
TABLES = ("runs", "decisions", "steps")
# In the footer of a study's file: of how many runs it has rows.
RUN_COUNT = b"sumo_hmdp.run_count"


@dataclass(frozen=True)
class Results:
    """The tables of a results directory.

    Attributes:
        runs: one row a run.
        decisions: one row a decision.
        steps: one row per vehicle and instant.
        manifests: by run id, configuration, versions and trace hash.
    """

    runs: pd.DataFrame
    decisions: pd.DataFrame
    steps: pd.DataFrame
    manifests: Mapping[str, Mapping[str, Any]]


def writable_folder(path: Path) -> Path:
    """Make a results directory and make sure that it can be written.

    Raises:
        InputError: if it cannot.
    """
    try:
        for part in ("", *TABLES, "manifests"):
            (path / part).mkdir(parents=True, exist_ok=True)
        probe = path / f".probe-{os.getpid()}"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise InputError([f"--out: {path} must be a writable directory: {error.strerror}. Choose another"]) from None
    return path


def page_path(folder: Path, run_id: str) -> Path:
    """Return where the page of a run stands."""
    return folder / f"{run_id}.html"


def traceback_path(folder: Path, run_id: str) -> Path:
    """Return where the traceback of a failed run stands."""
    return folder / "failures" / f"{run_id}.txt"


def dispute_path(folder: Path, run_id: str) -> Path:
    """Return where the decision stands on which two solvers disagreed."""
    return folder / "failures" / f"{run_id}.json"


def decision_folder(folder: Path, run_id: str) -> Path:
    """Return where the decisions of a run stand as files."""
    return folder / "decision_files" / run_id


def discard(folder: Path, run_id: str) -> None:
    """Take away what an earlier run of the same name left, its row in `runs` first."""
    for table in TABLES:
        table_path(folder, table, run_id).unlink(missing_ok=True)
    manifest_path(folder, run_id).unlink(missing_ok=True)
    page_path(folder, run_id).unlink(missing_ok=True)
    traceback_path(folder, run_id).unlink(missing_ok=True)
    dispute_path(folder, run_id).unlink(missing_ok=True)
    for file in decision_folder(folder, run_id).glob("[0-9]*.json"):
        file.unlink()


def table_path(folder: Path, table: str, run_id: str) -> Path:
    """Return where one table of a run stands."""
    return folder / table / f"{run_id}.parquet"


def manifest_path(folder: Path, run_id: str) -> Path:
    """Return where the manifest of a run stands."""
    return folder / "manifests" / f"{run_id}.json"


def write_text(path: Path, text: str) -> None:
    """Write a file whole or not at all."""
    with whole(path) as partial:
        partial.write_text(text, encoding="utf-8")


def write_table(folder: Path, table: str, run_id: str, frame: pd.DataFrame) -> None:
    """Write one table of one run whole or not at all."""
    with whole(table_path(folder, table, run_id)) as partial:
        frame.to_parquet(partial, index=False)


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Give a name to write a file under, which gets its real name when it is complete and on the disk."""
    path.parent.mkdir(parents=True, exist_ok=True)
    # The dot and the ending keep readers of whole folders away from it.
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        yield partial
        with partial.open("rb") as file:
            os.fsync(file.fileno())
        partial.replace(path)
    except OSError:
        # On a full disk what was written is worth nothing and in the way.
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        raise


def write_manifest(folder: Path, run_id: str, manifest: Mapping[str, Any]) -> None:
    """Write the manifest of one run."""
    write_text(manifest_path(folder, run_id), json.dumps(manifest, indent=1, default=str) + "\n")


def read_table(file: Path) -> pd.DataFrame:
    """Read one file of a table.

    Raises:
        InputError: if it is damaged, with the remedy.
    """
    try:
        frame: pd.DataFrame = parquet.ParquetFile(file, page_checksum_verification=True).read().to_pandas()
    except (OSError, ArrowException) as error:
        raise _broken(file, error) from None
    return frame


def _broken(file: Path, error: Exception) -> InputError:
    remedy = "Delete it and start the run, or the study, again: its runs, and no others, are run again"
    return InputError([f"must be a whole Parquet file: {str(error).rstrip('.')}. {remedy}"], str(file))


def run_count(file: Path) -> int | None:
    """Return of how many runs a file of a study holds rows, from its footer alone; None where it does not say.

    Raises:
        InputError: if the file has no sound footer, such as one that was cut short.
    """
    try:
        metadata = parquet.read_schema(file).metadata or {}
    except (OSError, ArrowException) as error:
        raise _broken(file, error) from None
    return int(metadata[RUN_COUNT]) if RUN_COUNT in metadata else None


def read_vouched(folder: Path, table: str, file: Path) -> pd.DataFrame:
    """Read one file of a table without rows of runs that its file in `runs` does not have.

    Such rows are there for an instant while a file takes more runs in, and stay if the process is killed in it.

    Raises:
        InputError: if a file is damaged, with the remedy.
    """
    frame = read_table(folder / table / file)
    if table == "runs" or run_count(folder / table / file) == run_count(folder / "runs" / file):
        return frame
    return frame[frame["run_id"].isin(read_table(folder / "runs" / file)["run_id"])]


def load(folder: str | Path) -> Results:
    """Read a results directory, of single runs or of a study.

    What stands there of a run without a row in `runs`, one that was killed, is left out.

    Args:
        folder: as given to `--out`.

    Returns:
        The tables `runs`, `decisions` and `steps` of all its runs as pandas frames, and the manifests. The runs of a
        study have their cell and a column for each factor.

    Raises:
        InputError: if there are no results, or if a file is damaged.
    """
    folder = Path(folder)
    if not (folder / "runs").is_dir():
        raise InputError([f"{folder} must be a results directory (with a folder `runs`); give the one named by --out"])
    frames = {table: _joined(folder, table) for table in TABLES}
    frames["runs"] = _with_factors(frames["runs"])
    return Results(frames["runs"], frames["decisions"], frames["steps"], _manifests(folder, frames["runs"]))


def run_files(folder: Path) -> list[Path]:
    """Return the files of the table `runs`, below it: of single runs, and of a study's cells."""
    runs = folder / "runs"
    return [file.relative_to(runs) for file in sorted([*runs.glob("*.parquet"), *runs.glob("cell=*/*.parquet")])]


def cell_of(file: Path) -> str | None:
    """Return the study cell whose runs a file holds, None for a single run."""
    return file.parent.name.removeprefix("cell=") or None


def _joined(folder: Path, table: str) -> pd.DataFrame:
    parts = []
    for file in run_files(folder):
        path = folder / table / file
        if path.is_file():
            part = read_vouched(folder, table, file)
            cell = cell_of(file)
            parts.append(part if cell is None else part.assign(cell=cell))
    # Empty parts would change the columns' types.
    filled = [part for part in parts if len(part)] or parts[:1]
    return pd.concat(filled, ignore_index=True) if filled else pd.DataFrame()


def _with_factors(runs: pd.DataFrame) -> pd.DataFrame:
    """Add a column for each factor; one that has a measured column's name, such as `duration_s`, as `factors.NAME`."""
    if "factors_json" not in runs:
        return runs
    factors = [json.loads(text) if isinstance(text, str) else {} for text in runs["factors_json"]]
    names = dict.fromkeys(
        name for values in factors for name in values if name not in {"planner", "solver", "risk_level"}
    )
    columns = {
        f"factors.{name}" if name in runs else name: [values.get(name) for values in factors] for name in names
    }  # fmt: skip
    return pd.concat([runs, pd.DataFrame(columns, index=runs.index)], axis=1)


def _manifests(folder: Path, runs: pd.DataFrame) -> dict[str, Mapping[str, Any]]:
    cells = {file.stem: _read_json(file) for file in (folder / "cells").glob("*.json")}
    manifests: dict[str, Mapping[str, Any]] = {}
    for row in runs.to_dict("records"):
        run_id = row["run_id"]
        if row.get("cell") in cells:
            of_run = {key: row[key] for key in ("run_id", "seed", "status", "reason", "trace_hash")}
            manifests[run_id] = cells[row["cell"]] | of_run
        elif manifest_path(folder, run_id).is_file():
            manifests[run_id] = _read_json(manifest_path(folder, run_id))
    return manifests


def _read_json(file: Path) -> dict[str, Any]:
    content: dict[str, Any] = read_json(file).content
    return content
