"""Doing the runs of a study: what is not in the store yet goes to the workers, what comes back goes to the store."""

import json
import time
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from sumo_hmdp.decision.registry import planner_package
from sumo_hmdp.errors import SumoHmdpError
from sumo_hmdp.study.asked import Asked, write_asked
from sumo_hmdp.study.design import Cell, Design
from sumo_hmdp.study.files import FULL
from sumo_hmdp.study.ledger import Ledger
from sumo_hmdp.study.parts import RunTables, Writer, disk, study_hash
from sumo_hmdp.study.pool import Pool
from sumo_hmdp.study.record import RunStatus, Trace
from sumo_hmdp.study.recovery import Finished
from sumo_hmdp.study.run import run_facts
from sumo_hmdp.study.stopping import is_enough
from sumo_hmdp.study.worker import Job, Outcome

ATTEMPTS = 2
FLUSH_S, FLUSH_RUNS = 10.0, 200
SEEDS_AT_ONCE = 10
# What of a scenario is not the traffic around the ego.
_NOT_TRAFFIC = ("name", "description", "published", "planner", "planners")
ENDED_WELL = (RunStatus.COMPLETED, RunStatus.CONTACT)


def job_of(design: Design, cell: Cell, seed: int) -> Job:
    """Return one run of a study as a job."""
    run, file = cell.ready, design.file
    return Job(
        cell.run_id(seed), cell.id, cell.document, run.planner_name, run.solver,
        run.parameters.get("risk_level"), seed, Trace(file.trace), file.wall_limit_s, _package(run.planner_name),
    )  # fmt: skip


def _package(planner: str) -> str | None:
    package = planner_package(planner)
    return None if package is None else str(package)


def asked_of(design: Design, seeds: Iterable[int]) -> Asked:
    """Return what a study asks for, of the seeds that are known to be needed."""
    file = design.file
    labels = {cell.id: cell.factors for cell in design.cells}
    return Asked(file.name, " ".join(file.description.split()), file.trace, labels, frozenset(seeds))


def in_order(cells: Sequence[Cell], seeds: Sequence[int]) -> Iterator[tuple[Cell, int]]:
    """Yield the runs of a batch of seeds in the order in which they are done.

    A few seeds of every cell come before the next seeds of any, so that a study that is ended early has nearly the same
    seeds everywhere. Within these, cells with the same traffic take turns, for a worker draws and warms it up once for
    runs of one seed that follow each other; other cells come one after the other, for what is written is a file a cell.
    """
    groups: dict[str, list[Cell]] = defaultdict(list)
    for cell in cells:
        world = {key: value for key, value in cell.document.items() if key not in _NOT_TRAFFIC}
        groups[json.dumps(world, sort_keys=True)].append(cell)
    for start in range(0, len(seeds), SEEDS_AT_ONCE):
        for group in groups.values():
            for seed in seeds[start : start + SEEDS_AT_ONCE]:
                yield from ((cell, seed) for cell in group)


@dataclass(frozen=True)
class Progress:
    """How far a study is.

    Attributes:
        planned: runs of the batches of seeds that are known to be needed.
        done: runs of these that are finished, those of earlier calls included.
        new: runs that were finished in this call.
        failed: finished runs that did not end well.
    """

    planned: int
    done: int
    new: int
    failed: int


@dataclass
class Study:
    """A study at work.

    Attributes:
        design: what to run.
        folder: its store, opened.
        finished: what the store held at the start.
        pool: where to run.
        limit: of runs in this call; None for all.
        on_progress: called whenever a run is finished.
    """

    design: Design
    folder: Path
    finished: Finished
    pool: Pool
    limit: int | None = None
    on_progress: Callable[[Progress], None] | None = None
    _rows: dict[str, dict[str, object]] = field(default_factory=dict)
    _planned: set[str] = field(default_factory=set)
    _counts: Counter[str] = field(default_factory=Counter)
    _new: int = 0

    def run(self) -> bool:
        """Do what is not done yet; tell whether the study is complete, which a limit may prevent.

        Raises:
            SumoHmdpError: if the disk takes no more.
            KeyboardInterrupt: if the user ends it; what is finished has been written by then.
        """
        rows: list[dict[str, object]] = self.finished.rows.to_dict("records")  # type: ignore[assignment]
        self._rows = {str(row["run_id"]): row for row in rows}
        self._writer = Writer(self.folder, self.design.cells)
        self._ledger = Ledger(self.folder)
        asked: list[int] = []
        for stage, seeds in enumerate(self.design.stages):
            asked += seeds
            planned = {cell.run_id(seed) for cell in self.design.cells for seed in seeds}
            self._planned |= planned
            self._counts.update(str(self._rows[run_id]["status"]) for run_id in planned & self._rows.keys())
            order = in_order(self.design.cells, seeds)
            jobs = [(cell, seed) for cell, seed in order if cell.run_id(seed) not in self._rows]
            allowed = len(jobs) if self.limit is None else self.limit - self._new
            self._report()
            enough = not jobs and self._is_enough(stage)
            if jobs or enough or stage == len(self.design.stages) - 1:
                with disk():
                    write_asked(self.folder, asked_of(self.design, asked))
            self._do(deque(jobs[:allowed]))
            if allowed < len(jobs):
                return False
            if enough or (jobs and self._is_enough(stage)):
                break
        return True

    def hash(self) -> str:
        """Return the hash of the study's tables."""
        return study_hash(self.folder, frozenset(self._planned))

    def counts(self) -> Counter[str]:
        """Return how many of the study's runs ended how."""
        return Counter(self._counts)

    def _do(self, jobs: deque[tuple[Cell, int]]) -> None:
        """Do some runs; whatever ends this, what is finished is written."""
        running: dict[str, tuple[Cell, int]] = {}
        flushed = time.monotonic()
        try:
            while jobs or running:
                while jobs and self.pool.free:
                    cell, seed = jobs.popleft()
                    running[cell.run_id(seed)] = (cell, seed)
                    self.pool.submit(job_of(self.design, cell, seed))
                for outcome in self.pool.collect(0.5):
                    cell, seed = running.pop(outcome.run_id)
                    if not self._settle(cell, seed, outcome):
                        jobs.append((cell, seed))
                if self._writer.waiting >= FLUSH_RUNS or time.monotonic() - flushed > FLUSH_S:
                    self._writer.flush()
                    flushed = time.monotonic()
        finally:
            self._writer.flush()

    def _settle(self, cell: Cell, seed: int, outcome: Outcome) -> bool:
        """Keep what came of a run; tell whether it is finished, or to be tried once more."""
        if outcome.status not in ENDED_WELL:
            if outcome.error_number in FULL:
                # Not the run's fault, and the next ones would fail the same way.
                raise SumoHmdpError(f"{outcome.run_id}: {outcome.reason}. Make room and start again; it goes on there")
            self._ledger.note(outcome)
            if self._ledger.attempts(outcome.run_id) < ATTEMPTS:
                return False
        run_id = outcome.run_id
        row = outcome.row or run_facts(cell.ready, run_id, outcome.status, outcome.reason) | {
            "seed": seed,
            "wall_time_s": outcome.wall_time,
        }
        self._writer.add(RunTables(cell.id, row, outcome.steps, outcome.decisions, outcome.traceback, outcome.versions))
        self._rows[run_id] = {**row, "cell": cell.id}
        self._counts[str(outcome.status)] += 1
        self._new += 1
        self._report()
        return True

    def _is_enough(self, stage: int) -> bool:
        rule = self.design.file.stopping
        if rule is None:
            return False
        seeds = [seed for batch in self.design.stages[: stage + 1] for seed in batch]
        return is_enough([pd.DataFrame(self._rows_of(cell, seeds)) for cell in self.design.cells], rule)

    def _rows_of(self, cell: Cell, seeds: list[int]) -> Iterator[dict[str, object]]:
        return (self._rows[cell.run_id(seed)] for seed in seeds)

    def _report(self) -> None:
        if self.on_progress is None:
            return
        failed = sum(count for status, count in self._counts.items() if status not in ENDED_WELL)
        self.on_progress(Progress(len(self._planned), self._counts.total(), self._new, failed))
