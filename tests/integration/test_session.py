"""A run that is stepped gives what a run gives; misuse is said in one line."""

import pytest

import sumo_hmdp
from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.domain.plan import Command, Decision, Status
from sumo_hmdp.errors import InputError, SimulationError
from sumo_hmdp.study.record import RunStatus

KEYS = {"duration_s": 3.0}


class Steady:
    """Keeps lane 2 and brakes a little."""

    period = 0.6

    def initial_memory(self):
        return 0

    def decide(self, scene, memory):
        return Decision(scene.time, Status.RULE, Command(2, -0.5), mode=Mode.DECELERATE, violation=None), memory + 1


@pytest.fixture(scope="module")
def run():
    return sumo_hmdp.scenario("case2", "idm_mobil", keys=KEYS)


@pytest.fixture(scope="module")
def record(run):
    return sumo_hmdp.run(run)


def test_stepping_without_orders_is_the_run(run, record):
    with sumo_hmdp.Session(run) as session:
        moment = session.reset()
        assert (moment.step, moment.scene.time, moment.decision) == (0, 0.0, None)
        while not session.ended:
            moment = session.step()
        stepped = session.record()
        first = stepped.row["trace_hash"]
        session.reset()
        assert session.record().status is RunStatus.INTERRUPTED
        while not session.ended:
            session.step()
        again = session.record()
    assert moment.step == 20
    assert stepped.status is RunStatus.COMPLETED
    assert first == again.row["trace_hash"] == record.row["trace_hash"]
    assert stepped.steps.equals(record.steps)


def test_commands_are_decisions_of_the_run():
    ready = sumo_hmdp.scenario("case2", Steady(), keys=KEYS)
    planned = sumo_hmdp.run(ready)
    with sumo_hmdp.Session(ready) as session:
        session.reset()
        step = 0
        while not session.ended:
            session.step(Command(2, -0.5) if step % 4 == 0 else None)
            step += 1
        commanded = session.record()
    assert planned.row["trace_hash"] == commanded.row["trace_hash"]
    assert planned.row["planner"] == "steady"
    # v = 30 - 0.5 t, so 3 s later 28.5 m/s.
    ego = commanded.steps[commanded.steps["vehicle_id"] == "ego"]
    assert ego["speed_mps"].iloc[-1] == pytest.approx(28.5, abs=0.05)


def test_a_lane_in_a_command_is_a_lane_change(run):
    with sumo_hmdp.Session(run) as session:
        session.reset()
        session.step(Command(1, 1.0))
        decisions = session.record().decisions
    assert decisions["lateral"].tolist() == [Lateral.LEFT.label]
    assert decisions["mode"].tolist() == ["accelerate"]


def test_misuse_is_said_in_one_line(run):
    session = sumo_hmdp.Session(run)
    with pytest.raises(SimulationError, match=r"call reset\(\) first"):
        session.step()
    with session:
        session.reset()
        with sumo_hmdp.Session(run) as second, pytest.raises(SimulationError, match="one"):
            second.reset()
        while not session.ended:
            session.step()
        with pytest.raises(SimulationError, match="got its end at 3 s"):
            session.step()
    with pytest.raises(SimulationError, match=r"reset\(\)"):
        session.step()


@pytest.mark.parametrize(("planner", "text"), [(Steady, "call Steady"), (object(), "no period, initial_memory")])
def test_what_is_no_planner_is_refused(planner, text):
    with pytest.raises(InputError, match=text):
        sumo_hmdp.scenario("case2", planner)


def test_set_is_an_override(shell, tmp_path):
    done = shell("run", "case2", "--planner", "constant", "--set", "duration_s=0.3", "--set", "ego.speed_mps=20",
                 "--out", tmp_path)  # fmt: skip
    assert done.code == 0, done.err
    steps = sumo_hmdp.load(tmp_path).steps
    assert steps["step"].max() == 2
    assert steps[steps["vehicle_id"] == "ego"]["speed_mps"].iloc[0] == 20.0


def test_each_mistake_of_set_is_one_line(shell, tmp_path):
    wrong = ["ego.speed_mps", "=3", "ego..x=1", "ego.lane=[", "dt_s=0.1", "dt_s=0.2"]
    done = shell("run", "case2", "--out", tmp_path, *(part for text in wrong for part in ("--set", text)))
    assert (done.code, len(done.err.splitlines())) == (2, 5)
    unknown = shell("run", "case2", "--out", tmp_path, "--set", "ego.sped_mps=3", "--set", "duration_s=x")
    assert (unknown.code, len(unknown.err.splitlines())) == (2, 2)
    assert list(tmp_path.iterdir()) == []
