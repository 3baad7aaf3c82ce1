"""How often is a plan that is called safe violated? Sampled worlds against the risk level asked for.

Random problems with 1 to 6 vehicles; each vehicle is moved up until the plan sits on its chance constraint, and the
problem is decided again. Then worlds are sampled from the whole policies and the noise (tests/oracles/joint_risk.py,
which shares no code with the package), and those are counted in which any distance is violated at any step.
`uniform` (what pruning drops accounted for) and `mixture` promise that at most risk_level of the worlds are;
`individual`, the paper's rule, does not.

    python analysis/03_joint_risk.py --problems 400 --samples 5000 --seed 0
"""

import argparse
import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np
from scipy.stats import binom

ORACLES = Path(__file__).resolve().parents[1] / "tests" / "oracles"
PROMISING = ("uniform", "mixture")


class Measured(NamedTuple):
    """One plan."""

    risk_level: float
    violations: int
    at_limit: bool


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


def measure(rule: str, problems: int, samples: int, seed: int) -> list[Measured]:
    """Sample the worlds of every problem that has an optimal plan under a rule."""
    joint_risk = load("joint_risk")
    measured = []
    for number in range(problems):
        rng = np.random.default_rng([seed, number])
        problem = joint_risk.with_rule(joint_risk.draw_problem(load("general_problems"), rng), rule)
        one = joint_risk.measure(load("brute_force"), load("agreement"), problem, rng, samples)
        if one is not None:
            measured.append(Measured(problem["planner"]["risk_level"], *one))
    return measured


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", type=int, default=400, help="problems drawn a rule")
    parser.add_argument("--samples", type=int, default=5000, help="worlds a problem")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    doubt, samples = 1e-6 / arguments.problems, arguments.samples
    columns = ("rule", "eps", "plans", "at limit", "worlds", "rate", "worst rate", "above eps", "refuted")
    print("".join(f"{column:>11}" for column in columns))
    broken = 0
    for rule in load("joint_risk").RULES:
        measured = measure(rule, arguments.problems, samples, arguments.seed)
        for risk_level in sorted({one.risk_level for one in measured}):
            group = [one for one in measured if one.risk_level == risk_level]
            violations = [one.violations for one in group]
            refuted = sum(count > binom.isf(doubt, samples, risk_level) for count in violations)
            above = sum(count > samples * risk_level for count in violations)
            numbers = (len(group), sum(one.at_limit for one in group), len(group) * samples)
            rates = (sum(violations) / (len(group) * samples), max(violations) / samples)
            cells = (rule, risk_level, *numbers, *(f"{rate:.5f}" for rate in rates), above, refuted)
            print("".join(f"{cell:>11}" for cell in cells), flush=True)
            broken += refuted * (rule in PROMISING)
    print("above eps: plans whose share of violated worlds is above eps in the sample")
    print(f"refuted: plans where so many have a probability below {doubt:.1e} if eps were kept (exact binomial)")
    return int(broken > 0)


if __name__ == "__main__":
    raise SystemExit(main())
