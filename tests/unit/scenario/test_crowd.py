"""The place that the ego takes in the traffic, and the traffic before it is warmed up: who comes, who leaves, where."""

from dataclasses import replace
from pathlib import Path

import pytest

from sumo_hmdp.domain.road import Road
from sumo_hmdp.errors import InputError
from sumo_hmdp.scenario.crowd import background, ego_start
from sumo_hmdp.scenario.schema import EgoFile
from sumo_hmdp.scenario.traffic import TrafficFile
from sumo_hmdp.sim.world_checks import WorldSettings
from sumo_hmdp.traffic.spawn import DriverKind, Spawn

NETWORKS = Path(__file__).parents[3] / "networks"
BELIEF = {
    "lateral_probs": {"left": 0.0, "keep": 1.0, "right": 0.0},
    "longitudinal_probs": {"accelerate": 0.0, "cruise": 1.0, "decelerate": 0.0},
    "position_var_m2": 0.0,
    "speed_var_m2ps2": 0.0,
    "process_position_var_m2": 0.0,
    "process_speed_var_m2ps2": 0.0,
}
CROWD = (
    Spawn("bg-1", 1, 90.0, 30.0, DriverKind.BACKGROUND),
    Spawn("bg-2", 2, 100.0, 25.0, DriverKind.BACKGROUND),
    Spawn("bg-3", 2, 160.0, 26.0, DriverKind.BACKGROUND),
    # Nearer, but it enters later.
    Spawn("bg-4", 2, 135.0, 27.0, DriverKind.BACKGROUND, time=5.0),
)


def ego(**keys):
    return EgoFile.model_validate({"x_m": 131.0, "lane": 2, "in_traffic": True} | keys)


def test_the_ego_takes_the_place_and_speed_of_the_nearest_vehicle_in_its_lane():
    start, crowd = ego_start(ego(), CROWD)
    assert (start.x, start.speed, start.lane) == (160.0, 26.0, 2)
    assert [spawn.id for spawn in crowd] == ["bg-1", "bg-2", "bg-4"]


def test_of_two_equally_near_the_first_by_name():
    assert ego_start(ego(x_m=130.0), CROWD)[0].id == "bg-2"


def test_without_in_traffic_the_ego_is_where_it_is_put_and_nobody_goes():
    start, crowd = ego_start(ego(in_traffic=False, speed_mps=31.0), CROWD)
    assert (start.x, start.speed, start.lane) == (131.0, 31.0, 2)
    assert crowd == CROWD


@pytest.mark.parametrize(
    ("keys", "path", "message"),
    [
        ({"in_traffic": False}, "ego.speed_mps", "is missing; add it, or set ego.in_traffic"),
        ({"speed_mps": 30.0}, "ego.speed_mps", "must be left out with ego.in_traffic, got 30 m/s"),
        ({"lane": 3}, "ego.in_traffic", "must be in a lane with background traffic, got lane 3"),
        ({"x_m": 661.0}, "ego.x_m", "must be within 500 m of a vehicle in lane 2, got 661 m; the nearest is at 160 m"),
    ],
)
def test_a_place_that_cannot_be_taken(keys, path, message):
    with pytest.raises(InputError) as caught:
        ego_start(ego(**keys), CROWD)
    (problem,) = caught.value.problems
    assert problem.path == path
    assert message in problem.message


def traffic(**keys):
    base = {"density_vpkm_per_lane": 12.0, "stretch_m": [0.0, 1500.0], "lanes": [1, 2, 3], "warm_up_s": 0.0}
    return TrafficFile.model_validate(base | {"belief": BELIEF} | keys)


def drawn(network="highway_ramps", lane_count=4, seed=4, duration=60.0, **keys):
    """Return the traffic as it is drawn: without a warm-up nobody has moved yet."""
    world = WorldSettings(
        NETWORKS / f"{network}.net.xml", Road(lane_count, 4.0), dt=0.2, seed=seed,
        background=traffic(**keys).lane_changes.settings(),
    )  # fmt: skip
    return {spawn.id: spawn for spawn in background(traffic(**keys), world, duration)}


@pytest.fixture(scope="module")
def plain():
    return drawn()


def test_without_flows_nobody_uses_a_ramp(plain):
    assert len([spawn for spawn in plain.values() if spawn.time == 0.0]) in {54, 55, 56}
    assert any(spawn.time > 0.0 for spawn in plain.values())
    assert {(spawn.entry, spawn.exit) for spawn in plain.values()} == {(None, None)}
    assert {spawn.lane for spawn in plain.values()} == {1, 2, 3}
    assert {spawn.driver for spawn in plain.values()} == {DriverKind.BACKGROUND}


def test_who_leaves_is_drawn_for_each_by_itself(plain):
    few, many = drawn(exit_share=0.2), drawn(exit_share=0.6)
    leaving = [{name for name, spawn in some.items() if spawn.exit is not None} for some in (few, many)]
    assert set() < leaving[0] < leaving[1]
    # 20 and 60 % of about 130: within four standard deviations.
    for share, some in zip((0.2, 0.6), leaving, strict=True):
        assert abs(len(some) - share * len(plain)) < 4 * (share * (1 - share) * len(plain)) ** 0.5
    for some in (few, many):
        assert {name: replace(spawn, exit=None) for name, spawn in some.items()} == plain


def test_nobody_is_sent_to_an_exit_that_is_behind_or_too_near():
    beyond = drawn(exit_share=1.0, stretch_m=[3700.0, 4700.0])
    ahead = {spawn.id for spawn in beyond.values() if spawn.exit == "off_ramp"}
    assert ahead == {spawn.id for spawn in beyond.values() if spawn.x + 200.0 < 4100.0}
    assert set() < ahead < set(beyond)


def test_the_ramp_has_streams_of_its_own(plain):
    ramp = drawn(ramp_flow_vph=900.0)
    new = {name: spawn for name, spawn in ramp.items() if name not in plain}
    assert {name: spawn for name, spawn in ramp.items() if name in plain} == plain
    # 900 vehicles/h for 60 s are 15.
    assert 8 <= len(new) <= 20
    assert {spawn.entry for spawn in new.values()} == {"on_ramp"}
    assert max(spawn.speed for spawn in new.values()) <= 12.0
    more = drawn(ramp_flow_vph=900.0, density_vpkm_per_lane=20.0)
    assert {name: spawn for name, spawn in more.items() if name in new} == new


def test_side_streets_have_a_stream_each():
    flows = drawn("urban", 3, population="urban", density_vpkm_per_lane=5.0, side_flow_vph=400.0)
    by_entry = {}
    for spawn in flows.values():
        if spawn.entry is not None:
            by_entry.setdefault(spawn.entry, []).append(spawn.time)
    assert sorted(by_entry) == sorted(f"{side}_{k}_in" for side in ("north", "south") for k in (1, 2, 3, 4))
    assert len({tuple(times) for times in by_entry.values()}) == 8


def test_without_inflow_nobody_comes_later():
    assert {spawn.time for spawn in drawn(inflow=False).values()} == {0.0}


def test_another_seed_is_other_traffic(plain):
    assert {s.x for s in drawn(seed=5).values()}.isdisjoint({s.x for s in plain.values() if s.time == 0.0})


@pytest.mark.parametrize(
    ("network", "lane_count", "keys", "path", "message"),
    [
        ("highway_3x4m", 3, {"ramp_flow_vph": 1.0}, "traffic.ramp_flow_vph", "a network that has an on-ramp"),
        ("highway_3x4m", 3, {"side_flow_vph": 1.0}, "traffic.side_flow_vph", "a network that has a side street"),
        ("highway_3x4m", 3, {"exit_share": 0.1}, "traffic.exit_share", "an off-ramp or a turn"),
        ("highway_ramps", 4, {"side_flow_vph": 1.0}, "traffic.side_flow_vph", "a side street"),
        ("urban", 3, {"ramp_flow_vph": 1.0}, "traffic.ramp_flow_vph", "an on-ramp"),
        ("highway_ramps", 4, {"lanes": [3, 4]}, "traffic.lanes", "all along stretch_m, got 4, which does not at -1000"),
        ("highway_3x4m", 3, {"stretch_m": [-989.0, 0.0]}, "traffic.stretch_m", "must be within -988..9000 m"),
        ("highway_3x4m", 3, {"stretch_m": [0.0, 9001.0]}, "traffic.stretch_m", "must be within -988..9000 m"),
    ],
)
def test_traffic_that_the_network_does_not_fit(network, lane_count, keys, path, message):
    with pytest.raises(InputError) as caught:
        drawn(network, lane_count, **keys)
    (problem,) = caught.value.problems
    assert problem.path == path
    assert message in problem.message


def test_lane_4_may_have_traffic_where_it_exists():
    assert 4 in {s.lane for s in drawn(stretch_m=[1500.0, 1800.0], lanes=[1, 4], inflow=False).values()}


def problems(**keys):
    return {problem.path: problem.message for problem in traffic(**keys).problems(3, 0.2)}


def test_a_good_section_has_no_problems():
    assert problems() == {}
    assert problems(density_vpkm_per_lane=None, flow_vph_per_lane=1200.0) == {}


# The highway's mean vehicle is 0.85 * 4.5 + 0.15 * 12 = 5.625 m long with 2 m ahead of it: 1 / 7.625 m = 131.1 / km.
@pytest.mark.parametrize(("density", "good"), [(131.0, True), (131.2, False)])
def test_no_more_than_a_jam(density, good):
    found = problems(density_vpkm_per_lane=density)
    assert (found == {}) is good
    assert good or "jam density of a lane, 131.1 vehicles/km" in found["traffic.density_vpkm_per_lane"]


CAR = {
    "name": "car", "share": 1.0, "length_m": 4.5, "width_m": 1.8,
    "desired_speed_mps": {"mean": 30, "min": 25, "max": 35}, "time_gap_s": {"mean": 1.5, "min": 1, "max": 2},
    "politeness": {"mean": 0.2, "min": 0, "max": 0.5},
}  # fmt: skip


def test_classes_of_ones_own_are_drawn():
    keys = {"classes": [CAR | {"accel_mps2": 1.1}], "lanes": [2], "stretch_m": [0.0, 300.0]}
    spawns = drawn("highway_3x4m", 3, **keys).values()
    assert {(s.length, s.desired_speed, s.idm.accel, s.idm.time_gap, s.politeness) for s in spawns} == {
        (4.5, 30.0, 1.1, 1.5, 0.2)
    }
