"""Do the two solvers answer as an enumeration does? A comparison on random decision problems.

The enumeration (tests/oracles/brute_force.py) is written from docs/formulation.md and shares no code with the
package. Compared are status, branch counts, objective (1e-6) and violation (1e-5 m), and each solver's own plan is
judged by the enumeration. Prints what was compared, by horizon and rule, and exits with 1 where anything differs.

    python analysis/02_solvers_agree.py --problems 10000 --milp 2000 --seed 0
"""

import argparse
import importlib.util
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from time import perf_counter
from types import ModuleType
from typing import NamedTuple

import numpy as np

ORACLES = Path(__file__).resolve().parents[1] / "tests" / "oracles"
STATUSES = ("optimal", "relaxed", "fallback", "error")


class Compared(NamedTuple):
    """One problem and what came of it."""

    number: int
    rules: tuple[str, ...]
    status: str
    solvers: tuple[str, ...]
    disagreements: list[str]


def load(name: str) -> ModuleType:
    """Load a module of the oracle by its path: tests are no package."""
    key = f"oracle_{name}"
    if key not in sys.modules:
        spec = importlib.util.spec_from_file_location(key, ORACLES / f"{name}.py")
        if spec is None or spec.loader is None:
            raise FileNotFoundError(ORACLES / f"{name}.py")
        sys.modules[key] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[key])
    return sys.modules[key]


def compare(number: int, seed: int, milp: int, milp_horizon: int) -> Compared:
    """Draw the problem of a number and compare its answers."""
    document = load("general_problems").random_general_problem(np.random.default_rng([seed, number]))
    planner = document["planner"]
    with_milp = number < milp and planner["horizon_steps"] <= milp_horizon
    solvers = ("search", "milp") if with_milp else ("search",)
    status, said = load("agreement").disagreements(load("brute_force"), document, solvers)
    accounted = " accounted" if planner["account_pruned"] and planner["risk_allocation"] == "uniform" else ""
    rules = (
        f"H = {planner['horizon_steps']}",
        planner["risk_allocation"] + accounted,
        planner.get("occupancy", "target"),
        planner.get("distance_rule", "fixed"),
        "stopping" if planner.get("stopping") else "not stopping",
        "all",
    )
    return Compared(number, rules, status, solvers, said)


def table(results: list[Compared]) -> str:
    """Lay out how many problems of each rule had each status, and how many were answered otherwise."""
    counts: dict[str, Counter[str]] = {}
    for result in results:
        for rule in result.rules:
            row = counts.setdefault(rule, Counter())
            row.update((result.status, *result.solvers))
            row["differ"] += bool(result.disagreements)
    columns = ("search", "milp", *STATUSES, "differ")
    lines = [f"{'':20}" + "".join(f"{column:>10}" for column in columns)]
    rules = sorted(counts, key=lambda rule: (rule == "all", not rule.startswith("H"), rule))
    lines += [f"{rule:20}" + "".join(f"{counts[rule][column]:10}" for column in columns) for rule in rules]
    return "\n".join(lines)


def main() -> int:
    """Compare and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", type=int, default=10_000, help="problems for the search and the enumeration")
    parser.add_argument("--milp", type=int, default=1000, help="the first so many are given to the MILP too")
    parser.add_argument("--milp-horizon", type=int, default=4, help="but only up to this horizon, in steps")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1, help="processes")
    arguments = parser.parse_args()
    begin = perf_counter()
    one = partial(compare, seed=arguments.seed, milp=arguments.milp, milp_horizon=arguments.milp_horizon)
    results: list[Compared] = []
    with ProcessPoolExecutor(arguments.workers) as pool:
        for result in pool.map(one, range(arguments.problems), chunksize=20):
            results.append(result)
            for sentence in result.disagreements:
                print(f"problem [{arguments.seed}, {result.number}] {result.rules}: {sentence}", flush=True)
    print(table(results))
    differing = sum(bool(result.disagreements) for result in results)
    print(f"{differing} of {len(results)} problems are answered otherwise ({perf_counter() - begin:.0f} s)")
    return int(differing > 0)


if __name__ == "__main__":
    raise SystemExit(main())
