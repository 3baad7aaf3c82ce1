"""Was the risk that was asked for kept where the world follows the model? Violation rates beside every epsilon.

Runs a matched world for each risk rule and epsilon, with its noise as the planner believes it and doubled behind the
planner's back, looks every plan up in the trace of its run, and prints Markdown tables: rates with exact intervals and
verdicts; how far the plans were from their bounds. In `matched_tight` (the default) plans lie near their bounds, in
`matched` there are six vehicles that also brake and change lanes. With `--placed` a run of `matched_tight` is a single
plan, and the leader starts where that plan lies on its bound exactly.

    python analysis/08_risk_audit.py --seeds 80
    python analysis/08_risk_audit.py --seeds 80 --rules joint
    python analysis/08_risk_audit.py --seeds 80 --wavering
    python analysis/08_risk_audit.py --seeds 2030 --placed
    python analysis/08_risk_audit.py --scenario matched --seeds 125
"""

import argparse
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import norm

from sumo_hmdp.decision.plan_distances import shortfalls
from sumo_hmdp.decision.planner import HmdpEvidence, HmdpPlanner
from sumo_hmdp.documents import read_yaml
from sumo_hmdp.metrics.planned_distances import audit_run, audit_settings
from sumo_hmdp.metrics.risk_audit import violation_rates
from sumo_hmdp.prediction.dynamics import position_variances
from sumo_hmdp.scenario.load import RunOptions, assemble_scenario, find_scenario, load_scenario
from sumo_hmdp.sim.episode import Moment
from sumo_hmdp.study.run import execute

RULES = ("joint", "uniform", "mixture", "individual")
# Of one branch `uniform` and `mixture` make the same plan, so one plan a run is looked at once.
SAME_RULE = ("uniform",)
RISK_LEVELS = (0.2, 0.1, 0.05, 0.01)
NOISE_SCALES = (1.0, 2.0)
# With a leader that wavers `uniform` and `mixture` plan differently: each braking branch takes a share of the risk.
WAVERING = {
    "vehicles[0].policy[0].longitudinal_probs.accelerate": 0.2,
    "vehicles[0].policy[0].longitudinal_probs.cruise": 0.6,
    "vehicles[0].policy[0].longitudinal_probs.decelerate": 0.2,
}
# On the bound and not a rounding error beyond it [m].
ON_BOUND = 1e-6
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


@dataclass
class Spare:
    """What optimal plans left to their bounds, in standard deviations of the vehicle's place, by horizon step."""

    by_step: dict[int, list[float]] = field(default_factory=dict)
    statuses: dict[str, int] = field(default_factory=dict)

    def observe(self, moment: Moment) -> None:
        """Take an instant in."""
        decision = moment.decision
        if decision is None:
            return
        self.statuses[decision.status] = self.statuses.get(decision.status, 0) + 1
        if decision.status != "optimal" or not isinstance(decision.evidence, HmdpEvidence):
            return
        problem, found = decision.evidence.problem, decision.evidence.answer
        std = found.branches.x_std[found.branches.vehicle]
        for k, rows, _, missing in shortfalls(problem, found.plan, found.branches, found.margin):
            if len(rows):
                self.by_step.setdefault(k + 1, []).append(float((-missing / std[rows, k]).min()))


def placed(rule: str, risk_level: float) -> dict[str, float]:
    """Return where the leader starts, and for how long a run goes on, for one plan that lies on its bound.

    The ego is as fast as the leader and can but cruise: to get farther by the last step it would have to be nearer than
    the safe distance and the margin there, z sigma_H, which is just where it is.
    """
    path = find_scenario("matched_tight")
    planner = load_scenario(path, RunOptions(solver="search")).planner
    assert isinstance(planner, HmdpPlanner)  # noqa: S101 - the scenario's
    H, T = planner.settings.horizon_steps, planner.settings.period
    variance = position_variances(planner.beliefs["leader"].noise, T, H)[-1]
    share = risk_level if rule == "individual" else risk_level / H
    place = planner.settings.safe_distance + float(norm.isf(share) * np.sqrt(variance)) + ON_BOUND
    return {"vehicles[0].x_m": place, "duration_s": round(H * T, 9)}


def audited(
    given: argparse.Namespace, rule: str, risk_level: float, noise_scale: float, seeds: range
) -> tuple[pd.DataFrame, Spare]:
    """Return the violation rates of one cell per plan, with what its plans left to their bounds."""
    overrides: dict[str, Any] = {"planners.hmdp_mpc.risk_allocation": rule, "noise_scale": noise_scale}
    overrides |= WAVERING if given.wavering else {}
    overrides |= placed(rule, risk_level) if given.placed else {}
    path = find_scenario(given.scenario)
    document = read_yaml(path)
    rows, runs, spare = [], [], Spare()
    for seed in seeds:
        options = RunOptions(solver="search", seed=seed, risk_level=risk_level, overrides=overrides)
        run_id = f"{rule}-{risk_level}-{noise_scale}-{seed}"
        ready = assemble_scenario(document, options, path)
        record = execute(ready, spare.observe, run_id, detailed=False)
        settings = audit_settings(record.manifest)
        assert settings is not None  # noqa: S101 - hmdp_mpc has a safe distance
        rows.append(audit_run(record.decisions, record.steps, settings))
        runs.append(record.row)
    rates = violation_rates(pd.concat(rows, ignore_index=True), pd.DataFrame(runs))
    rates = rates[(rates["status"] == "optimal") & (rates["per"] == "plan")]
    relaxed = 1 - spare.statuses["optimal"] / sum(spare.statuses.values())
    return rates.assign(rule=rule, asked=risk_level, noise_scale=noise_scale, relaxed_share=relaxed), spare


def verdicts(table: pd.DataFrame) -> list[str]:
    """Return the rates of optimal plans as the lines of a Markdown table."""
    lines = [
        "| rule | noise | epsilon | plans | violated | rate per plan (95 %) | verdict | not optimal |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in table.itertuples():
        interval = f"{row.violation_rate:.4f} ({row.low_rate:.4f} to {row.high_rate:.4f})"
        counts = f"{row.trial_count} | {row.violation_count}"
        told = f"{row.verdict} | {100 * row.relaxed_share:.1f} %"
        lines.append(f"| {row.rule} | x {row.noise_scale:g} | {row.asked} | {counts} | {interval} | {told} |")
    return lines


def slack(cells: dict[tuple[str, float], Spare]) -> list[str]:
    """Return how far plans were from their bounds as the lines of a Markdown table."""
    lines = [
        f"| rule | epsilon | step | {' | '.join(f'{q:.0%}' for q in QUANTILES)} |",
        "| --- " * (3 + len(QUANTILES)) + "|",
    ]
    for (rule, risk_level), spare in cells.items():
        for step, values in sorted(spare.by_step.items()):
            told = " | ".join(f"{value:.2f}" for value in np.quantile(values, QUANTILES))
            lines.append(f"| {rule} | {risk_level} | {step} | {told} |")
    return lines


def main() -> None:
    """Run all cells and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenario", default="matched_tight")
    parser.add_argument("--seeds", type=int, default=80)
    parser.add_argument("--wavering", action="store_true", help="the leader of matched_tight changes its mode")
    parser.add_argument("--placed", action="store_true", help="one plan a run of matched_tight, on its bound exactly")
    parser.add_argument("--rules", nargs="+", choices=RULES, default=RULES)
    given = parser.parse_args()
    if given.placed and (given.wavering or given.scenario != "matched_tight"):
        parser.error("--placed must go with matched_tight as it is; leave the other options out")
    seeds = range(given.seeds)
    found = {
        (rule, risk_level, scale): audited(given, rule, risk_level, scale, seeds)
        for scale in NOISE_SCALES
        for rule in (SAME_RULE if given.placed else given.rules)
        for risk_level in RISK_LEVELS
    }
    few = audited(given, "uniform", 0.1, 1.0, range(1))[0]
    print("\n".join(verdicts(pd.concat([*(rates for rates, _ in found.values()), few], ignore_index=True))))
    print(
        "\nWhat optimal plans left to the nearest bound of each step, in standard deviations (quantiles over plans):\n"
    )
    # Under `joint` there is no bound for each step, only one for the whole plan.
    right = {(rule, eps): spare for (rule, eps, scale), (_, spare) in found.items() if scale == 1.0 and rule != "joint"}
    print("\n".join(slack(right)))


if __name__ == "__main__":
    main()
