"""What a study costs besides its runs: processes, the parent, memory, files, and going on with thousands of runs.

Prints a Markdown table. Speeds are taken in turns and compared with each other, for absolute times depend on the
machine; run it on one that does nothing else.

    python analysis/10_studies.py --turns 3 --runs 40 --memory-runs 500 --store-runs 8100
"""

import argparse
import os
import resource
import statistics
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import sumo_hmdp
from sumo_hmdp.study.design import Design, load_design
from sumo_hmdp.study.parts import RunTables, Writer, opened, study_hash
from sumo_hmdp.study.pool import LocalPool
from sumo_hmdp.study.record import tables_hash
from sumo_hmdp.study.recovery import sweep
from sumo_hmdp.study.run import execute
from sumo_hmdp.study.runner import Study, in_order, job_of
from sumo_hmdp.study.store import TABLES

# 30 s of traffic: about a second of computing on one core.
STUDY = """
name: overhead
scenarios: [highway]
factors: {{planner: [hmdp_mpc], duration_s: [{duration}], traffic.density_vpkm_per_lane: [{densities}]}}
seeds: {{first: 0, count: {seeds}}}
solver: search
"""


def design_of(folder: Path, seeds: int, duration: float = 30.0, densities: str = "15.0") -> Design:
    """Write a study file and read it."""
    file = folder / "study.yaml"
    file.write_text(STUDY.format(seeds=seeds, duration=duration, densities=densities), encoding="utf-8")
    return load_design(file)


@dataclass(frozen=True)
class Done:
    """What a study took: time from start to end, of it the parent's own computing [s], and its hash."""

    wall: float
    parent: float
    hash: str


def run_study(seeds: int, workers: int) -> Done:
    """Do a study from nothing, the start of its processes included."""
    with tempfile.TemporaryDirectory() as scratch:
        design = design_of(Path(scratch), seeds)
        pool = LocalPool(workers)
        with opened(Path(scratch) / "out") as folder:
            study = Study(design, folder, sweep(folder), pool)
            usage, began = resource.getrusage(resource.RUSAGE_SELF), time.monotonic()
            try:
                study.run()
            finally:
                pool.close()
            wall, after = time.monotonic() - began, resource.getrusage(resource.RUSAGE_SELF)
            parent = after.ru_utime + after.ru_stime - usage.ru_utime - usage.ru_stime
            return Done(wall, parent, study.hash())


def speed_rows(turns: int, runs: int) -> list[tuple[str, str]]:
    """Compare one worker with two, in turns."""
    pairs = [(run_study(runs, 1), run_study(runs, 2)) for _ in range(turns)]
    if len({done.hash for pair in pairs for done in pair}) != 1:
        raise AssertionError("one and two workers must leave the same tables")
    factors = [one.wall / two.wall for one, two in pairs]
    shares = [two.parent / two.wall for _, two in pairs]
    return [
        (f"two workers over one, {runs} runs, {turns} turns", f"{statistics.median(factors):.2f} times as fast"),
        ("the parent's computing beside two workers", f"{100 * statistics.median(shares):.1f} % of one core"),
    ]


def resident_mb(pid: int) -> float:
    """Return the memory that a process has in use [MB]."""
    pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def memory_rows(runs: int) -> list[tuple[str, str]]:
    """Do many runs in one process that is never replaced."""
    with tempfile.TemporaryDirectory() as scratch:
        design = design_of(Path(scratch), runs, duration=4.0)
        pool = LocalPool(1, runs_per_worker=runs + 1)
        began, first, resident = time.monotonic(), 0.0, []
        try:
            for cell, seed in in_order(design.cells, design.seeds):
                pool.submit(job_of(design, cell, seed))
                while not (outcomes := pool.collect(1.0)):
                    pass
                first = first or time.monotonic() - began - outcomes[0].wall_time
                (pid,) = pool.process_ids
                resident.append(resident_mb(pid))
        finally:
            pool.close()
    marks = [n for n in (1, 50, 100, 200, 500, 1000) if n < runs] + [runs]
    told = ", ".join(f"{resident[n - 1]:.0f} MB after {n}" for n in marks)
    return [
        ("from a worker's start to its first run", f"{first:.1f} s"),
        ("memory of one worker over runs of 4 s", told),
    ]


def store_rows(runs: int) -> list[tuple[str, str]]:
    """Write a store of many runs, in batches as a study does, and go on with it."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        design = design_of(folder, runs // 18, duration=60.0, densities=", ".join(f"{10 + k / 2}" for k in range(18)))
        record = execute(design.cells[0].ready, detailed=False)
        row = record.row | {"tables_hash": tables_hash(record.decisions)}
        batches, began = 0, time.monotonic()
        with opened(folder / "out") as out:
            writer = Writer(out, design.cells)
            writer.describe_cells()
            for cell, seed in in_order(design.cells, design.seeds):
                run_id = cell.run_id(seed)
                decisions = record.decisions.assign(run_id=run_id)
                writer.add(
                    RunTables(cell.id, {**row, "run_id": run_id, "seed": seed}, record.steps.iloc[:0], decisions)
                )
                # What two workers finish in ten seconds.
                if writer.waiting == 10:
                    writer.flush()
                    batches += 1
            writer.flush()
            written = (time.monotonic() - began) / max(1, batches)
            times = []
            for what in (lambda: sweep(out), lambda: study_hash(out, sweep(out).run_ids), lambda: sumo_hmdp.load(out)):
                began = time.monotonic()
                what()
                times.append(time.monotonic() - began)
            files = [file for table in TABLES for file in (out / table).rglob("*.parquet")]
            size = sum(file.stat().st_size for file in files) / 1e6
    count = f"{len(design.cells) * len(design.seeds):,} runs"
    return [
        (f"files of {count}", f"{len(files)}, {size:.0f} MB"),
        ("writing a batch of 10 runs", f"{1000 * written:.0f} ms"),
        (f"going on with {count}: what is finished", f"{times[0]:.2f} s"),
        (f"the study hash of {count}", f"{times[1] - times[0]:.2f} s"),
        (f"`load` of {count}", f"{times[2]:.2f} s"),
    ]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--memory-runs", type=int, default=500)
    parser.add_argument("--store-runs", type=int, default=8100)
    given = parser.parse_args()
    measures = (
        lambda: store_rows(given.store_runs),
        lambda: memory_rows(given.memory_runs),
        lambda: speed_rows(given.turns, given.runs),
    )
    if given.turns < 1:
        parser.error(f"--turns must be at least 1, got {given.turns}")
    print("| what | measured |\n| --- | --- |")
    for measure in measures:
        for what, measured in measure():
            print(f"| {what} | {measured} |", flush=True)


if __name__ == "__main__":
    main()
