"""Results on disk: where everything stands, and reading it back."""

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from sumo_hmdp.errors import InputError
from sumo_hmdp.study.asked import Asked, read_asked
from sumo_hmdp.study.files import DamagedFileError, names_in, read_sealed, whole, write_text
from sumo_hmdp.study.tables import TABLE_REMEDY, checked_names, read_table, read_with_count, write_parquet
from sumo_hmdp.study.versions import mixture, read_versions

__all__ = ["Results", "load", "read_table", "whole", "write_text"]

SCHEMA_VERSION = 1
TABLES = ("runs", "decisions", "steps")
# What is read of a cell's description; the rest is for people.
CELL_KEYS = {"cell": str, "scenario": str, "planner": str, "solver": str, "factors": dict, "document": dict,
             "configuration": dict, "parameters": dict, "versions": dict}  # fmt: skip


@dataclass(frozen=True)
class Results:
    """The tables of a results directory.

    Attributes:
        runs: one row a run.
        decisions: one row a decision.
        steps: one row per vehicle and instant.
        manifests: by run id, configuration, versions and trace hash.
        notes: what a reader must know: what was left out, and whether versions differ.
    """

    runs: pd.DataFrame
    decisions: pd.DataFrame
    steps: pd.DataFrame
    manifests: Mapping[str, Mapping[str, Any]]
    notes: tuple[str, ...] = ()


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


def cell_path(folder: Path, cell: str) -> Path:
    """Return where a study's store says what a cell is."""
    return folder / "cells" / f"{cell}.json"


def write_table(folder: Path, table: str, run_id: str, frame: pd.DataFrame) -> None:
    """Write one table of one run whole or not at all."""
    write_parquet(table_path(folder, table, run_id), frame)


def write_manifest(folder: Path, run_id: str, manifest: Mapping[str, Any]) -> None:
    """Write the manifest of one run."""
    write_text(manifest_path(folder, run_id), json.dumps(manifest, indent=1, default=str) + "\n")


def read_manifest(folder: Path, run_id: str) -> dict[str, Any]:
    """Read the manifest of one run.

    Raises:
        DamagedFileError: if it is no JSON object.
        InputError: if the system does not give it out.
    """
    return read_sealed(manifest_path(folder, run_id), {}, sealed=False)


def json_names(folder: Path) -> list[str]:
    """Return the JSON files in a folder, without those that were set aside."""
    return [name for name in names_in(folder) if name.endswith(".json") and not name.startswith(".")]


def read_cell(folder: Path, cell: str) -> dict[str, Any]:
    """Read what a cell of a study is.

    Raises:
        DamagedFileError: if the file is not what was written.
        InputError: if the system does not give it out.
    """
    content = read_sealed(cell_path(folder, cell), CELL_KEYS, sealed=False)
    if content["cell"] != cell:
        raise DamagedFileError(cell_path(folder, cell), f"must be of the cell {cell!r}, got {content['cell']!r}")
    return content


def run_files(folder: Path) -> list[Path]:
    """Return the files of the table `runs`, below it: of single runs, and of a study's cells.

    Raises:
        InputError: if the system does not say what a folder holds.
    """
    names = names_in(folder / "runs")
    single = [Path(name) for name in names if name.endswith(".parquet") and not name.startswith(".")]
    return single + [
        Path(cell, name)
        for cell in names
        if cell.startswith("cell=")
        for name in names_in(folder / "runs" / cell)
        if name.endswith(".parquet") and not name.startswith(".")
    ]


def cell_of(file: Path) -> str | None:
    """Return the study cell whose runs a file holds, None for a single run."""
    return file.parent.name.removeprefix("cell=") or None


def read_runs(folder: Path) -> Iterator[tuple[Path, pd.DataFrame]]:
    """Yield every file of `runs` with its rows, whose names are checked and which have their `cell`.

    Raises:
        DamagedFileError: if a file is not what was written, or has runs that another one has.
        InputError: if the system does not give it out.
    """
    known: dict[str, Path] = {}
    for file in run_files(folder):
        path, cell = folder / "runs" / file, cell_of(file)
        rows = checked_names(read_table(path), path, cell)
        twice = next((name for name in rows["run_id"] if name in known), None)
        if twice is not None:
            raise DamagedFileError(
                path, f"must hold runs of its own, got {twice}, which {known[twice]} has", TABLE_REMEDY
            )
        known |= dict.fromkeys(rows["run_id"], file)
        yield file, rows if cell is None else rows.assign(cell=cell)


def load(folder: str | Path, *, everything: bool = False) -> Results:
    """Read a results directory, of single runs or of a study.

    Of a study the runs that its study file asks for at present, with its labels; `notes` says in one line what else is
    there. What stands there of a run without a row in `runs`, one that was killed, is left out.

    Args:
        folder: as given to `--out`.
        everything: return what a study no longer asks for as well, under the labels that it had.

    Returns:
        The tables `runs`, `decisions` and `steps` of all its runs as pandas frames, and the manifests. The runs of a
        study have their cell and a column for each factor.

    Raises:
        DamagedFileError: if a file is not what was written.
        InputError: if there are no results, or the system does not give them out.
    """
    folder = Path(folder)
    if "runs" not in names_in(folder):
        raise InputError([f"{folder} must be a results directory (with a folder `runs`); give the one named by --out"])
    asked = read_asked(folder)
    found = list(read_runs(folder))
    runs = _together([rows for _, rows in found])
    notes: tuple[str, ...] = ()
    kept = dict(found)
    if asked is not None and not everything and len(runs):
        notes = asked.left_out(runs)
        kept = {file: rows[asked.holds(rows)] for file, rows in found}
        runs = _together(list(kept.values()))
    tables = [
        _together([_rows(folder, table, file, kept[file], len(rows)) for file, rows in found if len(kept[file])])
        for table in ("decisions", "steps")
    ]
    cells = _cells(folder, runs, asked)
    runs = _with_factors(runs, cells)
    manifests = _manifests(folder, runs, cells)
    return Results(runs, tables[0], tables[1], manifests, (*notes, *_mixed(runs, manifests)))


def _rows(folder: Path, table: str, file: Path, runs: pd.DataFrame, run_count: int) -> pd.DataFrame:
    """Return the rows of some runs of a file, without those of runs that its file in `runs` does not have.

    Such rows are there for an instant while a file takes more runs in, and stay if the process is killed in it.
    """
    path, cell = folder / table / file, cell_of(file)
    if not path.exists() and (cell is None or not (folder / table).exists()):
        return pd.DataFrame()
    frame, count = read_with_count(path)
    if cell is not None and not (count == run_count == len(runs)):
        frame = frame[frame["run_id"].isin(runs["run_id"])]
    return frame if cell is None else frame.assign(cell=cell)


def _together(parts: Sequence[pd.DataFrame]) -> pd.DataFrame:
    # Empty parts would change the columns' types.
    filled = [part for part in parts if len(part)] or list(parts[:1])
    return pd.concat(filled, ignore_index=True) if filled else pd.DataFrame()


def _cells(folder: Path, runs: pd.DataFrame, asked: Asked | None) -> dict[str, dict[str, Any]]:
    """Return what the cells of runs are, with the labels that the study file gives them at present."""
    cells: dict[str, dict[str, Any]] = {}
    for cell in dict.fromkeys(runs["cell"]) if "cell" in runs else ():
        content = read_cell(folder, cell) if cell_path(folder, cell).exists() else {}
        labels = asked.cells.get(cell) if asked is not None else None
        if not content and labels is None and "factors_json" in runs:
            # Of before labels had a file of their own.
            labels = json.loads(runs["factors_json"][runs["cell"] == cell].iloc[0])
        cells[cell] = content if labels is None else content | {"factors": dict(labels)}
    return cells


def _with_factors(runs: pd.DataFrame, cells: Mapping[str, Mapping[str, Any]]) -> pd.DataFrame:
    """Add a column for each factor; one that has a measured column's name, such as `duration_s`, as `factors.NAME`."""
    if "cell" not in runs:
        return runs
    runs = runs.drop(columns="factors_json", errors="ignore")
    labels = {cell: content.get("factors", {}) for cell, content in cells.items()}
    names = dict.fromkeys(
        name for values in labels.values() for name in values if name not in {"planner", "solver", "risk_level"}
    )
    of_run = runs["cell"].tolist()
    texts = {cell: json.dumps(values, sort_keys=True) for cell, values in labels.items()}
    columns: dict[str, list[Any]] = {"factors_json": [texts[cell] for cell in of_run]}
    for name in names:
        columns[f"factors.{name}" if name in runs else name] = [labels[cell].get(name) for cell in of_run]
    return pd.concat([runs, pd.DataFrame(columns, index=runs.index)], axis=1)


def _manifests(
    folder: Path, runs: pd.DataFrame, cells: Mapping[str, Mapping[str, Any]]
) -> dict[str, Mapping[str, Any]]:
    manifests: dict[str, Mapping[str, Any]] = {}
    versions: dict[object, dict[str, Any]] = {}
    for row in runs.to_dict("records"):
        run_id = str(row["run_id"])
        content = cells.get(str(row.get("cell")))
        if content:
            name = row.get("versions_hash")
            if name not in versions:
                versions[name] = read_versions(folder, name)
            own = {"versions": versions[name]} if versions[name] else {}
            of_run = {key: row[key] for key in ("run_id", "seed", "status", "reason", "trace_hash")}
            manifests[run_id] = {**content, **own, **of_run}
        elif "cell" not in row and manifest_path(folder, run_id).exists():
            manifests[run_id] = read_manifest(folder, run_id)
    return manifests


def _mixed(runs: pd.DataFrame, manifests: Mapping[str, Mapping[str, Any]]) -> tuple[str, ...]:
    """Return one line if runs were made with different versions."""
    if "versions_hash" not in runs:
        return ()
    counts = runs.groupby(["planner", "versions_hash"])["run_id"].agg(["first", "size"])
    versions = [dict(manifests.get(str(first), {}).get("versions", {})) for first in counts["first"]]
    sizes = [int(size) for size in counts["size"]]
    packages: dict[str, list[tuple[dict[str, str], int]]] = {}
    for planner, one, size in zip(counts.index.get_level_values("planner"), versions, sizes, strict=True):
        # Planners come from different packages; that is a difference only between runs of one planner.
        package = {key: one.pop(key) for key in ("planner_package",) if key in one}
        packages.setdefault(str(planner), []).append((package, size))
    told = [mixture(zip(versions, sizes, strict=True)), *(mixture(of_planner) for of_planner in packages.values())]
    words = "; ".join(line for line in told if line)
    return (f"made with different versions: {words}",) if words else ()
