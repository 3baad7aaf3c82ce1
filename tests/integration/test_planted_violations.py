"""The audit finds what is planted: more noise than the planner believes in, in a world in which plans lie on bounds."""

import pandas as pd
import pytest

from sumo_hmdp.metrics.planned_distances import audit_run, audit_settings
from sumo_hmdp.metrics.risk_audit import violation_rates
from sumo_hmdp.scenario.load import RunOptions, find_scenario, load_scenario
from sumo_hmdp.study.run import execute


def plans(noise_scale, seeds, risk_level=0.05):
    """Return the audited plans of a tight world, and its runs."""
    rows, runs = [], []
    for seed in seeds:
        overrides = {"noise_scale": noise_scale}
        options = RunOptions(solver="search", seed=seed, risk_level=risk_level, overrides=overrides)
        record = execute(load_scenario(find_scenario("matched_tight"), options), run_id=f"r{seed}", detailed=False)
        rows.append(audit_run(record.decisions, record.steps, audit_settings(record.manifest)))
        runs.append(record.row)
    return pd.concat(rows, ignore_index=True), pd.DataFrame(runs)


def verdict(audited, runs):
    rates = violation_rates(audited, runs)
    return rates[(rates["status"] == "optimal") & (rates["per"] == "plan")].iloc[0]


@pytest.mark.parametrize(("noise_scale", "verdicts"), [(1.0, {"consistent", "conservative"}), (2.0, {"violated"})])
def test_doubled_noise_is_found_and_the_noise_that_was_told_of_is_not(noise_scale, verdicts):
    audited, runs = plans(noise_scale, range(16))
    found = verdict(audited, runs)
    assert found["trial_count"] > 300
    assert found["verdict"] in verdicts
    few = audited[(audited["run_id"] == "r0") & (audited["decision_index"] < 10)]
    assert verdict(few, runs)[["trial_count", "verdict"]].tolist() in ([10, "too few data"], [9, "too few data"])
