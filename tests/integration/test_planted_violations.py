"""The audit finds what is planted: more noise than the planner believes in, in a world in which plans lie on bounds."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom, multivariate_normal, norm

from sumo_hmdp.metrics.planned_distances import audit_run, audit_settings
from sumo_hmdp.metrics.risk_audit import violation_rates
from sumo_hmdp.scenario.load import RunOptions, find_scenario, load_scenario
from sumo_hmdp.study.run import execute


def plans(noise_scale, seeds, risk_level=0.05, **changed):
    """Return the audited plans of a tight world, and its runs."""
    rows, runs = [], []
    for seed in seeds:
        overrides = {"noise_scale": noise_scale, **changed}
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
    # Of ten plans those that are not optimal are counted apart.
    assert 8 <= verdict(few, runs)["trial_count"] <= 10
    assert verdict(few, runs)["verdict"] == "too few data"


# Of matched_tight: variances of the leader's noise in a step, and the period.
PLACE_VAR, SPEED_VAR, PERIOD = 0.5, 0.01, 0.8


def spread(steps):
    """Return the covariance of the leader's places after each step: sums of the noise that has come in by then."""
    seen = np.zeros((steps, 2 * steps))
    for k in range(steps):
        seen[k, : k + 1] = PLACE_VAR**0.5
        seen[k, steps : steps + k] = SPEED_VAR**0.5 * PERIOD * np.arange(k, 0, -1)
    return seen @ seen.T


# At 0.2 three steps share the risk: one step alone on its bound would hardly tell doubled noise from what was allowed.
@pytest.mark.parametrize(
    ("noise_scale", "runs", "verdicts"), [(1.0, 40, {"consistent", "conservative"}), (2.0, 150, {"violated"})]
)
def test_plans_exactly_on_their_bound_tell_doubled_noise_at_the_largest_epsilon(noise_scale, runs, verdicts):
    cov = spread(3)
    beyond = norm.isf(0.2 / 3) * cov[2, 2] ** 0.5
    audited, ended = plans(
        noise_scale, range(runs), 0.2, **{"vehicles[0].x_m": 10.0 + beyond + 1e-6, "duration_s": 2.4}
    )
    found = verdict(audited, ended)
    assert found["trial_count"] == runs
    assert found["verdict"] in verdicts
    # The ego goes as fast as the leader, so that every step falls short where its noise takes more than `beyond`.
    kept = multivariate_normal(cov=noise_scale**2 * cov, seed=0).cdf([beyond] * 3)
    low, high = binom.interval(0.999, runs, 1 - kept)
    assert low <= found["violation_count"] <= high
