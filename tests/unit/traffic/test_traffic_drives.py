"""Traffic that drives for minutes by these models alone: nobody touches anybody, and theory's speed comes out."""

import numpy as np
import pytest

from sumo_hmdp.traffic.car_following import EMERGENCY_DECEL, idm_accel
from sumo_hmdp.traffic.demand import Demand, initial_population
from sumo_hmdp.traffic.drivers import HIGHWAY_CLASSES, drivers_of
from sumo_hmdp.traffic.mobil import LaneChangeRule, Passing, Vehicles, choose_lanes
from sumo_hmdp.traffic.neighbours import find_neighbours
from sumo_hmdp.traffic.theory import fundamental_diagram

DT = 0.2
LANES = 3
CHANGE_TIME, PAUSE = 4.0, 5.0


# In dense traffic long rings have stop-and-go waves: the equilibrium is there, but not stable.
@pytest.mark.parametrize(("density", "length"), [(0.012, 600.0), (0.03, 200.0), (0.06, 150.0), (0.1, 100.0)])
def test_a_ring_reaches_the_speed_of_theory(density, length):
    there = initial_population(Demand(HIGHWAY_CLASSES, density=density), (1,), 0.0, length, 2)
    traits = [vehicle.traits for vehicle in there]
    drivers, length = drivers_of(traits), np.array([one.length for one in traits])
    x, speed = (np.array([getattr(vehicle, name) for vehicle in there]) for name in ("x", "speed"))
    circumference = len(there) / density
    for _ in range(8_000):
        gap = (np.roll(x, 1) - x) % circumference - np.roll(length, 1)
        speed = np.maximum(0.0, speed + DT * idm_accel(drivers, speed, gap, np.roll(speed, 1)))
        x = x + DT * speed
    theory = fundamental_diagram(density, traits)
    assert speed == pytest.approx(float(theory.speed), abs=1e-3)


def drive(demand, rule, seconds, seed, bias=None):
    """Drive along an endless road; return all moves, the least gap and the hardest braking after a change."""
    there = initial_population(demand, range(1, LANES + 1), 0.0, 1000.0, seed)
    drivers, count = drivers_of([vehicle.traits for vehicle in there]), len(there)
    x, speed, length = (np.array(v) for v in zip(*((v.x, v.speed, v.traits.length) for v in there), strict=True))
    politeness = np.array([vehicle.traits.politeness for vehicle in there])
    lane = np.array([vehicle.lane for vehicle in there])
    second, since = np.zeros(count, dtype=int), np.full(count, np.inf)
    moves, least_gap, hardest = [], np.inf, 0.0
    allowed, everybody = np.ones((count, LANES), dtype=bool), np.arange(count)
    for _ in range(round(seconds / DT)):
        vehicles = Vehicles(x, speed, lane, second, length, politeness, drivers)
        move = choose_lanes(vehicles, rule, allowed, since >= PAUSE, bias)
        moves.append(move)
        goes = move != 0
        second = np.where(goes, lane, second)
        lane, since = lane + move, np.where(goes, 0.0, since)
        near = find_neighbours(x, lane, second, LANES)
        accel = np.full(count, np.inf)
        for lanes in (lane, second):
            ahead = near.ahead[lanes - 1, everybody]
            rear, lead_speed = np.append(x - length, np.inf), np.append(speed, 0.0)
            gap = np.where(lanes > 0, rear[ahead] - x, np.inf)
            least_gap = min(least_gap, gap.min())
            accel = np.minimum(accel, idm_accel(drivers, speed, gap, np.where(lanes > 0, lead_speed[ahead], speed)))
        hardest = max(hardest, -accel.min())
        speed = np.maximum(0.0, speed + DT * accel)
        x, since = x + DT * speed, since + DT
        second = np.where(since >= CHANGE_TIME, 0, second)
    return np.array(moves), least_gap, hardest


@pytest.mark.parametrize("rule", [LaneChangeRule(), LaneChangeRule(Passing.LEFT_ONLY, right_bias=0.3)])
@pytest.mark.parametrize("density", [0.01, 0.03])
def test_lane_changes_never_end_in_a_contact(rule, density):
    moves, least_gap, hardest = drive(Demand(HIGHWAY_CLASSES, density=density), rule, 120.0, 8)
    assert (moves == -1).sum() > 3
    assert (moves == 1).sum() > 3
    assert least_gap > 1.0
    # Nobody is made to brake harder than is safe, but for what the leader does in the meantime.
    assert hardest < rule.safe_decel + 1.0 < EMERGENCY_DECEL


def test_whoever_is_drawn_to_the_right_gets_there():
    # Everybody wants into the rightmost lane, whatever it costs: still nobody touches anybody.
    demand = Demand(HIGHWAY_CLASSES, density=0.02)
    count = len(initial_population(demand, range(1, LANES + 1), 0.0, 1000.0, 8))
    moves, least_gap, hardest = drive(demand, LaneChangeRule(), 120.0, 8, np.tile([-50.0, 50.0], (count, 1)))
    assert (moves >= 0).all()
    assert (moves == 1).sum() > count / 2
    assert least_gap > 1.0
    assert hardest < EMERGENCY_DECEL
