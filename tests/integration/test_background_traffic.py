"""The traffic's IDM and its vehicles in SUMO itself: the same accelerations, and a calm start."""

from pathlib import Path

import numpy as np
import pytest

from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.sim.libsumo_world import LibsumoWorld
from sumo_hmdp.sim.world_checks import WorldSettings
from sumo_hmdp.traffic.car_following import EMERGENCY_DECEL, Drivers, idm_accel
from sumo_hmdp.traffic.demand import Demand, initial_population, to_spawn
from sumo_hmdp.traffic.drivers import HIGHWAY_CLASSES, drivers_of
from sumo_hmdp.traffic.spawn import DriverKind, IdmParameters, Spawn

NET = Path(__file__).parents[2] / "networks" / "highway_3x4m.net.xml"
SETTINGS = WorldSettings(NET, Road(lane_count=3, lane_width=4.0), dt=0.2, seed=1)
# Far from all others, alone in its lane.
EGO = VehicleState("ego", x=0.0, y=0.0, speed=20.0, lane=2)


def ego_after(steps):
    return VehicleState("ego", x=EGO.x + 4.0 * steps, y=0.0, speed=20.0, lane=2)


@pytest.mark.parametrize(
    ("gap", "speed", "lead_speed"),
    [
        (40.0, 25.0, 20.0),
        # A leader that is faster by 20 m/s: the wanted gap is no less than min_gap.
        (15.0, 10.0, 30.0),
        # A standing leader: as hard as anybody brakes.
        (30.0, 25.0, 0.0),
    ],
)
def test_sumo_accelerates_by_the_same_formula(gap, speed, lead_speed):
    idm = IdmParameters(min_gap=2.5, time_gap=1.2, accel=1.3, decel=1.8, exponent=4.0)
    leader = Spawn("s", lane=1, x=100.0, speed=lead_speed)
    follower = Spawn("f", 1, 100.0 - leader.length - gap, speed, DriverKind.IDM, desired_speed=33.0, idm=idm)
    driver, accels = Drivers.of([(idm, 33.0)]), []
    with LibsumoWorld(SETTINGS, EGO, (leader, follower)) as world:
        for step in range(1, 31):
            f, s = world.observe()
            gap = s.x - s.length - f.x
            expected = float(idm_accel(driver, np.array([f.speed]), np.array([gap]), s.speed)[0])
            world.advance(ego_after(step), {"s": lead_speed})
            after = world.observe()[0]
            assert after.speed == pytest.approx(max(0.0, f.speed + 0.2 * expected), abs=1e-8)
            accels.append(expected)
    assert (min(accels) == -EMERGENCY_DECEL) == (lead_speed == 0.0)


@pytest.mark.parametrize("density", [0.01, 0.04, 0.09])
def test_a_population_starts_calmly(density):
    demand = Demand(HIGHWAY_CLASSES, density=density)
    traffic = {vehicle.id: vehicle for vehicle in initial_population(demand, (1, 3), -400.0, 400.0, 5)}
    with LibsumoWorld(SETTINGS, EGO, tuple(map(to_spawn, traffic.values()))) as world:
        for step in range(1, 26):
            rows = sorted(world.observe(), key=lambda state: (state.lane, -state.x))
            assert len(rows) == len(traffic)
            lane, x, speed, length = (np.array([getattr(r, n) for r in rows]) for n in ("lane", "x", "speed", "length"))
            gap, lead_speed = np.full(len(rows), np.inf), np.zeros(len(rows))
            led = np.flatnonzero(lane[1:] == lane[:-1]) + 1
            gap[led], lead_speed[led] = x[led - 1] - length[led - 1] - x[led], speed[led - 1]
            drivers = drivers_of([traffic[row.id].traits for row in rows])
            expected = np.maximum(0.0, speed + 0.2 * idm_accel(drivers, speed, gap, lead_speed))
            world.advance(ego_after(step), {})
            after = {state.id: state.speed for state in world.observe()}
            assert [after[row.id] for row in rows] == pytest.approx(expected, abs=1e-8)
            assert ((speed - expected) / 0.2 <= drivers.decel + 0.5).all()
            assert (gap > 0.0).all()
