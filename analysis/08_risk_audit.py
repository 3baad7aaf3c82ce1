"""Was the risk that was asked for kept where the world follows the model? Violation rates beside every epsilon.

Runs `scenarios/matched.yaml` for each risk rule and epsilon, looks every plan up in the trace of its run, and prints a
Markdown table with exact intervals and verdicts; then the same with the noise of the world doubled behind the
planner's back, which the audit has to find.

    python analysis/08_risk_audit.py --seeds 80
"""

import argparse
import dataclasses

import pandas as pd

from sumo_hmdp.metrics.risk_audit import audit_run, audit_settings, violation_rates
from sumo_hmdp.scenario.load import RunOptions, find_scenario, load_scenario
from sumo_hmdp.study.run import execute

RULES = ("uniform", "mixture", "individual")
RISK_LEVELS = (0.2, 0.1, 0.05, 0.01)


def audited(rule: str, risk_level: float, seeds: range, noise_scale: float = 1.0) -> pd.DataFrame:
    """Return the violation rates of one cell: per step, plan and run."""
    overrides = {"planners.hmdp_mpc.risk_allocation": rule, "noise_scale": noise_scale}
    rows, runs = [], []
    for seed in seeds:
        options = RunOptions(solver="search", seed=seed, risk_level=risk_level, overrides=overrides)
        record = execute(load_scenario(find_scenario("matched"), options), detailed=False)
        settings = audit_settings(record.manifest)
        assert settings is not None  # noqa: S101 - hmdp_mpc has a safe distance
        settings = dataclasses.replace(settings, lane_columns=("intended_lane",))
        run_id = f"{rule}-{risk_level}-{seed}"
        rows.append(audit_run(record.decisions, record.steps, settings).assign(run_id=run_id))
        runs.append(record.row | {"run_id": run_id})
    rates = violation_rates(pd.concat(rows, ignore_index=True), pd.DataFrame(runs))
    return rates.assign(rule=rule, asked=risk_level, noise_scale=noise_scale)


def markdown(table: pd.DataFrame) -> list[str]:
    """Return the rates of optimal plans as the lines of a Markdown table."""
    lines = [
        "| rule | noise | epsilon | plans | violated | rate per plan (95 %) | verdict |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    rows = table[(table["status"] == "optimal") & (table["per"] == "plan")]
    for row in rows.itertuples():
        interval = f"{row.violation_rate:.4f} ({row.low_rate:.4f} to {row.high_rate:.4f})"
        cells = (
            row.rule,
            f"x {row.noise_scale:g}",
            row.asked,
            row.trial_count,
            row.violation_count,
            interval,
            row.verdict,
        )
        lines.append(f"| {' | '.join(str(cell) for cell in cells)} |")
    return lines


def main() -> None:
    """Run all cells and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=80)
    seeds = range(parser.parse_args().seeds)
    cells = [audited(rule, risk_level, seeds) for rule in RULES for risk_level in RISK_LEVELS]
    cells += [audited("uniform", 0.1, seeds, noise_scale=2.0), audited("uniform", 0.1, range(1))]
    table = pd.concat(cells, ignore_index=True)
    for line in markdown(table):
        print(line)


if __name__ == "__main__":
    main()
