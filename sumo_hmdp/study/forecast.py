"""What a study will take: time and disk, measured on one run of a few of its cells."""

import tempfile
from dataclasses import dataclass
from pathlib import Path

from sumo_hmdp.study.design import Cell, Design
from sumo_hmdp.study.parts import RunTables, Writer
from sumo_hmdp.study.pool import LocalPool
from sumo_hmdp.study.record import RunStatus
from sumo_hmdp.study.runner import job_of
from sumo_hmdp.study.store import TABLES

CELLS_MEASURED = 4


@dataclass(frozen=True)
class Forecast:
    """One run's needs.

    Attributes:
        run_id: which run was measured; nothing of it is kept.
        status: how it ended.
        reason: why it did not complete, empty if it did.
        wall_time: that it took [s].
        size: of its tables in files of their own [bytes]; batches of runs take less a run.
    """

    run_id: str
    status: RunStatus
    reason: str
    wall_time: float
    size: int


def forecast(design: Design) -> tuple[Forecast, ...]:
    """Do the first run of a few cells, spread over the study since their runs may differ, and measure each."""
    count = len(design.cells)
    cells = [design.cells[at * count // CELLS_MEASURED] for at in range(CELLS_MEASURED)]
    pool = LocalPool(1)
    try:
        return tuple(_measured(design, cell, pool) for cell in {cell.id: cell for cell in cells}.values())
    finally:
        pool.close()


def _measured(design: Design, cell: Cell, pool: LocalPool) -> Forecast:
    pool.submit(job_of(design, cell, design.seeds[0]))
    outcome = None
    while outcome is None:
        outcome = next(iter(pool.collect(1.0)), None)
    size = 0
    if outcome.row is not None:
        with tempfile.TemporaryDirectory(prefix="sumo-hmdp-forecast-") as scratch:
            writer = Writer(Path(scratch), [cell])
            writer.add(RunTables(cell.id, outcome.row, outcome.steps, outcome.decisions))
            writer.flush()
            size = sum(file.stat().st_size for table in TABLES for file in Path(scratch, table).rglob("*.parquet"))
    return Forecast(outcome.run_id, outcome.status, outcome.reason, outcome.wall_time, size)
