"""How long a decision takes: predict, carve and solve apart, by horizon and number of vehicles.

Everything is measured side by side in one run on the same problems: the compiled MILP, the search, the MILP built
afresh in Pyomo and solved through Pyomo's own HiGHS interface, and plain enumeration. Absolute times depend on the
machine; the ratios are what to quote. Run it with `make bench`.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyomo.environ as pyo

from sumo_hmdp.decision.audit import shifted
from sumo_hmdp.decision.corridors import Corridors, carve, clearances
from sumo_hmdp.decision.cost import objective
from sumo_hmdp.decision.decide import Answer, answer
from sumo_hmdp.decision.highs import compile_model, solve
from sumo_hmdp.decision.lattice import EgoLattice, ego_lattice
from sumo_hmdp.decision.milp import build_model
from sumo_hmdp.decision.optimiser import best_sequence, fill, shape_of, start_values
from sumo_hmdp.decision.problem import DecisionProblem, PlannerSettings, Preferences, RiskAllocation
from sumo_hmdp.decision.risk import margins
from sumo_hmdp.decision.search import search_best
from sumo_hmdp.domain.maneuver import Mode
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.prediction.branches import PredictedVehicle, predict
from sumo_hmdp.prediction.dynamics import Noise
from sumo_hmdp.prediction.policy import Policy

ROAD = Road(3, 4.0)
LATERAL = ((0.0, 0.95, 0.05), (0.025, 0.95, 0.025), (0.05, 0.95, 0.0))
LONGITUDINAL = (0.05, 0.9, 0.05)
HORIZONS = (3, 5, 8, 10)


def scene(rng: np.random.Generator, vehicles: int, horizon: int, terminal_weight: float) -> DecisionProblem:
    """Draw highway traffic: a leader and a follower in each lane, and behind and ahead of them whoever is left.

    Those nearest to the ego decide how many windows there are, so that number does not grow with the vehicles.
    """
    settings = PlannerSettings(
        period=0.6,
        horizon_steps=horizon,
        accel=2.0,
        speed_min=0.0,
        speed_max=40.0,
        safe_distance=20.0,
        risk_level=0.05,
        risk_allocation=RiskAllocation.INDIVIDUAL,
        sequence_threshold=1e-3,
        preferences=Preferences(
            speed_weight=3.1, desired_speed=32.0, speed_deadband=0.6, lane_weight=0.3, goal_lane=2,
            terminal_weight=terminal_weight,
        ),
    )  # fmt: skip
    ego = VehicleState("ego", 0.0, 0.0, float(rng.uniform(24, 32)), 2, Mode.CRUISE)
    others = []
    for index in range(vehicles):
        lane, rank = 1 + index % 3, index // 3
        ahead = rank % 2 == 0
        distance = float(rng.uniform(30, 60)) + 45.0 * (rank // 2)
        x = distance if ahead else -distance
        state = VehicleState(f"sv{index}", x, ROAD.center_y(lane), float(rng.uniform(22, 32)), lane)
        others.append(PredictedVehicle(state, Policy(LATERAL, LONGITUDINAL), Noise(0.1, 0.04, 0.02, 0.01)))
    return DecisionProblem(ROAD, settings, ego, tuple(others))


def timed(action: Callable[[], object]) -> tuple[float, object]:
    """Return the wall-clock time of an action [ms] and its result."""
    started = time.perf_counter()
    result = action()
    return 1000 * (time.perf_counter() - started), result


def fresh_pyomo(problem: DecisionProblem, lattice: EgoLattice, corridors: Corridors) -> float:
    """Build the model in Pyomo, fix its data and solve it through Pyomo's HiGHS interface; return the objective."""
    shape = shape_of(problem, lattice, corridors, relaxed=False)
    model = build_model(shape)
    data = fill(compile_model(shape), problem, lattice, corridors)
    for variable, value in zip(model.data.component_data_objects(pyo.Var), data.tolist(), strict=True):
        variable.fix(value)
    solver = pyo.SolverFactory("appsi_highs")
    solver.solve(model, tee=False)
    return float(pyo.value(model.cost))


def carved(problem: DecisionProblem) -> tuple[EgoLattice, Corridors]:
    """Return the lattice and corridors of a problem."""
    lattice = ego_lattice(problem)
    branches = predict(problem.vehicles, problem.settings.prediction())
    margin = margins(branches, problem.settings)
    return lattice, carve(problem, lattice, branches, clearances(problem, branches, margin, relaxed=False))


def enumeration(problem: DecisionProblem, lattice: EgoLattice, corridors: Corridors) -> float:
    """Walk through all sequences of maneuvers in plain Python and return the least cost."""
    preferences, best = problem.settings.preferences, float("inf")
    tables = [(s.lane.tolist(), s.low.tolist(), s.high.tolist(), s.moves.tolist()) for s in corridors.stages]

    def extend(k: int, node: int, lane: int, modes: tuple[int, ...], laterals: tuple[int, ...]) -> None:
        nonlocal best
        if k == lattice.steps:
            from sumo_hmdp.decision.problem import ManeuverSequence  # noqa: PLC0415

            best = min(best, objective(preferences, lattice, problem.ego.lane, ManeuverSequence(laterals, modes)))
            return
        lanes, low, high, moves = tables[k]
        for mode in (-1, 0, 1):
            if abs(mode - (modes[-1] if modes else problem.ego.mode)) > 1:
                continue
            motion = lattice.walk((*modes, mode))[-1]
            if not lattice.allows(motion.level, step=k + 1):
                continue
            for following, at in enumerate(lanes):
                if moves[node][following] and low[following] <= motion.point <= high[following]:
                    extend(k + 1, following, at, (*modes, mode), (*laterals, at - lane))

    extend(0, 0, problem.ego.lane, (), ())
    return best


def quantiles(times: list[float]) -> str:
    """Return median, 99th percentile and worst of some times [ms]."""
    return f"{statistics.median(times):.2f} / {np.percentile(times, 99):.2f} / {max(times):.2f}"


def by_size(rng: np.random.Generator, repeats: int) -> None:
    """Print the table of decision times."""
    print("## Decision time by horizon and vehicles\n")
    print("Median / 99th percentile / worst [ms].\n")
    print("| H | vehicles | branches | windows | predict | carve | solve, milp | solve, search |")
    print("|---|---|---|---|---|---|---|---|")
    for horizon in HORIZONS:
        for vehicles in (4, 16, 64, 256):
            count = repeats if horizon < 8 else max(10, repeats // 4)
            problems = [scene(rng, vehicles, horizon, 1.0) for _ in range(count)]
            best_sequence(problems[0], *carved(problems[0]))
            rows: dict[str, list[float]] = {"predict": [], "carve": [], "milp": [], "search": []}
            branch_counts, windows = [], []
            for problem in problems:
                took, branches = timed(lambda p=problem: predict(p.vehicles, p.settings.prediction()))
                rows["predict"].append(took)
                lattice, margin = ego_lattice(problem), margins(branches, problem.settings)
                distances = clearances(problem, branches, margin, relaxed=False)
                took, corridors = timed(lambda p=problem, la=lattice, b=branches, d=distances: carve(p, la, b, d))
                rows["carve"].append(took)
                branch_counts.append(len(branches.vehicle))
                windows.append(max(len(stage.lane) for stage in corridors.stages))
                compile_model(shape_of(problem, lattice, corridors, relaxed=False))
                took, milp = timed(lambda p=problem, la=lattice, c=corridors: best_sequence(p, la, c))
                rows["milp"].append(took)
                took, searched = timed(lambda p=problem, la=lattice, c=corridors: search_best(p, la, c))
                rows["search"].append(took)
                require_equal(problem, milp, searched)
            print(
                f"| {horizon} | {vehicles} | {statistics.median(branch_counts):.0f} | {max(windows)} | "
                + " | ".join(quantiles(rows[name]) for name in ("predict", "carve", "milp", "search"))
                + " |",
                flush=True,
            )


def require_equal(problem: DecisionProblem, milp: object, searched: object) -> None:
    """Stop if the two solvers differ."""
    lattice = ego_lattice(problem)
    costs = [
        None if sequence is None else objective(problem.settings.preferences, lattice, problem.ego.lane, sequence)
        for sequence in (milp, searched)
    ]
    if (costs[0] is None) != (costs[1] is None) or (costs[0] is not None and abs(costs[0] - costs[1]) > 1e-6):
        raise SystemExit(f"the solvers differ: {costs}")


def against_others(rng: np.random.Generator, repeats: int) -> None:
    """Print the compiled MILP beside a fresh build and plain enumeration on the same problems."""
    print("\n## The same problems, solved four ways\n")
    print("Median [ms] from the corridor graph to the plan; ratio of medians to the compiled MILP.\n")
    print("| H | milp, compiled | search | fresh Pyomo build | plain enumeration |")
    print("|---|---|---|---|---|")
    for horizon, count in ((3, repeats), (5, max(5, repeats // 4))):
        ways: dict[str, Callable[[DecisionProblem, EgoLattice, Corridors], object]] = {
            "milp": best_sequence,
            "search": search_best,
            "fresh": fresh_pyomo,
            "enumeration": enumeration,
        }
        times: dict[str, list[float]] = {name: [] for name in ways}
        # Pyomo's interface has nothing to load where no plan is feasible.
        drawn = (scene(rng, 8, horizon, 1.0) for _ in range(10 * count))
        problems = [problem for problem in drawn if best_sequence(problem, *carved(problem)) is not None][:count]
        for problem in problems:
            found, graph = {}, carved(problem)
            for name, way in ways.items():
                took, found[name] = timed(lambda p=problem, w=way, g=graph: w(p, *g))
                times[name].append(took)
            if abs(found["fresh"] - found["enumeration"]) > 1e-6:
                raise SystemExit(f"fresh build and enumeration differ: {found}")
        base = statistics.median(times["milp"])
        cells = (f"{statistics.median(t):.2f} ({statistics.median(t) / base:.2f}x)" for t in times.values())
        print(f"| {horizon} | " + " | ".join(cells) + " |", flush=True)


def by_vehicles(rng: np.random.Generator, repeats: int) -> None:
    """Print the solve time with many vehicles beside that with few, for the same number of windows."""
    print("\n## Solve time at the same number of windows, H = 3\n")
    times: dict[int, list[float]] = {16: [], 256: []}
    for _ in range(repeats):
        # The first sixteen are the nearest: who comes on top is out of reach and adds no window.
        crowd = scene(rng, 256, 3, 1.0)
        filled = {}
        for vehicles in times:
            problem = replace(crowd, vehicles=crowd.vehicles[:vehicles])
            lattice, corridors = carved(problem)
            if corridors.passable:
                compiled = compile_model(shape_of(problem, lattice, corridors, relaxed=False))
                filled[vehicles] = compiled, fill(compiled, problem, lattice, corridors)
        if len(filled) == len(times) and filled[16][0].shape == filled[256][0].shape:
            # Back to back, so that both find the processor in the same state.
            for vehicles, model in filled.items():
                times[vehicles].append(timed(lambda m=model: solve(*m))[0])
    few, many = (statistics.median(times[vehicles]) for vehicles in (16, 256))
    print(f"- 16 vehicles {few:.2f} ms, 256 vehicles {many:.2f} ms, ratio {many / few:.2f} (n = {len(times[16])})")


def warm_start(rng: np.random.Generator, repeats: int) -> None:
    """Print the solve time with and without the start from the plan before, along drives through traffic."""
    print("\n## Starting from the plan before\n")
    print("Median / 99th percentile / worst [ms] of the same decisions, those whose start is feasible.\n")
    print("| H | decisions | cold | warm |")
    print("|---|---|---|---|")
    for horizon in (3, 5, 8):
        cold, warm = [], []
        for _ in range(max(2, repeats // 10)):
            problem = scene(rng, 8, horizon, 1.0)
            for _ in range(10):
                found = answer(problem)
                if found.sequence is None:
                    break
                problem = following(problem, found)
                lattice, corridors = carved(problem)
                if not corridors.passable:
                    break
                compiled = compile_model(shape_of(problem, lattice, corridors, relaxed=False))
                data = fill(compiled, problem, lattice, corridors)
                start = start_values(compiled, problem, lattice, corridors)
                if start is not None:
                    cold.append(timed(lambda c=compiled, d=data: solve(c, d))[0])
                    warm.append(timed(lambda c=compiled, d=data, s=start: solve(c, d, start=s))[0])
        print(f"| {horizon} | {len(cold)} | {quantiles(cold)} | {quantiles(warm)} |", flush=True)


def following(problem: DecisionProblem, found: Answer) -> DecisionProblem:
    """Return the decision problem one period on: the ego on its plan, everybody else as is likeliest."""
    step, branches = found.plan[0], found.branches
    moved = []
    for index, vehicle in enumerate(problem.vehicles):
        rows = np.flatnonzero(branches.vehicle == index)
        row = rows[branches.probability[rows].argmax()]
        state = replace(vehicle.state, x=float(branches.x[row, 0]), speed=float(branches.speed[row, 0]))
        moved.append(replace(vehicle, state=state))
    ego = replace(problem.ego, x=step.x, speed=step.speed, lane=step.lane, mode=step.mode, y=ROAD.center_y(step.lane))
    return replace(problem, ego=ego, vehicles=tuple(moved), start=shifted(problem, found))


def main() -> None:
    """Run all benchmarks and print Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=100, help="problems per cell")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    print("# Decision times\n")
    print(
        f"Written by `make bench` (`analysis/{Path(__file__).name} --repeats {options.repeats} --seed {options.seed}`)."
    )
    print("Everything in one run on one machine, two shared cores; only the ratios carry over to another one.\n")
    by_size(rng, options.repeats)
    against_others(rng, min(options.repeats, 40))
    by_vehicles(rng, options.repeats)
    warm_start(rng, options.repeats)


if __name__ == "__main__":
    main()
