"""Arguments of a world and commands of a step: every mistake is found before SUMO sees it."""

import math
from dataclasses import replace
from pathlib import Path

import pytest

from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.errors import InputError
from sumo_hmdp.sim.network import read_network
from sumo_hmdp.sim.world_checks import WorldSettings, blocks, command_problems, start_problems, world_problems
from sumo_hmdp.traffic.spawn import DriverKind, Spawn

NET = Path(__file__).parents[3] / "networks" / "highway_3x4m.net.xml"
ROAD = Road(lane_count=3, lane_width=4.0)
EGO = VehicleState("ego", x=0.0, y=0.0, speed=20.0, lane=2)
SETTINGS = WorldSettings(NET, ROAD, dt=0.2, seed=1)
KINDS = {"s": DriverKind.SCRIPTED, "p": DriverKind.POSED, "i": DriverKind.IDM}
POSED = replace(EGO, id="p", y=4.0)


def test_the_built_network_is_the_road_and_names_nothing_of_the_machine_that_built_it():
    network = read_network(NET, ROAD)
    assert (network.route, network.x_begin, network.x_end) == (("highway",), -1000.0, 9000.0)
    assert "<!--" not in NET.read_text()


def test_a_network_that_is_unchanged_is_read_once_and_one_that_has_changed_again(tmp_path):
    file = changed(tmp_path, 'edge id="highway"', 'edge id="road"')
    network = read_network(file, ROAD)
    assert network.route == ("road",)
    assert read_network(file, ROAD) is network
    changed(tmp_path, 'edge id="highway"', 'edge id="motorway"')
    assert read_network(file, ROAD).route == ("motorway",)
    file.unlink()
    with pytest.raises(InputError, match="readable XML"):
        read_network(file, ROAD)


@pytest.mark.parametrize(
    ("road", "path"), [(Road(2, 4.0), "lane_count"), (Road(3, 3.5), "lane_width")], ids=["lanes", "width"]
)
def test_another_road_is_refused(road, path):
    with pytest.raises(InputError) as caught:
        read_network(NET, road)
    assert caught.value.problems[0].path == path


def changed(tmp_path, old, new):
    text = NET.read_text()
    assert old in text
    file = tmp_path / "net.xml"
    file.write_text(text.replace(old, new))
    return file


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("-1000.00,-4.00 9000.00,-4.00", "-1000.00,-5.00 9000.00,-5.00", "lane 3 must run along y = -4.0 m"),
        ("-1000.00,4.00 9000.00,4.00", "9000.00,4.00 -1000.00,4.00", "growing x"),
        ('shape="-1000.00,4.00 9000.00,4.00"', 'shape="here"', "shapes of numbers"),
        ("</edge>", '</edge><edge id="b"></edge>', "edge b must have lanes, got none"),
        ("</net>", "", "readable XML"),
        ("<edge", '<edge function="internal"', "must have an edge, got none"),
    ],
)
def test_a_network_that_is_not_a_straight_road_is_refused(tmp_path, old, new, message):
    with pytest.raises(InputError, match=message):
        read_network(changed(tmp_path, old, new), ROAD)


@pytest.mark.parametrize(
    ("change", "path"),
    [
        ({"dt": 0.0}, "dt"),
        ({"dt": math.nan}, "dt"),
        ({"dt": 0.0125}, "dt"),
        ({"seed": -1}, "seed"),
        ({"net_file": Path("nowhere.net.xml")}, "net_file"),
    ],
)
def test_settings(change, path):
    assert [p.path for p in world_problems(replace(SETTINGS, **change), EGO, ())] == [path]


def test_all_mistakes_at_once():
    ego = replace(EGO, id="me", x=math.nan)
    problems = world_problems(replace(SETTINGS, dt=-1.0), ego, (Spawn("a", 9, 0.0, 1.0),))
    assert [p.path for p in problems] == ["dt", "ego", "ego.id", "spawns[0].lane"]


@pytest.mark.parametrize(
    ("ego", "spawn", "found"),
    [
        ({}, {"x": 20.0}, 0),
        ({}, {"x": 4.0}, 1),
        ({}, {"x": 4.0, "time": 3.0}, 0),
        ({"y": 1.5}, {"x": 2.0, "lane": 1}, 0),  # the ego's left side is at 2.4, the other's right at 3.1
        ({"y": 2.5}, {"x": 2.0, "lane": 1}, 1),
        ({"x": -996.0}, {"x": 20.0}, 1),
        ({"y": 6.1}, {"x": 20.0}, 1),
        ({}, {"x": 9000.0}, 1),
    ],
)
def test_where_vehicles_start(ego, spawn, found):
    spawns = [Spawn(**({"id": "a", "lane": 2, "speed": 5.0} | spawn))]
    assert len(start_problems(read_network(NET, ROAD), replace(EGO, **ego), spawns, 0.2)) == found


def test_others_may_not_start_in_each_other():
    spawns = [Spawn("a", 1, 50.0, 5.0), Spawn("b", 1, 54.0, 5.0)]
    (problem,) = start_problems(read_network(NET, ROAD), EGO, spawns, 0.2)
    assert "a and b must not start in each other" in problem.message


def test_a_newcomer_waits_for_its_place():
    newcomer = Spawn("a", lane=1, x=100.0, speed=20.0)  # covers 95.5 to 100
    other = replace(EGO, id="b", y=4.0, lane=1, speed=20.0)  # moves 4 m in a step
    assert not blocks(replace(other, x=91.4), newcomer, ROAD, 0.2)
    assert blocks(replace(other, x=91.6), newcomer, ROAD, 0.2)
    assert blocks(replace(other, x=104.4), newcomer, ROAD, 0.2)
    assert not blocks(replace(other, x=104.5), newcomer, ROAD, 0.2)
    assert not blocks(replace(other, x=98.0, y=0.0), newcomer, ROAD, 0.2)
    assert blocks(replace(other, x=98.0, y=1.5), newcomer, ROAD, 0.2)


def test_good_commands():
    assert command_problems((EGO, POSED), {"s": 20.0}, KINDS) == []


@pytest.mark.parametrize(
    ("moved", "speeds", "path"),
    [
        ((EGO, POSED), {}, "speeds"),
        ((EGO, POSED), {"s": 1.0, "i": 1.0}, "speeds"),
        ((EGO, POSED), {"s": math.nan}, "speeds.s"),
        ((EGO, POSED), {"s": -1.0}, "speeds.s"),
        ((EGO,), {"s": 1.0}, "poses"),
        ((EGO, POSED, POSED), {"s": 1.0}, "poses"),
        ((replace(EGO, x=math.nan), POSED), {"s": 1.0}, "ego"),
        ((replace(EGO, heading=math.inf), POSED), {"s": 1.0}, "ego"),
        ((replace(EGO, heading=2.0), POSED), {"s": 1.0}, "ego"),
        ((replace(EGO, speed=-0.1), POSED), {"s": 1.0}, "ego"),
        ((EGO, replace(POSED, y=math.nan)), {"s": 1.0}, "p"),
    ],
)
def test_bad_commands(moved, speeds, path):
    problems = command_problems(moved, speeds, KINDS)
    assert path in [p.path for p in problems]
