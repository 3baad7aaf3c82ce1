"""One stored run: finding it, what is kept of it, and doing it again from its description alone."""

import difflib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd

from sumo_hmdp.documents import Document
from sumo_hmdp.domain.scene import EGO_ID
from sumo_hmdp.errors import InputError, SumoHmdpError
from sumo_hmdp.scenario.load import RunOptions, assemble_scenario
from sumo_hmdp.sim.episode import Moment
from sumo_hmdp.study.files import DamagedFileError
from sumo_hmdp.study.machine import versions
from sumo_hmdp.study.reasons import Reasons
from sumo_hmdp.study.run import RunRecord, execute
from sumo_hmdp.study.store import cell_of, cell_path, manifest_path, read_cell, read_manifest, read_runs, read_table
from sumo_hmdp.study.versions import differences, read_versions

NAMED = 3


@dataclass(frozen=True)
class StoredRun:
    """One run of a results directory.

    Attributes:
        folder: the directory, of single runs or of a study.
        file: its table file, below `runs`, `decisions` and `steps`.
        row: its row of `runs`.
    """

    folder: Path
    file: Path
    row: Mapping[str, Any]

    @property
    def run_id(self) -> str:
        """Its name."""
        return str(self.row["run_id"])

    def table(self, name: str) -> pd.DataFrame:
        """Return its rows of a table; an empty frame where nothing was stored."""
        path = self.folder / name / self.file
        if not path.exists():
            return pd.DataFrame()
        rows = read_table(path)
        return rows[rows["run_id"] == self.run_id].reset_index(drop=True)

    def manifest(self) -> dict[str, Any]:
        """Return configuration, versions and how it ended; of a study's run, what its cell says with its own facts.

        Raises:
            InputError: if the file is gone.
        """
        cell = cell_of(self.file)
        path = manifest_path(self.folder, self.run_id) if cell is None else cell_path(self.folder, cell)
        if not path.exists():
            raise InputError(["must be there to do a run again, got no such file. Restore it"], str(path))
        if cell is None:
            content = read_manifest(self.folder, self.run_id)
        else:
            content = read_cell(self.folder, cell)
            own = read_versions(self.folder, self.row.get("versions_hash"))
            content |= {"versions": own} if own else {}
        for key in ("configuration", "versions"):
            if not isinstance(content.get(key), dict):
                raise DamagedFileError(path, f"must hold `{key}`, got {content.get(key)!r}", "Restore it")
        facts = {key: self.row[key] for key in ("run_id", "seed", "status", "reason", "trace_hash")}
        return content | {key: None if pd.isna(value) else value for key, value in facts.items()}

    def changed_versions(self) -> tuple[str, ...]:
        """Return what of the software has another version now, in words."""
        return differences(self.manifest()["versions"], versions(str(self.row["planner"])))


def stored_run(folder: Path, run_id: str) -> StoredRun:
    """Find a run.

    Args:
        folder: a results directory, of single runs or of a study.
        run_id: its name, as in the table `runs`.

    Raises:
        InputError: if there is no such run; the nearest names are given.
    """
    known = []
    for file, rows in read_runs(folder):
        for row in rows.drop(columns="cell", errors="ignore").to_dict("records"):
            if row["run_id"] == run_id:
                return StoredRun(folder, file, {str(key): value for key, value in row.items()})
            known.append(str(row["run_id"]))
    if not known:
        raise InputError([f"{folder} must be a results directory with runs, got none. Check the path"])
    near = difflib.get_close_matches(run_id, known, n=NAMED, cutoff=0.0)
    named = " or ".join(f"`{one}`" for one in near)
    raise InputError([f"RUN_ID: must be a run in {folder}, got {run_id!r}; did you mean {named}?"])


def run_again(run: StoredRun, on_moment: Callable[[Moment], None] | None = None) -> RunRecord:
    """Do a run again from what is stored of it.

    Args:
        run: the stored run.
        on_moment: called with every instant, for progress.

    Raises:
        InputError: if nothing was recorded of it, or if it cannot be assembled here.
    """
    row = run.row
    if not isinstance(row["trace_hash"], str):
        raise InputError([f"run {run.run_id} must have a trace, got none: it ended as {row['status']}"])
    manifest = run.manifest()
    risk_level = None if pd.isna(row["risk_level"]) else float(row["risk_level"])
    options = RunOptions(row["planner"], row["solver"], int(row["seed"]), risk_level)
    document = manifest.get("document", manifest["configuration"])
    ready = assemble_scenario(Document(document), options, run.folder / run.run_id)
    return execute(ready, on_moment, run_id=run.run_id)


@dataclass(frozen=True)
class WholeRun:
    """Everything of one run that a replay shows.

    Attributes:
        manifest: configuration and how it ended.
        row: its row of `runs`.
        steps: all vehicles at all instants.
        decisions: with branches and forbidden stretches.
        repeated: whether it was done again, since not all of this was stored.
        untold: why `decisions` do not say what other first actions would have led to, empty where they do, or where
            nobody asked.
    """

    manifest: Mapping[str, Any]
    row: Mapping[str, Any]
    steps: pd.DataFrame
    decisions: pd.DataFrame
    repeated: bool
    untold: str = ""


def keeps_all(steps: pd.DataFrame) -> bool:
    """Tell whether stored steps hold more vehicles than the ego; a run with nobody else is cheap to do again."""
    return len(steps) > 0 and bool((steps["vehicle_id"] != EGO_ID).any())


def whole_run(
    run: StoredRun, on_moment: Callable[[Moment], None] | None = None, *, explained: bool = False
) -> WholeRun:
    """Return a run with all its vehicles: as stored, or done again where only a part was kept.

    A repetition shows the solve times that were stored: they are of the run, not of its repetition.

    Args:
        run: the stored run.
        on_moment: called with every instant of a repetition.
        explained: do it again in any case, if its planner predicts anything, so that `decisions` say in `actions_json`
            what the other first actions would have led to.

    Raises:
        InputError: as for `run_again`.
        SumoHmdpError: if the repetition is not the same run, bit for bit.
    """
    steps, decisions = run.table("steps"), run.table("decisions")
    stored = WholeRun(run.manifest(), run.row, steps, decisions, repeated=False)
    kept = keeps_all(steps)
    if kept and not (explained and len(decisions) and decisions["branch_count"].any()):
        return stored
    reasons = Reasons()

    def watch(moment: Moment) -> None:
        if explained:
            reasons.observe(moment)
        if on_moment is not None:
            on_moment(moment)

    try:
        record = _repeated(run, watch)
    except SumoHmdpError as error:
        if not kept:
            raise
        return replace(stored, untold=str(error))
    if not kept:
        times = decisions["solve_time_ms"].to_numpy() if len(decisions) else None
        again = record.decisions if times is None else record.decisions.assign(solve_time_ms=times)
        stored = replace(stored, steps=record.steps, decisions=again, repeated=True)
    return replace(stored, decisions=reasons.beside(stored.decisions)) if explained else stored


def _repeated(run: StoredRun, on_moment: Callable[[Moment], None]) -> RunRecord:
    """Do a run again, and raise unless it is the same, bit for bit."""
    record = run_again(run, on_moment)
    if record.row["trace_hash"] != run.row["trace_hash"]:
        raise SumoHmdpError(_not_the_same(run, record))
    return record


def _not_the_same(run: StoredRun, record: RunRecord) -> str:
    if not run.row.get("reproducible", True):
        why = "its deadline was enforced, so that its decisions hung on the machine's speed"
    else:
        changed = run.changed_versions()
        why = f"other versions: {'; '.join(changed)}" if changed else "the versions are the same: see `sumo-hmdp repro`"
    hashes = f"trace hash was {run.row['trace_hash'][:16]}, is {record.row['trace_hash'][:16]}"
    return (
        f"{run.run_id} cannot be shown: its other vehicles were not stored, and doing it again gives another run "
        f"({hashes}); {why}. Run it once more with --trace all"
    )
