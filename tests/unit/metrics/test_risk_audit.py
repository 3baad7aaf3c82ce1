"""Realised against asked risk on tables made by hand: what counts, what does not, and the verdict."""

import json

import numpy as np
import pandas as pd
import pytest

from sumo_hmdp.domain.distance import DistanceRule, SafeDistance
from sumo_hmdp.domain.occupancy import Occupancy
from sumo_hmdp.domain.road import Road
from sumo_hmdp.errors import InputError
from sumo_hmdp.metrics.blame import Blame, blame_violations, prediction_hits
from sumo_hmdp.metrics.catalogue import METRICS
from sumo_hmdp.metrics.decision_tables import with_intents
from sumo_hmdp.metrics.planned_distances import AuditSettings, Claim, audit_run, audit_settings
from sumo_hmdp.metrics.proportion import clustered_proportion
from sumo_hmdp.metrics.registry import RunData
from sumo_hmdp.metrics.risk_audit import Verdict, audit_results, event_count, judge, violation_rates
from sumo_hmdp.metrics.trace import Motion, Trace

ROAD = Road(3, 4.0)
NOTHING = Motion(*np.zeros((9, 0, 0)))
EMPTY = Trace(np.zeros(0), NOTHING, NOTHING, ())
SETTINGS = AuditSettings(period=0.6, distance=SafeDistance(20.0), road=ROAD)


def decision(index, time, plan, status="optimal", branches=(), run="r", branch_count=None):
    """Build one decision: plan is a list of (lane, x), branches of (vehicle, lanes, modes, x, x_std)."""
    steps = [
        {"step": k, "lane": lane, "x_m": x, "lateral": "keep", "speed_mps": 10.0}
        for k, (lane, x) in enumerate(plan, start=1)
    ]
    return {
        "run_id": run,
        "decision_index": index,
        "time_s": time,
        "status": status,
        "branch_count": len(branches) if branch_count is None else branch_count,
        "plan_json": json.dumps(steps),
        "branches_json": json.dumps(
            [
                {
                    "vehicle_id": vehicle,
                    "probability": 1 / len(branches),
                    "lanes": lanes,
                    "modes": modes,
                    "x_m": x,
                    "y_m": [0.0] * len(x),
                    "x_std_m": std,
                    "y_std_m": [0.1] * len(x),
                }
                for vehicle, lanes, modes, x, std in branches
            ]
        ),
    }


def trace(*rows, run="r"):
    """Build a steps table of (time, vehicle, x, lane[, intended lane, mode])."""
    full = [(*row, row[3], "cruise")[:6] if len(row) == 4 else row for row in rows]
    names = ["time_s", "vehicle_id", "x_m", "lane", "intended_lane", "mode"]
    bodies = {"y_m": 0.0, "speed_mps": 10.0, "length_m": 4.5, "width_m": 1.8}
    return pd.DataFrame(full, columns=names).assign(run_id=run, **bodies)


# Two steps planned in lane 2, then 1. The car is 25 m ahead, then in lane 1, 19 m behind; a truck is near in lane 3.
DECISIONS = pd.DataFrame([decision(0, 0.0, [(2, 100.0), (1, 112.0)])])
STEPS = trace(
    (0.6, "ego", 101.0, 2),
    (0.6, "car", 125.0, 2),
    (0.6, "truck", 100.0, 3),
    (1.2, "ego", 113.0, 1),
    (1.2, "car", 93.0, 1),
    (1.2, "truck", 112.0, 3),
)


def test_each_step_is_looked_up_at_its_own_instant_and_lane():
    found = audit_run(DECISIONS, STEPS, SETTINGS)
    assert found["distance_m"].tolist() == [25.0, 19.0]
    assert found["vehicle_id"].tolist() == ["car", "car"]
    assert found["violated"].tolist() == [False, True]
    assert found["observed"].all()


def test_the_executed_step_is_the_first_one_where_the_ego_was():
    found = audit_run(DECISIONS, STEPS, SETTINGS, Claim.EXECUTED)
    assert found[["horizon_step", "ego_x_m", "distance_m", "violated"]].to_numpy().tolist() == [[1, 101.0, 24.0, False]]


def test_a_vehicle_takes_up_the_lane_that_it_intends():
    steps = STEPS.assign(intended_lane=[2, 2, 2, 1, 1, 1])  # the truck merges
    found = audit_run(DECISIONS, steps, SETTINGS)
    assert found["vehicle_id"].tolist() == ["truck", "truck"]
    assert found["distance_m"].tolist() == [0.0, 0.0]


def test_a_distance_on_its_bound_holds_and_an_empty_lane_cannot_fall_short():
    steps = trace((0.6, "ego", 100.0, 2), (0.6, "car", 119.999999, 2), (1.2, "ego", 113.0, 1))
    found = audit_run(DECISIONS, steps, SETTINGS)
    assert found["violated"].tolist() == [False, False]
    assert np.isnan(found["distance_m"][1])


def test_times_that_differ_by_rounding_are_the_same_instant():
    decisions = pd.DataFrame([decision(0, 0.1 + 0.2, [(2, 100.0)])])
    found = audit_run(decisions, trace((0.9, "ego", 100.0, 2), (0.9, "car", 90.0, 2)), SETTINGS)
    assert found["violated"].tolist() == [True]


def runs_of(*rows):
    return pd.DataFrame(rows, columns=["run_id", "planner", "status", "risk_level"])


def rates_by_unit(audited, runs, **options):
    table = violation_rates(audited, runs, **options)
    return {(row.status, row.per): (row.violation_count, row.trial_count) for row in table.itertuples()}


def test_denominators_are_never_mixed_and_relaxed_plans_stand_apart():
    ego = [(0.6 * k, "ego", 100.0 + k, 2) for k in range(1, 5)]
    car = [(0.6 * k, "car", 200.0 if k != 3 else 110.0, 2) for k in range(1, 5)]
    decisions = pd.DataFrame(
        [
            decision(0, 0.0, [(2, 100.0), (2, 100.0)]),
            decision(1, 0.6, [(2, 100.0), (2, 100.0)]),  # its second step is violated at 1.8 s
            decision(2, 1.2, [(2, 100.0), (2, 100.0)], status="relaxed"),  # its first step is
            decision(3, 1.8, [(2, 100.0), (2, 100.0)]),  # its second step is beyond the record
        ]
    )
    audited = audit_run(decisions, trace(*ego[:3], *car[:3], (2.4, "ego", 104.0, 2)), SETTINGS)
    runs = runs_of(("r", "hmdp", "completed", 0.05))
    assert audited["observed"].sum() == 7
    assert rates_by_unit(audited, runs) == {
        ("optimal", "step"): (1, 5),
        ("optimal", "plan"): (1, 2),
        ("optimal", "run"): (1, 1),
        ("relaxed", "step"): (1, 2),
        ("relaxed", "plan"): (1, 1),
        ("relaxed", "run"): (1, 1),
    }
    # What the run itself says is of the plans that claim to keep their distances.
    own = METRICS.all
    run = RunData(EMPTY, decisions, steps=trace(*ego[:3], *car[:3], (2.4, "ego", 104.0, 2)), audit=SETTINGS)
    assert own["step_violation_rate"].compute(run) == 1 / 5
    assert own["plan_violation_rate"].compute(run) == 1 / 2
    assert np.isnan(own["plan_violation_rate"].compute(RunData(EMPTY, decisions)))


def test_a_run_without_any_plan_has_no_rate():
    """All its decisions are fallbacks; the audit of such a run ended in KeyError: 'intended_lane'."""
    decisions = pd.DataFrame([decision(0, 0.0, [], status="fallback") | {"vehicles_json": '["car"]'}])
    steps = trace((0.6, "ego", 100.0, 2), (0.6, "car", 110.0, 2))
    assert audit_run(decisions, steps, SETTINGS).empty
    found = METRICS.all["plan_violation_rate"].compute(RunData(EMPTY, decisions, steps=steps, audit=SETTINGS))
    assert np.isnan(found)


@pytest.mark.parametrize(("status", "plans"), [("completed", (0, 0)), ("contact", (1, 1))])
def test_a_plan_cut_short_by_a_contact_counts_if_it_is_violated(status, plans):
    audited = audit_run(DECISIONS, trace((0.6, "ego", 100.0, 2), (0.6, "car", 101.0, 2)), SETTINGS)
    found = rates_by_unit(audited, runs_of(("r", "hmdp", status, 0.05)))
    assert found["optimal", "step"] == (1, 1)
    assert found["optimal", "plan"] == plans
    assert found["optimal", "run"] == plans


def many(violated_by_run, planner="hmdp", first=0):
    """Build audited one-step plans from a list of truth values per run."""
    return pd.DataFrame(
        [
            {
                "run_id": f"r{first + run}",
                "decision_index": index,
                "status": "optimal",
                "horizon_step": 1 + index % 2,
                "observed": True,
                "violated": bool(value),
                "vehicle_id": "car" if value else "",
            }
            for run, values in enumerate(violated_by_run)
            for index, value in enumerate(values)
        ]
    )


def test_rates_by_planner_and_step():
    audited = pd.concat([many([[0, 1] * 5] * 8), many([[0, 0] * 5] * 150, first=8)], ignore_index=True)
    runs = runs_of(*((f"r{i}", "a" if i < 8 else "b", "completed", 0.05) for i in range(158)))
    table = violation_rates(audited, runs, ["planner", "horizon_step"]).set_index(["planner", "horizon_step"])
    assert table["per"].unique().tolist() == ["step"]
    assert table["violation_rate"].to_dict() == {("a", 1): 0.0, ("a", 2): 1.0, ("b", 1): 0.0, ("b", 2): 0.0}
    assert table["verdict"].to_dict() == {
        ("a", 1): "too few data",
        ("a", 2): "violated",
        ("b", 1): "conservative",
        ("b", 2): "conservative",
    }
    per = violation_rates(audited, runs, ["planner"]).set_index(["planner", "per"])["verdict"]
    assert per["a", "plan"] == "violated"
    assert per["b", "plan"] == "conservative"
    assert set(per[:, "run"]) == {"no claim"}


def test_consecutive_plans_that_one_vehicle_violates_are_one_event():
    audited = many([[1, 1, 1, 0, 1, 0], [0, 1, 1, 0, 0, 0]])
    assert event_count(audited) == 3
    # Another vehicle is another event, also without a plan between them.
    other = audited.copy()
    other.loc[(other["run_id"] == "r0") & (other["decision_index"] == 2), "vehicle_id"] = "truck"
    assert event_count(other) == 4
    assert event_count(many([[0, 0]])) == 0
    rates = violation_rates(audited, runs_of(("r0", "a", "completed", 0.05), ("r1", "a", "completed", 0.05)))
    assert rates.set_index("per").loc["plan", ["violation_count", "event_count"]].tolist() == [6, 3]


def test_runs_that_fail_as_a_whole_widen_the_interval():
    runs = runs_of(*((f"r{i}", "a", "completed", 0.05) for i in range(10)))
    clustered = violation_rates(many([[1] * 20] + [[0] * 20] * 9), runs).iloc[0]
    spread = violation_rates(many([[1, 1] + [0] * 18] * 10), runs).iloc[0]
    assert clustered["violation_rate"] == spread["violation_rate"] == 0.1
    # Twenty plans of one run are one bad run of ten, which eps = 0.05 may well give; twenty in all runs are not.
    assert (clustered["verdict"], spread["verdict"]) == ("too few data", "violated")
    assert (clustered["run_count"], clustered["effective_count"], clustered["df_count"]) == (10, 10, 0)


# With eps = 0.05 no violation in n runs reaches above it up to n = 71: 1 - 0.025^(1/n) = 0.0506, and 0.0499 for 72.
@pytest.mark.parametrize(
    ("hits", "runs", "expected"),
    [
        (0, 71, Verdict.TOO_FEW),
        (0, 72, Verdict.CONSISTENT),
        (0, 0, Verdict.TOO_FEW),
        (3, 3, Verdict.VIOLATED),
        (0, 145, Verdict.CONSISTENT),  # 0.0251
        (0, 146, Verdict.CONSERVATIVE),  # 0.0250
        (50, 1000, Verdict.CONSISTENT),
        (65, 1000, Verdict.VIOLATED),
    ],
)
@pytest.mark.parametrize("plans", [1, 32])
def test_the_verdict_by_hand(hits, runs, expected, plans):
    """Runs whose plans all agree tell the same, however many plans they have."""
    measured = clustered_proportion([plans] * hits + [0] * (runs - hits), [plans] * runs)
    assert judge(measured, 0.05) is expected


def test_no_violation_in_many_plans_of_few_runs_is_too_few_data():
    assert judge(clustered_proportion([0] * 20, [32] * 20), 0.05) is Verdict.TOO_FEW


def test_without_a_risk_level_there_is_no_claim():
    assert judge(clustered_proportion([0], [9]), float("nan")) is Verdict.NO_CLAIM


def test_missing_columns_of_runs_are_named():
    with pytest.raises(InputError, match="column density must be in the table of runs"):
        violation_rates(many([[0]]), runs_of(), ["density"])


def test_a_study_is_audited_run_by_run():
    lanes = {"count": 3, "width_m": 4.0}
    manifest = {"period_s": 0.6, "safe_distance_m": 20.0, "lanes": lanes, "parameters": {}, "run_id": "r"}
    rule = {**manifest, "safe_distance_m": None}
    found = audit_results(DECISIONS, STEPS, {"r": manifest, "q": rule})
    assert found["violated"].tolist() == [False, True]
    assert len(audit_results(DECISIONS, STEPS, {"q": rule})) == 0
    only_ego = STEPS[STEPS["vehicle_id"] == "ego"]
    with pytest.raises(InputError) as caught:
        audit_results(
            DECISIONS.assign(branch_count=3),
            only_ego,
            {"r": manifest, "s": {**manifest, "run_id": "s", "parameters": {"distance_rule": "mine"}}},
        )
    assert [str(problem) for problem in caught.value.problems] == [
        "run r must have all vehicles in its steps to be audited. Record it with --trace all",
        "distance_rule must be one of fixed, time_headway, rss for an audit, got mine (s). Leave the run out",
    ]
    with pytest.raises(InputError, match="run r must have all vehicles"):
        audit_results(DECISIONS, STEPS.iloc[:0], {"r": manifest})
    assert audit_settings(rule) is None


@pytest.mark.parametrize(
    ("branch", "status", "claim", "count", "expected"),
    [
        # The car ends at 117 m in lane 2 (cruise), 17 m ahead of the plan and 12 m of the ego.
        (("car", [2, 2], ["cruise", "cruise"], [110.0, 120.0], [1.0, 2.0]), "optimal", "planned", 1, Blame.CHANCE),
        (("car", [2, 2], ["cruise", "cruise"], [110.0, 124.0], [1.0, 2.0]), "optimal", "planned", 1, Blame.PREDICTOR),
        (("car", [2, 1], ["cruise", "cruise"], [110.0, 120.0], [1.0, 2.0]), "optimal", "planned", 1, Blame.PRUNING),
        (("car", [1, 2], ["cruise", "cruise"], [110.0, 120.0], [1.0, 2.0]), "optimal", "planned", 1, Blame.PRUNING),
        (("car", [2, 2], ["accelerate", "cruise"], [110.0, 120.0], [1.0, 2.0]), "optimal", "planned", 1, Blame.PRUNING),
        (("car", [2, 1], ["cruise", "cruise"], [110.0, 120.0], [1.0, 2.0]), "optimal", "planned", 5, Blame.UNKNOWN),
        (("bus", [2, 2], ["cruise", "cruise"], [110.0, 120.0], [1.0, 2.0]), "optimal", "planned", 1, Blame.UNSEEN),
        (("bus", [2, 2], ["cruise", "cruise"], [110.0, 120.0], [1.0, 2.0]), "relaxed", "planned", 1, Blame.PLANNER),
        (None, "optimal", "planned", 3, Blame.UNKNOWN),
        (None, "optimal", "planned", 0, Blame.UNSEEN),
    ],
)
def test_blame_by_hand(branch, status, claim, count, expected):
    branches = [] if branch is None else [branch]
    decisions = pd.DataFrame(
        [decision(0, 0.0, [(1, 90.0), (2, 100.0)], status=status, branches=branches, branch_count=count)]
    )
    steps = trace((0.6, "ego", 90.2, 1), (0.6, "car", 109.0, 2), (1.2, "ego", 105.0, 2), (1.2, "car", 117.0, 2))
    audited = audit_run(decisions, steps, SETTINGS, Claim(claim))
    found = blame_violations(audited, decisions, steps, SETTINGS, Claim(claim))
    assert found["blame"].tolist() == [str(expected)]
    assert found["tracking_error_m"].tolist() == pytest.approx([0.2])


@pytest.mark.parametrize(
    ("ego", "claim", "blames"),
    [(99.0, "executed", ["tracking"]), (90.4, "executed", ["chance"]), (99.0, "planned", ["chance"])],
)
def test_tracking_is_to_blame_only_for_where_the_ego_was(ego, claim, blames):
    branch = ("car", [2], ["cruise"], [109.0], [1.0])
    decisions = pd.DataFrame([decision(0, 0.0, [(2, 90.0)], branches=[branch])])
    steps = trace((0.6, "ego", ego, 2), (0.6, "car", 109.0, 2))
    audited = audit_run(decisions, steps, SETTINGS, Claim(claim))
    found = blame_violations(audited, decisions, steps, SETTINGS, Claim(claim))
    assert found["blame"].tolist() == blames


def test_any_branch_may_hold_the_vehicle():
    branches = [
        ("car", [2, 2], ["cruise", "cruise"], [110.0, 120.0], [1.0, 1.0]),
        ("car", [2, 1], ["cruise", "cruise"], [110.0, 117.5], [1.0, 1.0]),
        ("lost", [2, 2], ["cruise", "cruise"], [10.0, 20.0], [1.0, 1.0]),
    ]
    decisions = pd.DataFrame([decision(0, 0.0, [], branches=branches)])
    steps = trace((0.6, "car", 109.0, 2), (1.2, "car", 114.5, 2), (1.2, "lost", 20.0, 2))
    found = prediction_hits(decisions, steps, 0.6, level=0.99).set_index(["vehicle_id", "horizon_step"])
    # 3 m off at a spread of 1 m is outside 99 % (2.58), inside 99.9 % (3.29); the lane is that of the other branch.
    assert found["in_interval"].to_dict() == {("car", 1): True, ("car", 2): False, ("lost", 2): True}
    assert found["kept"].to_dict() == {("car", 1): True, ("car", 2): True, ("lost", 2): False}
    assert prediction_hits(decisions, steps, 0.6)["in_interval"].all()


def test_no_violation_no_blame():
    decisions = pd.DataFrame([decision(0, 0.0, [(2, 90.0)])])
    steps = trace((0.6, "ego", 90.0, 2))
    audited = audit_run(decisions, steps, SETTINGS)
    assert blame_violations(audited, decisions, steps, SETTINGS).empty


def test_a_world_that_follows_the_model_is_within_the_interval():
    """Plans that leave the margin of eps = 0.1 in a world of the predicted spread fall short in a tenth of cases."""
    rng = np.random.default_rng(8)
    margin = 1.2815515655446004  # the 90 % point of the normal distribution
    audited, runs = [], []
    for run in range(60):
        cars = 100.0 + 20.0 + margin + rng.normal(size=10)
        decisions = pd.DataFrame([decision(index, float(index), [(2, 100.0)], run=f"r{run}") for index in range(10)])
        seen = [
            (index + 0.6, *where) for index, car in enumerate(cars) for where in (("ego", 100.0, 2), ("car", car, 2))
        ]
        audited.append(audit_run(decisions, trace(*seen), SETTINGS))
        runs.append((f"r{run}", "hmdp", "completed", 0.1))
    table = violation_rates(pd.concat(audited, ignore_index=True), runs_of(*runs), level=0.99).set_index("per")
    assert table.loc["plan", "low_rate"] < 0.1 < table.loc["plan", "high_rate"]
    assert table.loc["plan", "verdict"] == "consistent"


def one_step(speed, lateral="keep", lane=2, **extra):
    """Build one decision with one step planned: lane 2 of three unless said, front bumper at 100 m."""
    step = {"step": 1, "lane": lane, "x_m": 100.0, "lateral": lateral, "speed_mps": speed}
    return pd.DataFrame([decision(0, 0.0, []) | {"plan_json": json.dumps([step]), "ego_y_m": 0.0} | extra])


def around(ego_length=5.0, **car):
    """Build the trace of one instant: the ego, and a car that is 8 m long in lane 2."""
    steps = trace((0.6, "ego", 100.0, 2), (0.6, "car", 0.0, 2))
    own = {"vehicle_id": "car", "length_m": 8.0, **car}
    steps.loc[1, list(own)] = list(own.values())
    return steps.assign(length_m=[ego_length, 8.0])


@pytest.mark.parametrize(
    ("rule", "car", "required"),
    [
        # 6 m and 1.5 s at 10 m/s between bumpers: to the car ahead with its 8 m, to the one behind with the ego's 5 m.
        ("time_headway", {"x_m": 128.0, "speed_mps": 30.0}, 8.0 + 6.0 + 15.0),
        ("time_headway", {"x_m": 75.0, "speed_mps": 30.0}, 5.0 + 6.0 + 15.0),
        # The ego, 10 m/s, goes 0.5 s on with 2 m/s2 (5.25 m, then 11 m/s) and brakes by 4 (15.125 m); the car ahead
        # brakes from 8 m/s by 8 (4 m). Behind, it is the car that comes from 16 m/s: 8.25 + 36.125 less 6.25 m.
        ("rss", {"x_m": 128.0, "speed_mps": 8.0}, 8.0 + 5.25 + 15.125 - 4.0),
        ("rss", {"x_m": 75.0, "speed_mps": 16.0}, 5.0 + 8.25 + 36.125 - 6.25),
        # From 40 m/s the car ahead needs 100 m to stop: bumpers may touch, and no less.
        ("rss", {"x_m": 107.0, "speed_mps": 40.0}, 8.0),
    ],
)
def test_distances_between_bumpers_by_hand(rule, car, required):
    settings = AuditSettings(0.6, SafeDistance(6.0, DistanceRule(rule), time_headway=1.5), ROAD)
    found = audit_run(one_step(10.0), around(**car), settings).iloc[0]
    assert found["required_m"] == pytest.approx(required)
    assert found["distance_m"] == abs(car["x_m"] - 100.0)
    assert found["violated"] == (abs(car["x_m"] - 100.0) < required)


# Width 1.8 m in lanes of 4 m: a body is over a lane while its centre is less than 2.9 m from that of the lane.
@pytest.mark.parametrize(
    ("y", "occupancy", "violated"), [(1.2, "swept", True), (1.0, "swept", False), (1.2, "target", False)]
)
def test_a_car_that_changes_lanes_is_in_both(y, occupancy, violated):
    """The car is still in lane 2 and intends it; the ego plans to be in lane 1, next to it."""
    steps = around(x_m=95.0, y_m=y)
    settings = AuditSettings(0.6, SafeDistance(20.0), ROAD, Occupancy(occupancy))
    found = audit_run(one_step(10.0, lane=1, ego_y_m=4.0), steps, settings)
    assert found["violated"].tolist() == [violated]


@pytest.mark.parametrize(("occupancy", "violated"), [("swept", True), ("target", False)])
def test_an_ego_that_leaves_a_lane_is_still_in_it(occupancy, violated):
    steps = around(x_m=110.0)
    settings = AuditSettings(0.6, SafeDistance(20.0), ROAD, Occupancy(occupancy))
    found = audit_run(one_step(10.0, lateral="left", lane=1), steps, settings)
    assert found["violated"].tolist() == [violated]


@pytest.mark.parametrize(("kept", "violated"), [('["car"]', True), ('["bus"]', False), ("[]", False), ("null", True)])
def test_only_distances_that_the_plan_kept_are_counted(kept, violated):
    """A follower in the ego's own lane keeps the distance by itself; without such a list all count."""
    found = audit_run(one_step(10.0, vehicles_json=kept), around(x_m=90.0), SETTINGS)
    assert found["violated"].tolist() == [violated]


def test_background_vehicles_intend_the_lane_that_they_head_for():
    """Recorded in lane 2 and moving left by 1 m/s, it is taken to intend lane 1; nothing was told of its mode."""
    rows = trace((0.4, "car", 50.0, 2), (0.6, "car", 55.0, 2), (0.4, "bus", 80.0, 3), (0.6, "bus", 85.0, 3))
    steps = rows.assign(y_m=[0.2, 0.4, -4.0, -4.0])
    shown = with_intents(steps, ROAD, frozenset())
    assert shown["intended_lane"].tolist() == [2, 1, 3, 3]
    assert shown["mode"].unique().tolist() == [""]
    told = with_intents(steps, ROAD, frozenset({"car"}))
    assert told["intended_lane"].tolist() == [2, 2, 3, 3]
    assert told["mode"].tolist() == ["cruise", "cruise", "", ""]
    assert with_intents(steps, ROAD, None) is steps


def test_the_lane_change_time_is_the_egos_unless_the_planner_has_its_own():
    lanes = {"count": 3, "width_m": 4.0}
    manifest = {"period_s": 0.6, "safe_distance_m": 2.0, "lanes": lanes, "planner": "p", "parameters": {}}
    configuration = {"ego": {"lane_change_time_s": 8.0}, "planners": {"p": {}}, "traffic": None, "vehicles": []}
    assert audit_settings({**manifest, "configuration": configuration}).lane_change_time == 8.0
    own = {**configuration, "planners": {"p": {"lane_change_time_s": 3.0}}, "traffic": {}}
    found = audit_settings({**manifest, "configuration": own})
    assert (found.lane_change_time, found.told) == (3.0, frozenset())


def test_lanes_that_nobody_thought_of_are_told_from_branches_that_were_left_out():
    """Two branches with the same lanes are shown, so all sequences of lanes are; the car went to another lane."""
    stay = [("car", [2, 2], ["cruise", mode], [110.0, 120.0], [1.0, 2.0]) for mode in ("cruise", "decelerate")]
    decisions = pd.DataFrame([decision(0, 0.0, [(1, 60.0), (1, 100.0)], branches=stay, branch_count=9)])
    steps = trace((0.6, "ego", 90.0, 1), (0.6, "car", 109.0, 2), (1.2, "ego", 105.0, 1), (1.2, "car", 117.0, 1))
    found = blame_violations(audit_run(decisions, steps, SETTINGS), decisions, steps, SETTINGS)
    assert found["blame"].tolist() == ["pruning"]
    # A mode that is not shown may be among those that were left out.
    braking = steps.assign(mode=["cruise", "accelerate"] * 2, lane=[1, 2, 2, 2], intended_lane=[1, 2, 2, 2])
    there = pd.DataFrame([decision(0, 0.0, [(1, 60.0), (2, 100.0)], branches=stay, branch_count=9)])
    found = blame_violations(audit_run(there, braking, SETTINGS), there, braking, SETTINGS)
    assert found["blame"].tolist() == ["unknown"]
