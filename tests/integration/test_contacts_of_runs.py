"""Contacts of whole runs: where they happen in a step, whose fault they are, and what the tables say of them."""

import json
from pathlib import Path

import pandas as pd
import pytest

from sumo_hmdp.scenario.load import RunOptions, find_scenario, load_scenario
from sumo_hmdp.study.record import Trace
from sumo_hmdp.study.run import execute, save

STANDING = Path(__file__).parents[1] / "fixtures" / "contacts" / "standing_car.yaml"


def run_of(**overrides):
    renamed = {name.replace("__", "."): value for name, value in overrides.items()}
    renamed = {name.replace("b.", "vehicles[0]."): value for name, value in renamed.items()}
    return execute(load_scenario(STANDING, RunOptions(overrides=renamed)), detailed=False)


@pytest.mark.parametrize("dt", [1.0, 0.5, 0.2, 0.1])
@pytest.mark.parametrize("x", [165.0, 168.4, 182.0])
def test_a_standing_car_is_hit_at_the_same_time_whatever_the_step(dt, x):
    row = run_of(dt_s=dt, b__x_m=x).row
    assert row["contact_first_s"] == pytest.approx((x - 4.5) / 40.0, abs=1e-6)
    assert (row["status"], row["contact_count"], row["contact_at_fault_count"]) == ("contact", 1, 1)
    assert row["gap_min_m"] <= 0.0
    assert (row["ttc_min_s"], row["ttc_leader_min_s"], row["time_gap_min_s"]) == (0.0, 0.0, 0.0)
    assert (row["ttc2d_min_s"], row["mttc_min_s"], row["drac_max_mps2"]) == (0.0, 0.0, float("inf"))
    assert row["near_miss_count"] >= 1
    assert f"contact with b at {row['contact_first_s']:.2f} s, the ego's fault" in row["reason"]


@pytest.mark.parametrize(("x", "speed", "dt"), [(40.9, 12.0, 0.4), (60.0, 15.0, 0.2), (33.3, 10.0, 0.1)])
def test_a_slower_car_is_hit_by_the_egos_fault(x, speed, dt):
    row = run_of(dt_s=dt, b__x_m=x, b__speed_mps=speed, ego__speed_mps=30.0).row
    assert row["contact_first_s"] == pytest.approx((x - 4.5) / (30.0 - speed), abs=1e-6)
    assert (row["contact_at_fault_count"], row["ttc_min_s"]) == (1, 0.0)


@pytest.mark.parametrize("x", [4.5, 4.5 + 1e-9])
@pytest.mark.parametrize("speed", [10.0, 13.3])
def test_touching_is_no_contact(x, speed):
    row = run_of(b__x_m=x, b__speed_mps=speed, ego__speed_mps=speed).row
    assert (row["status"], row["contact_count"], row["gap_min_m"]) == ("completed", 0, 0.0)
    assert (row["ttc_min_s"], row["drac_max_mps2"]) == (float("inf"), 0.0)
    assert row["contact_first_s"] is None


def test_tables_and_manifest_tell_of_a_contact(tmp_path):
    record = run_of(b__x_m=182.0, dt_s=1.0)
    named = record.manifest["contact_disagreements"]
    assert record.row["contact_disagreement_count"] == len(named)
    save(record, tmp_path, Trace.ALL, dump_decisions=False)
    row = pd.read_parquet(next((tmp_path / "runs").glob("*.parquet"))).iloc[0]
    assert row["contact_first_s"] == pytest.approx(4.4375, abs=1e-6)
    assert json.loads(next((tmp_path / "manifests").glob("*.json")).read_text())["contact_disagreements"] == named


@pytest.mark.parametrize("dt", [0.2, 0.4])
def test_a_point_mass_is_where_its_plan_puts_it(dt):
    """Each period of one acceleration covers v T + a T^2 / 2, whatever the step (docs/formulation.md, eq. 37)."""
    changes = {"dt_s": dt, "duration_s": 4.0, "noise": False, "vehicles[0].x_m": 60.0}
    record = execute(load_scenario(find_scenario("matched_tight"), RunOptions(overrides=changes)), detailed=False)
    ego = record.steps[record.steps["vehicle_id"] == "ego"]
    ego = ego.set_index(ego["time_s"].round(6))
    plans = [(row.time_s, json.loads(row.plan_json)[0]) for row in record.decisions.itertuples()]
    assert len({round(step["speed_mps"], 6) for _, step in plans}) > 1
    for time, step in plans:
        assert ego.loc[round(time + 0.8, 6), "x_m"] == pytest.approx(step["x_m"], abs=1e-6)
