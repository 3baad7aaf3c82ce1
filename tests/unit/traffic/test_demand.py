"""Who is on the road and who comes: realised densities and flows, room for everybody, and streams of one's own."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import kstest

from sumo_hmdp.domain.road import Road
from sumo_hmdp.errors import InputError
from sumo_hmdp.traffic.car_following import idm_accel
from sumo_hmdp.traffic.demand import Demand, arrivals, initial_population, to_spawn
from sumo_hmdp.traffic.drivers import HIGHWAY_CLASSES, URBAN_CLASSES, TruncatedNormal, VehicleClass, drivers_of
from sumo_hmdp.traffic.spawn import DriverKind, spawn_problems

LANES = (1, 2, 3)
EXACT = TruncatedNormal(0.0, 0.0, 0.0, 0.0)
# Everybody is alike: s0 = 2, T = 1.5, v0 = 40, length 4. In equilibrium at 20 m/s the spacing is 4 + 32 / sqrt(15/16).
ALIKE = VehicleClass(
    "alike",
    1.0,
    4.0,
    2.0,
    TruncatedNormal(40.0, 0.0, 40.0, 40.0),
    TruncatedNormal(1.5, 0.0, 1.5, 1.5),
    EXACT,
    accel=2.0,
)
PINNED = (1494.848576, 19.814955, 32.350527)
SPACING = 4 + 32 / math.sqrt(15 / 16)

demands = st.builds(
    lambda classes, density, spread: Demand(classes, density=density, gap_spread=spread),
    st.sampled_from([HIGHWAY_CLASSES, URBAN_CLASSES]),
    st.floats(0.0, 0.07),
    st.floats(0.0, 0.9),
)
seeds = st.integers(0, 2**40)


def present(demand, seed=1, x_from=-500.0, x_to=1500.0, lanes=LANES):
    return initial_population(demand, lanes, x_from, x_to, seed)


def test_alike_drivers_without_spread_stand_in_equilibrium():
    demand = Demand((ALIKE,), density=1 / SPACING, gap_spread=0.0)
    assert demand.mean_speed == pytest.approx(20.0)
    assert demand.mean_flow == pytest.approx(20.0 / SPACING)
    there = present(demand, x_from=0.0, x_to=10 * SPACING, lanes=(2,))
    assert [vehicle.id for vehicle in there] == [f"bg-2-{k:03d}" for k in range(10)]
    assert [ahead.x - behind.x for ahead, behind in pairwise(there)] == pytest.approx([SPACING] * 9)
    assert [vehicle.speed for vehicle in there] == pytest.approx([20.0] * 10)


@settings(max_examples=40, deadline=None)
@given(demands, seeds)
def test_everybody_has_room_and_drives_sensibly(demand, seed):
    there = present(demand, seed)
    for lane in LANES:
        row = [vehicle for vehicle in there if vehicle.lane == lane]
        assert abs(len(row) - demand.mean_density * 2000.0) < 1.0
        if not row:
            continue
        assert row[0].x <= 1500.0
        assert row[-1].x - row[-1].traits.length >= -500.0 - 1e-6
        for ahead, behind in pairwise(row):
            gap = ahead.x - ahead.traits.length - behind.x
            assert gap >= behind.traits.idm.min_gap - 1e-6
            accel = idm_accel(drivers_of([behind.traits]), np.array([behind.speed]), np.array([gap]), ahead.speed)
            assert accel[0] >= -behind.traits.idm.decel - 1e-6
    assert all(0.0 <= vehicle.speed <= vehicle.traits.desired_speed for vehicle in there)


@settings(max_examples=30, deadline=None)
@given(demands, seeds)
def test_who_arrives_drives_sensibly(demand, seed):
    coming = arrivals(demand, LANES, -500.0, 60.0, seed)
    assert [vehicle.time for vehicle in coming] == sorted(vehicle.time for vehicle in coming)
    for vehicle in coming:
        assert 0.0 < vehicle.time < 60.0
        assert 0.0 < vehicle.speed <= min(vehicle.traits.desired_speed, demand.mean_speed)
    for lane in LANES:
        for ahead, behind in pairwise(vehicle for vehicle in coming if vehicle.lane == lane):
            gap = ahead.speed * (behind.time - ahead.time) - ahead.traits.length
            assert gap >= behind.traits.idm.min_gap - 1e-6
            accel = idm_accel(drivers_of([behind.traits]), np.array([behind.speed]), np.array([gap]), ahead.speed)
            assert accel[0] >= -behind.traits.idm.decel - 1e-6


@settings(max_examples=30, deadline=None)
@given(demands, seeds)
def test_everything_can_be_spawned_together(demand, seed):
    everybody = (*present(demand, seed), *arrivals(demand, LANES, -500.0, 30.0, seed))
    assert spawn_problems([to_spawn(vehicle) for vehicle in everybody], Road(3, 4.0)) == []


def test_a_spawn_is_the_vehicle():
    vehicle = present(Demand(HIGHWAY_CLASSES, density=0.02))[7]
    spawn = to_spawn(vehicle)
    assert (spawn.id, spawn.lane, spawn.x, spawn.speed, spawn.time) == (
        vehicle.id,
        vehicle.lane,
        vehicle.x,
        vehicle.speed,
        0.0,
    )
    assert (spawn.driver, spawn.idm) == (DriverKind.IDM, vehicle.traits.idm)
    assert (spawn.desired_speed, spawn.length) == (vehicle.traits.desired_speed, vehicle.traits.length)
    assert spawn.width == vehicle.traits.width


def traits_by_id(vehicles):
    return {vehicle.id: vehicle.traits for vehicle in vehicles}


@settings(max_examples=20, deadline=None)
@given(st.floats(0.005, 0.03), seeds)
def test_nobody_changes_because_there_are_more(density, seed):
    few, many = (Demand(HIGHWAY_CLASSES, density=factor * density) for factor in (1, 2))
    for fewer, more in (
        (present(few, seed), present(many, seed)),
        (present(few, seed, lanes=(2,)), present(few, seed)),
        (present(few, seed, x_to=700.0), present(few, seed)),
        (arrivals(few, (3,), -500.0, 50.0, seed), arrivals(few, LANES, 0.0, 300.0, seed)),
    ):
        some, all_of_them = traits_by_id(fewer), traits_by_id(more)
        assert set(some) <= set(all_of_them)
        assert all(traits == all_of_them[name] for name, traits in some.items())


def test_arrival_times_do_not_depend_on_lanes_or_duration():
    demand = Demand(HIGHWAY_CLASSES, flow=0.3)
    short, long = arrivals(demand, (2,), 0.0, 60.0, 9), arrivals(demand, LANES, 0.0, 120.0, 9)
    assert short == tuple(vehicle for vehicle in long if vehicle.lane == 2 and vehicle.time < 60.0)


def test_another_seed_is_other_traffic_and_the_same_seed_the_same():
    demand = Demand(HIGHWAY_CLASSES, density=0.02)
    assert present(demand, 1) == present(demand, 1)
    assert {v.traits for v in present(demand, 1)}.isdisjoint({v.traits for v in present(demand, 2)})
    assert {v.traits for v in present(demand, 1)}.isdisjoint({v.traits for v in arrivals(demand, LANES, 0.0, 60.0, 1)})


def test_published_runs_keep_their_traffic():
    # Written down once: whoever changes a stream changes every result.
    vehicle = present(Demand(HIGHWAY_CLASSES, density=0.02), 1)[0]
    assert (vehicle.id, vehicle.traits.class_name) == ("bg-1-000", "car")
    assert (vehicle.x, vehicle.speed, vehicle.traits.desired_speed) == pytest.approx(PINNED, abs=1e-6)


def test_density_and_flow_are_those_asked_for():
    # 40 lanes of 2 km: the chance of one more averages out.
    demand = Demand(HIGHWAY_CLASSES, density=0.0173)
    there = present(demand, 3, lanes=range(1, 41))
    assert len(there) / (40 * 2000.0) == pytest.approx(0.0173, rel=0.01)
    flow = Demand(HIGHWAY_CLASSES, flow=0.25)
    coming = arrivals(flow, range(1, 41), 0.0, 600.0, 3)
    assert len(coming) / (40 * 600.0) == pytest.approx(0.25, rel=0.03)
    assert flow.mean_density * flow.mean_speed == pytest.approx(0.25)


def test_headways_are_a_least_one_and_an_exponential_rest():
    demand = Demand((ALIKE,), flow=0.2)
    speed = demand.mean_speed
    times = [0.0] + [vehicle.time for vehicle in arrivals(demand, (1,), 0.0, 5000.0, 4)]
    least = 6.0 / speed + 1.5
    headways = np.diff(times)
    assert headways.min() >= least
    assert kstest(headways - least, "expon", args=(0.0, 5.0 - least)).pvalue > 0.05


def test_behind_a_slow_and_long_vehicle_one_enters_later():
    slow = replace(ALIKE, name="slow", share=0.5, length=40.0, desired_speed=TruncatedNormal(2.0, 0.0, 2.0, 2.0))
    demand = Demand((slow, replace(ALIKE, share=0.5)), flow=0.15)
    coming = arrivals(demand, (1,), 0.0, 400.0, 6)
    pairs = [(ahead, behind) for ahead, behind in pairwise(coming) if ahead.traits.class_name == "slow"]
    assert len(pairs) > 3
    for ahead, behind in pairs:
        assert ahead.speed * (behind.time - ahead.time) >= 42.0 - 1e-6


def test_no_demand_is_no_traffic():
    for demand in (Demand(HIGHWAY_CLASSES, density=0.0), Demand(HIGHWAY_CLASSES, flow=0.0)):
        assert present(demand) == arrivals(demand, LANES, 0.0, 100.0, 1) == ()
        assert demand.mean_speed == pytest.approx(demand.mean_driver.desired_speed)


def test_more_than_a_lane_holds_is_refused_with_the_limit():
    # 1 / (5.625 + 2).
    with pytest.raises(
        InputError, match=r"density must be at least 0 and below 0\.131148 1/m.*got 0\.1312 1/m\. Lower it"
    ):
        Demand(HIGHWAY_CLASSES, density=0.1312)
    with pytest.raises(InputError, match=r"capacity of a lane, got 0\.6 1/s\. Lower it"):
        Demand(HIGHWAY_CLASSES, flow=0.6)


def test_drawn_vehicles_that_do_not_fit_are_refused():
    # Half of them are 60 m long: 1 / 34 m is the jam on average, but seven of eight long ones are too many.
    long = replace(ALIKE, name="long", share=0.5, length=60.0)
    demand = Demand((replace(ALIKE, share=0.5), long), density=0.98 / 34.0)
    with pytest.raises(InputError, match="at standstill they need"):
        present(demand, 1, x_from=0.0, x_to=300.0, lanes=range(1, 21))


@pytest.mark.parametrize(
    "fields",
    [
        {},
        {"density": 0.01, "flow": 0.1},
        {"density": -0.01},
        {"density": math.nan},
        {"flow": -0.1},
        {"density": 0.01, "gap_spread": 1.0},
        {"density": 0.01, "classes": HIGHWAY_CLASSES[:1]},
    ],
)
def test_demands_that_make_no_sense_are_refused(fields):
    with pytest.raises(InputError):
        Demand(**({"classes": HIGHWAY_CLASSES} | fields))


def test_calls_that_make_no_sense_are_refused():
    demand = Demand(HIGHWAY_CLASSES, density=0.01)
    with pytest.raises(InputError) as caught:
        initial_population(demand, (1, 1), 10.0, 10.0, -1)
    assert [problem.path for problem in caught.value.problems] == ["lanes", "seed", "x_from"]
    with pytest.raises(InputError) as caught:
        arrivals(demand, (0,), 0.0, -1.0, -1)
    assert [problem.path for problem in caught.value.problems] == ["lanes", "seed", "duration"]
