"""What is counted while a run is recorded, on moments made by hand."""

from dataclasses import replace

import pandas as pd
import pytest

from sumo_hmdp.domain.plan import Command, Decision, Status
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import Scene, VehicleState
from sumo_hmdp.metrics.summary import run_metrics
from sumo_hmdp.scenario.load import RunOptions, find_scenario, load_scenario
from sumo_hmdp.sim.contact import Contact, Side
from sumo_hmdp.sim.episode import Moment
from sumo_hmdp.study.record import Recorder
from sumo_hmdp.study.run import execute
from sumo_hmdp.vehicle.tracking import TrackingInfo

SCENE = Scene(0.0, Road(3, 4.0), VehicleState("ego", 0.0, 0.0, 20.0, 2), ())
QUIET = Moment(0, SCENE, None, (), (), None)
SOLVED = TrackingInfo(solved=True, status="solved", iterations=3, x_error=0.0, y_error=0.0)


def test_counts_of_the_recorder():
    front = Contact("car", Side.FRONT, at_fault=True, time=0.1)
    rear = Contact("bus", Side.REAR, at_fault=False, time=0.1)
    recorder = Recorder("r")
    moments = (
        replace(QUIET, tracking=SOLVED),
        replace(QUIET, tracking=replace(SOLVED, solved=False), sumo_contacts=(("ego", "car"), ("ego", "bus"))),
        replace(QUIET, tracking=replace(SOLVED, solved=False)),
        replace(QUIET, contacts=(front, rear), sumo_contacts=(("ego", "car"),)),
    )
    for moment in moments:
        recorder.observe(moment)
    # Two bodies touched, one by the ego's fault; SUMO named the ego at two instants; two programs were not solved.
    counted = {"contact_count": len(recorder.contacts), "contact_at_fault_count": recorder.contacts_at_fault}
    counted |= {"sumo_contact_count": recorder.sumo_contacts, "tracking_failure_count": recorder.qp_failures}
    assert counted == {
        "contact_count": 2,
        "contact_at_fault_count": 1,
        "sumo_contact_count": 2,
        "tracking_failure_count": 2,
    }


def test_contacts_that_only_one_list_has_are_told():
    recorder = Recorder("r")
    both, bodies = (Contact(name, Side.FRONT, at_fault=True, time=4.4375) for name in ("both", "bodies"))
    recorder.observe(replace(QUIET, contacts=(both, bodies), sumo_contacts=(("ego", "both"), ("only", "ego"))))
    # They become the column "contact_disagreement_count"; "contact_first_s" is the first time of the bodies' own.
    assert recorder.disagreements() == [
        "SUMO lists a contact with only, which the bodies did not have",
        "SUMO does not list the contact with bodies at 4.44 s",
    ]
    assert recorder.contact_sentences()[0] == "contact with both at 4.44 s, the ego's fault"
    assert recorder.front_contact


def test_whom_a_decision_keeps_a_distance_to_is_written_down():
    recorder = Recorder("r")
    for vehicles in (None, (), ("a", "b")):
        decision = Decision(0.0, Status.RULE, Command(2, 0.0), vehicles=vehicles)
        recorder.observe(replace(QUIET, decision=decision))
    assert recorder.decision_table()["vehicles_json"].tolist() == ["null", "[]", '["a", "b"]']


def test_a_decision_that_took_longer_than_its_period_missed_the_deadline():
    ready = load_scenario(find_scenario("case2"), RunOptions("constant", overrides={"duration_s": 0.6}))
    period = ready.planner.period
    times = iter((0.5 * period, 1.5 * period, period, 2.0 * period) * 10)

    class Slow:
        """The planner, with times of its own: two of four are beyond the period."""

        name = "slow"

        def __init__(self):
            self.period = period

        def initial_memory(self):
            return ready.planner.initial_memory()

        def decide(self, scene, memory):
            decision, memory = ready.planner.decide(scene, memory)
            return replace(decision, solve_time=next(times)), memory

    record = execute(replace(ready, planner=Slow()), detailed=False)
    given = [0.5, 1.5, 1.0, 2.0] * 10
    missed = sum(share > 1.0 for share in given[: len(record.decisions)])
    assert missed > 0
    assert record.row["deadline_miss_count"] == missed


def test_quantiles_of_the_decision_time():
    """Of 0, 1, .. 200 ms the 99 % quantile is 198 ms."""
    columns = {"time_s": 0.0, "status": "optimal", "lateral": "keep", "violation_m": 0.0}
    decisions = pd.DataFrame({"solve_time_ms": [float(t) for t in range(200, -1, -1)]}).assign(**columns)
    recorder = Recorder("r")
    recorder.observe(QUIET)
    row = run_metrics(recorder.step_table(), decisions)
    found = [row[name] for name in ("solve_time_median_ms", "solve_time_p99_ms", "solve_time_max_ms")]
    assert found == pytest.approx([100.0, 198.0, 200.0])
