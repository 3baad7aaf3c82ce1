"""Worker processes, each with its own SUMO and its own pipe, so that the end of one costs its run and nothing else."""

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Protocol

from sumo_hmdp.study.record import RunStatus
from sumo_hmdp.study.worker import Job, Outcome

# A new process takes a second or more until it can start; over 200 restarts SUMO's memory has been seen to stay flat.
RUNS_PER_WORKER = 200
# Not `-m`: the classes that go through the pipe must belong to the module's real name.
PROGRAM = "from sumo_hmdp.study.worker import main; main()"
# Between the moment at which a worker says where it hangs and the moment at which it is ended [s].
GRACE = 1.0
START_LIMIT = 300.0


class Pool(Protocol):
    """Where jobs are done."""

    @property
    def free(self) -> int:
        """How many jobs it takes at present."""

    def submit(self, job: Job) -> None:
        """Take a job."""

    def collect(self, timeout: float) -> Sequence[Outcome]:
        """Wait until something is done, at most for a time [s], and return everything that is."""

    def close(self) -> None:
        """Give up what is not done."""


@dataclass
class _Worker:
    """A process and what it does."""

    process: subprocess.Popen[bytes]
    connection: Connection
    scratch: Path
    awake: bool = False
    job: Job | None = None
    deadline: float = 0.0
    started: float = 0.0
    log_from: int = 0
    done: int = 0

    @property
    def log(self) -> Path:
        """What it writes to standard error."""
        return self.scratch / "stderr.txt"


@dataclass
class LocalPool:
    """Worker processes on this machine.

    Attributes:
        count: how many.
        runs_per_worker: after so many runs a process is replaced, so that what it may leak cannot add up.
    """

    count: int
    runs_per_worker: int = RUNS_PER_WORKER
    _workers: list[_Worker] = field(default_factory=list)

    @property
    def free(self) -> int:
        """How many jobs it takes at present."""
        return self.count - sum(worker.job is not None for worker in self._workers)

    @property
    def process_ids(self) -> tuple[int, ...]:
        """The processes that run at present, as the system numbers them."""
        return tuple(worker.process.pid for worker in self._workers)

    def submit(self, job: Job) -> None:
        """Give a job to an idle process; one that has died meanwhile is replaced."""
        idle = [worker for worker in self._workers if worker.job is None]
        for worker in idle:
            if worker.process.poll() is not None or worker.done >= self.runs_per_worker:
                self._end(worker, killed=False)
        worker = next((worker for worker in self._workers if worker.job is None), None) or self._start()
        worker.job = job
        worker.started = time.monotonic()
        # The time that a process takes to start is no run's.
        worker.deadline = worker.started + (job.wall_limit + GRACE if worker.awake else START_LIMIT)
        worker.log_from = worker.log.stat().st_size
        # If it died just now, `collect` finds its pipe closed.
        with contextlib.suppress(OSError):
            worker.connection.send(job)

    def collect(self, timeout: float) -> list[Outcome]:
        """Wait until something is done, at most for a time [s], and return everything that is."""
        busy = [worker for worker in self._workers if worker.job is not None]
        if not busy:
            return []
        next_deadline = min(worker.deadline for worker in busy) - time.monotonic()
        ready = wait([worker.connection for worker in busy], max(0.0, min(timeout, next_deadline)))
        outcomes = []
        for worker in busy:
            if worker.connection in ready:
                outcomes.append(self._receive(worker))
            elif time.monotonic() >= worker.deadline:
                outcomes.append(self._lost(worker, RunStatus.TIMED_OUT))
        return [outcome for outcome in outcomes if outcome is not None]

    def close(self) -> None:
        """End all processes."""
        for worker in self._workers:
            worker.connection.close()
        for worker in list(self._workers):
            self._end(worker, killed=worker.job is not None)

    def _start(self) -> _Worker:
        scratch = Path(tempfile.mkdtemp(prefix="sumo-hmdp-worker-"))
        ours, theirs = socket.socketpair()
        with (scratch / "stderr.txt").open("wb") as stderr, theirs:
            process = subprocess.Popen(  # noqa: S603 - our own program
                [sys.executable, "-P", "-c", PROGRAM, str(theirs.fileno()), str(scratch)],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=stderr,
                env={**os.environ, "TMPDIR": str(scratch)},
                # Signals from the terminal are for the parent alone.
                start_new_session=True,
            )
        worker = _Worker(process, Connection(ours.detach()), scratch)
        self._workers.append(worker)
        return worker

    def _receive(self, worker: _Worker) -> Outcome | None:
        try:
            outcome: Outcome | None = worker.connection.recv()
        except (EOFError, OSError):
            return self._lost(worker, RunStatus.CRASHED)
        if outcome is None and worker.job is not None:
            worker.awake = True
            worker.started = time.monotonic()
            worker.deadline = worker.started + worker.job.wall_limit + GRACE
            return None
        worker.job = None
        worker.done += 1
        return outcome

    def _lost(self, worker: _Worker, status: RunStatus) -> Outcome:
        """Say what is known of a run whose process is gone, or hangs and is ended now."""
        job = worker.job
        assert job is not None  # noqa: S101 - only busy workers are asked
        elapsed = time.monotonic() - worker.started
        with worker.log.open("rb") as log:
            self._end(worker, killed=status is RunStatus.TIMED_OUT)
            log.seek(worker.log_from)
            text = log.read().decode(errors="replace")
        if status is RunStatus.TIMED_OUT:
            reason = f"took longer than {job.wall_limit if worker.awake else START_LIMIT:g} s"
        else:
            reason = f"the process ended: {_ending(worker.process.returncode)}"
        return Outcome(job.run_id, status, reason, traceback=text or f"{reason}\n", wall_time=elapsed)

    def _end(self, worker: _Worker, *, killed: bool) -> None:
        self._workers.remove(worker)
        # An idle process ends by itself when its pipe does.
        worker.connection.close()
        if killed:
            worker.process.kill()
        try:
            worker.process.wait(GRACE)
        except subprocess.TimeoutExpired:
            # Its pipe is closed but it lives on, such as in a library's handler for crashes.
            worker.process.kill()
            worker.process.wait()
        shutil.rmtree(worker.scratch, ignore_errors=True)


def _ending(code: int) -> str:
    return f"exit code {code}" if code >= 0 else f"signal {-code} ({signal.strsignal(-code)})"
