"""Answers that no vehicle can carry out end a run at once, in words that their author understands."""

import json
import math
from dataclasses import dataclass, replace

import pytest

from sumo_hmdp.decision.baselines import ConstantPlanner, rule_decision
from sumo_hmdp.decision.contract import PlannerError, require_decision, steps_per_decision
from sumo_hmdp.domain.maneuver import Lateral
from sumo_hmdp.domain.plan import Command, Decision, Status
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import EGO_ID, Scene, VehicleState
from sumo_hmdp.scenario.load import RunOptions, find_scenario, load_scenario
from sumo_hmdp.study.run import execute


@pytest.mark.parametrize(("period", "steps"), [(0.15, 1), (0.3, 2), (0.6000000000000001, 4)])
def test_periods_are_whole_numbers_of_steps(period, steps):
    assert steps_per_decision(ConstantPlanner(period), 0.15) == steps


@pytest.mark.parametrize("period", [0.0, 0.05, 0.2, -0.15, math.inf, math.nan])
def test_no_other_periods(period):
    with pytest.raises(PlannerError, match=r"the planner's period must be a multiple of dt \(0.15 s\), got "):
        steps_per_decision(ConstantPlanner(period), 0.15)


@dataclass(frozen=True)
class Answering:
    """Answers always the same."""

    command: object
    period: float = 0.15

    def initial_memory(self):
        return None

    def decide(self, scene, memory):
        if not isinstance(self.command, Command):
            return self.command, memory
        return rule_decision(scene, self.command, Lateral.KEEP), memory


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (Command(9, 0.0), "PlannerError: command.lane must be 1..3, got 9 (at 0 s)"),
        (Command(1.5, 0.0), "PlannerError: command.lane must be 1..3, got 1.5 (at 0 s)"),
        (Command(2, math.nan), "PlannerError: command.accel must be a finite number, got nan m/s2 (at 0 s)"),
        ("go", "PlannerError: decide must return a Decision and the memory, got 'go'"),
    ],
)
def test_a_run_ends_with_the_first_wrong_answer(command, reason):
    ready = load_scenario(find_scenario("case2"), RunOptions(planner="constant", overrides={"duration_s": 0.6}))
    record = execute(replace(ready, planner=Answering(command)))
    assert (record.status, record.reason) == ("failed", reason)


@pytest.mark.parametrize("notes", [{"gap_m": math.inf}, {"gap_m": None}, {3: "three"}, {"gaps_m": [1.0]}])
def test_notes_are_names_with_numbers_or_words(notes):
    road = Road(3, 4.0)
    scene = Scene(1.0, road, VehicleState(EGO_ID, 0.0, 0.0, 20.0, 2), ())
    decision = replace(rule_decision(scene, Command(2, 0.0), Lateral.KEEP), notes=notes)
    with pytest.raises(PlannerError, match="notes must map names to finite numbers, true or false, or text, got"):
        require_decision(decision, road)


def test_notes_are_kept_as_they_were_told():
    notes = {"gap_m": 12.5, "safe": True, "why": "free road"}
    decision = Decision(0.0, Status.RULE, Command(2, 0.0), notes=notes)
    require_decision(decision, Road(3, 4.0))
    notes["gap_m"] = 1.0
    assert dict(decision.notes) == {"gap_m": 12.5, "safe": True, "why": "free road"}
    with pytest.raises(TypeError):
        decision.notes["gap_m"] = 2.0
    assert hash(decision) == hash(replace(decision, notes={}))


def test_notes_stand_in_the_decisions_table():
    ready = load_scenario(find_scenario("case2"), RunOptions(planner="idm_mobil", overrides={"duration_s": 0.6}))
    record = execute(ready)
    first = json.loads(record.decisions["notes_json"].iloc[0])
    assert first["lane_3_safe"] == "no: the lane is forbidden"
    assert {"lane_1_accel_mps2", "lane_1_incentive_mps2", "lane_2_accel_mps2"} <= set(first)
