"""One run to one record: simulate, whatever happens, and write down what happened."""

import json
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pandas as pd

from sumo_hmdp.decision.decide import SolversDisagreeError
from sumo_hmdp.decision.problem_file import problem_document
from sumo_hmdp.domain.plan import Status
from sumo_hmdp.domain.scene import EGO_ID
from sumo_hmdp.errors import InputError
from sumo_hmdp.metrics.planned_distances import AuditSettings, audit_settings
from sumo_hmdp.metrics.summary import run_metrics
from sumo_hmdp.scenario.load import ReadyRun
from sumo_hmdp.sim.episode import Moment, run_episode
from sumo_hmdp.sim.recorded_world import RecordedSettings
from sumo_hmdp.study.files import error_number, write_text
from sumo_hmdp.study.machine import versions
from sumo_hmdp.study.record import RUN_COLUMNS, Recorder, RunStatus, Trace
from sumo_hmdp.study.store import (
    SCHEMA_VERSION,
    decision_folder,
    discard,
    dispute_path,
    traceback_path,
    write_manifest,
    write_table,
)
from sumo_hmdp.study.versions import versions_hash


@dataclass(frozen=True)
class RunRecord:
    """What a run left.

    Attributes:
        run_id: its name.
        status: how it ended.
        reason: why it did not complete, empty when it did.
        row: its row of the `runs` table.
        steps: all vehicles at all instants.
        decisions: all decisions.
        documents: their problems in the file form.
        manifest: configuration, versions and trace hash.
        traceback: of a failed run, empty otherwise.
        disputed: the problem, in its file form, on which two solvers disagreed; None without such a dispute.
        error_number: of the system, where it refused something and so broke the run; None otherwise.
    """

    run_id: str
    status: RunStatus
    reason: str
    row: dict[str, Any]
    steps: pd.DataFrame
    decisions: pd.DataFrame
    documents: tuple[str | None, ...]
    manifest: dict[str, Any]
    traceback: str = ""
    disputed: str | None = None
    error_number: int | None = None


def run_id_of(run: ReadyRun) -> str:
    """Return the name of a run: scenario, planner, solver, risk level where there is one, and seed."""
    parts = [run.scenario, run.planner_name]
    if run.solver != "milp":
        parts.append(run.solver)
    risk_level = run.parameters.get("risk_level")
    if risk_level is not None:
        parts.append(f"eps{risk_level!r}")
    return "-".join([*parts, f"seed{run.seed}"])


def execute(
    run: ReadyRun,
    on_moment: Callable[[Moment], None] | None = None,
    run_id: str | None = None,
    *,
    detailed: bool = True,
) -> RunRecord:
    """Simulate a run; a failure or an interruption ends it early but never loses its record.

    Args:
        run: the run.
        on_moment: called with every instant, for progress.
        run_id: its name; None takes that of a single run.
        detailed: whether to write down what decisions rest on: branches, forbidden intervals, problems.

    Raises:
        InputError: if the run cannot even start for a mistake in its input.
    """
    recorder = Recorder(run_id or run_id_of(run), detailed)
    started = datetime.now(tz=UTC)
    status, reason, trace = RunStatus.COMPLETED, "", ""
    disputed: str | None = None
    number: int | None = None

    def observe(moment: Moment) -> None:
        recorder.observe(moment)
        if on_moment is not None:
            on_moment(moment)

    try:
        with run.open_world() as world:
            run_episode(run.episode, world, run.planner, observe)
    except KeyboardInterrupt:
        status, reason = RunStatus.INTERRUPTED, "interrupted by the user"
    except Exception as error:  # whatever breaks a run must leave a record of it
        if isinstance(error, InputError) and not recorder.scenes:
            raise
        text = " ".join(f"{type(error).__name__}: {error}".split())
        status, reason, trace = RunStatus.FAILED, text, traceback.format_exc()
        number = error_number(error)
        if isinstance(error, SolversDisagreeError):
            disputed = json.dumps(problem_document(error.problem))
    if recorder.contacts:
        status, reason = RunStatus.CONTACT, "; ".join(recorder.contact_sentences())
    record = record_of(run, recorder, status, reason, trace, started)
    return replace(record, disputed=disputed, error_number=number)


def record_of(
    run: ReadyRun, recorder: Recorder, status: RunStatus, reason: str, trace: str, started: datetime
) -> RunRecord:
    """Return the record of a run from what was recorded of it.

    Args:
        run: the run.
        recorder: that has observed its instants.
        status: how it ended.
        reason: why it did not complete.
        trace: the traceback of a failed run.
        started: when.
    """
    steps, decisions = recorder.step_table(), recorder.decision_table()
    finished = datetime.now(tz=UTC)
    disagreements = recorder.disagreements() if _sumo_looks(run) else None
    manifest = run_manifest(run)
    row = {
        **run_facts(run, recorder.run_id, status, reason),
        **run_metrics(
            steps,
            decisions,
            run.parameters.get("desired_speed_mps"),
            _audited_as(run),
            contact=bool(recorder.contacts),
            front_contact=recorder.front_contact,
            ended_in_contact=status is RunStatus.CONTACT,
        ),
        "contact_count": len(recorder.contacts),
        "contact_at_fault_count": recorder.contacts_at_fault,
        "contact_first_s": min((contact.time for contact in recorder.contacts), default=None),
        "sumo_contact_count": recorder.sumo_contacts if _sumo_looks(run) else None,
        "contact_disagreement_count": None if disagreements is None else len(disagreements),
        "background_contact_count": recorder.background_contacts,
        "red_light_count": recorder.red_lights,
        "junction_stop_count": recorder.junction_stops,
        "goal_reached": recorder.goal_reached,
        "tracking_failure_count": recorder.qp_failures,
        "deadline_miss_count": int((decisions["solve_time_ms"] > 1000 * run.planner.period).sum()),
        "wall_time_s": (finished - started).total_seconds(),
        "trace_hash": recorder.trace.hexdigest(),
        "versions_hash": versions_hash(manifest["versions"]),
    }
    if isinstance(run.world, RecordedSettings) and (told := first_decision_note(decisions)):
        manifest["network_notes"] = [*manifest["network_notes"], told]
    manifest |= {
        "run_id": recorder.run_id,
        "seed": run.seed,
        "status": str(status),
        "reason": reason,
        "trace_hash": row["trace_hash"],
        "contact_disagreements": disagreements or [],
        "started_at": started.isoformat(timespec="seconds"),
    }
    return RunRecord(
        recorder.run_id, status, reason, row, steps, decisions, tuple(recorder.documents), manifest, trace
    )  # fmt: skip


def first_decision_note(decisions: pd.DataFrame) -> str:
    """Return that recorded gaps left the first decision no plan that keeps the distances; empty where they did."""
    first = str(decisions["status"].iloc[0]) if len(decisions) else ""
    if first not in {Status.RELAXED, Status.FALLBACK}:
        return ""
    return f"the first decision is {first}: the gaps that were recorded are smaller than the planner's distances"


def _sumo_looks(run: ReadyRun) -> bool:
    """Tell whether SUMO looks for contacts: not where there is traffic around, or no SUMO."""
    return not isinstance(run.world, RecordedSettings) and run.world.background is None


def _audited_as(run: ReadyRun) -> AuditSettings | None:
    """Return what the plans of a run are asked for, None where nobody knows: a planner may have rules of its own."""
    try:
        return audit_settings(run_manifest(run))
    except InputError:
        return None


def run_facts(run: ReadyRun, run_id: str, status: RunStatus, reason: str) -> dict[str, Any]:
    """Return what is known of a run, in the row of `runs`, even if nothing of it was recorded."""
    return {
        "run_id": run_id,
        "scenario": run.scenario,
        "planner": run.planner_name,
        "solver": run.solver,
        "seed": run.seed,
        "risk_level": run.parameters.get("risk_level"),
        "status": str(status),
        "reason": reason,
        "reproducible": not run.parameters.get("enforce_deadline", False),
    }


def run_manifest(run: ReadyRun) -> dict[str, Any]:
    """Return the configuration and versions that a run has in common with those of other seeds."""
    return {
        "schema_version": SCHEMA_VERSION,
        "scenario": run.scenario,
        "planner": run.planner_name,
        "solver": run.solver,
        "dt_s": run.episode.dt,
        "period_s": run.planner.period,
        "duration_s": run.episode.duration,
        "motion": str(run.episode.motion),
        "horizon_steps": run.parameters.get("horizon_steps"),
        "risk_level": run.parameters.get("risk_level"),
        "safe_distance_m": run.parameters.get("safe_distance_m"),
        "lanes": {"count": run.episode.road.lane_count, "width_m": run.episode.road.lane_width},
        "versions": versions(run.planner_name),
        "parameters": dict(run.parameters),
        "configuration": dict(run.configuration),
        "network_notes": list(run.notes),
        **({"tracks_sha256": run.world.traffic.digest} if isinstance(run.world, RecordedSettings) else {}),
    }


def kept_steps(record: RunRecord, trace: Trace) -> pd.DataFrame:
    """Return the rows of the `steps` table that are to be kept."""
    if trace is Trace.NONE:
        return record.steps.iloc[:0]
    return record.steps if trace is Trace.ALL else record.steps[record.steps["vehicle_id"] == EGO_ID]


def save(record: RunRecord, folder: Path, trace: Trace, *, dump_decisions: bool) -> None:
    """Write the tables and the manifest of a run, in place of an earlier run of the same name.

    The row in `runs` goes first and comes last, so that it vouches for the rest whenever the process is killed.

    Args:
        record: the run.
        folder: a writable results directory.
        trace: which vehicles the `steps` table keeps.
        dump_decisions: whether to write each decision's problem as a file of its own.
    """
    discard(folder, record.run_id)
    write_table(folder, "steps", record.run_id, kept_steps(record, trace))
    write_table(folder, "decisions", record.run_id, record.decisions)
    write_manifest(folder, record.run_id, record.manifest)
    if record.traceback:
        write_text(traceback_path(folder, record.run_id), record.traceback)
    if record.disputed is not None:
        write_text(dispute_path(folder, record.run_id), record.disputed + "\n")
    if dump_decisions:
        for index, document in enumerate(record.documents):
            if document is not None:
                write_text(decision_folder(folder, record.run_id) / f"{index:04d}.json", document + "\n")
    write_table(
        folder, "runs", record.run_id, pd.DataFrame([record.row], columns=list(RUN_COLUMNS)).astype(RUN_COLUMNS)
    )
