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

from sumo_hmdp.errors import SumoHmdpError
from sumo_hmdp.study.record import RunStatus
from sumo_hmdp.study.worker import Job, Outcome

# A new process takes a second or more until it can start; over 200 restarts SUMO's memory has been seen to stay flat.
RUNS_PER_WORKER = 200
# Not `-m`: the classes that go through the pipe must belong to the module's real name.
PROGRAM = "from sumo_hmdp.study.worker import main; main()"
# Between the moment at which a worker says where it hangs and the moment at which it is ended [s].
GRACE = 1.0
START_LIMIT = 300.0
# Between two looks at the workers no more than this counts against a run: a parent that was stopped, or whose machine
# slept, must not take runs for hanging that had no chance to be heard [s].
LOOK_MAX = 2.0


class PoolLostError(SumoHmdpError):
    """Where runs are done is gone; nothing more can be done there."""


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
    _clock: float = 0.0
    _looked: float = field(default_factory=time.monotonic)

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
            lost = worker.process.poll() is not None or not worker.log.is_file()
            if lost or worker.done >= self.runs_per_worker:
                self._end(worker, killed=False)
        worker = next((worker for worker in self._workers if worker.job is None), None) or self._start()
        worker.job = job
        worker.started = self._now()
        # The time that a process takes to start is no run's.
        worker.deadline = worker.started + (job.wall_limit + GRACE if worker.awake else START_LIMIT)
        with contextlib.suppress(OSError):
            worker.log_from = worker.log.stat().st_size
        # If it died just now, `collect` finds its pipe closed.
        with contextlib.suppress(OSError):
            worker.connection.send(job)

    def collect(self, timeout: float) -> list[Outcome]:
        """Wait until something is done, at most for a time [s], and return everything that is."""
        busy = [worker for worker in self._workers if worker.job is not None]
        if not busy:
            return []
        next_deadline = min(worker.deadline for worker in busy) - self._now()
        ready = wait([worker.connection for worker in busy], max(0.0, min(timeout, next_deadline, LOOK_MAX)))
        now = self._now()
        outcomes = []
        for worker in busy:
            if worker.connection in ready:
                outcomes.append(self._receive(worker))
            elif now >= worker.deadline:
                outcomes.append(self._lost(worker, RunStatus.TIMED_OUT))
        return [outcome for outcome in outcomes if outcome is not None]

    def close(self) -> None:
        """End all processes."""
        for worker in self._workers:
            worker.connection.close()
        for worker in list(self._workers):
            self._end(worker, killed=worker.job is not None)

    def _now(self) -> float:
        """Return the time that counts [s]."""
        now = time.monotonic()
        self._clock += min(now - self._looked, LOOK_MAX)
        self._looked = now
        return self._clock

    def _start(self) -> _Worker:
        try:
            scratch = Path(tempfile.mkdtemp(prefix="sumo-hmdp-worker-"))
        except OSError as error:
            message = f"no folder for temporary files can be made: {error}. Make room, or set TMPDIR to one that exists"
            raise PoolLostError(message) from None
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
            worker.started = self._now()
            worker.deadline = worker.started + worker.job.wall_limit + GRACE
            return None
        if outcome is not None and outcome.status is RunStatus.FAILED and not worker.scratch.is_dir():
            # Not the run's fault, and the next ones would fail the same way.
            return self._lost(worker, RunStatus.CRASHED, "its folder for temporary files was removed")
        worker.job = None
        worker.done += 1
        return outcome

    def _lost(self, worker: _Worker, status: RunStatus, why: str = "") -> Outcome:
        """Say what is known of a run whose process is gone, or is of no use and is ended now."""
        job = worker.job
        assert job is not None  # noqa: S101 - only busy workers are asked
        elapsed = self._now() - worker.started
        # What stands in a file that was removed is lost with it.
        log = None
        with contextlib.suppress(OSError):
            log = worker.log.open("rb")
        self._end(worker, killed=status is RunStatus.TIMED_OUT or bool(why))
        text = ""
        if log is not None:
            with log:
                log.seek(worker.log_from)
                text = log.read().decode(errors="replace")
        if status is RunStatus.TIMED_OUT:
            reason = f"took longer than {job.wall_limit if worker.awake else START_LIMIT:g} s"
        else:
            reason = why or f"the process ended: {_ending(worker.process.returncode)}"
        return Outcome(job.run_id, status, reason, traceback=text or f"{reason}\n", wall_time=elapsed)

    def _end(self, worker: _Worker, *, killed: bool) -> None:
        self._workers.remove(worker)
        # An idle process ends by itself when its pipe does.
        worker.connection.close()
        if not killed:
            # Its pipe is closed but it may live on, such as in a library's handler for crashes.
            _await_end(worker.process.pid, GRACE)
        # It leads a group of its own; with it go the processes that planners have started.
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(worker.process.pid, signal.SIGKILL)
        worker.process.wait()
        shutil.rmtree(worker.scratch, ignore_errors=True)


def _await_end(pid: int, limit: float) -> None:
    """Wait until a child has ended, at most for a time [s], and leave its number taken: its group may live on."""
    until = time.monotonic() + limit
    with contextlib.suppress(ChildProcessError):
        while os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT | os.WNOHANG) is None and time.monotonic() < until:
            time.sleep(0.005)


def _ending(code: int) -> str:
    return f"exit code {code}" if code >= 0 else f"signal {-code} ({signal.strsignal(-code)})"
