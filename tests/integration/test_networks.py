"""The committed networks in SUMO itself: edges without a seam, and the signals that the reader says."""

import math
from pathlib import Path

import pytest

from sumo_hmdp.domain.road import Road
from sumo_hmdp.sim.network import read_network
from sumo_hmdp.sim.sumo import libsumo
from sumo_hmdp.sim.sumo_input import sumo_command

NETWORKS = Path(__file__).parents[2] / "networks"
RAMPS, URBAN = NETWORKS / "highway_ramps.net.xml", NETWORKS / "urban.net.xml"
EXACT = 1e-9
TYPE = (
    '<additional><vType id="car" carFollowModel="IDM" length="4.5" width="1.8" minGap="2" tau="1.2" accel="1.5" '
    'decel="2" delta="4" speedDev="0" maxSpeed="{0}" stepping="0.2" lcOvertakeRight="1"/></additional>'
)


@pytest.fixture
def start(tmp_path):
    """Start SUMO with IDM cars that want a speed [m/s]; at the end step once more, as a move must be followed by it."""

    def start_sumo(net_file, dt, top_speed):
        types = tmp_path / "types.add.xml"
        types.write_text(TYPE.format(top_speed))
        libsumo.start(sumo_command(net_file, types, dt, 1))

    yield start_sumo
    if libsumo.isLoaded():
        libsumo.simulationStep()
        libsumo.close()


def add(name, route, lane, position, speed, mode=31):
    libsumo.route.add(name, list(route))
    libsumo.vehicle.add(name, name, typeID="car", departLane=str(lane), departPos=str(position), departSpeed=str(speed))
    libsumo.vehicle.setLaneChangeMode(name, 0)
    libsumo.vehicle.setSpeedMode(name, mode)


def move(name, x, y, speed):
    libsumo.vehicle.moveToXY(name, "", -1, float(x), float(y), 90.0, 3)
    libsumo.vehicle.setSpeed(name, float(speed))


def test_nothing_happens_to_free_traffic_where_edges_meet(start):
    network = read_network(RAMPS, Road(4, 4.0))
    start(RAMPS, 0.2, 30.0)
    for lane in range(3):
        add(str(lane), network.route, lane, 2400.0, 30.0)
    libsumo.simulationStep()
    for step in range(1, 470):  # x from 1400 to 4214 m
        libsumo.simulationStep()
        for lane in range(3):
            place = libsumo.vehicle.getPosition(str(lane))
            assert place == pytest.approx((1400.0 + 6.0 * step, -2.0 + 4.0 * lane), abs=1e-6)
            assert network.lane_of[libsumo.vehicle.getLaneID(str(lane))] == 3 - lane


@pytest.mark.parametrize("x_first", [1400.0, 1700.0, 3700.0, 4000.0])
def test_a_moved_vehicle_goes_over_a_border_and_is_in_the_lane_that_the_reader_says(start, x_first):
    network = read_network(RAMPS, Road(4, 4.0))
    start(RAMPS, 0.2, 30.0)
    add("ego", network.route, 1, 2000.0, 30.0, mode=32)
    libsumo.simulationStep()
    lanes = set()
    for step in range(60):
        x = x_first + 6.123456789 * step
        # From the left border to the right one, or into lane 4 where it exists.
        y = 2.0 + 5.9 * math.sin(0.2 * step) - 1.5 * network.lane_exists(x)[3]
        move("ego", x, y, 30.0)
        libsumo.simulationStep()
        assert libsumo.vehicle.getPosition("ego") == pytest.approx((x, y), abs=EXACT)
        lane = network.lane_of[libsumo.vehicle.getLaneID("ego")]
        assert lane == network.road.lane_at(y)
        assert network.lane_exists(x)[lane - 1]
        lanes.add(lane)
    assert lanes >= {1, 2, 3}


@pytest.mark.parametrize("border", [1500.0, 1800.0, 3800.0, 4100.0])
def test_a_follower_sees_over_a_border(start, border):
    network = read_network(RAMPS, Road(4, 4.0))
    start(RAMPS, 0.2, 30.0)
    index = network.route.index(next(s.edge for s in network.stretches if s.x_end == border))
    begin = network.stretches[index].x_begin
    lane = sum(network.stretches[index].lanes) - 2
    add("leader", network.route[index:], lane, border - begin - 10.0, 20.0, mode=32)
    add("follower", network.route[index:], lane, border - begin - 60.0, 20.0)
    libsumo.simulationStep()
    for ahead in (-1.0, 2.0, 6.0):  # before the border, across it, behind it
        move("leader", border + ahead, 2.0, 20.0)
        libsumo.simulationStep()
        behind = libsumo.vehicle.getPosition("follower")[0]
        name, gap = libsumo.vehicle.getLeader("follower", 200.0)
        # SUMO's gap is less the follower's least gap of 2 m.
        assert (name, gap) == ("leader", pytest.approx(border + ahead - 4.5 - behind - 2.0, abs=1e-6))


def test_the_on_ramp_leads_into_the_fourth_lane_which_ends(start):
    network = read_network(RAMPS, Road(4, 4.0))
    (ramp,) = network.on_ramps
    start(RAMPS, 0.2, 30.0)
    add("ramp", ramp.route, 0, 250.0, 20.0)
    seen = set()
    for _ in range(300):
        libsumo.simulationStep()
        lane = network.lane_of.get(libsumo.vehicle.getLaneID("ramp"))
        x, y = libsumo.vehicle.getPosition("ramp")
        if lane is not None:
            assert (lane, y) == (ramp.lane, -6.0)
            assert ramp.x_begin <= x <= ramp.x_end
        seen.add(lane)
    assert seen == {None, 4}
    assert x == pytest.approx(1800.0, abs=0.1)


def test_the_off_ramp_is_reached_from_the_fourth_lane(start):
    (ramp,) = read_network(RAMPS, Road(4, 4.0)).off_ramps
    start(RAMPS, 0.2, 20.0)
    add("ramp", ramp.route[3:], 0, 200.0, 20.0)
    for _ in range(60):
        libsumo.simulationStep()
    assert libsumo.vehicle.getRoadID("ramp") == "off_ramp"


# Green of the arterial begins at 0, 39, 18 and 53 s, lasts 30 s of 60, and 4 s of yellow follow.
@pytest.mark.parametrize(
    ("number", "lane", "link", "colours"),
    [
        (0, 1, 6, {10: "G", 29: "G", 31: "y", 33: "y", 35: "r", 59: "r", 61: "G"}),
        (1, 2, 5, {8: "G", 10: "y", 14: "r", 38: "r", 40: "G", 60: "G"}),
        (2, 3, 4, {1: "r", 17: "r", 19: "G", 47: "G", 49: "y", 53: "r"}),
        (3, 2, 4, {1: "G", 22: "G", 24: "y", 28: "r", 52: "r", 54: "G"}),
    ],
)
def test_a_vehicle_sees_the_signal_that_the_reader_says(start, number, lane, link, colours):
    network = read_network(URBAN, Road(3, 4.0))
    signal = network.signals[number]
    start(URBAN, 1.0, 13.89)
    add("ego", network.route, 1, 20.0, 0.0, mode=32)
    libsumo.simulationStep()
    for second in range(1, 62):
        move("ego", signal.x_stop - 40.0, network.road.center_y(lane), 0.0)
        libsumo.simulationStep()
        if second in colours:
            name, place, distance, colour = libsumo.vehicle.getNextTLS("ego")[0]
            assert (name, place, colour) == (signal.name, link, colours[second])
            assert signal.straight[lane - 1] == link
            assert distance == pytest.approx(40.0, abs=EXACT)


def test_traffic_waits_before_the_stop_line_and_goes_when_it_is_green(start):
    network = read_network(URBAN, Road(3, 4.0))
    signal = network.signals[0]
    start(URBAN, 0.2, 13.89)
    add("early", network.route, 1, 300.0, 13.0)  # reaches the stop line at about 23 s, in the green
    for step in range(1, 351):
        libsumo.simulationStep()
        if step == 75:
            add("late", network.route, 0, 300.0, 13.0)
        if step == 295:  # at 59 s it has been red for 25 s
            assert libsumo.vehicle.getSpeed("late") < 0.01
            assert signal.x_stop - 1.5 < libsumo.vehicle.getPosition("late")[0] < signal.x_stop
            assert libsumo.vehicle.getPosition("early")[0] > signal.x_exit
    assert libsumo.vehicle.getPosition("late")[0] > signal.x_stop


def test_a_moved_vehicle_goes_through_the_junctions(start):
    network = read_network(URBAN, Road(3, 4.0))
    start(URBAN, 0.2, 13.89)
    add("ego", network.route, 1, 20.0, 13.0, mode=32)
    libsumo.simulationStep()
    x = -270.0
    while x < 1890.0:
        x += 2.6
        # All lanes as long as there are all, lane 2 at the last junction.
        y = 5.0 * math.sin(x / 40.0) if x < 1500.0 else 0.5
        move("ego", x, y, 13.0)
        libsumo.simulationStep()
        assert libsumo.vehicle.getPosition("ego") == pytest.approx((x, y), abs=EXACT)
        assert network.lane_of[libsumo.vehicle.getLaneID("ego")] == network.road.lane_at(y)
        assert network.holds(x, y)


@pytest.mark.parametrize("number", range(4))
def test_turns_and_side_entries_are_routes_that_sumo_drives(start, number):
    network = read_network(URBAN, Road(3, 4.0))
    signal = network.signals[number]
    entries = [entry for entry in network.side_entries if entry.signal == signal.name]
    start(URBAN, 0.2, 13.89)
    for turn in signal.turns:
        (lane,) = turn.lanes
        add(turn.name, turn.route[-2:], 3 - lane, 200.0, 10.0)
    for entry in entries:
        add(entry.name, entry.route, 0, 100.0, 10.0)
    ends, joined = {}, {}
    for _ in range(500):
        libsumo.simulationStep()
        for name in libsumo.vehicle.getIDList():
            road, lane = libsumo.vehicle.getRoadID(name), libsumo.vehicle.getLaneID(name)
            ends[name] = (road, libsumo.vehicle.getPosition(name))
            joined.setdefault(name, network.lane_of.get(lane) if road.startswith("arterial") else None)
            if joined[name] is None and road == f"arterial_{number + 2}":
                joined[name] = network.lane_of[lane]
    for turn in signal.turns:
        edge, (_, y) = ends[turn.name]
        assert edge == turn.name
        assert (y > 12.0) == (turn.side == "left")
    assert [joined[entry.name] for entry in entries] == [entry.lanes[0] for entry in entries]
