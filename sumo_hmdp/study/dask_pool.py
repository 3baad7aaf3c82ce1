"""Runs on a Dask cluster: each of its threads watches over one process of its own, as on a single machine."""

import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from sumo_hmdp.errors import InputError
from sumo_hmdp.study.pool import LocalPool
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
        try:
            self._client = Client(self.address, timeout=10)
        except (OSError, ValueError) as error:
            message = f"--dask: must be a scheduler that answers, got {self.address!r}: {error}. Check the address"
            raise InputError([message]) from None

    @property
    def free(self) -> int:
        """How many jobs it takes at present: two a thread, so that none waits for this process."""
        threads: dict[str, int] = self._client.nthreads()
        return max(0, 2 * sum(threads.values()) - len(self._running))

    def submit(self, job: Job) -> None:
        """Take a job."""
        self._running[self._client.submit(do, job, pure=False)] = job.run_id

    def collect(self, timeout: float) -> list[Outcome]:
        """Wait until something is done, at most for a time [s], and return everything that is."""
        from distributed import wait  # noqa: PLC0415 - an optional extra

        try:
            done = wait(list(self._running), timeout=timeout, return_when="FIRST_COMPLETED").done
        except TimeoutError:
            return []
        outcomes = []
        for future in done:
            run_id = self._running.pop(future)
            error = future.exception()
            lost = Outcome(run_id, RunStatus.CRASHED, f"the Dask worker was lost: {error}")
            outcomes.append(future.result() if error is None else lost)
        return outcomes

    def close(self) -> None:
        """Give up what is not done."""
        self._client.cancel(list(self._running), force=True)
        self._client.close()
