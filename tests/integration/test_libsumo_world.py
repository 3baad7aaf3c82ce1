"""The world against SUMO itself: exact poses, textbook IDM, both lanes' followers, contacts, determinism."""

import importlib.util
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.errors import InputError, SimulationError
from sumo_hmdp.sim import libsumo_world
from sumo_hmdp.sim.contact import contacts
from sumo_hmdp.sim.libsumo_world import LibsumoWorld
from sumo_hmdp.sim.sumo import libsumo
from sumo_hmdp.traffic.spawn import DriverKind, IdmParameters, Spawn

SCRIPT = Path(__file__).with_name("libsumo_trace.py")
_spec = importlib.util.spec_from_file_location("libsumo_trace", SCRIPT)
run = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(run)

EXACT = 1e-9


@pytest.fixture
def sumo():
    return libsumo.vehicle


def ghosts(sumo):
    return [name for name in sumo.getIDList() if name.startswith("ghost")]


def test_everybody_starts_exactly(sumo):
    ego = replace(run.EGO, x=1.23456789012, y=0.31, speed=21.0987654321, heading=0.02)
    others = (
        Spawn("b", lane=3, x=100.123456789, speed=22.123456789),
        Spawn("a", lane=1, x=-50.5, speed=0.0, driver=DriverKind.IDM, desired_speed=30.0, length=9.0, width=2.5),
    )
    with LibsumoWorld(run.settings(), ego, others) as world:
        assert world.time == 0.0
        assert sumo.getPosition("ego") == pytest.approx((ego.x, ego.y), abs=EXACT)
        assert sumo.getSpeed("ego") == ego.speed
        a, b = world.observe()
        assert (a.id, a.y, a.speed, a.lane, a.length, a.width) == ("a", 4.0, 0.0, 1, 9.0, 2.5)
        assert (b.id, b.y, b.speed, b.lane) == ("b", -4.0, 22.123456789, 3)
        assert a.x == pytest.approx(-50.5, abs=EXACT)
        assert b.x == pytest.approx(100.123456789, abs=EXACT)
        assert b.heading == b.lateral_speed == b.accel == 0.0


@pytest.mark.parametrize("dt", [0.02, 0.2])
def test_the_ego_is_where_it_was_sent_in_the_same_step(sumo, dt):
    with LibsumoWorld(run.settings(dt), run.EGO, ()) as world:
        lanes, speed = set(), 20.0
        for step in range(1, round(6.0 / dt) + 1):
            time = step * dt
            speed += 1.5 * dt * (1 if time < 3.0 else -4)
            ego = replace(run.lane_change(time, 1.0, 0.0, 4.0), speed=speed)
            world.advance(ego, {})
            assert sumo.getPosition("ego") == pytest.approx((ego.x, ego.y), abs=EXACT)
            assert math.radians(90.0 - sumo.getAngle("ego")) == pytest.approx(ego.heading, abs=EXACT)
            assert sumo.getSpeed("ego") == speed
            assert sumo.getAcceleration("ego") == pytest.approx(1.5 if time < 3.0 else -6.0, abs=1e-6)
            assert world.observe() == ()
            lanes.add(run.ROAD.lane_of_sumo_index(sumo.getLaneIndex("ego")))
        assert lanes == {1, 2}
        assert world.sumo_contacts() == ()
        assert ghosts(sumo) == []


@pytest.mark.parametrize("y", [2.0, -2.0])
def test_on_the_line_itself_the_ghost_is_in_the_other_lane(sumo, y):
    with LibsumoWorld(run.settings(), run.EGO, ()) as world:
        world.advance(replace(run.EGO, x=4.0, y=y), {})
        (ghost,) = ghosts(sumo)
        assert abs(sumo.getLaneIndex(ghost) - sumo.getLaneIndex("ego")) == 1
        assert {run.ROAD.lane_of_sumo_index(sumo.getLaneIndex(n)) for n in (ghost, "ego")} == {
            2,
            1 if y > 0 else 3,
        }


def test_scripted_vehicles_move_exactly_by_their_speed():
    speeds = [30.0, 0.0, 0.0, 59.0, 70.0, 12.3456]
    with LibsumoWorld(run.settings(), run.EGO, (Spawn("s", lane=3, x=50.0, speed=30.0),)) as world:
        x, before = 50.0, 30.0
        for k, speed in enumerate(speeds):
            world.advance(replace(run.EGO, x=4.0 * (k + 1)), {"s": speed})
            x += speed * 0.2
            (s,) = world.observe()
            assert (s.speed, s.lane, s.y) == (speed, 3, -4.0)
            assert s.x == pytest.approx(x, abs=EXACT)
            assert s.accel == pytest.approx((speed - before) / 0.2)
            before = speed


def test_posed_vehicles_are_where_they_were_sent_and_their_lateral_speed_is_seen():
    with LibsumoWorld(run.settings(), run.EGO, (Spawn("p", 3, 60.0, 20.0, driver=DriverKind.POSED),)) as world:
        for step in range(1, 31):
            time = step * 0.2
            pose = run.lane_change(time, 1.0, -4.0, 0.0, replace(run.EGO, id="p", x=60.0))
            world.advance(replace(run.EGO, x=20.0 * time), {}, [pose])
            (p,) = world.observe()
            assert (p.x, p.y, p.speed) == pytest.approx((pose.x, pose.y, 20.0), abs=EXACT)
            assert p.heading == pytest.approx(pose.heading, abs=EXACT)
            assert p.lateral_speed == pytest.approx(20.0 * math.sin(pose.heading), abs=1e-6)
        assert p.lane == 2


def idm_accel(speed, gap, lead_speed, v0, p):
    """The Intelligent Driver Model of Treiber, Hennecke and Helbing (2000)."""
    wanted = p.min_gap + max(
        0.0, p.time_gap * speed + speed * (speed - lead_speed) / (2 * math.sqrt(p.accel * p.decel))
    )
    return p.accel * (1 - (speed / v0) ** p.exponent - (wanted / gap) ** 2)


@pytest.mark.parametrize(
    "p", [IdmParameters(), IdmParameters(min_gap=3.0, time_gap=1.1, accel=3.0, decel=4.0, exponent=6.0)]
)
def test_idm_followers_of_the_ego_drive_by_the_textbook(p):
    follower = Spawn("f", lane=2, x=-45.0, speed=22.0, driver=DriverKind.IDM, desired_speed=31.0, idm=p)
    ego = run.EGO
    with LibsumoWorld(run.settings(), ego, (follower,)) as world:
        for step in range(1, 101):
            (f,) = world.observe()
            expected = idm_accel(f.speed, ego.x - ego.length - f.x, ego.speed, 31.0, p)
            speed = 20.0 + 3.0 * math.sin(0.1 * step)
            ego = replace(ego, x=ego.x + speed * 0.2, speed=speed, accel=(speed - ego.speed) / 0.2)
            world.advance(ego, {})
            (after,) = world.observe()
            assert after.accel == pytest.approx(expected, abs=1e-8)
            assert after.x == pytest.approx(f.x + after.speed * 0.2, abs=EXACT)
        assert world.sumo_contacts() == ()


def test_passing_on_the_right_is_free():
    passer = Spawn("i", lane=3, x=-60.0, speed=25.0, driver=DriverKind.IDM, desired_speed=30.0)
    slow = Spawn("s", lane=1, x=30.0, speed=5.0)
    ego = replace(run.EGO, speed=10.0)
    with LibsumoWorld(run.settings(), ego, (passer, slow)) as world:
        for step in range(1, 51):
            speed = world.observe()[0].speed
            world.advance(replace(ego, x=2.0 * step), {"s": 5.0})
            (i, _) = world.observe()
            # Free road: a (1 - (v / v0)^4).
            assert i.accel == pytest.approx(1.5 * (1 - (speed / 30.0) ** 4), abs=1e-8)
        assert i.x > 2.0 * 50


def followed_change(monkeypatch=None):
    """Return per step: time, follower in the new lane, follower in the old one, SUMO's contacts."""
    if monkeypatch is not None:
        monkeypatch.setattr(libsumo_world, "ghost_of", lambda *_: None)
    others = (
        Spawn("new", lane=1, x=-31.0, speed=20.0, driver=DriverKind.IDM, desired_speed=21.0),
        Spawn("old", lane=2, x=-31.0, speed=20.0, driver=DriverKind.IDM, desired_speed=24.0),
    )
    rows = []
    with LibsumoWorld(run.settings(), run.EGO, others) as world:
        for step in range(1, 61):
            ego = run.lane_change(step * 0.2, 2.0, 0.0, 4.0)
            world.advance(ego, {})
            rows.append((world.time, *world.observe(), world.sumo_contacts()))
    return rows


def test_followers_in_both_lanes_react_and_nobody_is_startled():
    rows = followed_change()
    assert all(row[3] == () for row in rows)
    # The body is over the line from about 3.4 to 4.7 s: both lanes' followers hold back for it.
    both = [row for row in rows if 3.9 < row[0] < 4.5]
    assert all(new.accel < -0.2 for _, new, _, _ in both)
    # The gap is about 26 m where the law wants 32 m: its answer is -3.1; an emergency is -9.
    assert min(new.accel for _, new, _, _ in rows) > -4.0
    assert min(old.accel for _, _, old, _ in rows) > -3.0
    held = max(old.accel for time, _, old, _ in rows if 3.0 < time < 4.5)
    freed = min(old.accel for time, _, old, _ in rows if 5.0 < time < 7.0)
    assert freed > held + 0.3
    assert freed > 0.5


def test_without_the_ghost_the_new_follower_reacts_later(monkeypatch):
    first = [next(t for t, new, _, _ in followed_change(m) if new.accel < -0.2) for m in (None, monkeypatch)]
    assert first[0] <= first[1] - 0.4


def test_the_ghost_is_seen_by_sumo_alone(sumo):
    with LibsumoWorld(run.settings(), run.EGO, ()) as world:
        seen = []
        for step in range(1, 41):
            ego = run.lane_change(step * 0.2, 2.0, 0.0, 4.0)
            world.advance(ego, {})
            assert world.observe() == ()
            for name in ghosts(sumo):
                seen.append(run.ROAD.lane_of_sumo_index(sumo.getLaneIndex(name)))
                assert sumo.getPosition(name)[0] == pytest.approx(ego.x, abs=EXACT)
                assert sumo.getSpeed(name) == 20.0
                assert abs(sumo.getLaneIndex(name) - sumo.getLaneIndex("ego")) == 1
        assert seen == sorted(seen)
        assert set(seen) == {1, 2}
        assert world.sumo_contacts() == ()


def test_rear_end_contact_is_found_by_the_boxes_and_by_sumo():
    # The gap of 7.5 m closes by 1 m a step, so the bodies overlap from step 8 on.
    boxes, reported = [], []
    with LibsumoWorld(run.settings(), run.EGO, (Spawn("s", lane=2, x=12.0, speed=15.0),)) as world:
        for step in range(1, 12):
            ego = replace(run.EGO, x=4.0 * step)
            world.advance(ego, {"s": 15.0})
            if contacts(ego, world.observe()):
                boxes.append(step)
            if new := world.sumo_contacts():
                reported.append((step, new))
    assert boxes == [8, 9, 10, 11]
    assert len(reported) == 1
    step, pairs = reported[0]
    assert pairs == (("ego", "s"),)
    assert step in {8, 9}


def test_late_vehicles_enter_on_time_or_when_their_place_is_free():
    others = (
        Spawn("free", lane=1, x=-500.0, speed=25.0, time=1.0),
        Spawn("held", lane=3, x=20.0, speed=20.0, time=0.6),
        Spawn("slow", lane=3, x=16.0, speed=5.0),
    )
    entered = {}
    with LibsumoWorld(run.settings(), run.EGO, others) as world:
        for step in range(1, 21):
            speeds = {v.id: {"free": 25.0, "held": 20.0, "slow": 5.0}[v.id] for v in world.observe()}
            world.advance(replace(run.EGO, x=4.0 * step), speeds)
            for v in world.observe():
                entered.setdefault(v.id, (step, v.x, v.speed))
    assert entered["free"] == (5, pytest.approx(-500.0), 25.0)
    # The rear of `slow` is at 11.5 m at first, moves 1 m a step, and is past 20 m after step 9.
    assert entered["held"] == (10, pytest.approx(20.0), 20.0)


def test_vehicles_leave_at_the_end_of_the_road():
    others = (
        Spawn("s", lane=1, x=8990.0, speed=30.0),
        Spawn("p", lane=3, x=8990.0, speed=30.0, driver=DriverKind.POSED),
    )
    with LibsumoWorld(run.settings(), run.EGO, others) as world:
        pose = VehicleState("p", x=8996.0, y=-2.0, speed=30.0, lane=3)
        world.advance(run.EGO, {"s": 30.0}, [pose])
        assert [v.id for v in world.observe()] == ["p", "s"]
        world.advance(run.EGO, {"s": 30.0}, [replace(pose, x=9002.0)])
        assert world.observe() == ()
        world.advance(run.EGO, {})


@pytest.mark.parametrize("place", [{"x": 9000.5}, {"x": -1000.5}, {"y": 6.5}, {"y": -6.5}])
def test_an_ego_sent_off_the_road_is_an_error(place):
    with (
        LibsumoWorld(run.settings(), run.EGO, ()) as world,
        pytest.raises(SimulationError, match=r"sent off the road|must not reach the road's end"),
    ):
        world.advance(replace(run.EGO, **place), {})


def test_a_vanished_ego_is_an_error(monkeypatch, sumo):
    with LibsumoWorld(run.settings(), run.EGO, ()) as world:
        monkeypatch.setattr(world, "_insert_due", lambda ego: sumo.remove("ego"))
        with pytest.raises(SimulationError, match="took it off the road"):
            world.advance(replace(run.EGO, x=4.0), {})


def test_a_nan_pose_never_reaches_sumo(sumo):
    with LibsumoWorld(run.settings(), run.EGO, ()) as world:
        with pytest.raises(InputError, match="x of ego must be finite"):
            world.advance(replace(run.EGO, x=math.nan), {})
        world.advance(replace(run.EGO, x=4.0), {})
        assert sumo.getPosition("ego") == (4.0, 0.0)


def test_one_world_at_a_time_and_none_after_the_end():
    with (
        LibsumoWorld(run.settings(), run.EGO, ()) as world,
        pytest.raises(SimulationError, match="one world"),
    ):
        LibsumoWorld(run.settings(), run.EGO, ()).__enter__()
    with pytest.raises(SimulationError, match="must be open"):
        world.observe()
    with LibsumoWorld(run.settings(), run.EGO, ()) as again:
        assert again.observe() == ()


def test_sumo_ends_also_after_an_error():
    with (
        pytest.raises(InputError),
        LibsumoWorld(run.settings(), run.EGO, (Spawn("p", 3, 0.0, 20.0, DriverKind.POSED),)) as world,
    ):
        world.advance(run.EGO, {})
    assert not libsumo.isLoaded()


def trace_of_another_process(*arguments):
    """Run the trace as a script that finds the package as this process does; return what it prints."""
    start = f"import runpy, sys; sys.path[:] = {sys.path!r}; runpy.run_path({str(SCRIPT)!r}, run_name='__main__')"
    command = [sys.executable, "-P", "-c", start, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    assert done.stderr == ""
    return done.stdout


def test_moves_that_no_step_follows_do_not_spoil_the_next_run():
    # In a process of its own: were it otherwise, SUMO would crash.
    assert trace_of_another_process("after-unstepped-moves") == run.trace() + "\n"


def test_runs_repeat_in_this_process_and_in_another():
    first = run.trace()
    assert len(first.splitlines()) == 100
    assert "late" in first
    assert run.trace() == first
    assert run.trace(seed=7) == first, "nothing random is left to SUMO"
    assert trace_of_another_process() == first + "\n", "or SUMO wrote to standard output"


def test_a_network_that_sumo_cannot_load_is_an_error_and_leaves_the_process_usable(tmp_path):
    net = tmp_path / "net.xml"
    net.write_text(run.NET.read_text().replace('incLanes="highway_0 ', 'incLanes="highway_7 '))
    with pytest.raises(SimulationError, match="SUMO must load"):
        LibsumoWorld(replace(run.settings(), net_file=net), run.EGO, ()).__enter__()
    with LibsumoWorld(run.settings(), run.EGO, ()) as world:
        assert world.observe() == ()
