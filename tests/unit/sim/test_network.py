"""The committed networks as the reader describes them, by numbers from their sources, and networks it refuses."""

import math
from pathlib import Path

import numpy as np
import pytest

from sumo_hmdp.domain.road import Road
from sumo_hmdp.errors import InputError
from sumo_hmdp.sim.network import Ramp, SideEntry, Signal, Turn, read_network

NETWORKS = Path(__file__).parents[3] / "networks"
RAMPS = NETWORKS / "highway_ramps.net.xml"
URBAN = NETWORKS / "urban.net.xml"
FOUR = Road(lane_count=4, lane_width=4.0)
THREE = Road(lane_count=3, lane_width=4.0)
ARTERIAL = ("arterial_1", "arterial_2", "arterial_3", "arterial_4", "arterial_5")


@pytest.fixture(scope="module")
def ramps():
    return read_network(RAMPS, FOUR)


@pytest.fixture(scope="module")
def urban():
    return read_network(URBAN, THREE)


def test_the_fourth_lane_is_there_on_two_stretches(ramps):
    three, four = (True, True, True, False), (True, True, True, True)
    assert [(s.edge, s.x_begin, s.x_end, s.lanes) for s in ramps.stretches] == [
        ("before_merge", -1000.0, 1500.0, three),
        ("merge", 1500.0, 1800.0, four),
        ("between", 1800.0, 3800.0, three),
        ("exit", 3800.0, 4100.0, four),
        ("after_exit", 4100.0, 9000.0, three),
    ]
    assert (ramps.x_begin, ramps.x_end) == (-1000.0, 9000.0)


def test_where_lanes_exist_in_one_call(ramps):
    x = np.array([-1000.1, -1000.0, 1499.9, 1500.0, 1799.9, 1800.0, 4000.0, 8999.9, 9000.0, math.nan, math.inf])
    exists = ramps.lane_exists(x)
    through = [False, True, True, True, True, True, True, True, False, False, False]
    assert exists.shape == (11, 4)
    assert exists[:, 0].tolist() == exists[:, 1].tolist() == exists[:, 2].tolist() == through
    assert np.flatnonzero(exists[:, 3]).tolist() == [3, 4, 6]
    assert ramps.lane_exists(1600.0).tolist() == [True] * 4


@pytest.mark.parametrize(
    ("x", "y", "held"),
    [
        (0.0, 8.0, True),
        (0.0, 8.1, False),
        (0.0, -4.0, True),
        (0.0, -4.1, False),
        (1600.0, -4.1, True),
        (1600.0, -8.0, True),
        (1600.0, -8.1, False),
        (1800.0, -6.0, False),
        (-1000.0, 2.0, True),
        (9000.0, 2.0, False),
        (math.nan, 2.0, False),
        (0.0, math.nan, False),
    ],
)
def test_the_road_holds_a_point_in_a_lane_that_exists_there(ramps, x, y, held):
    assert ramps.holds(x, y) is held


def test_ramps_join_and_leave_by_the_fourth_lane(ramps):
    onto = ("on_ramp", "merge", "between", "exit", "after_exit")
    off = ("before_merge", "merge", "between", "exit", "off_ramp")
    assert ramps.on_ramps == (Ramp("on_ramp", ("on_ramp",), 4, 1500.0, 1800.0, onto),)
    assert ramps.off_ramps == (Ramp("off_ramp", ("off_ramp",), 4, 3800.0, 4100.0, off),)
    assert (ramps.signals, ramps.side_entries) == ((), ())


def test_sumo_counts_lanes_from_the_right_of_each_edge(ramps, urban):
    assert [ramps.lane_of[f"merge_{index}"] for index in range(4)] == [4, 3, 2, 1]
    assert [ramps.lane_of[f"between_{index}"] for index in range(3)] == [3, 2, 1]
    assert "on_ramp_0" not in ramps.lane_of
    assert urban.lane_of["arterial_4_2"] == 1
    assert urban.lane_of[":signal_4_4_0"] == 2
    assert ":signal_4_5_0" not in urban.lane_of


def test_the_arterial_and_its_junctions(urban):
    assert urban.route == ARTERIAL
    borders = [-300.0, 300.0, 324.0, 750.0, 774.0, 1200.0, 1224.0, 1600.0, 1624.0]
    assert [stretch.x_begin for stretch in urban.stretches] == borders
    assert urban.x_end == 1900.0
    # Only lane 2 goes on at the last junction.
    assert urban.lane_exists([310.0, 1599.0, 1600.0, 1624.0]).tolist() == [
        [True, True, True],
        [True, True, True],
        [False, True, False],
        [True, True, True],
    ]
    assert urban.holds(1610.0, 1.9)
    assert not urban.holds(1610.0, 4.0)


def test_what_is_inside_a_junction(urban, ramps):
    x = np.array([299.9, 300.0, 323.9, 324.0, 700.0, 760.0, math.nan])
    assert urban.in_junction(x).tolist() == [False, True, True, False, False, True, False]
    assert bool(urban.in_junction(1601.0))
    # Edges that meet without a gap have no inside.
    assert not ramps.in_junction(np.linspace(-1000.0, 9000.0, 101)).any()


def test_signals_and_who_may_turn_where(urban):
    # Links count from the side street: north straight, north left, south right; then the arterial from right to left.
    assert urban.signals[1] == Signal(
        name="signal_2",
        x_stop=750.0,
        x_exit=774.0,
        straight=(6, 5, 4),
        turns=(
            Turn("south_2_out", "right", (3,), (3,), (*ARTERIAL[:2], "south_2_out")),
            Turn("north_2_out", "left", (1,), (7,), (*ARTERIAL[:2], "north_2_out")),
        ),
    )
    last = urban.signals[3]
    assert (last.name, last.x_stop, last.x_exit, last.straight) == ("signal_4", 1600.0, 1624.0, (None, 4, None))
    assert [(turn.side, turn.lanes, turn.links) for turn in last.turns] == [("right", (3,), (3,)), ("left", (1,), (5,))]
    assert [signal.x_stop for signal in urban.signals] == [300.0, 750.0, 1200.0, 1600.0]


def test_ways_onto_the_arterial(urban):
    assert len(urban.side_entries) == 8
    assert urban.side_entries[4:6] == (
        SideEntry("north_3_in", "signal_3", 1224.0, (1,), (1,), ("north_3_in", "arterial_4", "arterial_5")),
        SideEntry("south_3_in", "signal_3", 1224.0, (3,), (2,), ("south_3_in", "arterial_4", "arterial_5")),
    )
    assert (urban.on_ramps, urban.off_ramps) == ((), ())


def test_a_ramp_may_have_more_than_one_edge(tmp_path):
    text = RAMPS.read_text().replace(
        "</net>",
        '<edge id="a"><lane id="a_0" length="9" width="4" shape="1195,-50 1204,-50"/></edge>'
        '<connection from="a" to="on_ramp" fromLane="0" toLane="0"/></net>',
    )
    file = tmp_path / "net.xml"
    file.write_text(text)
    (ramp,) = read_network(file, FOUR).on_ramps
    assert ramp.edges == ("a", "on_ramp")
    assert ramp.route == ("a", "on_ramp", "merge", "between", "exit", "after_exit")


LOST = '<edge id="lost"><lane id="lost_0" length="9" width="4" shape="0,99 9,99"/></edge></net>'
OVERLAP = [('shape="1800.00,', 'shape="1790.00,'), ('length="2000.00"', 'length="2010.00"')]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ([("300.00", "298.00")], "lane exit_0 must be as long as its shape, 300 m, got 298.0 m"),
        ([("1800.00,-6.00", "1790.00,-6.00"), ('length="300.00"', 'length="290.00"')], "begin and end together"),
        ([("1500.00,-6.00 1800.00,-6.00", "1500.00,-2.00 1800.00,-2.00")], "merge must lie side by side"),
        (OVERLAP, "edge between must begin where merge ends or behind, at x = 1800.0 m, got 1790.0 m"),
        ([('from="merge"', 'from="on_ramp"')], "a connection must lead from edge merge to between, got none"),
        ([('to="merge" fromLane="2" toLane="3"', 'to="merge" fromLane="2" toLane="2"')], "lane 1 .* keep it, got 2"),
        ([('to="merge" fromLane="2" toLane="3"', 'to="exit" fromLane="2" toLane="3"')], "lead to merge, got exit"),
        ([('from="exit" to="off_ramp"', 'from="after_exit" to="off_ramp"')], "got only an exit to off_ramp"),
        ([('"on_ramp" to="merge" fromLane="0" toLane="0"', '"on_ramp" to="merge" fromLane="0" toLane="1"')], "on-ramp"),
        ([('to="off_ramp" fromLane="0"', 'to="off_ramp" fromLane="1"')], "off-ramp off_ramp must come from one lane"),
        ([("</net>", LOST)], "edge lost must be the road's, or lead onto it or off it"),
        ([('toLane="3"', 'toLane="left"')], "connections must have edges and lanes"),
        ([("-1000.00,6.00 1500.00,6.00", "-1000.00,6.00")], "shapes of numbers"),
        ([("-1000.00,6.00 1500.00,6.00", "-1000.00,nan 1500.00,6.00")], "shapes of numbers"),
    ],
)
def test_a_highway_that_is_refused(tmp_path, changes, message):
    with pytest.raises(InputError, match=message):
        read_network(changed(RAMPS, changes, tmp_path), FOUR)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ([('via=":signal_1_4_1" ', "")], "must have inner lanes just where it has a length"),
        ([('tl="signal_1" linkIndex="5" ', "")], r"one signal, got \['None', 'signal_1'\]"),
        ([('linkIndex="5"', "")], "one signal"),
    ],
)
def test_an_arterial_that_is_refused(tmp_path, changes, message):
    with pytest.raises(InputError, match=message):
        read_network(changed(URBAN, changes, tmp_path), THREE)


def changed(net, changes, folder):
    text = net.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    file = folder / "net.xml"
    file.write_text(text)
    return file


def test_all_mistakes_at_once(tmp_path):
    changes = [("</net>", LOST), ('to="off_ramp" fromLane="0"', 'to="off_ramp" fromLane="1"')]
    with pytest.raises(InputError) as caught:
        read_network(changed(RAMPS, changes, tmp_path), FOUR)
    assert [problem.message.split(" must ")[0] for problem in caught.value.problems] == [
        "off-ramp off_ramp",
        "edge lost",
    ]


def test_the_auxiliary_lane_counts():
    with pytest.raises(InputError, match="lane_count must equal the network's 4, got 3"):
        read_network(RAMPS, THREE)


def test_edges_that_are_nowhere_near_the_road(tmp_path):
    file = tmp_path / "net.xml"
    lane = '<edge id="{0}"><lane id="{0}_0" length="9" width="4" shape="0,99 9,99"/></edge>'
    file.write_text(f"<net>{lane.format('a')}{lane.format('b')}</net>")
    with pytest.raises(InputError, match=r"an edge between y = -6.0 and 6.0 m, got none"):
        read_network(file, THREE)
