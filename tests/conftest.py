"""A study written by hand: real cells and the store's own writer, but rows whose statistics are known."""

import json
from datetime import UTC, datetime

import pandas as pd
import pytest

STUDY = """
name: by_hand
description: Rows written by hand.
scenarios: [highway]
factors:
  planner: [hmdp_mpc, idm_mobil]
  risk_level: [0.05, 0.2]
  planners.hmdp_mpc.distance_rule: [RULE]
seeds: {count: 12}
trace: all
solver: search
"""
# Seeds whose runs end in a contact, by risk level; in these the plan breaks the distance, too.
CONTACTS = {0.05: (), 0.2: (0, 4, 7), None: ()}
# How much faster than the baseline's 20 m/s + seed / 10 a run is, and how much more with every seed [m/s].
FASTER = {0.05: (1.0, 0.01), 0.2: (2.0, 0.01), None: (0.0, 0.0)}
SAFE_DISTANCE = 8.0


def run_row(cell, seed):
    """One row of `runs`."""
    risk_level = cell.ready.parameters.get("risk_level")
    more, per_seed = FASTER[risk_level]
    contact = seed in CONTACTS[risk_level]
    plans = risk_level is not None
    return {
        "run_id": cell.run_id(seed), "scenario": "highway", "planner": cell.ready.planner_name, "solver": "search",
        "seed": seed, "risk_level": risk_level, "status": "contact" if contact else "completed",
        "reason": "contact with v1 at 0.80 s, the ego's fault" if contact else None,
        "duration_s": 60.0, "distance_m": 1200.0, "speed_mean_mps": 20.0 + seed / 10 + more + per_seed * seed,
        "gap_min_m": 10.0, "ttc_min_s": float("inf") if not plans and seed == 3 else 4.0 - contact,
        "contact_count": int(contact), "contact_at_fault_count": int(contact), "near_miss_count": int(contact),
        "rss_violation_share": 0.0, "drac_max_mps2": 1.0, "jerk_rms_mps3": 2.0,
        "violation_max_m": 0.5 if plans and seed == 5 else 0.0 if plans else None,
        "reproducible": True, "trace_hash": f"hash{seed}",
    }  # fmt: skip


def decision_rows(cell, run_id, seed):
    """Four decisions: three with the plan of one step, the last a fallback, with times from 10 to 40 ms."""
    from sumo_hmdp.study.record import DECISION_COLUMNS  # noqa: PLC0415 - not needed where no study is

    risk_level = cell.ready.parameters.get("risk_level")
    plan = [{"step": 1, "lateral": "keep", "mode": "cruise", "lane": 2, "x_m": 100.0, "speed_mps": 20.0}]
    rows = [
        {
            "run_id": run_id, "decision_index": index, "time_s": 0.8 * index,
            "status": "rule" if risk_level is None else "fallback" if index == 3 else "optimal",
            "lane": 2, "ego_y_m": 0.0, "solve_time_ms": 10.0 * (index + 1), "forbidden_json": "[]",
            "branch_count": 0 if risk_level is None else 2,
            "plan_json": json.dumps([] if risk_level is None or index == 3 else plan),
            "vehicles_json": '["v1"]', "branches_json": "[]",
        }
        for index in range(4)
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=list(DECISION_COLUMNS)).astype(DECISION_COLUMNS)


def step_rows(cell, run_id, seed):
    """The ego and one vehicle, which is too near in the first plan of the runs of `CONTACTS`."""
    from sumo_hmdp.study.record import STEP_COLUMNS  # noqa: PLC0415

    broken = seed in CONTACTS[cell.ready.parameters.get("risk_level")]
    rows = [
        {
            "run_id": run_id, "step": index, "time_s": 0.8 * index, "vehicle_id": name, "lane": 2, "intended_lane": 2,
            "x_m": 100.0 if name == "ego" else 100.0 + (SAFE_DISTANCE - 1 if broken and index == 1 else 30.0),
            "y_m": 0.0, "heading_rad": 0.0, "speed_mps": 20.0, "accel_mps2": 0.0, "mode": "cruise",
            "length_m": 4.5, "width_m": 1.8,
        }
        for index in range(4)
        for name in ("ego", "v1")
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=list(STEP_COLUMNS)).astype(STEP_COLUMNS)


@pytest.fixture(scope="session")
def study_by_hand(tmp_path_factory):
    """Return a function that writes a study: `seeds` of it, the vehicles that `trace` says, failed runs."""
    from sumo_hmdp.study.design import load_design  # noqa: PLC0415
    from sumo_hmdp.study.ledger import Ledger  # noqa: PLC0415
    from sumo_hmdp.study.parts import RunTables, Writer, opened  # noqa: PLC0415
    from sumo_hmdp.study.record import RunStatus  # noqa: PLC0415
    from sumo_hmdp.study.worker import Outcome  # noqa: PLC0415

    designs = {}

    def design_of(rule):
        if rule not in designs:
            file = tmp_path_factory.mktemp("design") / "study.yaml"
            file.write_text(STUDY.replace("RULE", rule))
            designs[rule] = load_design(file), file
        return designs[rule]

    def write(folder, seeds=range(12), trace="all", failed=(), rule="fixed", change=dict):
        design, file = design_of(rule)
        with opened(folder):
            writer = Writer(folder, design.cells)
            writer.describe_cells()
            (folder / "study.yaml").write_text(file.read_text())
            for cell in design.cells:
                for seed in seeds:
                    row = run_row(cell, seed)
                    if seed in failed:
                        keys = ("run_id", "scenario", "planner", "solver", "seed", "risk_level")
                        lost = {key: row[key] for key in keys} | {"status": "failed", "reason": "ValueError: <b>"}
                        writer.add(RunTables(cell.id, lost, traceback="Traceback"))
                        outcome = Outcome(row["run_id"], RunStatus.FAILED, "ValueError: <b>", 1.5)
                        Ledger(folder).note(outcome)
                        continue
                    steps = step_rows(cell, row["run_id"], seed)
                    kept = {"all": ["ego", "v1"], "ego": ["ego"], "none": []}[trace]
                    decisions = decision_rows(cell, row["run_id"], seed)
                    steps = steps[steps["vehicle_id"].isin(kept)]
                    writer.add(RunTables(cell.id, change(row), steps, decisions))
            writer.flush()
        return folder

    return write


@pytest.fixture
def at_noon(monkeypatch):
    """The ledger's clock stands."""
    from sumo_hmdp.study import ledger  # noqa: PLC0415

    class Noon(datetime):
        @classmethod
        def now(cls, tz=None):
            return datetime(2026, 1, 1, 12, tzinfo=UTC)

    monkeypatch.setattr(ledger, "datetime", Noon)
