"""What keeps a vehicle from entering is said, all of it, each with its place."""

import math

import pytest

from sumo_hmdp.domain.road import Road
from sumo_hmdp.traffic.spawn import DriverKind, IdmParameters, Spawn, spawn_problems

ROAD = Road(lane_count=3, lane_width=4.0)


def test_good_vehicles_have_no_problems():
    spawns = [
        Spawn("sv1", lane=1, x=10.0, speed=20.0),
        Spawn("sv.2", lane=3, x=10.0, speed=0.0, driver=DriverKind.IDM, desired_speed=30.0, time=4.0),
        Spawn("sv-3", lane=2, x=-10.0, speed=20.0, driver=DriverKind.POSED),
    ]
    assert spawn_problems(spawns, ROAD) == []


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("id", "ego"),
        ("id", "ghost-of-ego"),
        ("id", "a b"),
        ("id", ""),
        ("lane", 0),
        ("lane", 4),
        ("x", math.nan),
        ("speed", -1.0),
        ("speed", math.inf),
        ("time", -0.1),
        ("length", 0.0),
        ("width", math.nan),
        ("desired_speed", 0.0),
        ("driver", "human"),
    ],
)
def test_each_mistake_is_found(field, value):
    spawn = Spawn(**({"id": "a", "lane": 1, "x": 0.0, "speed": 5.0} | {field: value}))
    (problem,) = spawn_problems([spawn], ROAD)
    assert problem.path == f"spawns[0].{field}"
    assert "must" in problem.message


def test_idm_vehicles_must_be_able_to_drive():
    slow = Spawn("a", 1, 0.0, 20.0, driver=DriverKind.IDM, desired_speed=10.0)
    stuck = Spawn("b", 1, 0.0, 20.0, driver=DriverKind.IDM, idm=IdmParameters(accel=0.0))
    assert [p.path for p in spawn_problems([slow, stuck], ROAD)] == [
        "spawns[0].desired_speed",
        "spawns[1].idm.accel",
    ]


def test_ids_are_unique():
    twins = [Spawn("a", 1, 0.0, 5.0), Spawn("a", 2, 0.0, 5.0)]
    assert [p.path for p in spawn_problems(twins, ROAD)] == ["spawns[1].id"]
