"""Predictions and causes in the report, on runs of a world that follows the model and of one that does not."""

import numpy as np
import pandas as pd
import pytest

from sumo_hmdp.metrics.planned_distances import audit_run, audit_settings
from sumo_hmdp.metrics.risk_audit import violation_rates
from sumo_hmdp.report.study_blame import blame_figure, blame_frame, blame_table
from sumo_hmdp.report.study_prediction import prediction_figure, prediction_tables, predictions
from sumo_hmdp.report.study_svg import svg_of
from sumo_hmdp.report.study_traces import TracedCell
from sumo_hmdp.scenario.load import RunOptions, find_scenario, load_scenario
from sumo_hmdp.study.run import execute


def cell(label, **overrides):
    """Run three seeds of the tight world and keep everything."""
    records = []
    for seed in range(3):
        options = RunOptions(solver="search", seed=seed, risk_level=0.2, overrides=overrides)
        records.append(execute(load_scenario(find_scenario("matched_tight"), options), run_id=f"{label}-{seed}"))
    tables = (pd.concat([getattr(r, name) for r in records], ignore_index=True) for name in ("decisions", "steps"))
    return TracedCell(label, "uniform", audit_settings(records[0].manifest), *tables)


@pytest.fixture(scope="module")
def cells():
    return cell("told", noise_scale=1.0), cell("doubled", noise_scale=2.0)


def test_doubled_noise_shows_in_coverage_and_paths(cells):
    found = predictions(cells)
    inside = found.coverage.groupby(["cell_label", "level"])[["hit_count", "trial_count"]].sum()
    share = inside["hit_count"] / inside["trial_count"]
    # One branch: half of the intervals' reach is 95 % -> 2 Phi(0.98) - 1 = 67 %, 50 % -> 26 %.
    assert share["told", 0.95] == pytest.approx(0.95, abs=0.05)
    assert share["doubled", 0.95] == pytest.approx(0.67, abs=0.12)
    assert share["told", 0.5] == pytest.approx(0.50, abs=0.12)
    assert share["doubled", 0.5] == pytest.approx(0.26, abs=0.12)
    # Nobody leaves the lane that is certain to be kept.
    assert found.reliability["probability_mean"].tolist() == pytest.approx([1.0, 1.0], abs=1e-6)
    assert found.reliability["taken_share"].tolist() == [1.0, 1.0]
    assert found.scores["log_loss_mean"].abs().max() < 1e-6
    told, doubled = found.paths.set_index("cell_label")["fde_best_m"].loc[["told", "doubled"]]
    assert doubled > 1.5 * told


def test_tables_and_figure_show_the_same_numbers(cells):
    found = predictions(cells)
    scores, coverage, reliability, paths = prediction_tables(found)
    assert [row[0] for row in paths.rows] == ["told", "doubled"]
    assert len(scores.rows) == 6
    assert len(coverage.rows) == 18
    assert reliability.rows[0][3] == "{0} of {0}".format(found.reliability["trial_count"].iloc[0])
    figure = prediction_figure(found)
    at95 = found.coverage[found.coverage["level"] == 0.95]
    assert f"of {at95['trial_count'].sum()} places" in figure.title
    assert "share of times it was taken" in svg_of(figure)


def test_causes_of_a_world_that_is_wilder_than_told(cells):
    frame = blame_frame(cells).set_index(["cell_label", "claim"])
    causes = [name for name in frame if name.endswith("_count") and name not in {"trial_count", "violation_count"}]
    assert (frame[causes].sum(axis=1) == frame["violation_count"]).all()
    doubled, told = frame.loc[("doubled", "planned")], frame.loc[("told", "planned")]
    assert doubled["violation_count"] > told["violation_count"]
    # Its one branch is all there is, and the vehicle stays in its lane: it was chance, or too wide a miss.
    assert doubled[["unknown_count", "pruning_count", "unseen_count", "tracking_count"]].sum() == 0
    assert doubled["predictor_count"] > 0
    assert doubled["chance_count"] > 0
    figure = blame_figure(frame.reset_index())
    assert f"{frame.xs('planned', level='claim')['violation_count'].sum()} violated steps" in figure.title
    assert "violated steps of plans" in svg_of(figure)
    assert len(blame_table(frame.reset_index()).rows) == 4


def test_without_branches_or_violations_there_is_nothing_to_draw(cells):
    told = cells[0].decisions
    for decisions in (told.assign(prediction_json="[]"), told.drop(columns="prediction_json")):
        assert predictions([TracedCell("silent", "", cells[0].settings, decisions, cells[0].steps)]) is None
    assert predictions([]) is None
    kept = blame_frame(cells).assign(violation_count=np.int64(0))
    assert blame_figure(kept) is None


def test_runs_without_any_plan_are_audited_and_have_no_rate(cells):
    """A run whose decisions are all fallbacks ended the report in KeyError: 'intended_lane'."""
    decisions = cells[0].decisions.assign(plan_json="[]", status="fallback")
    bare = TracedCell("bare", "", cells[0].settings, decisions, cells[0].steps)
    assert [len(part) for part in bare.planned] == [0] * 3
    assert blame_frame([bare])["violation_count"].sum() == 0


def test_a_run_tells_the_risk_that_its_plans_took():
    options = RunOptions(solver="search", seed=2, risk_level=0.2, overrides={"noise_scale": 2.0})
    record = execute(load_scenario(find_scenario("matched_tight"), options))
    audited = audit_run(record.decisions, record.steps, audit_settings(record.manifest))
    rates = violation_rates(audited, pd.DataFrame([record.row])).set_index(["status", "per"])["violation_rate"]
    assert record.row["plan_violation_rate"] == rates["optimal", "plan"] > 0
    assert record.row["step_violation_rate"] == rates["optimal", "step"] < rates["optimal", "plan"]


def test_a_planner_without_a_safe_distance_takes_no_risk_that_could_be_told():
    options = RunOptions(planner="idm_mobil", overrides={"duration_s": 1.0})
    record = execute(load_scenario(find_scenario("highway"), options))
    assert record.row["plan_violation_rate"] is None
    assert record.row["step_violation_rate"] is None
