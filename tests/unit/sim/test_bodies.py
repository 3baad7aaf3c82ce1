"""The background vehicles of SUMO in arrays, with a stand-in that plays back where vehicles are."""

import math
from pathlib import Path
from types import SimpleNamespace

import pytest

from sumo_hmdp.domain.road import Road
from sumo_hmdp.errors import SimulationError
from sumo_hmdp.sim.bodies import Bodies
from sumo_hmdp.sim.network import read_network
from sumo_hmdp.traffic.spawn import DriverKind, Spawn

ROAD = Road(3, 4.0)
NETWORK = read_network(Path(__file__).parents[3] / "networks" / "highway_3x4m.net.xml", ROAD)
DT = 0.2


class Playback:
    """As much of SUMO's interface as is read: (x, y, speed) of each vehicle, and who has arrived."""

    TraCIException = RuntimeError

    def __init__(self):
        self.now, self.arrived = {}, ()
        self.vehicle = SimpleNamespace(
            getPosition=lambda name: self.now[name][:2], getSpeed=lambda name: self.now[name][2]
        )
        self.simulation = SimpleNamespace(getArrivedIDList=lambda: self.arrived)

    def at(self, arrived=(), **now):
        self.now, self.arrived = now, arrived


def spawn(name, x, lane=2, **options):
    return Spawn(name, lane, x, 20.0, DriverKind.BACKGROUND, desired_speed=30.0, **options)


def world(*spawns):
    sumo = Playback()
    bodies = Bodies(sumo, NETWORK, DT, spawns)
    bodies.enter(range(len(spawns)), spawns, -math.inf)
    return sumo, bodies


def names(bodies, x=0.0, reach=1e6):
    return [state.id for state in bodies.states(x, reach)]


def test_nobody():
    sumo = Playback()
    bodies = Bodies(sumo, NETWORK, DT, ())
    bodies.read(0.0)
    assert (len(bodies.rows), names(bodies), bodies.crossing(0.0, 50.0), bodies.contacts) == (0, [], [], set())


def test_who_leaves_takes_all_of_its_columns_along():
    sumo, bodies = world(spawn("a", 0.0), spawn("b", 50.0, lane=1), spawn("c", 100.0, lane=3))
    # b has been told to change, and leaves in the same step.
    bodies.begin_change(1, 2, 4.0)
    sumo.at(arrived=("b", "somebody else"), a=(4.0, 0.0, 20.0), c=(104.0, -4.0, 20.0))
    bodies.read(DT)
    assert (bodies.rows.tolist(), bodies.lane.tolist(), bodies.origin.tolist()) == ([0, 2], [2, 3], [2, 3])
    assert [(s.id, s.x, s.y, s.lane, s.accel) for s in bodies.states(0.0, 1e6)] == [
        ("a", 4.0, 0.0, 2, 0.0),
        ("c", 104.0, -4.0, 3, 0.0),
    ]
    sumo.at(arrived=("a", "c"))
    bodies.read(2 * DT)
    assert (len(bodies.rows), names(bodies)) == (0, [])


def test_a_change_that_sumo_refuses_is_taken_back_and_one_that_it_begins_ends_in_time():
    sumo, bodies = world(spawn("a", 0.0), spawn("b", 50.0))
    for column in (0, 1):
        bodies.begin_change(column, 1, 0.3)
    sumo.at(a=(4.0, 0.2, 20.0), b=(54.0, 0.0, 20.0))
    bodies.read(DT)
    assert (bodies.lane.tolist(), bodies.origin.tolist()) == ([1, 2], [2, 2])
    # Who has been refused looks again after its interval.
    assert bodies.arrives.tolist() == [0.3, DT]
    sumo.at(a=(8.0, 4.0, 20.0), b=(58.0, 0.0, 20.0))
    bodies.read(2 * DT)
    assert bodies.origin.tolist() == [1, 2]


def test_who_comes_by_a_ramp_is_nowhere_until_it_has_been_read():
    sumo, bodies = world(spawn("a", 0.0), spawn("r", 0.0, entry="ramp"))
    assert names(bodies) == ["a"]
    # Beside the road at first, then in a lane; its first step has no acceleration, the second has.
    sumo.at(a=(4.0, 0.0, 20.0), r=(30.0, -9.0, 10.0))
    bodies.read(DT)
    assert names(bodies) == ["a"]
    (beside,) = bodies.crossing(20.0, 50.0)
    assert (beside.id, beside.accel, beside.lateral_speed) == ("r", 0.0, 0.0)
    sumo.at(a=(8.0, 0.0, 20.0), r=(40.0, -4.0, 10.4))
    bodies.read(2 * DT)
    (a, r), away = bodies.states(0.0, 1e6), bodies.crossing(20.0, 50.0)
    assert (a.id, away) == ("a", [])
    # It turns into the course of its first step: 10 m on and 5 m to the left.
    assert (r.id, r.lane, r.accel, r.heading) == ("r", 3, pytest.approx(2.0), math.atan2(5.0, 10.0))


def test_a_place_that_is_not_finite_is_refused_by_name():
    sumo, bodies = world(spawn("a", 0.0), spawn("b", 50.0))
    sumo.at(a=(4.0, 0.0, 20.0), b=(math.nan, 0.0, 20.0))
    with pytest.raises(SimulationError, match="the state of b must be finite"):
        bodies.read(DT)


def test_bodies_that_overlap_in_a_lane_are_noted():
    sumo, bodies = world(spawn("b", 50.0), spawn("a", 47.0), spawn("c", 47.0, lane=1))
    sumo.at(b=(54.0, 0.0, 20.0), a=(51.0, 0.0, 20.0), c=(51.0, 4.0, 20.0))
    bodies.read(DT)
    assert bodies.contacts == {("a", "b")}
