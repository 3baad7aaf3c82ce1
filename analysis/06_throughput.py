"""How many seconds of traffic one second of computing simulates, and where the time goes.

The scenario is `highway` with a fixed number of background vehicles. Everything is measured in one process on the same
traffic, in turns: the closed loop with each solver, and SUMO alone. Then whole runs of `highway` as a study does
them, from the scenario to the tables. Absolute times depend on the machine; the ratios are what to quote. Run it with
`make bench-traffic`.
"""

import argparse
import importlib.util
import math
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Any

from sumo_hmdp.decision import decide
from sumo_hmdp.decision.planner import HmdpPlanner
from sumo_hmdp.documents import read_yaml
from sumo_hmdp.scenario import crowd
from sumo_hmdp.scenario.load import ReadyRun, RunOptions, assemble_scenario, find_scenario, load_scenario
from sumo_hmdp.sim.background import Background
from sumo_hmdp.sim.bodies import Bodies
from sumo_hmdp.sim.episode import TraceHash
from sumo_hmdp.sim.libsumo_world import LibsumoWorld
from sumo_hmdp.sim.motion import BicycleMotion
from sumo_hmdp.sim.sumo import libsumo
from sumo_hmdp.study import run as study_run
from sumo_hmdp.study.pool import RUNS_PER_WORKER
from sumo_hmdp.study.record import Recorder, Trace
from sumo_hmdp.study.run import execute, kept_steps

SOLVERS = ("search", "milp")
# Where the time goes: what is timed, and the row of the table that its own time counts in, without what it calls.
STEP, READ, MOBIL, WORLD = "SUMO's step", "reading", "MOBIL", "ego, ghost and entering vehicles"
PREDICT, SOLVE, TRACK, RECORD, REST = "prediction", "corridors and solving", "tracking", "recording", "the loop itself"
Stages = tuple[tuple[str, Any, str], ...]
STAGES: Stages = (
    (STEP, libsumo, "simulationStep"),
    (READ, Bodies, "read"),
    (READ, LibsumoWorld, "observe"),
    (READ, LibsumoWorld, "crossing"),
    (MOBIL, Background, "change_lanes"),
    (WORLD, LibsumoWorld, "advance"),
    (PREDICT, decide, "predict"),
    (PREDICT, decide, "margins"),
    (SOLVE, HmdpPlanner, "decide"),
    (TRACK, BicycleMotion, "move"),
    (RECORD, Recorder, "observe"),
    (RECORD, Recorder, "step_table"),
    (RECORD, Recorder, "decision_table"),
    (RECORD, study_run, "run_metrics"),
    (RECORD, TraceHash, "add"),
)
# The same for a whole run of a study; what is left of its loading is the reading and checking of the scenario.
LOAD, DRAW, WARM, START, LOOP = (
    "reading and checking",
    "drawing the traffic",
    "warm-up",
    "SUMO's start and end",
    "the loop",
)
TABLES, STORE, PROCESS = "tables and metrics", "Parquet", f"start of the process, shared by {RUNS_PER_WORKER} runs"
RUN_STAGES: Stages = (
    (DRAW, crowd, "initial_population"),
    (DRAW, crowd, "arrivals"),
    (WARM, crowd, "warm_up"),
    (START, LibsumoWorld, "__init__"),
    (START, LibsumoWorld, "__enter__"),
    (START, LibsumoWorld, "__exit__"),
    (LOOP, study_run, "run_episode"),
)
DENSITIES = (15.0, 25.0, 35.0)
# The ego of a world without planner swings to the lane on its right and back in this time [s].
SWING = 10.0


@dataclass
class Stopwatch:
    """Own time of nested calls by row [s]."""

    times: dict[str, float] = field(default_factory=dict)
    _inner: list[float] = field(default_factory=lambda: [0.0])

    def timed(self, row: str, action: Callable[..., object]) -> Callable[..., object]:
        """Return the action, whose own time counts in a row."""

        def call(*args: object, **options: object) -> object:
            self._inner.append(0.0)
            started = time.perf_counter()
            try:
                return action(*args, **options)
            finally:
                span = time.perf_counter() - started
                own = span - self._inner.pop()
                self._inner[-1] += span
                self.times[row] = self.times.get(row, 0.0) + own

        return call

    @contextmanager
    def watching(self, stages: Stages) -> Iterator[None]:
        """Time some stages."""
        with ExitStack() as stack:
            for row, owner, name in stages:
                action = getattr(owner, name)
                stack.callback(setattr, owner, name, action)
                setattr(owner, name, self.timed(row, action))
            yield


def traffic(vehicles: int, solver: str, seed: int) -> ReadyRun:
    """Return `highway` with a number of background vehicles, none of which enters or leaves."""
    text = find_scenario("highway").read_text()
    density = "density_vpkm_per_lane: 15.0"
    if text.count(density) != 1:
        raise SystemExit(f"the scenario highway must have the line `{density}`")
    # Three lanes of two kilometres.
    changed = text.replace(density, f"density_vpkm_per_lane: {vehicles / 6.0!r}\n  inflow: false")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "highway.yaml"
        path.write_text(changed)
        return load_scenario(path, RunOptions(solver=solver, seed=seed))


def closed_loop(run: ReadyRun) -> float:
    """Return how many seconds a run simulates in one."""
    started = time.perf_counter()
    record = execute(run, detailed=False)
    return float(record.row["duration_s"]) / (time.perf_counter() - started)


def stage_times(run: ReadyRun) -> dict[str, float]:
    """Return where the time of a run goes [ms per simulated second]; the watch takes a little itself."""
    watch = Stopwatch()
    started = time.perf_counter()
    with watch.watching(STAGES):
        record = execute(run, detailed=False)
    wall = time.perf_counter() - started
    watch.times[REST] = wall - sum(watch.times.values())
    return {row: 1000 * span / float(record.row["duration_s"]) for row, span in watch.times.items()}


def bare(run: ReadyRun) -> float:
    """Return the wall-clock time of a step of SUMO with the same traffic, untouched [s]."""
    with LibsumoWorld(run.world, run.episode.ego, run.spawns):
        started = time.perf_counter()
        for _ in range(run.episode.steps):
            libsumo.simulationStep()
        return (time.perf_counter() - started) / run.episode.steps


def driven(run: ReadyRun, *, observed: bool = True) -> float:
    """Return the wall-clock time of a step of the world, everybody read into arrays [s].

    If `observed`, those in sight are also handed out as the objects that a planner gets. The ego keeps its speed and
    swings between its lane and the next, so that half of the time it needs a ghost.
    """
    ego, dt, width = run.episode.ego, run.episode.dt, run.episode.road.lane_width
    with LibsumoWorld(run.world, ego, run.spawns) as world:
        started = time.perf_counter()
        for step in range(run.episode.steps):
            now = (step + 1) * dt
            phase = math.tau * now / SWING
            sideways = -width / 2 * math.sin(phase) * math.tau / SWING
            pose = replace(
                ego,
                x=ego.x + ego.speed * now,
                y=ego.y - width / 2 * (1.0 - math.cos(phase)),
                heading=math.atan2(sideways, ego.speed),
            )
            world.advance(pose, {})
            if observed:
                world.observe()
        return (time.perf_counter() - started) / run.episode.steps


def highway_env_speed(vehicles: int, seconds: int, seed: int) -> tuple[str, float]:
    """Return the version of highway-env, and how many seconds its `highway-v0` simulates in one at 15 Hz."""
    import gymnasium  # noqa: PLC0415
    import highway_env  # noqa: PLC0415

    gymnasium.register_envs(highway_env)
    config = {"vehicles_count": vehicles, "simulation_frequency": 15, "policy_frequency": 1, "duration": seconds}
    env = gymnasium.make("highway-v0", config=config)
    env.reset(seed=seed)
    idle, spent = 1, 0.0
    for second in range(seconds):
        started = time.perf_counter()
        _, _, terminated, truncated, _ = env.step(idle)
        spent += time.perf_counter() - started
        if terminated or truncated:
            env.reset(seed=seed + second + 1)
    env.close()
    return version("highway-env"), seconds / spent


def report(vehicles: int, repeats: int, seed: int) -> None:
    """Print the closed loop's speed, where its time goes, and SUMO's own."""
    runs = {solver: traffic(vehicles, solver, seed) for solver in SOLVERS}
    for run in runs.values():
        execute(run, detailed=False)
    rates: dict[str, list[float]] = {solver: [] for solver in SOLVERS}
    spent: dict[str, list[dict[str, float]]] = {solver: [] for solver in SOLVERS}
    steps, worlds, seen = [], [], []
    for _ in range(repeats):
        steps.append(bare(runs["search"]))
        worlds.append(driven(runs["search"], observed=False))
        seen.append(driven(runs["search"]))
        for solver, run in runs.items():
            rates[solver].append(closed_loop(run))
            spent[solver].append(stage_times(run))
    dt = runs["search"].episode.dt
    alone, world = statistics.median(steps), statistics.median(worlds)
    print("## The closed loop\n")
    print("| what | simulated seconds per second |")
    print("|---|---|")
    for solver in SOLVERS:
        print(f"| planner hmdp_mpc, {solver} | {statistics.median(rates[solver]):.1f} |")
    print(f"| SUMO alone, same traffic | {dt / alone:.0f} |\n")
    print("## Where the time goes\n")
    print("Own time [ms] per simulated second, and its share of the whole.\n")
    print("| stage | " + " | ".join(SOLVERS) + " |")
    print("|---|" + "---|" * len(SOLVERS))
    table = {
        solver: {row: statistics.median(times[row] for times in spent[solver]) for row in spent[solver][0]}
        for solver in SOLVERS
    }
    for row in dict.fromkeys([*(row for row, _, _ in STAGES), REST]):
        cells = (f"{table[s][row]:.2f} ({table[s][row] / sum(table[s].values()):.0%})" for s in SOLVERS)
        print(f"| {row} | " + " | ".join(cells) + " |")
    ratios = sorted(mine / bare for mine, bare in zip(worlds, steps, strict=True))
    print(
        f"\nA step of the world, with everybody read, MOBIL, an ego that is moved and its ghost, takes "
        f"{1000 * world:.2f} ms, a step of SUMO alone {1000 * alone:.2f} ms: {world / alone:.1f} times as much "
        f"({ratios[0]:.1f} to {ratios[-1]:.1f} in {repeats} turns). With those in sight handed out as a planner gets "
        f"them it is {statistics.median(seen) / alone:.1f} times.\n"
    )


def whole_run(density: float, seed: int) -> dict[str, float]:
    """Return where the time of one run of `highway` goes, as a study does it [ms]."""
    document, watch = read_yaml(find_scenario("highway")), Stopwatch()
    changes = {"traffic.density_vpkm_per_lane": density}
    clock = [time.perf_counter()]
    with watch.watching(RUN_STAGES), tempfile.TemporaryDirectory() as folder:
        run = assemble_scenario(document, RunOptions(solver="search", seed=seed, overrides=changes), Path("highway"))
        clock.append(time.perf_counter())
        record = execute(run, detailed=False)
        clock.append(time.perf_counter())
        for name, frame in (("steps", kept_steps(record, Trace.EGO)), ("decisions", record.decisions)):
            frame.to_parquet(Path(folder) / f"{name}.parquet", index=False)
        clock.append(time.perf_counter())
    loading, executing, storing = (later - earlier for earlier, later in pairwise(clock))
    times = watch.times
    times[LOAD] = loading - times[DRAW] - times[WARM]
    times[TABLES] = executing - times[START] - times[LOOP]
    times[STORE] = storing
    return {row: 1000 * span for row, span in times.items()}


def process_start() -> float:
    """Return how long a worker process takes until it can begin its first run [ms]."""
    started = time.perf_counter()
    subprocess.run([sys.executable, "-P", "-c", "import sumo_hmdp.study.worker"], check=True)
    return 1000 * (time.perf_counter() - started)


def report_runs(repeats: int, seed: int) -> None:
    """Print where the time of whole runs goes."""
    whole_run(DENSITIES[0], seed)
    columns = {}
    for density in DENSITIES:
        # Every run has a seed of its own: the traffic of one that has just been seen is kept.
        runs = [whole_run(density, seed + 1 + turn) for turn in range(repeats)]
        columns[density] = {row: statistics.median(run[row] for run in runs) for row in runs[0]}
    start = statistics.median(process_start() for _ in range(repeats)) / RUNS_PER_WORKER
    print("## Where the time of a run goes\n")
    print("A run of `highway`, 60 s, planner `hmdp_mpc` with `search`, as a study does it [ms], and the share of it.\n")
    print("| stage | " + " | ".join(f"{density:g} vehicles/km and lane" for density in DENSITIES) + " |")
    print("|---|" + "---|" * len(DENSITIES))
    for column in columns.values():
        column[PROCESS] = start
    for row in (PROCESS, LOAD, DRAW, WARM, START, LOOP, TABLES, STORE):
        cells = (f"{column[row]:.0f} ({column[row] / sum(column.values()):.1%})" for column in columns.values())
        print(f"| {row} | " + " | ".join(cells) + " |")
    print("| all | " + " | ".join(f"{sum(column.values()):.0f}" for column in columns.values()) + " |\n")


def compare(vehicles: int, repeats: int, seed: int) -> None:
    """Print our world next to highway-env's, if that is installed."""
    print(f"## Next to highway-env, {vehicles} vehicles\n")
    if importlib.util.find_spec("highway_env") is None:
        print("highway-env is not installed here (`pip install highway-env`), so there is nothing to compare with.")
        return
    run = traffic(vehicles, "search", seed)
    execute(run, detailed=False)
    theirs, world, loop, name = [], [], [], ""
    for turn in range(repeats):
        name, rate = highway_env_speed(vehicles, 40, seed + 100 * turn)
        theirs.append(rate)
        world.append(run.episode.dt / driven(run))
        loop.append(closed_loop(run))
    other = statistics.median(theirs)
    print("| what | simulated seconds per second | ratio |")
    print("|---|---|---|")
    print(f"| highway-env {name}, `highway-v0`, 15 Hz, ego idle, observed | {other:.1f} | 1.0 |")
    for label, rates in (("our world, everybody read", world), ("our closed loop, search", loop)):
        rate = statistics.median(rates)
        print(f"| {label}, {1 / run.episode.dt:g} Hz | {rate:.1f} | {rate / other:.1f} |")


def main() -> None:
    """Run all benchmarks and print Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vehicles", type=int, default=100, help="in the background")
    parser.add_argument("--repeats", type=int, default=5, help="runs of each kind")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    print("# Throughput\n")
    arguments = f"--vehicles {options.vehicles} --repeats {options.repeats} --seed {options.seed}"
    print(f"Written by `make bench-traffic` (`analysis/{Path(__file__).name} {arguments}`).")
    print(
        f"`highway` with {options.vehicles} background vehicles, medians of {options.repeats} runs in turns, nothing "
        "is written to files. Everything in one process on one machine, two shared cores; only the ratios carry over.\n"
    )
    report(options.vehicles, options.repeats, options.seed)
    report_runs(options.repeats, options.seed)
    compare(50, options.repeats, options.seed)


if __name__ == "__main__":
    main()
