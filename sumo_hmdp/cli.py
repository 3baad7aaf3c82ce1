"""The command line: `sumo-hmdp decide | run | check | list`."""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from sumo_hmdp.errors import InputError, SumoHmdpError
from sumo_hmdp.planning.decide import SOLVERS, answer
from sumo_hmdp.planning.problem_file import answer_document, read_problem
from sumo_hmdp.planning.registry import planner_kinds
from sumo_hmdp.report.replay import write_replay
from sumo_hmdp.scenario.load import (
    ReadyRun,
    RunOptions,
    find_scenario,
    load_scenario,
    read_yaml,
    scenario_names,
)
from sumo_hmdp.sim.episode import Moment
from sumo_hmdp.study.record import RunStatus, Trace
from sumo_hmdp.study.run import RunRecord, execute, save
from sumo_hmdp.study.store import writable_folder
from sumo_hmdp.validation import nearest

BAD_INPUT, FAILED, INTERRUPTED = 2, 1, 130

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    help="Co-simulation studies of hybrid-MDP, chance-constrained driving decisions in SUMO.",
)
out, err = Console(), Console(stderr=True)


def main() -> None:
    """Run the command line; a mistake of the user ends with exit code 2 and one line per mistake."""
    try:
        app()
    except InputError as error:
        _complain(error)
        sys.exit(BAD_INPUT)
    except SumoHmdpError as error:
        err.print(f"error: {error}", style="red", markup=False, soft_wrap=True)
        sys.exit(FAILED)


def _complain(error: InputError) -> None:
    for line in error.lines():
        err.print(line, style="red", markup=False, highlight=False, soft_wrap=True)


SolverOption = Annotated[str, typer.Option(help=f"How a decision is solved: {', '.join(SOLVERS)}.")]


@app.command()
def decide(
    files: Annotated[list[Path], typer.Argument(help="Decision problems, JSON.", show_default=False)],
    solver: SolverOption = "milp",
) -> None:
    """Solve decision problems from files; one line of JSON each, in the order of the files.

    A file with mistakes gets one line per mistake on standard error and none on standard output; the others are
    still answered, and the exit code is 2.

    Example: `sumo-hmdp decide results/decision_files/case2-hmdp_mpc-eps0.05-seed0/0010.json`
    """
    if solver not in SOLVERS:
        raise InputError([f"--solver: must be a known solver, got {solver!r}; {nearest(solver, SOLVERS)}"])
    clean = True
    for file in files:
        try:
            problem = read_problem(file)
        except InputError as error:
            _complain(error)
            clean = False
            continue
        sys.stdout.write(json.dumps(answer_document(answer(problem, SOLVERS[solver]))) + "\n")
        sys.stdout.flush()
    if not clean:
        raise typer.Exit(BAD_INPUT)


@app.command()
def run(
    scenario: Annotated[str, typer.Argument(help="A scenario's name (see `list`) or YAML file.", show_default=False)],
    planner: Annotated[str | None, typer.Option(help="Another planner than the scenario's own.")] = None,
    solver: SolverOption = "milp",
    seed: Annotated[int, typer.Option(help="Seed of everything random.", min=0, max=2**31 - 1)] = 0,
    epsilon: Annotated[float | None, typer.Option(help="Another risk level than the scenario's, in (0, 0.5].")] = None,
    out_dir: Annotated[Path, typer.Option("--out", help="Directory for tables, manifest and page.")] = Path("results"),
    trace: Annotated[Trace, typer.Option(help="Which vehicles the `steps` table keeps.")] = Trace.ALL,
    dump_decisions: Annotated[  # noqa: FBT002 - a flag of the command line
        bool,
        typer.Option("--dump-decisions", help="Write every decision as a file that `decide` answers again."),
    ] = False,
) -> None:
    """Run one scenario: tables in Parquet, a manifest, and a page with a replay.

    Example: `sumo-hmdp run case2 --epsilon 0.01 --out results`

    Read it back with `import sumo_hmdp; results = sumo_hmdp.load("results")`.
    """
    ready = load_scenario(find_scenario(scenario), RunOptions(planner, solver, seed, epsilon))
    folder = writable_folder(out_dir)
    record = _execute_with_progress(ready)
    save(record, folder, trace, dump_decisions=dump_decisions)
    page = folder / f"{record.run_id}.html"
    if len(record.steps):
        write_replay(page, record.manifest, record.steps, record.decisions)
    out.print(summary_table(record))
    out.print(f"tables: {folder}    page: {page}", markup=False, highlight=False, soft_wrap=True)
    if record.status is RunStatus.FAILED:
        err.print(
            f"the run failed: {record.reason}; the traceback is in {folder / 'failures' / (record.run_id + '.txt')}",
            style="red", markup=False, soft_wrap=True,
        )  # fmt: skip
        raise typer.Exit(FAILED)
    if record.status is RunStatus.INTERRUPTED:
        err.print("interrupted; everything up to here was kept", style="yellow")
        raise typer.Exit(INTERRUPTED)


def _execute_with_progress(ready: ReadyRun) -> RunRecord:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[now]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=err, transient=True) as progress:
        task = progress.add_task(f"{ready.scenario} · {ready.planner_name}", total=ready.episode.steps, now="0.0 s")

        def on_moment(moment: Moment) -> None:
            progress.update(task, completed=moment.step, now=f"{moment.scene.time:.1f} of {ready.episode.duration:g} s")

        return execute(ready, on_moment)


SUMMARY = (
    ("distance_m", "distance", "m", 1),
    ("speed_mean_mps", "mean speed", "m/s", 2),
    ("gap_min_m", "smallest gap", "m", 1),
    ("ttc_min_s", "smallest time to collision", "s", 1),
    ("lane_change_count", "lane changes", "", 0),
    ("lane_change_first_s", "first lane-change decision at", "s", 2),
    ("decision_count", "decisions", "", 0),
    ("solve_time_median_ms", "decision time, median", "ms", 1),
    ("solve_time_max_ms", "decision time, worst", "ms", 1),
    ("contact_count", "contacts", "", 0),
)


def summary_table(record: RunRecord) -> Table:
    """Return what a reader wants to know of a run first."""
    table = Table(title=f"{record.run_id}: {record.status}", show_header=False)
    if record.reason:
        table.add_row("why", record.reason)
    for key, label, unit, digits in SUMMARY:
        value = record.row[key]
        table.add_row(label, "none" if value is None else f"{value:.{digits}f} {unit}".rstrip())
    shares = ", ".join(
        f"{name} {100 * (record.row[f'{name}_share'] or 0):.1f} %" for name in ("optimal", "relaxed", "fallback")
    )
    table.add_row("statuses", shares)
    table.add_row("trace hash", record.row["trace_hash"][:16])
    return table


@app.command()
def check(
    files: Annotated[
        list[str], typer.Argument(help="Scenario files or names, or decision problems.", show_default=False)
    ],
) -> None:
    """Validate files without running them; one line per mistake, exit code 2 if there is any.

    Example: `sumo-hmdp check my_scenario.yaml`
    """
    clean = True
    for name in files:
        try:
            if name.endswith(".json"):
                read_problem(Path(name))
            else:
                load_scenario(find_scenario(name))
        except InputError as error:
            _complain(error)
            clean = False
        else:
            out.print(f"{name}: ok", markup=False, highlight=False)
    if not clean:
        raise typer.Exit(BAD_INPUT)


@app.command(name="list")
def list_all() -> None:
    """List the scenarios that come with the package, and the planners."""
    scenarios = Table("scenario", "planner", "what it is", title="scenarios")
    for name, path in scenario_names().items():
        content = read_yaml(path)
        scenarios.add_row(name, content["planner"], " ".join(content["description"].split()))
    planners = Table("planner", "what it does", title="planners")
    for name, kind in sorted(planner_kinds().items()):
        planners.add_row(name, kind.summary)
    out.print(scenarios)
    out.print(planners)
