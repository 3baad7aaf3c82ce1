"""The worker process: one run at a time from a pipe, and back what is to be stored of it."""

import contextlib
import faulthandler
import os
import queue
import shutil
import signal
import sys
import threading
import traceback
from collections.abc import Mapping
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NoReturn

import pandas as pd

from sumo_hmdp.decision.registry import planner_package
from sumo_hmdp.documents import Document
from sumo_hmdp.errors import InputError
from sumo_hmdp.scenario.load import ReadyRun, RunOptions, assemble_scenario
from sumo_hmdp.study.files import error_number
from sumo_hmdp.study.machine import versions
from sumo_hmdp.study.record import RunStatus, Trace, tables_hash
from sumo_hmdp.study.run import execute, kept_steps

# A folder that is written to is removed in a few tries; once it is gone nothing can be written there.
REMOVALS = 100


@dataclass(frozen=True)
class Job:
    """One run to do, complete in itself.

    Attributes:
        run_id: its name.
        cell_id: its cell.
        document: the scenario.
        planner: who decides.
        solver: how.
        risk_level: of the planner, None where it has none.
        seed: of everything random.
        trace: which vehicles' steps are wanted.
        wall_limit: after this time the run is given up [s].
        planner_package: the package of the planner in words, None for a planner of this one.
    """

    run_id: str
    cell_id: str
    document: Mapping[str, Any]
    planner: str
    solver: str
    risk_level: float | None
    seed: int
    trace: Trace
    wall_limit: float
    planner_package: str | None = None

    def ready(self) -> ReadyRun:
        """Assemble the run.

        Raises:
            InputError: if this is not possible here, such as without the planner's package, or with another one.
        """
        package = planner_package(self.planner)
        if self.planner_package is not None and str(package) != self.planner_package:
            message = f"planner {self.planner}: must be of {self.planner_package}, got {package}"
            raise InputError([f"{message}. Start the study again where all have the same"])
        options = RunOptions(self.planner, self.solver, self.seed, self.risk_level)
        return assemble_scenario(Document(self.document), options, Path(self.cell_id))


@dataclass(frozen=True)
class Outcome:
    """What became of a job.

    Attributes:
        run_id: the job's.
        status: how it ended.
        reason: why it did not complete, empty if it did.
        row: its row of `runs`; None where the process that should have made it is gone.
        steps: the steps that were wanted.
        decisions: all decisions.
        traceback: of what failed, empty otherwise.
        wall_time: from start to end [s].
        error_number: of the system, where it refused something and so broke the run; None otherwise.
        versions: what the run was made with, empty where the process is gone.
    """

    run_id: str
    status: RunStatus
    reason: str = ""
    row: Mapping[str, Any] | None = None
    steps: pd.DataFrame | None = None
    decisions: pd.DataFrame | None = None
    traceback: str = ""
    wall_time: float = 0.0
    error_number: int | None = None
    versions: Mapping[str, str] = field(default_factory=dict)


def run_job(job: Job) -> Outcome:
    """Do a run; whatever goes wrong is in what it returns."""
    try:
        record = execute(job.ready(), run_id=job.run_id, detailed=job.trace is Trace.ALL)
    except Exception as error:  # noqa: BLE001 - a run that cannot start must not end the others
        text = " ".join(f"{type(error).__name__}: {error}".split())
        number, text_lines = error_number(error), traceback.format_exc()
        return Outcome(job.run_id, RunStatus.FAILED, text, traceback=text_lines, error_number=number)
    steps = kept_steps(record, job.trace)
    # Here, where it costs the one process that writes nothing.
    row = record.row | {"tables_hash": tables_hash(record.decisions, steps), "trace": str(job.trace)}
    return Outcome(
        job.run_id, record.status, record.reason, row, steps, record.decisions, record.traceback, row["wall_time_s"],
        record.error_number, record.manifest["versions"],
    )  # fmt: skip


def serve(connection: Connection, scratch: Path) -> None:
    """Do the jobs that come through a pipe until it ends; the end of the other side ends this process at once.

    Args:
        connection: the pipe.
        scratch: this process's own folder for temporary files, which goes with it.
    """
    jobs: queue.SimpleQueue[Job] = queue.SimpleQueue()

    def listen() -> None:
        with contextlib.suppress(EOFError, OSError):
            while True:
                jobs.put(connection.recv())
        # Nobody waits for what is being done; a planner that hangs would keep the process for ever. A parent that was
        # killed cannot take the folder for temporary files away.
        for _ in range(REMOVALS):
            # The run goes on meanwhile and may have put a file where all were gone.
            shutil.rmtree(scratch, ignore_errors=True)
            if not scratch.exists():
                break
        if os.getpgrp() == os.getpid():
            # With it go the processes that planners have started.
            os.killpg(0, signal.SIGKILL)
        os._exit(0)

    listener = threading.Thread(target=listen, daemon=True)
    listener.start()
    # A pipe that is broken by the end of the other side is the listener's to clear away.
    with contextlib.suppress(BrokenPipeError, ConnectionResetError):
        _answer(connection, jobs)
    listener.join()


def _answer(connection: Connection, jobs: "queue.SimpleQueue[Job]") -> NoReturn:
    """Do one job after the other and send what became of it."""
    # Now, while the sources are those that were imported.
    versions()
    # From here on the time of the first run counts.
    connection.send(None)
    while True:
        job = jobs.get()
        # Shortly before the parent ends this process, standard error shall say where it hangs.
        faulthandler.dump_traceback_later(job.wall_limit)
        outcome = run_job(job)
        faulthandler.cancel_dump_traceback_later()
        connection.send(outcome)


def main() -> None:
    """Serve the pipe whose number is the first argument, with the folder for temporary files that is the second."""
    # The parent decides when to end; Ctrl-C is for it alone.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    faulthandler.enable()
    serve(Connection(int(sys.argv[1])), Path(sys.argv[2]))
