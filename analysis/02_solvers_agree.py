"""Do the two solvers answer as an enumeration does? A comparison on random decision problems.

The enumeration (tests/oracles/brute_force.py) is written from docs/formulation.md and shares no code with the
package. Every problem is answered three times: by the enumeration, by the search and by the MILP. Compared are status,
branch counts, objective (1e-6) and violation (1e-5 m), and each solver's own plan is judged by the enumeration.
Horizons are 2 to 6 steps. Half of the problems have as many vehicles as leaves the horizon some feasible plans
(tests/oracles/general_problems.py), the other half 0 to 12 at every horizon. Prints what was compared, as a table in
Markdown, also when it is interrupted, and exits with 1 where anything differs.

    python analysis/02_solvers_agree.py --problems 10000 --seed 12
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
from typing import Any, NamedTuple

import numpy as np

ORACLES = Path(__file__).resolve().parents[1] / "tests" / "oracles"
SOLVERS = ("search", "milp")
STATUSES = ("optimal", "relaxed", "fallback", "error")


class Compared(NamedTuple):
    """One problem and what came of it."""

    number: int
    features: tuple[tuple[str, str], ...]
    status: str
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


def drawn(number: int, seed: int) -> dict[str, Any]:
    """Draw the problem of a number, every second one with 0 to 12 vehicles whatever its horizon."""
    rng = np.random.default_rng([seed, number])
    if number % 2 == 0:
        return dict(load("general_problems").random_general_problem(rng))
    horizon, vehicles = int(rng.integers(2, 7)), int(rng.integers(0, 13))
    return dict(load("general_problems").random_general_problem(rng, horizon=horizon, vehicles=vehicles))


def compare(number: int, seed: int) -> Compared:
    """Compare the answers to the problem of a number."""
    document = drawn(number, seed)
    status, said = load("agreement").disagreements(load("brute_force"), document, SOLVERS)
    return Compared(number, features_of(document), status, said)


def features_of(document: dict[str, Any]) -> tuple[tuple[str, str], ...]:
    """Return the lines of the table that a problem counts in."""
    planner, vehicles = document["planner"], len(document["vehicles"])
    accounted = ", accounted" if planner["account_pruned"] and planner["risk_allocation"] == "uniform" else ""
    third = (vehicles + 2) // 3
    occupancy, distance = planner.get("occupancy", "target"), planner.get("distance_rule", "fixed")
    hard = planner["horizon_steps"] >= 5 and occupancy == "swept" and distance != "fixed"
    return (
        ("horizon", f"{planner['horizon_steps']} steps"),
        ("vehicles", "0" if vehicles == 0 else f"{3 * third - 2} to {3 * third}"),
        ("risk", planner["risk_allocation"] + accounted),
        ("occupancy", occupancy),
        ("distance", distance),
        ("low speed", "may stop" if planner.get("stopping") else "may not stop"),
        ("largest models", f"5 or 6 steps, swept, not fixed: {'yes' if hard else 'no'}"),
        ("all", ""),
    )


def number_first(name: str) -> tuple[int, str]:
    """Return a key that sorts names by the number that they begin with, then by letters."""
    first = name.split(" ", maxsplit=1)[0]
    return int(first) if first.isdigit() else 0, name


def table(results: list[Compared]) -> str:
    """Lay out how many problems of each kind had each status, and how many were answered otherwise."""
    counts: dict[tuple[str, str], Counter[str]] = {}
    for result in results:
        for feature in result.features:
            row = counts.setdefault(feature, Counter())
            row.update(("compared", result.status))
            row["differ"] += bool(result.disagreements)
    columns = ("compared", *STATUSES, "differ")
    kinds = [kind for kind, _ in results[0].features]
    lines = ["| | | " + " | ".join(columns) + " |", "|---" * (2 + len(columns)) + "|"]
    for kind, name in sorted(counts, key=lambda row: (kinds.index(row[0]), number_first(row[1]))):
        numbers = " | ".join(str(counts[kind, name][column]) for column in columns)
        lines.append(f"| {kind} | {name} | {numbers} |")
    return "\n".join(lines)


def main() -> int:
    """Compare and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", type=int, default=10_000, help="how many to compare")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1, help="processes")
    arguments = parser.parse_args()
    begin = perf_counter()
    one = partial(compare, seed=arguments.seed)
    results: list[Compared] = []
    with ProcessPoolExecutor(arguments.workers) as pool:
        try:
            for result in pool.map(one, range(arguments.problems), chunksize=20):
                results.append(result)
                for sentence in result.disagreements:
                    print(f"problem [{arguments.seed}, {result.number}] {result.features}: {sentence}", flush=True)
                if len(results) % 500 == 0:
                    print(f"{len(results)} compared ({perf_counter() - begin:.0f} s)", file=sys.stderr, flush=True)
        except KeyboardInterrupt:
            pool.shutdown(cancel_futures=True)
    print(table(results))
    differing = sum(bool(result.disagreements) for result in results)
    print(f"{differing} of {len(results)} problems are answered otherwise ({perf_counter() - begin:.0f} s)")
    return int(differing > 0)


if __name__ == "__main__":
    raise SystemExit(main())
