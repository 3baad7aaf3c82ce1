"""The planner `sumo`: SUMO drives the ego, and the record says what it did."""

import base64
import math
import re
import zlib
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import yaml

from sumo_hmdp.decision.sumo_driver import SumoDriver
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.errors import InputError, SimulationError
from sumo_hmdp.scenario.load import RunOptions, find_scenario, load_scenario
from sumo_hmdp.scenario.packaged import data_folder
from sumo_hmdp.sim.background import BackgroundSettings
from sumo_hmdp.sim.libsumo_world import LibsumoWorld
from sumo_hmdp.sim.motion import MotionKind
from sumo_hmdp.sim.world_checks import WorldSettings
from sumo_hmdp.study.run import execute
from sumo_hmdp.traffic.mobil import LaneChangeRule
from sumo_hmdp.traffic.spawn import DriverKind, Spawn

DT = 0.15
ROAD = Road(lane_count=3, lane_width=4.0)
EGO = VehicleState("ego", x=0.0, y=0.0, speed=30.0, lane=2)
SLOW = Spawn("slow", lane=2, x=120.0, speed=22.0)


@pytest.fixture(scope="module")
def record():
    return execute(load_scenario(find_scenario("case2"), RunOptions(planner="sumo")))


@pytest.fixture
def load_changed(tmp_path):
    """Load case2 for the planner `sumo` with a changed section, or with none."""

    def load(section, **ego):
        content = yaml.safe_load(find_scenario("case2").read_text(encoding="utf-8"))
        content["ego"].update(ego)
        content["planners"].pop("sumo")
        if section is not None:
            content["planners"]["sumo"] = section
        path = tmp_path / "changed.yaml"
        path.write_text(yaml.safe_dump(content), encoding="utf-8")
        return load_scenario(path, RunOptions(planner="sumo"))

    return load


def of(record, vehicle_id):
    return record.steps[record.steps["vehicle_id"] == vehicle_id].set_index("time_s")


def settings(driver):
    return WorldSettings(data_folder("networks") / "highway_3x4m.net.xml", ROAD, DT, 0, driver)


def world(driver, others=(), ego=EGO):
    return LibsumoWorld(settings(driver), ego, tuple(others))


def drive(driver, others=(), duration=45.0, ego=EGO):
    """Return (ego, others) at every instant; scripted vehicles keep their speed."""
    speeds = {spawn.id: spawn.speed for spawn in others if spawn.driver is DriverKind.SCRIPTED}
    with world(driver, others, ego) as sumo:
        instants = [(sumo.ego(), sumo.observe())]
        for _ in range(round(duration / DT)):
            sumo.advance(None, speeds)
            instants.append((sumo.ego(), sumo.observe()))
    return instants


def test_it_overtakes_without_contact(record):
    assert (record.status, record.row["contact_count"], record.row["sumo_contact_count"]) == ("completed", 0, 0)
    ego, sv2 = of(record, "ego"), of(record, "sv2")
    assert ego["x_m"].iloc[0] < sv2["x_m"].iloc[0]
    assert ego["x_m"].iloc[-1] - 4.5 > sv2["x_m"].iloc[-1] + 50.0
    assert record.row["gap_min_m"] > 30.0


def test_the_state_obeys_sumos_kinematics(record):
    ego = of(record, "ego")
    x, v, a = (ego[name].to_numpy() for name in ("x_m", "speed_mps", "accel_mps2"))
    assert np.abs(np.diff(x) - v[1:] * DT).max() < 1e-9
    assert np.abs(np.diff(v) - a[1:] * DT).max() < 1e-9
    assert v.min() > 25.0
    assert a.min() > -2.0


def test_the_desired_speed_is_respected(record, load_changed):
    assert of(record, "ego")["speed_mps"].max() <= 30.0
    assert of(record, "ego")["speed_mps"].iloc[-1] == pytest.approx(30.0, abs=0.01)
    faster = of(execute(load_changed({"desired_speed_mps": 33.0, "forbidden_lanes": [3]})), "ego")["speed_mps"]
    assert 32.5 < faster.max() <= 33.0


def test_the_lane_change_is_gradual_and_recorded_once(record):
    ego = of(record, "ego")
    y = ego["y_m"].to_numpy()
    lateral_steps = np.diff(y)
    assert (y[0], y[-1]) == (0.0, pytest.approx(4.0))
    # 4 m in 8 s at constant speed; the last of 54 steps is the rest.
    moving = lateral_steps[lateral_steps > 0.0]
    assert len(moving) == 54
    assert moving[:-1] == pytest.approx(4.0 / 8.0 * DT)
    assert lateral_steps.min() == 0.0
    changes = record.decisions[record.decisions["lateral"] != "keep"]
    assert changes[["lateral", "lane"]].to_numpy().tolist() == [["left", 1]]
    assert changes["time_s"].item() == ego.index[y > 0.0][0]
    assert set(record.decisions["status"]) == {"rule"}
    assert record.manifest["motion"] == "sumo"
    assert len(record.decisions) == 300
    assert (record.decisions["accel_mps2"].to_numpy() == ego["accel_mps2"].to_numpy()[:-1]).all()
    assert record.row["solve_time_median_ms"] is record.row["optimal_share"] is None


@pytest.mark.parametrize("scenario", ["case2", "case2_rule_based"])
def test_it_is_deterministic_in_both_motions(scenario):
    first, second = (execute(load_scenario(find_scenario(scenario), RunOptions(planner="sumo"))) for _ in range(2))
    assert first.status == "completed"
    assert first.row["trace_hash"] == second.row["trace_hash"]


def test_the_command_line_runs_and_lists_it(call, tmp_path):
    ran = call("run", "case2", "--planner", "sumo", "--out", tmp_path)
    assert ran.code == 0
    # How long SUMO takes to decide is not known.
    assert "nan" not in ran.out
    page = (tmp_path / "case2-sumo-seed0.html").read_text(encoding="utf-8")
    packed = re.search(r'id="replay-data"[^>]*>([^<]+)<', page).group(1)
    assert zlib.decompress(base64.b64decode(packed)).count(b'"solve_time_ms":null') == 300
    assert "SUMO drives the ego" in call("list").out


def test_it_needs_no_section(load_changed):
    ready = load_changed(None)
    assert ready.world.ego_driver == SumoDriver(lane_change_time=8.0)
    assert ready.episode.motion is MotionKind.SUMO


def test_only_this_planner_leaves_the_ego_to_sumo():
    ready = load_scenario(find_scenario("case2"))
    assert ready.world.ego_driver is None
    assert ready.episode.motion is MotionKind.BICYCLE


def test_an_ego_faster_than_it_desires_is_a_mistake(load_changed):
    with pytest.raises(InputError) as caught:
        load_changed({"desired_speed_mps": 29.0})
    assert "planners.sumo.desired_speed_mps: must be at least the speed 30.0 m/s" in str(caught.value)
    with pytest.raises(InputError, match=r"planners.sumo.forbidden_lanes\[0\]"):
        load_changed({"forbidden_lanes": [4]})


def test_in_traffic_an_ego_faster_than_it_desires_slows_down_comfortably():
    driver = SumoDriver(4.0, desired_speed=26.0)
    among = replace(settings(driver), background=BackgroundSettings(LaneChangeRule()))
    speeds = [EGO.speed]
    with LibsumoWorld(among, EGO, ()) as ride:
        for _ in range(30):
            ride.advance(None, {})
            speeds.append(ride.ego().speed)
    drops = -np.diff(speeds) / DT
    assert drops.max() == pytest.approx(driver.decel)
    assert speeds[-1] == pytest.approx(26.0)


@pytest.mark.parametrize(
    ("keep_right", "forbidden", "lane"), [(0.0, (), 1), (1.0, (), 3), (1.0, (3,), 2), (0.0, (1,), 3), (0.0, (1, 3), 2)]
)
def test_where_it_ends_after_overtaking(keep_right, forbidden, lane):
    driver = SumoDriver(4.0, keep_right=keep_right, forbidden_lanes=frozenset(forbidden))
    instants = drive(driver, (SLOW,), duration=60.0)
    assert instants[-1][0].lane == lane
    assert instants[-1][0].y == pytest.approx(ROAD.center_y(lane))
    assert not {ROAD.lane_at(ego.y) for ego, _ in instants} & set(forbidden)


def test_it_leaves_a_forbidden_lane_in_which_it_starts():
    assert drive(SumoDriver(4.0, forbidden_lanes=frozenset({2, 3})), duration=10.0)[-1][0].lane == 1


def test_the_lateral_speed_is_that_of_the_positions():
    instants = [ego for ego, _ in drive(SumoDriver(4.0), (SLOW,), duration=12.0)]
    for before, now in pairwise(instants):
        assert now.lateral_speed == (now.y - before.y) / DT
        # In the last step of a change, which is shorter, SUMO still has the heading of a whole one.
        if now.lateral_speed in (0.0, pytest.approx(1.0)):
            assert math.tan(now.heading) == pytest.approx(now.lateral_speed / now.speed, abs=0.004)
    assert max(ego.lateral_speed for ego in instants) == pytest.approx(1.0)


def test_followers_in_both_lanes_see_the_change_and_the_old_one_is_freed():
    def follower(name, lane):
        return Spawn(name, lane=lane, x=-75.0, speed=30.0, driver=DriverKind.IDM, desired_speed=32.0)

    instants = drive(SumoDriver(8.0), (SLOW, follower("new", 1), follower("old", 2)))
    start = next(k for k, (ego, _) in enumerate(instants) if ego.lateral_speed > 0.0)
    end = max(k for k, (ego, _) in enumerate(instants) if ego.lateral_speed > 0.0)
    accel = {name: [{v.id: v.accel for v in seen}[name] for _, seen in instants] for name in ("new", "old")}
    # Free, the new follower would accelerate towards 32 m/s; it sees the ego from the step after.
    assert accel["new"][start] > 0.0
    assert accel["new"][start + 1] < -0.2
    # The old one is held until the ego's body has left its lane, 72 % of the change, and no longer.
    assert max(accel["old"][start + 1 : start + 30]) < 0.0
    assert max(accel["old"][end - 14 : end]) > 0.2
    assert min(min(values) for values in accel.values()) > -3.0


def test_traffic_far_away_is_the_same_whoever_drives_the_ego():
    idm = {"driver": DriverKind.IDM, "desired_speed": 33.0}
    far = tuple(Spawn(f"f{k}", lane=k % 3 + 1, x=1500.0 + 14.0 * k, speed=20.0 + k, **idm) for k in range(6))
    driven = [others for _, others in drive(SumoDriver(8.0), far, duration=15.0)]
    with world(None, far) as sumo:
        moved = [sumo.observe()]
        for step in range(1, 101):
            sumo.advance(replace(EGO, x=30.0 * DT * step), {})
            assert sumo.ego().x == 30.0 * DT * step
            moved.append(sumo.observe())
    assert driven == moved


def test_a_driven_ego_takes_no_pose_and_a_moved_one_needs_it():
    with world(SumoDriver(4.0)) as sumo, pytest.raises(InputError, match="poses must name every posed vehicle"):
        sumo.advance(EGO, {})
    with world(None) as sumo, pytest.raises(InputError, match="the first pose must be the ego's"):
        sumo.advance(None, {})


def test_a_driven_ego_that_reaches_the_end_of_the_road_is_an_error():
    with pytest.raises(SimulationError, match="must not reach the road's end at 9000 m before its run ends"):
        drive(SumoDriver(4.0), duration=3.0, ego=replace(EGO, x=8950.0))


def test_it_sees_the_nearer_of_two_that_drove_through_each_other():
    # SUMO keeps the order in which they came: without help the ego would follow `fast` and drive into `slow`.
    fast, slow = (
        Spawn(name, lane=2, x=x, speed=speed, driver=DriverKind.POSED)
        for name, x, speed in (("fast", 60.0, 29.0), ("slow", 120.0, 20.0))
    )
    instants = []
    with world(SumoDriver(4.0, speed_gain=0.0), [fast, slow], replace(EGO, speed=26.0)) as sumo:
        for step in range(1, round(30.0 / DT)):
            poses = [
                VehicleState(spawn.id, spawn.x + spawn.speed * step * DT, 0.0, spawn.speed, 2) for spawn in (fast, slow)
            ]
            sumo.advance(None, {}, poses)
            instants.append({state.id: state for state in (sumo.ego(), *sumo.observe())})
    assert instants[0]["fast"].x < instants[0]["slow"].x
    assert instants[-1]["fast"].x > instants[-1]["slow"].x
    # Taking them out and in again leaves them where they were told to be.
    assert [instants[-1][pose.id].x for pose in poses] == pytest.approx([pose.x for pose in poses])
    assert [instants[-1][pose.id].speed for pose in poses] == pytest.approx([29.0, 20.0])
    gaps = [at["slow"].x - at["slow"].length - at["ego"].x for at in instants]
    assert min(gaps) > 10.0
    assert instants[-1]["ego"].speed == pytest.approx(20.0, abs=1.0)
