"""Where lanes end for whom, worked out by hand from networks/README.md."""

import math
from pathlib import Path

import numpy as np
import pytest

from sumo_hmdp.domain.road import Road
from sumo_hmdp.sim.network import read_network
from sumo_hmdp.sim.routes import Routes

NETWORKS = Path(__file__).parents[3] / "networks"
ON = math.inf


@pytest.fixture(scope="module")
def highway():
    return Routes(read_network(NETWORKS / "highway_ramps.net.xml", Road(4, 4.0)))


@pytest.fixture(scope="module")
def urban():
    return Routes(read_network(NETWORKS / "urban.net.xml", Road(3, 4.0)))


def test_a_plain_highway_needs_no_routes():
    routes = Routes(read_network(NETWORKS / "highway_3x4m.net.xml", Road(3, 4.0)))
    assert not routes.needed
    assert (routes.exits, routes.entries) == ({}, {})
    assert routes.edges(0, None) == ("highway",)
    assert routes.lane_ends(None, np.array([-1000.0, 8999.0])).tolist() == [[ON] * 3] * 2


# Lane 4 exists from 1500 to 1800 m, where it ends, and from 3800 to 4100 m, where it leads to the off-ramp.
HIGHWAY = {
    (None, 0.0): [ON, ON, ON, ON],
    (None, 1500.0): [ON, ON, ON, 1800.0],
    (None, 1799.9): [ON, ON, ON, 1800.0],
    (None, 1800.0): [ON, ON, ON, ON],
    (None, 3900.0): [ON, ON, ON, 4100.0],
    (None, 8999.0): [ON, ON, ON, ON],
    ("off_ramp", -900.0): [4100.0, 4100.0, 4100.0, ON],
    # Lane 4 of the on-ramp does not reach the off-ramp.
    ("off_ramp", 1600.0): [4100.0, 4100.0, 4100.0, 1800.0],
    ("off_ramp", 3900.0): [4100.0, 4100.0, 4100.0, ON],
    ("off_ramp", 4100.0): [ON, ON, ON, ON],
}


@pytest.mark.parametrize(("way", "x"), HIGHWAY)
def test_lane_ends_of_the_highway_with_ramps(highway, way, x):
    assert highway.lane_ends(way, np.array([x])).tolist() == [HIGHWAY[way, x]]


# At the fourth junction, at 1600 m, only lane 2 goes straight; its turns are from lanes 1 and 3, as everywhere.
URBAN = {
    (None, -200.0): [1600.0, ON, 1600.0],
    (None, 310.0): [1600.0, ON, 1600.0],
    (None, 1599.0): [1600.0, ON, 1600.0],
    # Inside the junction there is lane 2 alone; behind it all three again, to the end.
    (None, 1610.0): [ON, ON, ON],
    (None, 1700.0): [ON, ON, ON],
    ("north_2_out", 0.0): [ON, 750.0, 750.0],
    ("north_2_out", 749.0): [ON, 750.0, 750.0],
    ("south_2_out", 0.0): [750.0, 750.0, ON],
    ("south_4_out", 500.0): [1600.0, 1600.0, ON],
}


@pytest.mark.parametrize(("way", "x"), URBAN)
def test_lane_ends_of_the_arterial(urban, way, x):
    assert urban.lane_ends(way, np.array([x])).tolist() == [URBAN[way, x]]


def test_many_positions_are_answered_in_one_call(highway):
    ends = highway.lane_ends("off_ramp", np.array([1600.0, 3900.0, 5000.0]))
    assert ends.shape == (3, 4)
    assert ends.tolist() == [HIGHWAY["off_ramp", 1600.0], HIGHWAY["off_ramp", 3900.0], [ON] * 4]


def test_exits_are_the_off_ramps_and_turns_along_the_road(highway, urban):
    assert [(way.name, way.x, way.lanes) for way in highway.exits.values()] == [("off_ramp", 4100.0, (4,))]
    assert [(way.name, way.x, way.lanes) for way in urban.exits.values()] == [
        (f"{side}_{number}_out", x, (lane,))
        for number, x in ((1, 300.0), (2, 750.0), (3, 1200.0), (4, 1600.0))
        for side, lane in (("north", 1), ("south", 3))
    ]


def test_edges_from_an_entry_to_an_exit(highway, urban):
    assert highway.entry_edges("on_ramp", None) == ("on_ramp", "merge", "between", "exit", "after_exit")
    assert highway.entry_edges("on_ramp", "off_ramp") == ("on_ramp", "merge", "between", "exit", "off_ramp")
    assert urban.entry_edges("south_1_in", "north_3_out") == ("south_1_in", "arterial_2", "arterial_3", "north_3_out")
    assert urban.entry_edges("north_4_in", None) == ("north_4_in", "arterial_5")
    assert sorted(urban.entries) == sorted(f"{side}_{k}_in" for side in ("north", "south") for k in (1, 2, 3, 4))


def test_edges_from_the_middle_of_the_road(highway):
    assert highway.edges(3, "off_ramp") == ("exit", "off_ramp")
    assert highway.edges(3, None) == ("exit", "after_exit")


def test_what_a_lane_serves_where_it_ends(highway, urban):
    assert [urban.turn_of(750.0, lane) for lane in (1, 2, 3)] == ["north_2_out", None, "south_2_out"]
    assert [highway.turn_of(x, 4) for x in (1800.0, 4100.0)] == [None, "off_ramp"]
