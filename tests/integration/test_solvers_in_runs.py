"""Solvers inside whole runs: another one, both at once, a dispute, and an enforced deadline."""

import json
from dataclasses import replace

import pytest

import sumo_hmdp
from sumo_hmdp.decision import decide
from sumo_hmdp.decision.problem import ManeuverSequence
from sumo_hmdp.domain.maneuver import Lateral, Mode


def test_both_solvers_drive_alike_and_say_so(call, short_case, tmp_path):
    out = tmp_path / "out"
    for solver in ("milp", "search", "both"):
        assert call("run", short_case(9.0), "--solver", solver, "--out", out).code == 0
    decisions = sumo_hmdp.load(out).decisions
    assert set(decisions["solver"]) == {"milp", "search", "both"}
    # Between equal plans they may choose differently; here there are none.
    objectives = decisions.pivot_table(index="time_s", columns="solver", values="objective")
    assert objectives["milp"].to_numpy() == pytest.approx(objectives["search"].to_numpy(), abs=1e-6)
    assert objectives["both"].to_numpy() == pytest.approx(objectives["search"].to_numpy(), abs=1e-6)


def test_a_dispute_stops_the_run_with_the_decision_s_file(call, short_case, tmp_path, monkeypatch):
    wrong = ManeuverSequence((Lateral.KEEP,) * 3, (Mode.DECELERATE,) * 3)
    honest = decide.SEARCH.best

    def best(problem, lattice, corridors, *, deadline):
        return wrong if problem.ego.x > 80.0 else honest(problem, lattice, corridors, deadline=deadline)

    monkeypatch.setattr(decide, "SEARCH", replace(decide.SEARCH, best=best))
    out = tmp_path / "out"
    finished = call("run", short_case(9.0), "--solver", "both", "--out", out)
    assert finished.code == 1
    row = sumo_hmdp.load(out).runs.iloc[0]
    assert row["status"] == "failed"
    assert "both solvers must agree" in row["reason"]
    dispute = out / "failures" / f"{row['run_id']}.json"
    assert str(dispute) in finished.err
    assert json.loads(dispute.read_text())["ego"]["x_m"] > 80.0
    # The file is a decision problem like any other.
    monkeypatch.undo()
    again = call("decide", dispute, "--solver", "both")
    assert json.loads(again.out)["status"] == "optimal"


def test_an_enforced_deadline_marks_the_run_as_not_reproducible(call, short_case, tmp_path):
    scenario = short_case(1.5, "    period_s: 0.6 ", "    enforce_deadline: true\n    period_s: 0.6 ")
    assert call("run", scenario, "--out", tmp_path / "out").code == 0
    row = sumo_hmdp.load(tmp_path / "out").runs.iloc[0]
    assert not row["reproducible"]
    assert row["deadline_miss_count"] == 0
    assert call("run", short_case(1.5), "--out", tmp_path / "usual").code == 0
    assert sumo_hmdp.load(tmp_path / "usual").runs.iloc[0]["reproducible"]
