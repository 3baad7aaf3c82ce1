"""A queue that lets in who stands at the end of its lane, in SUMO itself."""

from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.scenario import crowd
from sumo_hmdp.scenario.load import RunOptions, load_scenario
from sumo_hmdp.sim.background import BackgroundSettings
from sumo_hmdp.sim.libsumo_world import LibsumoWorld
from sumo_hmdp.sim.world_checks import WorldSettings
from sumo_hmdp.study.run import execute
from sumo_hmdp.traffic.mobil import LaneChangeRule
from sumo_hmdp.traffic.spawn import DriverKind, Spawn

SCENARIOS = Path(__file__).parents[2] / "scenarios"
DT = 0.2


@pytest.fixture
def queue(tmp_path):
    """Return a scenario: the ego stands in lane 1, 25 m before its end, and dense traffic comes by in lane 2."""

    def write(share):
        document = yaml.safe_load((SCENARIOS / "urban.yaml").read_text())
        document["duration_s"] = 50.0
        document["ego"] = {"x_m": 1575.0, "lane": 1, "speed_mps": 0.0, "lane_change_time_s": 4.0, "goal_x_m": 1800.0}
        document["traffic"] |= {
            "density_vpkm_per_lane": 50.0, "stretch_m": [600.0, 1540.0], "lanes": [2], "side_flow_vph": 0.0,
            "exit_share": 0.0, "warm_up_s": 0.0, "courtesy": {"share": share},
        }  # fmt: skip
        file = tmp_path / f"queue-{share}.yaml"
        file.write_text(yaml.safe_dump(document))
        return file

    return write


@pytest.mark.parametrize(("share", "merges"), [(0.0, False), (1.0, True)])
def test_a_queue_lets_in_who_stands_at_the_end_of_its_lane(queue, share, merges):
    record = execute(load_scenario(queue(share), RunOptions(planner="hmdp_mpc", solver="search", seed=1)))
    assert record.row["goal_reached"] is merges
    rules = ("red_light_count", "junction_stop_count", "contact_count", "background_contact_count")
    assert [record.row[name] for name in rules] == [0] * len(rules)
    if not merges:
        return
    steps = record.steps
    ego = steps[steps.vehicle_id == "ego"]
    in_lane_2 = float(ego.time_s[ego.y_m < 2.0].iloc[0])
    now = steps[(steps.time_s == in_lane_2) & (steps.vehicle_id != "ego")]
    follower = now[now.x_m < float(ego.x_m[ego.time_s == in_lane_2].iloc[0])].sort_values("x_m").iloc[-1]
    before = steps[(steps.vehicle_id == follower.vehicle_id) & (steps.time_s <= in_lane_2)]
    # The one behind has slowed down for it, never harder than by its own comfortable 2 m/s2.
    assert before.speed_mps.min() < 0.5 * before.speed_mps.max()
    assert -2.0 - 1e-6 <= before.accel_mps2.min() < -1.0


def test_who_holds_back_still_brakes_for_a_signal_as_hard_as_it_takes():
    # For a driver in lane 2 the signal at 750 m turns amber late. Far ahead somebody asks for room in its lane.
    net = SCENARIOS.parent / "networks" / "urban.net.xml"
    settings = WorldSettings(net, Road(3, 4.0), DT, 1, background=BackgroundSettings(LaneChangeRule()), sight=1e5)
    asking = Spawn("asks", 1, 1590.0, 0.0)
    ego = VehicleState("ego", x=-200.0, y=-4.0, speed=0.0, lane=3)
    drives = {}
    for courteous in (False, True):
        driver = Spawn("driver", 2, 596.0, 13.0, DriverKind.BACKGROUND, courteous=courteous)
        with LibsumoWorld(settings, ego, (driver, asking)) as world:
            states = []
            for _ in range(150):
                world.advance(ego, {"asks": 0.0})
                states.append(next(state for state in world.observe() if state.id == "driver"))
        drives[courteous] = [(state.x, state.accel) for state in states]
    # So far away the signal counts for more. A commanded speed would have SUMO brake by 2 m/s2, then in an emergency.
    assert drives[True] == drives[False]
    assert -9.0 < min(accel for _, accel in drives[True]) < -4.0
    assert max(x for x, _ in drives[True]) < 749.5


def test_a_run_with_courtesy_repeats(queue):
    hashes = set()
    for _ in range(2):
        crowd._warm.cache_clear()
        ready = load_scenario(queue(1.0), RunOptions(planner="idm_mobil", seed=1))
        hashes.add(execute(ready).row["trace_hash"])
    assert len(hashes) == 1


def test_the_background_is_the_same_until_the_first_step_after_the_egos_differ(queue):
    ready = load_scenario(queue(1.0), RunOptions(planner="constant", seed=1))

    def trace(leaves):
        ego = ready.episode.ego
        with LibsumoWorld(replace(ready.world, sight=1e5), ego, ready.spawns) as world:
            states = [world.observe()]
            for step in range(1, 30):
                speed = 0.0 if step < leaves else 5.0
                ego = replace(ego, x=ego.x + speed * DT, speed=speed)
                world.advance(ego, {})
                states.append(world.observe())
        return states

    stays, goes = trace(99), trace(15)
    # Somebody waits for the ego at instant 15; who sees it go can react at 16.
    assert stays[:16] == goes[:16]
    assert stays[16] != goes[16]


def test_where_no_lane_ends_courtesy_changes_nothing(tmp_path):
    hashes = set()
    for share in (0.0, 1.0):
        document = yaml.safe_load((SCENARIOS / "highway.yaml").read_text())
        document |= {"duration_s": 12.0}
        document["traffic"] |= {"warm_up_s": 4.0, "courtesy": {"share": share}}
        file = tmp_path / "highway.yaml"
        file.write_text(yaml.safe_dump(document))
        hashes.add(execute(load_scenario(file, RunOptions(planner="idm_mobil", seed=1))).row["trace_hash"])
    assert len(hashes) == 1


def test_who_is_courteous_has_a_stream_of_its_own(tmp_path):
    drawn = {}
    for share in (0.0, 0.3, 0.6, 1.0):
        document = yaml.safe_load((SCENARIOS / "highway_ramps.yaml").read_text())
        document["traffic"] |= {"warm_up_s": 0.0, "courtesy": {"share": share}}
        file = tmp_path / "ramps.yaml"
        file.write_text(yaml.safe_dump(document))
        drawn[share] = load_scenario(file, RunOptions(planner="constant", seed=1)).spawns
    without = {share: [replace(spawn, courteous=False) for spawn in spawns] for share, spawns in drawn.items()}
    assert without[0.0] == without[0.3] == without[0.6] == without[1.0]
    names = {share: {spawn.id for spawn in spawns if spawn.courteous} for share, spawns in drawn.items()}
    everybody = len(drawn[0.0])
    assert not names[0.0]
    assert names[0.3] < names[0.6] < names[1.0]
    assert len(names[1.0]) == everybody
    # Three standard deviations of a count of some 200.
    assert len(names[0.6]) == pytest.approx(0.6 * everybody, abs=3.0 * (0.24 * everybody) ** 0.5)
