"""Is the rule `joint` exact, and does its bound hold? Random decision problems, an enumeration and sampled worlds.

The enumeration (tests/oracles/brute_joint.py) is written from docs/formulation.md and shares no code with the package;
nor does the sampler (tests/oracles/joint_sampler.py). Three questions:

1. Does the search, and does the MILP, answer as the enumeration: status, cost (1e-6), risk and least risk (1e-8), what
   each vehicle adds, and the plan itself? Every eighth problem of at most three steps is also answered by the MILP with
   every arc of the graph.
2. Does an optimal plan fail in sampled worlds more often than epsilon allows? It is called refuted where that is beyond
   4.5 standard errors.
3. Does the bound cost anything? Of the first optimal answers, are there plans among the 20 cheapest below the chosen
   one that fail in fewer worlds than half of epsilon, by 4.5 standard errors?

Horizons are 1 to 6 steps, roads have 1 to 6 lanes (tests/oracles/joint_problems.py). Prints tables in Markdown, also
when it is interrupted or out of time, and exits with 1 where anything differs or is refuted.

    python analysis/15_joint_decisions.py --problems 5000 --samples 20000 --nearby 200 --seed 90
"""

import argparse
import importlib.util
import math
import sys
from collections import Counter
from pathlib import Path
from time import perf_counter
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

ORACLES = Path(__file__).resolve().parents[1] / "tests" / "oracles"
STATUSES = ("optimal", "relaxed", "none")
DOUBT = 4.5
# How many of the plans that cost less than the chosen one are sampled.
CHEAPER = 20


class Compared(NamedTuple):
    """One problem and what came of it; the risk is that of an optimal plan.

    Attributes:
        number: of the problem.
        features: the rows of the table that it counts in.
        status: by the enumeration.
        said: what is answered otherwise.
        level: epsilon.
        risk: bound of the chosen plan.
        sampled: share of worlds in which it fails.
        refuted: whether that is beyond epsilon.
        safer: cheaper plans that fail in fewer worlds than half of epsilon, (cost less, bound, sampled); None where it
            was not looked.
    """

    number: int
    features: tuple[tuple[str, str], ...]
    status: str
    said: list[str]
    level: float
    risk: float | None = None
    sampled: float | None = None
    refuted: bool = False
    safer: list[tuple[float, float, float]] | None = None


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


def compare(number: int, seed: int, samples: int, *, nearby: bool) -> Compared:
    """Answer one problem, sample its plan and perhaps the plans that cost less."""
    rng = np.random.default_rng([seed, number])
    document = load("joint_problems").random_joint_problem(rng)
    expected = load("brute_joint").solve(document, everything=nearby)
    small = document["planner"]["horizon_steps"] <= 3 and number % 8 == 0
    ways = tuple(load("joint_agreement").WAYS)[: 3 if small else 2]
    _, said = load("joint_agreement").disagreements(document, expected, ways)
    level = document["planner"]["risk_level"]
    found = Compared(number, features_of(document), expected["status"], said, level)
    if expected["status"] != "optimal":
        return found
    sampled = failing(document, expected["sequence"], rng, samples)
    limit = level + DOUBT * math.sqrt(level * (1 - level) / samples)
    found = found._replace(risk=expected["risk_taken"], sampled=sampled, refuted=sampled > limit)
    if not nearby:
        return found
    cheaper = sorted(entry for entry in expected["plans"] if entry[0] < expected["objective"] - 1e-6)[-CHEAPER:]
    safer = []
    for cost, risk, plan in cheaper:
        share = failing(document, plan, rng, samples)
        if share + DOUBT * math.sqrt(max(share, 1 / samples) / samples) < level / 2:
            safer.append((expected["objective"] - cost, risk, share))
    return found._replace(safer=safer)


def failing(document: dict[str, Any], plan: tuple[tuple[int, int], ...], rng: np.random.Generator, n: int) -> float:
    """Return the share of worlds in which a plan fails."""
    return float(load("joint_sampler").sampled_risk(document, plan, rng, n)["any"][0])


def features_of(document: dict[str, Any]) -> tuple[tuple[str, str], ...]:
    """Return the lines of the table that a problem counts in."""
    planner = document["planner"]
    return (
        ("horizon", f"{planner['horizon_steps']} steps"),
        ("lanes", str(document["lanes"]["count"])),
        ("vehicles", str(len(document["vehicles"]))),
        ("occupancy", planner.get("occupancy", "target")),
        ("distance", planner.get("distance_rule", "fixed")),
        ("stop lines", "yes" if document.get("stop_lines") else "no"),
        ("all", ""),
    )


def agreement_table(results: list[Compared]) -> str:
    """Lay out how many problems of each kind had each status, and how many were answered otherwise."""
    counts: dict[tuple[str, str], Counter[str]] = {}
    for result in results:
        for feature in result.features:
            row = counts.setdefault(feature, Counter())
            row.update(("compared", result.status))
            row["differ"] += bool(result.said)
    columns = ("compared", *STATUSES, "differ")
    kinds = [kind for kind, _ in results[0].features]
    lines = ["| | | " + " | ".join(columns) + " |", "|---" * (2 + len(columns)) + "|"]
    for kind, name in sorted(counts, key=lambda row: (kinds.index(row[0]), row[1])):
        lines.append(f"| {kind} | {name} | " + " | ".join(str(counts[kind, name][c]) for c in columns) + " |")
    return "\n".join(lines)


def risk_table(results: list[Compared], samples: int) -> str:
    """Lay out how often optimal plans fail, by epsilon."""
    lines = [
        "| epsilon | optimal plans | mean bound | failed worlds | largest share | refuted | bound / share, median |",
        "|---" * 7 + "|",
    ]
    for level in sorted({result.level for result in results}):
        group = [r for r in results if r.level == level and r.risk is not None and r.sampled is not None]
        if not group:
            continue
        shares = np.array([r.sampled for r in group])
        bounds = np.array([r.risk for r in group])
        # A share of fewer worlds than 100 says little of a ratio.
        seen = shares * samples >= 100
        ratio = f"{np.median(bounds[seen] / shares[seen]):.2f} (of {seen.sum()})" if seen.any() else "-"
        refuted = sum(r.refuted for r in group)
        lines.append(
            f"| {level:g} | {len(group)} | {bounds.mean():.5f} | {shares.mean():.5f} | {shares.max():.5f} |"
            f" {refuted} | {ratio} |"
        )
    return "\n".join(lines)


def main() -> int:
    """Compare, sample and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", type=int, default=5000, help="how many to compare")
    parser.add_argument("--samples", type=int, default=20_000, help="worlds a plan")
    parser.add_argument("--nearby", type=int, default=200, help="optimal answers whose cheaper plans are sampled")
    parser.add_argument("--minutes", type=float, default=math.inf, help="after which no further problem is begun")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    begin, results, looked = perf_counter(), list[Compared](), 0
    try:
        for number in range(arguments.problems):
            if perf_counter() - begin > 60 * arguments.minutes:
                break
            result = compare(number, arguments.seed, arguments.samples, nearby=looked < arguments.nearby)
            looked += result.safer is not None
            results.append(result)
            for sentence in result.said:
                print(f"problem [{arguments.seed}, {number}] {result.features}: {sentence}", flush=True)
            if result.refuted:
                print(f"problem [{arguments.seed}, {number}] fails in {result.sampled} of worlds, above {result.level}")
            for less, bound, share in result.safer or ():
                print(
                    f"problem [{arguments.seed}, {number}]: a plan that costs {less:.3f} less fails in {share:.5f} of"
                    f" the worlds; its bound is {bound:.5f}, epsilon {result.level:g}"
                )
            if len(results) % 500 == 0:
                print(f"{len(results)} compared ({perf_counter() - begin:.0f} s)", file=sys.stderr, flush=True)
    except KeyboardInterrupt:
        pass
    print(agreement_table(results), risk_table(results, arguments.samples), sep="\n\n")
    differing, refuted = sum(bool(r.said) for r in results), sum(r.refuted for r in results)
    safer = sum(bool(r.safer) for r in results)
    print(f"\n{differing} of {len(results)} problems are answered otherwise; {refuted} optimal plans are refuted")
    print(f"{safer} of {looked} answers have a cheaper plan nearby that fails in fewer worlds than half of epsilon")
    print(f"{perf_counter() - begin:.0f} s")
    return int(differing > 0 or refuted > 0)


if __name__ == "__main__":
    raise SystemExit(main())
