"""Runs on a Dask cluster: each of its threads watches over one process of its own, as on a single machine."""

import contextlib
import logging
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from dataclasses import dataclass, field
from typing import Any

from sumo_hmdp.errors import InputError
from sumo_hmdp.study.pool import LocalPool, PoolLostError
from sumo_hmdp.study.record import RunStatus
from sumo_hmdp.study.worker import Job, Outcome

_here = threading.local()


def do(job: Job) -> Outcome:
    """Do a run in a process that belongs to the calling thread, so that a crash does not end the Dask worker."""
    if not hasattr(_here, "pool"):
        _here.pool = LocalPool(1)
    _here.pool.submit(job)
    while True:
        outcomes: Sequence[Outcome] = _here.pool.collect(1.0)
        if outcomes:
            return outcomes[0]


@dataclass
class DaskPool:
    """A Dask cluster.

    Attributes:
        address: of its scheduler.
    """

    address: str
    _running: dict[Any, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        try:
            from distributed import Client  # noqa: PLC0415 - an optional extra
        except ImportError:
            remedy = "Install it with `pip install 'sumo-hmdp[dask]'`"
            raise InputError([f"--dask: must go with the package `distributed`, which is missing. {remedy}"]) from None
        # What becomes of the connection is said here, in one line.
        for name in ("distributed", "tornado.application", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
        try:
            self._client = Client(self.address, timeout=10)
        except (OSError, ValueError) as error:
            message = f"--dask: must be a scheduler that answers, got {self.address!r}: {error}. Check the address"
            raise InputError([message]) from None

    @property
    def free(self) -> int:
        """How many jobs it takes at present: two a thread, so that none waits for this process."""
        with self._connected():
            threads: dict[str, int] = self._client.nthreads()
        return max(0, 2 * sum(threads.values()) - len(self._running))

    def submit(self, job: Job) -> None:
        """Take a job."""
        with self._connected():
            self._running[self._client.submit(do, job, pure=False)] = job.run_id

    def collect(self, timeout: float) -> list[Outcome]:
        """Wait until something is done, at most for a time [s], and return everything that is.

        Raises:
            PoolLostError: if the scheduler is gone.
        """
        from distributed import wait  # noqa: PLC0415 - an optional extra

        if not self._running:
            return []
        try:
            done = wait(list(self._running), timeout=timeout, return_when="FIRST_COMPLETED").done
        except TimeoutError:
            self._require_scheduler()
            return []
        except (OSError, CancelledError) as error:
            raise self._gone(error) from None
        outcomes = []
        for future in done:
            with self._connected():
                # A scheduler that goes away leaves its futures cancelled.
                lost = future.exception()
                found: Outcome | None = future.result() if lost is None else None
            run_id = self._running.pop(future)
            outcomes.append(found or Outcome(run_id, RunStatus.CRASHED, f"the Dask worker was lost: {lost}"))
        return outcomes

    def close(self) -> None:
        """Give up what is not done."""
        # Nobody is told if the scheduler is gone.
        with contextlib.suppress(OSError, TimeoutError, CancelledError, RuntimeError):
            self._client.cancel(list(self._running), force=True)
        with contextlib.suppress(OSError, TimeoutError, CancelledError, RuntimeError):
            self._client.close(timeout=2)

    def _require_scheduler(self) -> None:
        if getattr(self._client, "status", "running") not in {"running", "newly-created"}:
            raise self._gone(f"the connection is {self._client.status}")

    @contextlib.contextmanager
    def _connected(self) -> Iterator[None]:
        try:
            yield
        except (OSError, TimeoutError, CancelledError, RuntimeError) as error:
            raise self._gone(error) from None

    def _gone(self, error: object) -> PoolLostError:
        said = " ".join(f"{error}".split()) or type(error).__name__
        return PoolLostError(f"the Dask scheduler at {self.address} does not answer any more: {said}")
