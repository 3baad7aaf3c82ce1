"""Tables on disk: one Parquet file per table and run, each written whole or not at all."""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from sumo_hmdp.errors import InputError

SCHEMA_VERSION = 1
TABLES = ("runs", "decisions", "steps")


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
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)


def write_table(folder: Path, table: str, run_id: str, frame: pd.DataFrame) -> None:
    """Write one table of one run whole or not at all."""
    path = table_path(folder, table, run_id)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    frame.to_parquet(partial, index=False)
    partial.replace(path)


def write_manifest(folder: Path, run_id: str, manifest: Mapping[str, Any]) -> None:
    """Write the manifest of one run."""
    write_text(manifest_path(folder, run_id), json.dumps(manifest, indent=1, default=str) + "\n")


def load(folder: str | Path) -> Results:
    """Read a results directory. What stands there of a run without a row in `runs`, one that was killed, is left out.

    Args:
        folder: as given to `--out`.

    Returns:
        The tables `runs`, `decisions` and `steps` of all its runs as pandas frames, and the manifests.

    Raises:
        InputError: if there are no results.
    """
    folder = Path(folder)
    if not (folder / "runs").is_dir():
        raise InputError([f"{folder} must be a results directory (with a folder `runs`); give the one named by --out"])
    run_ids = [file.stem for file in sorted((folder / "runs").glob("*.parquet"))]
    frames = {}
    for table in TABLES:
        files = [table_path(folder, table, run_id) for run_id in run_ids]
        parts = [pd.read_parquet(file) for file in files if file.is_file()]
        # Empty parts would change the columns' types.
        filled = [part for part in parts if len(part)] or parts[:1]
        frames[table] = pd.concat(filled, ignore_index=True) if filled else pd.DataFrame()
    manifests = {
        run_id: json.loads(manifest_path(folder, run_id).read_text(encoding="utf-8"))
        for run_id in run_ids
        if manifest_path(folder, run_id).is_file()
    }
    return Results(frames["runs"], frames["decisions"], frames["steps"], manifests)
