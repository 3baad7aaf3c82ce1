"""What a study will take: time and disk, measured on one run of a few of its cells."""

import math
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import fmean

import pandas as pd

from sumo_hmdp.study.design import Cell, Design
from sumo_hmdp.study.parts import COLUMNS, RUNS_PER_FILE, RunTables, Writer
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
        size: what one more run adds to the tables of its cell, at the study's trace level [byte].
        overhead: what a cell's files take before any run is in them [byte].
    """

    run_id: str
    status: RunStatus
    reason: str
    wall_time: float
    size: float
    overhead: float = 0.0


def size_of(design: Design, found: Sequence[Forecast]) -> float:
    """Return what the tables of a whole study take at most [byte].

    Args:
        design: the study.
        found: the forecast of some of its cells.
    """
    size, overhead = fmean(one.size for one in found), fmean(one.overhead for one in found)
    file_count = math.ceil(len(design.seeds) / RUNS_PER_FILE)
    return len(design.cells) * (file_count * overhead + len(design.seeds) * size)


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
    size, overhead = 0.0, 0.0
    if outcome.row is not None:
        tables = RunTables(cell.id, outcome.row, outcome.steps, outcome.decisions)
        # A file is mostly its own description until many runs are in it. What one more run adds is what its rows after
        # the first one of a table take; of its one row in `runs`, about 8 byte a column.
        begun = replace(tables, steps=_first_row(outcome.steps), decisions=_first_row(outcome.decisions))
        whole = _written(cell, tables)
        size = whole - _written(cell, begun) + 8.0 * len(COLUMNS["runs"])
        overhead = whole - size
    return Forecast(outcome.run_id, outcome.status, outcome.reason, outcome.wall_time, size, overhead)


def _first_row(frame: pd.DataFrame | None) -> pd.DataFrame | None:
    return None if frame is None else frame.iloc[:1]


def _written(cell: Cell, tables: RunTables) -> int:
    """Return what the files of a single run take [byte]."""
    with tempfile.TemporaryDirectory(prefix="sumo-hmdp-forecast-") as scratch:
        writer = Writer(Path(scratch), [cell])
        writer.add(tables)
        writer.flush()
        return sum(file.stat().st_size for table in TABLES for file in Path(scratch, table).rglob("*.parquet"))
