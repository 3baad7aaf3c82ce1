"""The command line: `sumo-hmdp run`, and the commands of the other files `cli_*.py`."""
# ruff: noqa: PLC0415 - a command imports what it needs when it runs, so that `--help` answers at once

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from typer.exceptions import TyperException

from sumo_hmdp import (
    cli_check,
    cli_compare,
    cli_decide,
    cli_planner,
    cli_predict,
    cli_replay,
    cli_report,
    cli_study,
    cli_watch,
)
from sumo_hmdp.cli_common import (
    BAD_INPUT,
    FAILED,
    INTERRUPTED,
    RUNS,
    JsonOption,
    PlannerOption,
    ScenarioArgument,
    SolverOption,
    busy,
    complain,
    error_console,
    print_json,
    remark,
    say,
    show_table,
    tell,
    usage_line,
)
from sumo_hmdp.errors import InputError, SumoHmdpError

if TYPE_CHECKING:
    from rich.table import Table

    from sumo_hmdp.scenario.load import ReadyRun
    from sumo_hmdp.sim.episode import Moment
    from sumo_hmdp.study.run import RunRecord

app = typer.Typer(
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    help="Traffic studies of driving decisions in SUMO: runs, studies of many runs, and what they show.",
    epilog=(
        "Start with `sumo-hmdp run case2`, then open the page that it names. "
        "`sumo-hmdp COMMAND --help` has examples and says which files come out."
    ),
)


def main() -> None:
    """Run the command line; a mistake of the user ends with exit code 2 and one line per mistake."""
    try:
        # Without anything: the help, as somebody who types the bare name is looking for it.
        sys.exit(app(sys.argv[1:] or ["--help"], prog_name="sumo-hmdp", standalone_mode=False) or 0)
    except InputError as error:
        complain(error)
        sys.exit(BAD_INPUT)
    except TyperException as error:
        say(usage_line(error), typer.colors.RED)
        sys.exit(error.exit_code)
    except SumoHmdpError as error:
        say(f"error: {error}", typer.colors.RED)
        sys.exit(FAILED)


def _show_version(wanted: bool) -> None:  # noqa: FBT001 - a callback of Typer
    if wanted:
        tell(f"sumo-hmdp {version('sumo-hmdp')}")
        raise typer.Exit


@app.callback()
def options(
    _version: Annotated[  # noqa: FBT002 - a flag of the command line
        bool, typer.Option("--version", help="Show the version and exit.", callback=_show_version, is_eager=True)
    ] = False,
) -> None:
    """Take the options that stand before a command."""


@app.command(rich_help_panel=RUNS)
def run(
    scenario: ScenarioArgument,
    planner: PlannerOption = None,
    solver: SolverOption = "milp",
    seed: Annotated[int, typer.Option(help="Seed of everything random.", min=0, max=2**31 - 1)] = 0,
    epsilon: Annotated[float | None, typer.Option(help="Another risk level than the scenario's, in (0, 0.5].")] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="PATH=VALUE", help="Another value of the scenario, e.g. ego.speed_mps=25."),
    ] = None,
    out_dir: Annotated[Path, typer.Option("--out", help="Directory for tables, manifest and page.")] = Path("results"),
    trace: Annotated[
        Literal["none", "ego", "all"], typer.Option(help="Which vehicles the `steps` table keeps.")
    ] = "all",
    dump_decisions: Annotated[  # noqa: FBT002 - a flag of the command line
        bool,
        typer.Option("--dump-decisions", help="Write every decision as a file that `decide` answers again."),
    ] = False,
    as_json: JsonOption = False,  # noqa: FBT002 - a flag of the command line
) -> None:
    """Run one scenario: tables in Parquet, a manifest, and a page with a replay.

    Examples:
    - `sumo-hmdp run case2 --epsilon 0.01 --out results`
    - `sumo-hmdp run highway --planner idm_mobil --seed 3`
    - `sumo-hmdp run highway --set traffic.density_vpkm_per_lane=25 --set duration_s=30`
    - `sumo-hmdp run my_scenario.yaml --json`

    Files, all in `--out`, NAME being scenario, planner, risk level and seed: `NAME.html`, the page with the replay;
    `runs/`, `decisions/` and `steps/NAME.parquet`, the tables; `manifests/NAME.json`, configuration, versions and
    trace hash; `failures/NAME.txt`, the traceback of a run that failed; `decision_files/NAME/` with
    `--dump-decisions`. Read them back in Python with `sumo_hmdp.load("results")`.
    """
    from sumo_hmdp.report.replay import write_replay
    from sumo_hmdp.scenario.load import RunOptions, find_scenario, load_scenario
    from sumo_hmdp.scenario.overrides import read_settings
    from sumo_hmdp.study.reasons import Reasons
    from sumo_hmdp.study.record import RunStatus, Trace
    from sumo_hmdp.study.run import save
    from sumo_hmdp.study.store import dispute_path, page_path, traceback_path, writable_folder

    overrides = read_settings(settings or [])
    ready = load_scenario(find_scenario(scenario), RunOptions(planner, solver, seed, epsilon, overrides))
    for note in ready.notes:
        remark(f"note: {note}", as_json=as_json)
    folder = writable_folder(out_dir)
    reasons = Reasons()
    record = _execute_with_progress(ready, reasons.observe)
    page: Path | None = None
    with _writing():
        save(record, folder, Trace(trace), dump_decisions=dump_decisions)
        if len(record.steps):
            page = page_path(folder, record.run_id)
            with busy("weighing the other first actions"):
                weighed = reasons.beside(record.decisions)
            write_replay(page, record.manifest, record.steps, weighed)
    if as_json:
        print_json({"run": record.row, "results": str(folder), "page": None if page is None else str(page)})
    else:
        show_table(summary_table(record))
        tell(f"tables: {folder}" + ("" if page is None else f"    page: {page}"))
    if record.status is RunStatus.FAILED:
        where = traceback_path(folder, record.run_id)
        say(f"the run failed: {record.reason}; the traceback is in {where}", typer.colors.RED)
        if record.disputed is not None:
            say(f"the disputed decision is in {dispute_path(folder, record.run_id)}", typer.colors.RED)
        raise typer.Exit(FAILED)
    if record.status is RunStatus.INTERRUPTED:
        say("interrupted; everything up to here was kept", typer.colors.YELLOW)
        raise typer.Exit(INTERRUPTED)


@contextmanager
def _writing() -> Iterator[None]:
    """Finish what is being written in spite of Ctrl-C; a disk that takes no more is an error in one line."""
    in_main = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGINT, signal.SIG_IGN) if in_main else None
    try:
        yield
    except OSError as error:
        raise SumoHmdpError(f"the results cannot be written: {error}. Make room, or choose another --out") from error
    finally:
        if in_main:
            signal.signal(signal.SIGINT, before)


def _execute_with_progress(ready: "ReadyRun", watch: "Callable[[Moment], None]") -> "RunRecord":
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from sumo_hmdp.study.run import execute

    console = error_console()
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.fields[now]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(f"{ready.scenario} · {ready.planner_name}", total=ready.episode.steps, now="0.0 s")

        def on_moment(moment: "Moment") -> None:
            watch(moment)
            progress.update(task, completed=moment.step, now=f"{moment.scene.time:.1f} of {ready.episode.duration:g} s")

        return execute(ready, on_moment)


SUMMARY = (
    ("distance_m", "distance", "m", 1),
    ("speed_mean_mps", "mean speed", "m/s", 2),
    ("gap_min_m", "smallest gap", "m", 1),
    ("ttc_min_s", "smallest time to collision", "s", 1),
    ("distance_shortfall_max_m", "worst shortfall of the safe distance", "m", 1),
    ("lane_change_count", "lane changes", "", 0),
    ("lane_change_first_s", "first lane-change decision at", "s", 2),
    ("decision_count", "decisions", "", 0),
    ("solve_time_median_ms", "decision time, median", "ms", 1),
    ("solve_time_max_ms", "decision time, worst", "ms", 1),
    ("contact_count", "contacts", "", 0),
)


def summary_table(record: "RunRecord") -> "Table":
    """Return what a reader wants to know of a run first."""
    from rich.table import Table

    from sumo_hmdp.domain.plan import PLANNED_STATUSES
    from sumo_hmdp.study.run import first_decision_note

    table = Table(title=f"{record.run_id}: {record.status}", show_header=False, box=None, padding=(0, 0, 0, 2))
    if record.reason:
        table.add_row("why", record.reason)
    for sentence in record.manifest["contact_disagreements"]:
        table.add_row("note", sentence)
    if "tracks_sha256" in record.manifest and (told := first_decision_note(record.decisions)):
        table.add_row("note", told)
    # What was published is of the scenario's own planner.
    own = record.row["planner"] == record.manifest["configuration"]["planner"]
    published = (record.manifest["configuration"].get("published") or {}) if own else {}
    for key, label, unit, digits in SUMMARY:
        value = record.row[key]
        shown = "none" if value in (None, float("inf")) else f"{value:.{digits}f} {unit}".rstrip()
        if value is not None and published.get(key) is not None:
            shown += f" (published {published[key]:.{digits}f}, {value - published[key]:+.{digits}f} {unit})"
        table.add_row(label, shown)
    shares = ", ".join(
        f"{name} {100 * share:.1f} %" for name in PLANNED_STATUSES if (share := record.row[f"{name}_share"]) is not None
    )
    table.add_row("statuses", shares or ("rule" if record.row["decision_count"] else "none"))
    for name, told in (("risk of plans", risk_text(record)), ("not covered", uncovered_text_of(record))):
        if told:
            table.add_row(name, told)
    if not record.row["reproducible"]:
        table.add_row("not reproducible", "the deadline was enforced: results depend on the machine's speed")
    table.add_row("trace hash", record.row["trace_hash"][:16])
    return table


def risk_text(record: "RunRecord") -> str:
    """Return the risk that optimal plans took, in words; empty where none is computed."""
    from sumo_hmdp.report.short import percent

    decisions, asked = record.decisions, record.manifest["risk_level"]
    taken = decisions.loc[decisions["status"] == "optimal", "risk_taken"].dropna()
    if not len(taken) or asked is None:
        return ""
    return f"{percent(taken.median())} median, {percent(taken.max())} at most, of {percent(asked)} (optimal plans)"


def uncovered_text_of(record: "RunRecord") -> str:
    """Return what epsilon does not cover of the prediction, in words; empty where all is covered."""
    from sumo_hmdp.report.short import uncovered_of_run

    return uncovered_of_run(record.manifest, record.decisions["pruned_prob"])


for commands in (
    cli_watch,
    cli_replay,
    cli_study,
    cli_report,
    cli_compare,
    cli_predict,
    cli_check,
    cli_decide,
    cli_planner,
):
    commands.add_commands(app)
