"""The commands on studies: `sumo-hmdp study | repro`."""
# ruff: noqa: PLC0415 - a command imports what it needs when it runs, so that `--help` answers at once

import os
import shlex
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Annotated

import typer

from sumo_hmdp.cli_common import (
    INTERRUPTED,
    STUDIES,
    JsonOption,
    busy,
    complete_run,
    complete_solver,
    complete_study,
    error_console,
    print_json,
    remark,
    say,
    show_table,
    tell,
)
from sumo_hmdp.errors import InputError, SumoHmdpError

if TYPE_CHECKING:
    from rich.table import Table

    from sumo_hmdp.study.design import Design
    from sumo_hmdp.study.forecast import Forecast
    from sumo_hmdp.study.pool import Pool
    from sumo_hmdp.study.recovery import Finished
    from sumo_hmdp.study.runner import Progress, Study


def add_commands(app: typer.Typer) -> None:
    """Add the commands of this file to the command line."""
    app.command(rich_help_panel=STUDIES)(study)
    app.command(rich_help_panel=STUDIES)(repro)


def study(
    file: Annotated[
        str,
        typer.Argument(
            help="A study file, or the name of one that comes along.", show_default=False, autocompletion=complete_study
        ),
    ],
    out_dir: Annotated[Path, typer.Option("--out", help="The study's own directory; what is done there stays.")],
    workers: Annotated[int | None, typer.Option(help="Processes; without it one a core.", min=1)] = None,
    dask: Annotated[str | None, typer.Option(help="Address of a Dask scheduler to run on instead.")] = None,
    limit: Annotated[int | None, typer.Option(help="End after so many runs; the same command goes on.", min=1)] = None,
    dry_run: Annotated[  # noqa: FBT002 - a flag of the command line
        bool, typer.Option("--dry-run", help="Check everything, do one run to tell time and disk, and stop.")
    ] = False,
    retry_failed: Annotated[  # noqa: FBT002 - a flag of the command line
        bool, typer.Option("--retry-failed", help="Do runs that failed, crashed or timed out again, too.")
    ] = False,
    solver: Annotated[
        str | None, typer.Option(help="Another solver than the file's.", autocompletion=complete_solver)
    ] = None,
    as_json: JsonOption = False,  # noqa: FBT002 - a flag of the command line
) -> None:
    """Run every scenario of a study with every combination of its factors and every seed.

    The same command goes on after whatever ended it: nothing is run twice, nothing that was finished is lost. The exit
    code is 0 if every run ended well, 1 if some failed, timed out or crashed (they are in `runs` and `ledger.jsonl`).

    Examples:
    - `sumo-hmdp study case2_epsilon --out results/epsilon --workers 2`
    - `sumo-hmdp study my_study.yaml --out results/mine --dry-run`
    - `sumo-hmdp study my_study.yaml --out results/mine --dask tcp://10.0.0.1:8786`

    Files, in `--out`: `runs/`, `decisions/` and `steps/`, the tables; `cells/*.json`, what each cell is; `study.yaml`,
    the file as it was run; `ledger.jsonl` and `failures/`, what went wrong. Then: `sumo-hmdp report` and `compare`.
    """
    from sumo_hmdp.report.study_seeds import shortfalls
    from sumo_hmdp.study.design import find_study, load_design
    from sumo_hmdp.study.parts import opened
    from sumo_hmdp.study.pool import PoolLostError
    from sumo_hmdp.study.recovery import sweep
    from sumo_hmdp.study.resume import keep_file
    from sumo_hmdp.study.runner import Study

    if workers is not None and dask is not None:
        raise InputError(["--workers: must not go with --dask; leave one of the two out"])
    path = find_study(file)
    design = load_design(path, solver)
    for note in (*design.notes, *shortfalls(design)):
        remark(f"note: {note}", as_json=as_json)
    count = workers or len(os.sched_getaffinity(0))
    if dry_run:
        _show_forecast(design, count, as_json=as_json)
        return
    with opened(out_dir):
        finished = _go_on(design, out_dir, sweep(out_dir), retry_failed=retry_failed)
        keep_file(path, out_dir / "study.yaml", solver)
        pool = _pool(count, dask)
        with _progress() as on_progress, _ending_by_signal():
            work = Study(design, out_dir, finished, pool, limit, on_progress)
            try:
                complete = work.run()
            except KeyboardInterrupt:
                say(f"interrupted; what is finished was kept. Go on with\n{_again()}")
                raise typer.Exit(INTERRUPTED) from None
            except PoolLostError as error:
                raise SumoHmdpError(f"{error}; what is finished was kept. Go on with `{_again()}`") from None
            finally:
                pool.close()
        _show_end(work, out_dir, complete=complete, as_json=as_json)


def _again() -> str:
    return shlex.join(["sumo-hmdp", *sys.argv[1:]])


def _pool(workers: int, dask: str | None) -> "Pool":
    from sumo_hmdp.study.dask_pool import DaskPool
    from sumo_hmdp.study.pool import LocalPool

    return LocalPool(workers) if dask is None else DaskPool(dask)


def _go_on(design: "Design", folder: Path, finished: "Finished", *, retry_failed: bool) -> "Finished":
    """Say what a reader must know before old and new runs stand in one table, and take back what is done again."""
    from sumo_hmdp.study.parts import Writer
    from sumo_hmdp.study.resume import changes, take_back
    from sumo_hmdp.study.runner import asked_of

    for line in finished.damaged:
        say(line, typer.colors.YELLOW)
    Writer(folder, design.cells).describe_cells()
    asked = asked_of(design, design.seeds)
    left, told = take_back(folder, finished, asked, retry_failed=retry_failed)
    for line in (*told, *changes(folder, left, asked)):
        say(line, typer.colors.YELLOW)
    return left


@contextmanager
def _ending_by_signal() -> Iterator[None]:
    """End at SIGTERM, by which clusters announce their time limit, as at Ctrl-C."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    in_main = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGTERM, interrupt) if in_main else None
    try:
        yield
    finally:
        if in_main:
            signal.signal(signal.SIGTERM, before)


@contextmanager
def _progress() -> Iterator[Callable[["Progress"], None]]:
    from rich.progress import BarColumn, MofNCompleteColumn, ProgressColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns: tuple[ProgressColumn, ...] = (
        BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[failed]} failed"),
        TextColumn("{task.fields[rate]}"), TimeRemainingColumn(),
    )  # fmt: skip
    console = error_console()
    with Bar(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("runs", total=None, failed=0, rate="")

        def on_progress(now: "Progress") -> None:
            elapsed = bar.tasks[0].elapsed or 0.0
            rate = f"{now.new / elapsed:.2f} runs/s" if now.new and elapsed else ""
            bar.update(task, total=now.planned, completed=now.done, failed=now.failed, rate=rate)

        yield on_progress


def _show_end(work: "Study", folder: Path, *, complete: bool, as_json: bool) -> None:
    counts = work.counts()
    if as_json:
        by_status = dict(sorted(counts.items()))
        print_json({"results": str(folder), "runs": by_status, "complete": complete, "study_hash": work.hash()})
    else:
        tell(f"{counts.total()} runs: {', '.join(f'{n} {status}' for status, n in sorted(counts.items()))}")
        tell(f"tables: {folder}    study hash: {work.hash()}")
    if not complete:
        remark(f"stopped at --limit; go on with\n{_again()}", as_json=as_json)
    if set(counts) - {"completed", "contact"}:
        raise SumoHmdpError(f"some runs did not end well; {folder / 'ledger.jsonl'} says why, failures/ has tracebacks")


def _show_forecast(design: "Design", workers: int, *, as_json: bool) -> None:
    from sumo_hmdp.study.forecast import forecast

    with busy("doing a run of a few cells to tell time and disk"):
        found = forecast(design)
    if as_json:
        print_json(forecast_document(design, found, workers))
    else:
        # In a file, too, a cell's name is whole.
        show_table(design_table(design), width=200)
        tell(forecast_text(design, found, workers))
    for one in found:
        if one.reason:
            say(f"{one.run_id} ended as {one.status}: {one.reason}", typer.colors.YELLOW)


def forecast_document(design: "Design", found: "Sequence[Forecast]", workers: int) -> dict[str, object]:
    """Return what a study will take at most, as JSON has it."""
    from sumo_hmdp.study.forecast import size_of

    run_count = len(design.cells) * len(design.seeds)
    return {
        "cells": [{"cell": cell.id, "factors": dict(cell.factors)} for cell in design.cells],
        "run_count_min": len(design.cells) * len(design.stages[0]),
        "run_count_max": run_count,
        "wall_time_max_s": fmean(one.wall_time for one in found) * run_count / workers,
        "size_max_byte": round(size_of(design, found)),
        "measured_runs": [
            {"run_id": one.run_id, "status": str(one.status), "wall_time_s": one.wall_time} for one in found
        ],
    }


def design_table(design: "Design") -> "Table":
    """Return the cells of a study with their factors and how many runs each has."""
    from rich.table import Table

    named = dict.fromkeys(name for cell in design.cells for name in cell.factors)
    values = {name: {str(cell.factors.get(name, "")) for cell in design.cells} for name in named}
    # What is the same everywhere stands once, above.
    names = [name for name in named if len(values[name]) > 1]
    same = ", ".join(f"{name} {value}" for name in named if name not in names for value in values[name])
    stages = design.stages
    runs = str(len(stages[0])) if len(stages) == 1 else f"{len(stages[0])} to {len(design.seeds)}"
    table = Table("cell", *names, "runs", title=f"{design.file.name}: {same}" if same else design.file.name)
    for cell in design.cells:
        table.add_row(cell.id, *(str(cell.factors.get(name, "")) for name in names), runs)
    return table


def forecast_text(design: "Design", found: "Sequence[Forecast]", workers: int) -> str:
    """Say what a study will take, and what this is taken from."""
    from sumo_hmdp.study.forecast import size_of

    low, high = (len(design.cells) * len(seeds) for seeds in (design.stages[0], design.seeds))
    span = f"{low}" if low == high else f"{low} to {high}"
    times, mean_size = [one.wall_time for one in found], fmean(one.size for one in found)
    hours, size = fmean(times) * high / workers / 3600, size_of(design, found) / 1e6
    time = f"{hours:.1f} h" if hours >= 1 else f"{60 * hours:.1f} min"
    took = f"{times[0]:.2f} s" if len(times) == 1 else f"{min(times):.2f} to {max(times):.2f} s"
    names = "\n  ".join(one.run_id for one in found)
    return (
        f"{len(design.cells)} cells, {span} runs; at most about {time} with {workers} workers and {size:.1f} MB\n"
        f"if all runs are like these, which took {took} and {mean_size / 1e3:.0f} kB each:\n  {names}"
    )


def repro(
    folder: Annotated[Path, typer.Argument(help="A results directory.", show_default=False)],
    run_id: Annotated[
        str,
        typer.Argument(help="A run in it, as in the table `runs`.", show_default=False, autocompletion=complete_run),
    ],
    as_json: JsonOption = False,  # noqa: FBT002 - a flag of the command line
) -> None:
    """Do a stored run again, from what is stored of it alone, and compare the traces bit for bit.

    Examples:
    - `sumo-hmdp repro results case2-hmdp_mpc-eps0.05-seed0`
    - `sumo-hmdp repro results/epsilon RUN_ID --json`

    No file comes out. The exit code is 0 if the traces are the same, 1 if they differ.
    """
    from sumo_hmdp.study.repro import reproduce

    with busy(f"doing {run_id} again"):
        found = reproduce(folder, run_id)
    if as_json:
        print_json({"run_id": run_id, "same": found.same, **asdict(found)})
    for line in found.versions:
        remark(f"other version: {line}", as_json=as_json)
    if found.same and as_json:
        return
    if found.same:
        tell(f"the same: trace hash {found.new_hash[:16]}")
        return
    where = found.difference or "no stored step differs; what differs was not stored (see --trace)"
    raise SumoHmdpError(f"not the same: trace hash was {found.stored_hash[:16]}, is {found.new_hash[:16]}; {where}")
