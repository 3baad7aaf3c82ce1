"""Random traffic in SUMO itself: it repeats, and all planners meet the same until the ego makes a difference."""

import importlib.util
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.scenario import crowd
from sumo_hmdp.scenario.load import RunOptions, load_scenario
from sumo_hmdp.scenario.schema import EgoFile
from sumo_hmdp.sim.libsumo_world import LibsumoWorld
from sumo_hmdp.sim.warm_up import warm_up
from sumo_hmdp.study.run import execute
from sumo_hmdp.traffic.spawn import DriverKind, Spawn

DT = 0.2
SCRIPT = Path(__file__).with_name("traffic_trace.py")


def load(name):
    """Load a module beside this one by its path: tests are no package."""
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


lone, run = load("libsumo_trace"), load("traffic_trace")


def other_process(*arguments):
    start = (
        f"import runpy, sys; sys.path[:] = {sys.path!r}; sys.argv[1:] = {[str(a) for a in arguments]!r}; "
        f"runpy.run_path({str(SCRIPT)!r}, run_name='__main__')"
    )
    done = subprocess.run([sys.executable, "-P", "-c", start], capture_output=True, text=True, check=True, timeout=120)
    assert done.stderr == ""
    return done.stdout.splitlines()


def test_warm_ups_and_runs_repeat_whatever_ran_before_and_in_another_process(tmp_path):
    file = run.write_scenario(tmp_path)
    first, hashes = run.warm(), run.hashes(file)
    # Other traffic, another network, another step and vehicles of the same names in between.
    assert run.warm(seed=2) != first
    assert run.hashes(file, seed=2) != hashes
    lone.trace()
    crowd._warm.cache_clear()  # else the second load would not warm up again
    assert run.warm() == first
    assert run.hashes(file) == hashes
    there = other_process(file)
    assert there[:-1] == first.splitlines()
    assert there[-1].split() == hashes


def test_warm_traffic_is_in_its_lanes_with_the_traits_it_was_drawn_with():
    cold = {spawn.id: spawn for spawn in run.crowd()}
    warm = {line.id: line for line in warm_up(run.settings(), run.crowd(), 12.0)}
    assert set(warm) <= set(cold)
    present = [name for name, spawn in warm.items() if spawn.time == 0.0]
    # 12 s of inflow at about 30 m/s have come: those who were due by then are on the road or wait for room.
    assert {name for name, spawn in cold.items() if spawn.time == 0.0} <= set(present)
    for name, spawn in warm.items():
        was = cold[name]
        assert (spawn.idm, spawn.desired_speed, spawn.politeness, spawn.length, spawn.driver) == (
            was.idm, was.desired_speed, was.politeness, was.length, was.driver,
        )  # fmt: skip
        assert spawn.time == 0.0 or spawn.time == pytest.approx(max(DT, was.time - 12.0))
    assert any(warm[name].lane != cold[name].lane for name in present), "somebody changed lanes"
    assert any(spawn.time > 0.0 for spawn in warm.values())


@pytest.mark.parametrize("name", ["highway", "highway_ramps"])
def test_planners_meet_the_same_traffic(tmp_path, name):
    file = run.write_scenario(tmp_path, name=name)
    met = []
    for planner in ("hmdp_mpc", "idm_mobil", "sumo", "constant"):
        crowd._warm.cache_clear()  # each warms up for itself
        ready = load_scenario(file, RunOptions(planner=planner, seed=3))
        met.append((ready.spawns, ready.episode.ego, replace(ready.world, ego_driver=None)))
    assert met[0] == met[1] == met[2] == met[3]
    assert len(met[0][0]) > 90


def two_egos(first, second, steps=75):
    """Return the background's states at all instants beside two egos, given as (x, y, speed, lane) by step."""
    traffic = warm_up(run.settings(), run.crowd(), 8.0)
    start, others = crowd.ego_start(EgoFile(x_m=500.0, lane=2, in_traffic=True), traffic)
    traces = []
    for path in (first, second):
        ego = VehicleState("ego", x=start.x, y=0.0, speed=start.speed, lane=2)
        with LibsumoWorld(replace(run.settings(), sight=1e5), ego, others) as world:
            trace = [world.observe()]
            for step in range(1, steps):
                ego = path(ego, step)
                world.advance(ego, {})
                trace.append(world.observe())
        traces.append(trace)
    return traces


def keeps(ego, step):
    del step
    return replace(ego, x=ego.x + ego.speed * DT)


def test_the_background_is_the_same_until_the_first_step_after_the_egos_differ():
    # Both keep their speed until instant 25; then one brakes by 5 m/s2.
    def brakes(ego, step):
        speed = ego.speed if step < 25 else max(0.0, ego.speed - 5.0 * DT)
        return replace(ego, x=ego.x + speed * DT, speed=speed, accel=(speed - ego.speed) / DT)

    kept, braked = two_egos(keeps, brakes)
    # At instant 25 the egos differ; who follows reacts to the state before a step, so first at instant 26.
    assert kept[:26] == braked[:26]
    assert kept[26] != braked[26]


@pytest.mark.parametrize(("indicated", "changes"), [(2, True), (1, False)])
def test_drivers_see_the_lane_that_the_ego_intends_before_it_moves(indicated, changes):
    # `c` closes in on the ego and would pass it on the left; the right is taken. Not where the ego indicates left.
    ego = VehicleState("ego", x=100.0, y=0.0, speed=18.0, lane=2)
    c = Spawn("c", 2, 40.0, 25.0, DriverKind.BACKGROUND, desired_speed=33.0)
    wall = Spawn("wall", 3, 42.0, 25.0, DriverKind.BACKGROUND, desired_speed=25.0)
    with LibsumoWorld(run.settings(), ego, (c, wall)) as world:
        for _ in range(10):
            ego = replace(keeps(ego, 0), lane=indicated)
            world.advance(ego, {})
        assert (world.observe()[0].y > 0.0) is changes


def test_sumo_drives_the_ego_among_the_background(tmp_path):
    file = run.write_scenario(tmp_path, ("duration_s: 12.0", "duration_s: 20.0"))
    record = execute(load_scenario(file, RunOptions("sumo", seed=2)))
    assert (record.status, record.row["background_contact_count"], record.row["contact_count"]) == ("completed", 0, 0)
    ego = record.steps[record.steps.vehicle_id == "ego"]
    assert len(ego) == 101
    assert ego.x_m.iloc[-1] - ego.x_m.iloc[0] > 20.0 * 18.0
    assert record.steps.vehicle_id.nunique() > 10
    # SUMO's steps are x+ = x + v+ dt.
    assert np.diff(ego.x_m) == pytest.approx(0.2 * ego.speed_mps.to_numpy()[1:], abs=0.01)


def test_the_run_ends_where_the_ego_arrives(tmp_path):
    free = [
        ("in_traffic: true", "in_traffic: false\n  speed_mps: 30.0\n  goal_x_m: -800.0"),
        ("x_m: 1300.0", "x_m: -900.0"),
    ]
    record = execute(load_scenario(run.write_scenario(tmp_path, *free), RunOptions("constant")))
    # 100 m at 30 m/s are 16.67 steps of 0.2 s.
    assert (record.status, record.row["goal_reached"]) == ("completed", True)
    assert record.row["duration_s"] == pytest.approx(17 * DT)
    far = [(old, new.replace("goal_x_m: -800.0", "goal_x_m: 8000.0")) for old, new in free]
    late = execute(load_scenario(run.write_scenario(tmp_path, *far), RunOptions("constant")))
    assert late.row["goal_reached"] is False
    assert late.row["duration_s"] == pytest.approx(12.0)
    none = execute(load_scenario(run.write_scenario(tmp_path), RunOptions("constant")))
    assert none.row["goal_reached"] is None
