"""Random traffic in SUMO itself: how its vehicles follow, change lanes, come and go, and see the ego."""

import importlib.util
import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.sim.background import BackgroundSettings
from sumo_hmdp.sim.contact import contacts
from sumo_hmdp.sim.libsumo_world import LibsumoWorld
from sumo_hmdp.sim.sumo import libsumo
from sumo_hmdp.sim.warm_up import warm_up
from sumo_hmdp.traffic.mobil import LaneChangeRule
from sumo_hmdp.traffic.spawn import DriverKind, IdmParameters, Spawn

EXACT = 1e-9
DT = 0.2
# Behind all traffic, and slower: nobody sees it.
ALONE = VehicleState("ego", x=-900.0, y=0.0, speed=5.0, lane=2)


def load(name):
    """Load a module beside this one by its path: tests are no package."""
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


lone, run = load("libsumo_trace"), load("traffic_trace")


def drive(spawns, steps, ego=ALONE, settings=None):
    """Yield everybody of the background by id at every instant, with an ego that keeps its speed; seen to the end."""
    everywhere = replace(settings or run.settings(), sight=1e5)
    with LibsumoWorld(everywhere, ego, tuple(spawns)) as world:
        yield {state.id: state for state in world.observe()}
        for _ in range(steps):
            ego = replace(ego, x=ego.x + ego.speed * DT)
            world.advance(ego, {})
            yield {state.id: state for state in world.observe()}
        assert world.background_contacts() == ()


def keeps(ego, step):
    del step
    return replace(ego, x=ego.x + ego.speed * DT)


@pytest.fixture(scope="module")
def dense():
    """30 s at 35 vehicles/km/lane, with inflow, after the warm-up."""
    warm = warm_up(run.settings(), run.crowd(35.0, inflow=50.0), 12.0)
    return {spawn.id: spawn for spawn in warm}, list(drive(warm, 150))


@pytest.fixture(scope="module")
def medium():
    """40 s at 18 vehicles/km/lane, where there is room to change lanes."""
    warm = warm_up(run.settings(), run.crowd(18.0, stretch=(0.0, 1500.0), seed=2), 8.0)
    return {spawn.id: spawn for spawn in warm}, list(drive(warm, 200))


def overlaps(states):
    """Return the pairs whose bodies overlap, as upright boxes: a lane change turns a body by a few degrees at most."""
    x, y, length, width = (np.array([getattr(s, n) for s in states]) for n in ("x", "y", "length", "width"))
    along = np.minimum(x[:, None], x) - np.maximum(x[:, None] - length[:, None], x - length)
    across = (width[:, None] + width) / 2 - np.abs(y[:, None] - y)
    first, second = np.nonzero(np.triu((along > 0.0) & (across > 0.0), 1))
    return [(states[i].id, states[j].id) for i, j in zip(first, second, strict=True)]


def test_nobody_touches_anybody_in_dense_traffic(dense):
    spawns, trace = dense
    assert len([s for s in spawns.values() if s.time == 0.0]) > 80
    assert all(overlaps(list(instant.values())) == [] for instant in trace)


def test_the_oracle_of_overlaps_sees_one():
    a, b = ALONE, replace(ALONE, id="b", x=-896.0, y=1.7)
    assert overlaps([a, b]) == [("ego", "b")]
    assert overlaps([a, replace(b, y=1.9)]) == overlaps([a, replace(b, x=-895.0)]) == []


def test_newcomers_need_not_brake_for_the_place_they_enter_at(dense):
    # A gap of at least s0 + v T behind a leader who is no slower: s* / gap <= 1, so that by the IDM the acceleration is
    # at least a (1 - (v / v0)^delta - 1) = -a (v / v0)^delta, however dense the traffic.
    spawns, trace = dense
    seen = {}
    for number, instant in enumerate(trace):
        for name, state in instant.items():
            if spawns[name].time > 0.0:
                seen.setdefault(name, (number, state))
    assert len(seen) > 20
    for name, (number, state) in seen.items():
        spawn = spawns[name]
        assert (state.x, state.lane) == (pytest.approx(spawn.x, abs=EXACT), spawn.lane)
        assert state.speed <= spawn.speed + EXACT
        assert number * DT >= spawn.time - DT
        if number + 1 < len(trace):
            least = -spawn.idm.accel * (state.speed / spawn.desired_speed) ** spawn.idm.exponent
            assert trace[number + 1][name].accel >= least - 1e-6


def test_newcomers_wait_for_room(dense):
    spawns, trace = dense
    last = set().union(*trace)
    due = {name for name, spawn in spawns.items() if 0.0 < spawn.time <= 30.0}
    late = [
        next(number for number, instant in enumerate(trace) if name in instant) * DT - spawns[name].time
        for name in due & last
    ]
    assert min(late) >= -DT
    assert max(late) > 2 * DT


@pytest.mark.parametrize("x", [-60.0, -40.0, -20.0, 2.0, 30.0])
def test_newcomers_do_not_enter_in_the_ego(x):
    newcomer = Spawn("bg-a", 2, 0.0, 25.0, DriverKind.BACKGROUND, desired_speed=30.0, time=2.0)
    ego = VehicleState("ego", x=x, y=0.0, speed=20.0, lane=2)
    first = None
    with LibsumoWorld(run.settings(), ego, (newcomer,)) as world:
        for _ in range(50):
            ego = keeps(ego, 0)
            world.advance(ego, {})
            for other in world.observe():
                assert contacts(ego, [other]) == ()
                first = first or (world.time, ego.x, other.speed)
    assert first is not None
    time, ego_x, speed = first
    assert time >= 2.0
    # Behind the ego: at its speed, and 2 m + 1.5 s behind its rear. Nobody came in front of it so near.
    assert (speed, ego_x - 4.5 >= 2.0 + 1.5 * 20.0) == (20.0, True)


def test_newcomers_are_no_faster_than_who_has_the_nearest_rear():
    # The ego, about to enter the lane, is then level with a slower truck whose front is farther and rear nearer.
    newcomer = Spawn("bg-a", 2, 0.0, 25.0, DriverKind.BACKGROUND, desired_speed=30.0, time=2.4)
    ego = VehicleState("ego", x=40.0 - 2.4 * 20.0, y=4.0, speed=20.0, lane=2)
    truck = Spawn("truck", 2, 46.0 - 2.4 * 15.0, 15.0, length=12.0)
    with LibsumoWorld(run.settings(), ego, (newcomer, truck)) as world:
        while "bg-a" not in (seen := {other.id: other for other in world.observe()}):
            assert world.time < 3.0
            ego = keeps(ego, 0)
            world.advance(ego, {"truck": 15.0})
    assert (seen["bg-a"].x, seen["bg-a"].speed) == (0.0, 15.0)


def changes(trace):
    """Yield every change of lanes that is complete in a trace: id, first and last instant, y before and after."""
    for name in sorted(set().union(*trace)):
        numbers = [number for number, instant in enumerate(trace) if name in instant]
        y = np.array([trace[number][name].y for number in numbers])
        at_rest = np.isclose(y % 4.0, 0.0, atol=1e-6) | np.isclose(y % 4.0, 4.0, atol=1e-6)
        edges = np.flatnonzero(np.diff(at_rest.astype(int)))
        for begin, end in zip(edges[:-1:2].tolist(), edges[1::2].tolist(), strict=False):
            if at_rest[begin]:
                yield name, numbers[begin], numbers[end + 1], float(y[begin]), float(y[end + 1])


def test_a_lane_change_takes_its_time_and_is_gradual(medium):
    _, trace = medium
    found = list(changes(trace))
    assert len(found) >= 10
    for name, begin, end, y_from, y_to in found:
        assert abs(y_to - y_from) == pytest.approx(4.0, abs=1e-6)
        # SUMO moves sideways evenly; the first step may fall into the step of the command or the one after.
        assert (end - begin) * DT == pytest.approx(4.0, abs=DT + 1e-9)
        steps = np.diff([trace[number][name].y for number in range(begin, end + 1)]) * math.copysign(1.0, y_to - y_from)
        assert steps.min() > 0.0
        assert steps.max() <= 4.0 / (4.0 / DT) + 1e-6


def gap_accel(spawn, speed, gap, lead_speed):
    """The Intelligent Driver Model of Treiber, Hennecke and Helbing (2000), as SUMO has it."""
    p = spawn.idm
    wanted = p.min_gap + max(
        0.0, p.time_gap * speed + speed * (speed - lead_speed) / (2 * math.sqrt(p.accel * p.decel))
    )
    return p.accel * (1 - (speed / spawn.desired_speed) ** p.exponent - (wanted / gap) ** 2)


def test_nobody_changes_into_an_occupied_place(medium):
    spawns, trace = medium
    for name, begin, _, y_from, y_to in changes(trace):
        me = trace[begin][name]
        others = [s for other, s in trace[begin].items() if other != name and abs(s.y - y_to) < 2.0]
        ahead = min((s for s in others if s.x > me.x), key=lambda s: s.x, default=None)
        behind = max((s for s in others if s.x <= me.x), key=lambda s: s.x, default=None)
        assert y_from != y_to
        if ahead is not None:
            assert ahead.x - ahead.length - me.x >= 2.0
        if behind is not None:
            gap = me.x - me.length - behind.x
            assert gap >= 2.0
            assert gap_accel(spawns[behind.id], behind.speed, gap, me.speed) >= -4.0


def test_a_driver_waits_between_two_changes(medium):
    _, trace = medium
    last = {}
    for name, begin, end, _, _ in changes(trace):
        assert (begin - last.get(name, -1e9)) * DT >= 4.0 - 1e-6
        last[name] = end


def follower(name, lane, x):
    idm = IdmParameters(accel=1.4, decel=2.0, time_gap=1.5)
    return Spawn(name, lane, x, 25.0, DriverKind.BACKGROUND, desired_speed=27.0, idm=idm)


def test_who_changes_is_seen_in_the_new_lane_from_the_first_step_and_in_the_old_until_its_body_has_left_it():
    # Only `c` gains as much as 1 m/s2 by a change; lane 3 is taken beside it.
    settings = replace(run.settings(), background=BackgroundSettings(LaneChangeRule(threshold=1.0)))
    spawns = {
        "truck": Spawn("truck", 2, 190.0, 18.0, DriverKind.BACKGROUND, desired_speed=18.0, length=12.0),
        "c": Spawn("c", 2, 100.0, 25.0, DriverKind.BACKGROUND, desired_speed=33.0),
        "new": follower("new", 1, 30.0),
        "old": follower("old", 2, 40.0),
        "wall": Spawn("wall", 3, 102.0, 25.0, DriverKind.BACKGROUND, desired_speed=25.0),
    }
    trace = list(drive(spawns.values(), 60, settings=settings))
    (name, begin, end, _, y_to), *_ = changes(trace)
    assert (name, y_to) == ("c", 4.0)
    for number in range(begin + 1, end):
        now, then = trace[number], trace[number + 1]
        for one in ("new", "old"):
            leaders = [now["c"]] if one == "new" else [now["truck"]]
            # 1.8 m wide, and the line between the lanes is at y = 2 m.
            if one == "old" and now["c"].y < 2.9:
                leaders.append(now["c"])
            expected = min(
                gap_accel(spawns[one], now[one].speed, v.x - v.length - now[one].x, v.speed) for v in leaders
            )
            assert then[one].accel == pytest.approx(expected, abs=1e-6), (number - begin, one)


RAMPS = replace(run.settings(), net_file=run.ROOT / "networks" / "highway_ramps.net.xml", road=Road(4, 4.0))
TOWN = replace(run.settings(), net_file=run.ROOT / "networks" / "urban.net.xml")


def ramp_drive(spawns, steps, settings=RAMPS, ego=replace(ALONE, y=2.0)):  # noqa: B008 (frozen)
    """Return every vehicle's (SUMO's edge, state) at all instants, None for a state beside the road."""
    seen = {}
    vehicle = libsumo.vehicle
    with LibsumoWorld(replace(settings, sight=1e5), ego, tuple(spawns)) as world:
        for _ in range(steps):
            ego = replace(ego, x=ego.x + ego.speed * DT)
            world.advance(ego, {})
            states = {state.id: state for state in world.observe()}
            for name in vehicle.getIDList():
                seen.setdefault(name, []).append((vehicle.getRoadID(name), states.get(name)))
        assert world.background_contacts() == ()
    return seen


@pytest.mark.parametrize("lane", [1, 2, 3])
def test_who_wants_to_leave_gets_over_and_leaves(lane):
    leaver = Spawn("bg-a", lane, 2900.0, 28.0, DriverKind.BACKGROUND, desired_speed=30.0, exit="off_ramp")
    through = Spawn("bg-b", lane, 2700.0, 28.0, DriverKind.BACKGROUND, desired_speed=30.0)
    seen = ramp_drive((leaver, through), 300)
    roads = [road for road, _ in seen["bg-a"]]
    assert list(dict.fromkeys(roads)) == ["between", "exit", "off_ramp"]
    assert [state.lane for road, state in seen["bg-a"] if road == "exit"][-1] == 4
    assert max(state.lane for _, state in seen["bg-b"]) <= 3
    assert seen["bg-b"][-1][0] == "after_exit"


def test_who_comes_too_late_for_the_exit_drives_on():
    # 100 m and 3.5 s before the end of lane 4 nobody crosses three lanes.
    late = Spawn("bg-a", 1, 4000.0, 28.0, DriverKind.BACKGROUND, desired_speed=30.0, exit="off_ramp")
    roads = [road for road, _ in ramp_drive((late,), 60)["bg-a"]]
    assert list(dict.fromkeys(roads)) == ["exit", "after_exit"]


def driver(name, lane, x, speed, exit_name):
    return Spawn(name, lane, x, speed, DriverKind.BACKGROUND, desired_speed=speed, exit=exit_name)


@pytest.mark.parametrize(
    ("lane", "wanted", "taken"), [(1, "south_4_out", "north_4_out"), (3, "north_4_out", "south_4_out")]
)
def test_who_comes_too_late_for_a_turn_takes_the_one_that_its_lane_serves(lane, wanted, taken):
    # At the last signal neither lane goes on; it is green until 23 s. Who waited for its own turn would never leave.
    late, beside = driver("bg-a", lane, 1570.0, 13.0, wanted), driver("bg-b", 2, 1571.0, 13.0, None)
    roads = [road for road, _ in ramp_drive((late, beside), 60, TOWN, replace(ALONE, x=-250.0))["bg-a"]]
    assert list(dict.fromkeys(road for road in roads if not road.startswith(":"))) == ["arterial_4", taken]


@pytest.mark.parametrize(("lane", "exit_name", "most"), [(1, "north_4_out", 9.01), (3, "south_4_out", 8.16)])
def test_who_turns_keeps_to_the_speed_of_the_turn(lane, exit_name, most):
    fast = driver("bg-a", lane, 1500.0, 15.0, exit_name)
    vehicle, ego, speeds = libsumo.vehicle, replace(ALONE, x=-250.0), []
    # As in `urban`, whose limit takes the place of the network's, but not in a turn.
    with LibsumoWorld(replace(TOWN, speed_limit=13.9), ego, (fast,)) as world:
        for _ in range(60):
            ego = replace(ego, x=ego.x + ego.speed * DT)
            world.advance(ego, {})
            speeds.append((vehicle.getRoadID("bg-a"), vehicle.getSpeed("bg-a")))
    assert max(speed for road, speed in speeds if road == "arterial_4") > 14.5
    turn = [speed for road, speed in speeds if road.startswith(":")]
    assert len(turn) > 5
    assert max(turn) <= most + 0.01
    # It brakes for the turn as for anything else: no harder than comfortably, and a little.
    assert max(before - after for (_, before), (_, after) in pairwise(speeds)) / DT < 3.0


def test_who_comes_by_the_on_ramp_merges_before_its_lane_ends():
    comers = [
        Spawn(f"bg-on_ramp-{k}", 4, 0.0, 12.0, DriverKind.BACKGROUND, 30.0, time=4.0 * k + DT, entry="on_ramp")
        for k in range(4)
    ]
    through = [
        Spawn(f"bg-3-{k}", 3, 1500.0 - 60.0 * k, 26.0, DriverKind.BACKGROUND, desired_speed=28.0) for k in range(15)
    ]
    seen = ramp_drive((*comers, *through), 300)
    for comer in comers:
        rows = seen[comer.id]
        assert rows[0][0] == "on_ramp"
        assert list(dict.fromkeys(road for road, _ in rows)) == ["on_ramp", "merge", "between"]
        lanes = [state.lane for road, state in rows if road == "merge" and state is not None]
        assert lanes[0] == 4
        assert max(state.lane for road, state in rows if road == "between") == 3


def change_among(background):
    """Return per step the followers in the new and the old lane of an ego that changes from lane 2 to lane 1."""
    settings = replace(run.settings(), background=background)
    others = [
        Spawn("new", lane=1, x=-31.0, speed=20.0, driver=DriverKind.IDM, desired_speed=21.0),
        Spawn("old", lane=2, x=-31.0, speed=20.0, driver=DriverKind.IDM, desired_speed=24.0),
    ]
    if background is not None:
        others += [Spawn(f"bg-{k}", 3, 40.0 * k, 20.0, DriverKind.BACKGROUND, 20.0) for k in range(-3, 4)]
    rows = []
    with LibsumoWorld(settings, replace(ALONE, x=0.0, speed=20.0), tuple(others)) as world:
        for step in range(1, 61):
            world.advance(lone.lane_change(step * DT, 2.0, 0.0, 4.0), {})
            by_id = {state.id: state for state in world.observe()}
            rows.append((world.time, by_id["new"], by_id["old"]))
        assert world.sumo_contacts() == ()
    return rows


def test_followers_of_the_ego_react_alike_with_and_without_background():
    # With a background SUMO's image of the ego is on a lane's centre, and lane changes take time: nobody notices.
    among = change_among(BackgroundSettings(LaneChangeRule(threshold=99.0)))
    without = change_among(None)
    for row, other in zip(among, without, strict=True):
        for one, two in zip(row[1:], other[1:], strict=True):
            assert (one.x, one.speed) == pytest.approx((two.x, two.speed), abs=1e-9)
    both = [row for row in among if 3.9 < row[0] < 4.5]
    assert all(new.accel < -0.2 for _, new, _ in both)
    assert min(new.accel for _, new, _ in among) > -4.0
    freed = min(old.accel for time, _, old in among if 5.0 < time < 7.0)
    assert freed > max(old.accel for time, _, old in among if 3.0 < time < 4.5) + 0.3


def test_background_drivers_see_an_ego_that_changes_in_both_lanes():
    spawns = {"new": follower("new", 1, -80.0), "old": follower("old", 2, -80.0)}
    start = replace(ALONE, x=0.0, speed=20.0)
    nobody_changes = replace(run.settings(), background=BackgroundSettings(LaneChangeRule(threshold=99.0)))
    before, ahead = None, start
    with LibsumoWorld(nobody_changes, start, tuple(spawns.values())) as world:
        for step in range(1, 41):
            ego = lone.lane_change(step * DT, 2.0, 0.0, 4.0)
            world.advance(replace(ego, lane=1 if step > 10 else 2), {})
            now = {state.id: state for state in world.observe()}
            # Over the line from 3.4 to 4.7 s, by the oriented box of 4.5 m by 1.8 m.
            if before is not None and 3.9 < world.time < 4.5:
                for name, spawn in spawns.items():
                    expected = gap_accel(
                        spawn, before[name].speed, ahead.x - ahead.length - before[name].x, ahead.speed
                    )
                    assert now[name].accel == pytest.approx(expected, abs=1e-6)
            before, ahead = now, ego
