"""The Dask pool without a cluster: what its threads do, and what is said when something is missing."""

import sys
from concurrent.futures import CancelledError
from dataclasses import dataclass, field

import pytest

from sumo_hmdp.errors import InputError
from sumo_hmdp.study import dask_pool
from sumo_hmdp.study.dask_pool import DaskPool, do
from sumo_hmdp.study.pool import PoolLostError
from sumo_hmdp.study.record import RunStatus
from sumo_hmdp.study.runner import job_of


def test_a_thread_keeps_its_process(tiny):
    job = job_of(tiny, tiny.cells[-1], 5)
    outcomes = [do(job), do(job)]
    assert [(outcome.status, outcome.row["seed"]) for outcome in outcomes] == [(RunStatus.COMPLETED, 5)] * 2
    pool = dask_pool._here.pool
    assert [worker.done for worker in pool._workers] == [2]
    pool.close()
    del dask_pool._here.pool


def test_the_extra_is_named_where_it_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"--dask: .*pip install 'sumo-hmdp\[dask\]'"):
        DaskPool("tcp://127.0.0.1:8786")


@dataclass(eq=False)
class Future:
    error: Exception | None = None

    def exception(self):
        return self.error

    def result(self):
        return "an outcome"


@dataclass
class Client:
    futures: list = field(default_factory=list)

    def nthreads(self):
        return {"a": 1, "b": 2}

    def submit(self, function, job, *, pure):
        assert (function, pure) == (do, False)
        self.futures.append(Future(RuntimeError("four workers died") if job.seed == 1 else None))
        return self.futures[-1]


def test_a_run_whose_dask_worker_is_lost_is_a_crash(tiny, monkeypatch):
    import distributed  # noqa: PLC0415 - an optional extra

    client = Client()
    monkeypatch.setattr(distributed, "Client", lambda address, timeout: client)
    pool = DaskPool("tcp://a:1")
    assert pool.free == 6
    for seed in (0, 1):
        pool.submit(job_of(tiny, tiny.cells[0], seed))
    assert pool.free == 4

    def wait(futures, timeout, return_when):
        if timeout < 1:
            raise TimeoutError
        assert (futures, return_when) == (client.futures, "FIRST_COMPLETED")
        return type("Done", (), {"done": set(futures)})

    monkeypatch.setattr(distributed, "wait", wait)
    assert pool.collect(0.5) == []
    found = pool.collect(1.0)
    assert pool.free == 6
    (lost,) = [outcome for outcome in found if outcome != "an outcome"]
    assert (lost.run_id, lost.status) == (tiny.cells[0].run_id(1), RunStatus.CRASHED)
    assert lost.reason == "the Dask worker was lost: four workers died"


@pytest.mark.parametrize(
    "error", [OSError("in <TCP>: Stream is closed"), CancelledError("scheduler"), RuntimeError("x")]
)
def test_a_scheduler_that_goes_away_is_one_line(tiny, monkeypatch, error):
    import distributed  # noqa: PLC0415 - an optional extra

    @dataclass
    class Gone(Client):
        status: str = "running"

    client = Gone()
    monkeypatch.setattr(distributed, "Client", lambda address, timeout: client)
    pool = DaskPool("tcp://a:1")
    pool.submit(job_of(tiny, tiny.cells[0], 0))

    def fail(*arguments, **options):
        raise error

    future = client.futures[0]
    future.exception = fail
    monkeypatch.setattr(distributed, "wait", lambda *a, **o: type("Done", (), {"done": {future}}))
    with pytest.raises(PoolLostError, match=r"the Dask scheduler at tcp://a:1 does not answer any more"):
        pool.collect(0.5)
    client.nthreads = fail
    with pytest.raises(PoolLostError):
        _ = pool.free

    def late(*arguments, **options):
        raise TimeoutError

    monkeypatch.setattr(distributed, "wait", late)
    client.status = "connecting"
    with pytest.raises(PoolLostError, match="the connection is connecting"):
        pool.collect(0.5)
