"""Scripted drivers, against steps worked by hand."""

import math
from dataclasses import replace

import pytest

from sumo_hmdp.domain.maneuver import Mode
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import Scene, VehicleState
from sumo_hmdp.errors import InputError
from sumo_hmdp.traffic.scripted import Clock, ConstantSpeed, GapKeeping, ModeSchedule, leader, next_speed

ROAD = Road(lane_count=3, lane_width=4.0)
DT = 0.2


def vehicle(name="sv1", x=0.0, speed=20.0, lane=1, **more):
    return VehicleState(id=name, x=x, y=ROAD.center_y(lane), speed=speed, lane=lane, **more)


FAR_EGO = vehicle("ego", x=500.0, lane=2)


def scene(*others, time=0.0, ego=FAR_EGO):
    return Scene(time, ROAD, ego, others)


def act(driver, me, *others, time=0.0, ego=FAR_EGO, memory=None):
    memory = driver.initial_memory() if memory is None else memory
    return driver.accelerate(scene(me, *others, time=time, ego=ego), me, memory, DT)


def test_constant_speed_does_nothing():
    assert act(ConstantSpeed(), vehicle()) == (0.0, Mode.CRUISE, None)


def test_next_speed_stops_at_zero():
    assert next_speed(20.0, 2.5, 0.2) == pytest.approx(20.5)
    assert next_speed(0.3, -3.0, 0.2) == 0.0


def test_leader_is_the_nearest_ahead_in_the_intended_lane():
    me = vehicle(x=10.0)
    changing_in = replace(vehicle("ego", x=40.0, lane=1), y=0.1)
    changing_out = replace(vehicle("out", x=20.0, lane=2), y=3.9)
    behind, far = vehicle("behind", x=0.0), vehicle("far", x=90.0)
    assert leader(scene(me, changing_out, behind, far, ego=changing_in), me).id == "ego"
    assert leader(scene(me, changing_out, behind), me) is None


def test_schedule_on_the_clock_of_the_run():
    driver = ModeSchedule(((7.8, Mode.ACCELERATE), (9.0, Mode.DECELERATE)), accel=2.5)
    got = {t: act(driver, vehicle(), time=t)[:2] for t in (0.0, 7.6, 39 * 0.2, 8.8, 9.0)}
    assert got[0.0] == got[7.6] == (0.0, Mode.CRUISE)
    assert got[39 * 0.2] == got[8.8] == (2.5, Mode.ACCELERATE)
    assert got[9.0] == (-2.5, Mode.DECELERATE)


def test_schedule_on_the_clock_of_the_ego():
    driver = ModeSchedule(((1.8, Mode.ACCELERATE),), accel=2.5, clock=Clock.EGO_CHANGE)
    memory = driver.initial_memory()
    accels = {}
    for step in range(30):
        time = step * DT
        # It intends lane 1 from 2.0 s on, and is back in lane 2 at 3.0 s: the first change is what counts.
        ego = replace(FAR_EGO, lane=1 if 2.0 - 1e-9 <= time < 3.0 - 1e-9 else 2)
        accel, _, memory = act(driver, vehicle(), time=time, ego=ego, memory=memory)
        accels[step] = accel
    # It decides at 2.0 s and is first off its lane's centre one step later; 1.8 s after that SV1 has step 20 begun.
    assert memory.ego_change_time == pytest.approx(2.2)
    assert {accels[s] for s in range(20)} == {0.0}
    assert {accels[s] for s in range(20, 30)} == {2.5}


def test_an_ego_that_decides_at_once_starts_the_clock_one_step_later():
    driver = ModeSchedule(((1.8, Mode.ACCELERATE),), accel=2.5, clock=Clock.EGO_CHANGE)
    _, _, memory = act(driver, vehicle(), ego=replace(FAR_EGO, lane=1))
    assert memory.ego_change_time is None
    _, _, memory = act(driver, vehicle(), time=DT, ego=replace(FAR_EGO, lane=1), memory=memory)
    assert memory.ego_change_time == pytest.approx(DT)


def test_accelerating_ends_exactly_at_the_cap():
    driver = ModeSchedule(((0.0, Mode.ACCELERATE),), accel=2.5, speed_cap=20.7)
    speeds = [20.0]
    for _ in range(3):
        accel, mode, _ = act(driver, vehicle(speed=speeds[-1]))
        speeds.append(next_speed(speeds[-1], accel, DT))
    assert speeds == pytest.approx([20.0, 20.5, 20.7, 20.7])
    assert mode is Mode.CRUISE


def test_above_the_cap_it_does_not_brake():
    driver = ModeSchedule(((0.0, Mode.ACCELERATE),), accel=2.5, speed_cap=18.0)
    assert act(driver, vehicle(speed=20.0))[:2] == (0.0, Mode.CRUISE)


def test_braking_ends_at_standstill():
    driver = ModeSchedule(((0.0, Mode.DECELERATE),), accel=2.5)
    accel, mode, _ = act(driver, vehicle(speed=0.3))
    assert next_speed(0.3, accel, DT) == 0.0
    assert accel == pytest.approx(-1.5)
    assert mode is Mode.DECELERATE
    assert act(driver, vehicle(speed=0.0))[:2] == (0.0, Mode.CRUISE)


# v = 20: the wanted gap is 2 + 1.5 * 20 = 32 m, so e = gap - 32 with gap = x_lead - 4.5.
GAP_TABLE = [
    # e, v_lead, latched before -> acceleration, None where the law does not apply
    (0.0, 20.0, False, None),
    (-2.0, 20.0, False, -0.5),
    (-2.0, 21.0, False, 0.4),
    (-2.0, 18.0, False, -2.3),
    (-20.0, 20.0, False, -3.0),
    (3.0, 20.0, False, None),
    (3.0, 20.0, True, 0.75),
    (4.0, 20.0, True, 1.0),
    (4.1, 20.0, True, None),
    (4.1, 21.0, True, None),
    (8.0, 19.0, True, 1.1),
    (16.0, 19.0, True, 2.0),
]


@pytest.mark.parametrize(("surplus", "lead_speed", "latched", "accel"), GAP_TABLE)
def test_gap_keeping(surplus, lead_speed, latched, accel):
    lead = vehicle("ego", x=surplus + 32.0 + 4.5, speed=lead_speed)
    assert GapKeeping().follow(vehicle(), lead, latched=latched) == (None if accel is None else pytest.approx(accel))


def test_gap_keeping_counts_the_length_of_the_leader():
    truck = vehicle("truck", x=36.5, length=9.0)
    assert GapKeeping().follow(vehicle(), truck, latched=False) == pytest.approx(0.25 * -4.5)


def test_schedule_gives_way_and_takes_up_again():
    driver = ModeSchedule(((0.0, Mode.ACCELERATE),), accel=2.5, car_following=GapKeeping())
    near = vehicle("ego", x=34.5, speed=18.0)
    accel, mode, memory = act(driver, vehicle(), ego=near)
    assert (accel, mode, memory.latched) == (pytest.approx(-2.3), Mode.DECELERATE, True)
    opening = vehicle("ego", x=39.5, speed=20.0)
    accel, mode, memory = act(driver, vehicle(), ego=opening, memory=memory)
    assert (accel, mode, memory.latched) == (pytest.approx(0.75), Mode.CRUISE, True)
    accel, mode, memory = act(driver, vehicle(), ego=FAR_EGO, memory=memory)
    assert (accel, mode, memory.latched) == (2.5, Mode.ACCELERATE, False)


def test_every_mistake_of_a_schedule_is_named():
    with pytest.raises(InputError) as caught:
        ModeSchedule(((2.0, Mode.CRUISE), (1.0, Mode.CRUISE)), accel=-1.0, speed_cap=0.0)
    text = str(caught.value)
    assert "growing times" in text
    assert "accel must" in text
    assert "speed_cap must" in text
    with pytest.raises(InputError, match="finite times"):
        ModeSchedule(((math.nan, Mode.CRUISE),), accel=1.0)
