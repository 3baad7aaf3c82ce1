"""Doing a stored run again from what is stored of it, and comparing."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from sumo_hmdp.documents import Document, read_json
from sumo_hmdp.errors import InputError
from sumo_hmdp.scenario.load import RunOptions, assemble_scenario
from sumo_hmdp.study.run import execute, versions
from sumo_hmdp.study.store import cell_of, manifest_path, read_table, run_files
from sumo_hmdp.validation import nearest


@dataclass(frozen=True)
class Reproduction:
    """How a run compares with its repetition.

    Attributes:
        stored_hash: of the trace then.
        new_hash: of the trace now.
        difference: the first step at which the stored steps differ, in words; empty if none does or none are stored.
        versions: what of the software has another version now, in words.
    """

    stored_hash: str
    new_hash: str
    difference: str
    versions: tuple[str, ...]

    @property
    def same(self) -> bool:
        """Whether both runs are the same, bit for bit."""
        return self.stored_hash == self.new_hash


def reproduce(folder: Path, run_id: str) -> Reproduction:
    """Do a stored run again and compare the two.

    Args:
        folder: a results directory, of single runs or of a study.
        run_id: the run.

    Raises:
        InputError: if there is no such run, if nothing was recorded of it, or if it cannot be assembled here.
    """
    file, row = _find(folder, run_id)
    if not isinstance(row["trace_hash"], str):
        raise InputError([f"run {run_id} must have a trace, got none: it ended as {row['status']}"])
    manifest = _manifest(folder, file, run_id)
    risk_level = None if pd.isna(row["risk_level"]) else float(row["risk_level"])
    options = RunOptions(row["planner"], row["solver"], int(row["seed"]), risk_level)
    document = manifest.get("document", manifest["configuration"])
    record = execute(assemble_scenario(Document(document), options, folder / run_id), run_id=run_id)
    steps = folder / "steps" / file
    stored = read_table(steps) if steps.is_file() else pd.DataFrame(columns=record.steps.columns)
    now = versions()
    changed = {name: (then, now.get(name)) for name, then in manifest["versions"].items() if then != now.get(name)}
    return Reproduction(
        row["trace_hash"],
        record.row["trace_hash"],
        first_difference(stored[stored["run_id"] == run_id], record.steps),
        tuple(f"{name} {then}, now {today}" for name, (then, today) in changed.items()),
    )


def first_difference(stored: pd.DataFrame, new: pd.DataFrame) -> str:
    """Say where the stored steps first differ from new ones; vehicles that were not stored are not compared.

    Args:
        stored: rows of `steps` of one run.
        new: rows of `steps` with all vehicles.
    """
    keys = ["step", "vehicle_id"]
    new = new[new["vehicle_id"].isin(stored["vehicle_id"].unique())]
    both = stored.merge(new, on=keys, how="outer", suffixes=("", "_new"), indicator=True).sort_values(keys)
    for row in both.to_dict("records"):
        where = f"step {row['step']}, {row['vehicle_id']}"
        if row["_merge"] != "both":
            return f"{where}: only in the {'stored' if row['_merge'] == 'left_only' else 'new'} run"
        for column in stored.columns:
            if column not in keys and row[column] != row[f"{column}_new"]:
                return f"{where} at {row['time_s']:.2f} s: {column} was {row[column]!r}, is {row[f'{column}_new']!r}"
    return ""


def _find(folder: Path, run_id: str) -> tuple[Path, dict[str, Any]]:
    known = []
    for file in run_files(folder):
        for row in read_table(folder / "runs" / file).to_dict("records"):
            if row["run_id"] == run_id:
                return file, {str(key): value for key, value in row.items()}
            known.append(str(row["run_id"]))
    if not known:
        raise InputError([f"{folder} must be a results directory with runs, got none. Check the path"])
    remedy = nearest(run_id, known) if len(known) < 20 else "the table `runs` names them all"
    raise InputError([f"must be a run in {folder}, got {run_id!r}; {remedy}"])


def _manifest(folder: Path, file: Path, run_id: str) -> Mapping[str, Any]:
    cell = cell_of(file)
    path = manifest_path(folder, run_id) if cell is None else folder / "cells" / f"{cell}.json"
    if not path.is_file():
        raise InputError(["must be there to do a run again, got no such file. Restore it"], str(path))
    content: dict[str, Any] = read_json(path).content
    return content
