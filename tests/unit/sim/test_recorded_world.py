"""Recorded traffic: the record itself, and vehicles that leave it behind the ego."""

from dataclasses import replace

import numpy as np
import pytest

from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.errors import InputError, SimulationError
from sumo_hmdp.sim.recorded_world import RecordedSettings, RecordedWorld, recorded_problems
from sumo_hmdp.tracks.along import along_road
from sumo_hmdp.tracks.load import RecordedTraffic
from sumo_hmdp.tracks.record import Track
from sumo_hmdp.tracks.shape import straight_road

DT = 0.1
SHAPE = straight_road((3.5, 0.0, -3.5), 0.0, 300.0, forward=True, mirrored=False)


def track(name, start, y, speed=10.0, count=301, wave=0.0):
    time = np.arange(count) * DT
    x = start + speed * time + wave * np.sin(time)
    return Track(name, 4.0, 1.8, time, x, np.full(count, y), None, speed + wave * np.cos(time))


def settings(tracks, *, reactive, ego_track=None, duration=20.0):
    along = {t.id: along_road(t, SHAPE, DT, 0.0, 30.0)[0] for t in tracks}
    traffic = RecordedTraffic(SHAPE, DT, 30.0, along, {}, (), "")
    return RecordedSettings(traffic, 0.2, 0.0, duration, reactive, ego_track=ego_track)


def ego_at(x, y=1.75, speed=10.0):
    return VehicleState("ego", x, y, speed, 1, length=4.0, width=1.8)


def drive(world_settings, ego, move, steps):
    """States of everybody but the ego after each step; `move` tells where the ego is at a time."""
    seen = []
    with RecordedWorld(world_settings, ego) as world:
        for k in range(steps):
            world.advance(move((k + 1) * 0.2), {})
            seen.append({state.id: state for state in world.observe()})
    return seen


@pytest.mark.parametrize("reactive", [False, True])
def test_without_deviation_the_replay_is_the_record(reactive):
    """The ego drives as the vehicle did whose place it took: nobody leaves its record, however near it follows."""
    tracks = [track("1", 40.0, 1.75, wave=2.0), track("2", 32.0, 1.75, wave=1.0), track("3", 20.0, -1.75)]
    world = settings(tracks, reactive=reactive, ego_track="1")
    taken = world.traffic.tracks["1"]
    seen = drive(world, taken.at(0.0, world.road), lambda t: taken.at(t, world.road), 100)
    for k, states in enumerate(seen):
        assert set(states) == {"2", "3"}
        for name, state in states.items():
            record = world.traffic.tracks[name]
            instant = 2 * (k + 1)
            assert state.x == pytest.approx(record.x[instant], abs=1e-3)
            assert state.y == pytest.approx(record.y[instant], abs=1e-3)


def test_a_stopped_ego_has_its_follower_at_the_standstill_gap():
    """And who follows that one has left its record, too; the other lane goes on."""
    tracks = [track("1", 20.0, 1.75), track("2", 0.0, 1.75), track("3", 10.0, -1.75)]
    world = settings(tracks, reactive=True)
    ego = ego_at(120.0, speed=0.0)
    last = drive(world, ego, lambda _: ego, 140)[-1]
    minimum = world.drivers.min_gap
    assert ego.x - ego.length - last["1"].x == pytest.approx(minimum, abs=0.3)
    assert last["1"].x - last["1"].length - last["2"].x == pytest.approx(minimum, abs=0.3)
    assert max(last["1"].speed, last["2"].speed) < 0.1
    assert last["3"].x == pytest.approx(world.traffic.tracks["3"].x[280])


def test_pure_replay_runs_into_a_stopped_ego_and_reacting_traffic_does_not():
    def nearest(reactive):
        ego = ego_at(100.0, speed=0.0)
        world = settings([track("1", 20.0, 1.75)], reactive=reactive)
        return min(ego.x - ego.length - states["1"].x for states in drive(world, ego, lambda _: ego, 60))

    assert nearest(reactive=False) < 0.0
    assert nearest(reactive=True) > 0.0


def test_nobody_gets_ahead_of_its_record_and_all_join_it_again():
    """The ego brakes to 6 m/s for a while and then leaves the lane."""
    world = settings([track("1", 20.0, 1.75)], reactive=True)
    record = world.traffic.tracks["1"]
    slow = [ego_at(40.0 + 6.0 * t, speed=6.0) for t in np.arange(1, 151) * 0.2]

    def move(t):
        k = round(t / 0.2) - 1
        return slow[k] if k < 25 else replace(slow[k], y=-1.75, lane=2)

    seen = drive(world, ego_at(40.0, speed=6.0), move, 145)
    behind = np.array([record.x[2 * (k + 1)] - states["1"].x for k, states in enumerate(seen)])
    assert (behind >= -1e-9).all()
    assert behind.max() > 5.0
    assert behind[-1] == 0.0


def test_a_vehicle_whose_recorded_path_leads_into_the_ego_gives_way():
    """It changes into the ego's lane just behind the ego, where the record has nobody."""
    time = np.arange(301) * DT
    y = np.interp(time, [2.0, 6.0], [-1.75, 1.75])
    change = Track("1", 4.0, 1.8, time, 20.0 + 12.0 * time, y, None, np.full(301, 12.0))
    world = settings([change], reactive=True)
    seen = drive(world, ego_at(36.0), lambda t: ego_at(36.0 + 10.0 * t), 140)
    gaps = [36.0 + 10.0 * 0.2 * (k + 1) - 4.0 - states["1"].x for k, states in enumerate(seen)]
    assert min(gaps) > 0.0


def test_the_world_says_what_it_cannot_do():
    world = settings([track("1", 20.0, 1.75)], reactive=False)
    with pytest.raises(SimulationError, match="must be open"):
        RecordedWorld(world, ego_at(60.0)).observe()
    with RecordedWorld(world, ego_at(60.0)) as opened:
        with pytest.raises(InputError, match="nobody else"):
            opened.advance(None, {})
        with pytest.raises(SimulationError, match="stay on the road"):
            opened.advance(ego_at(60.0, y=9.0), {})


def test_overlaps_of_the_record_and_of_the_start_are_told():
    both = [track("1", 20.0, 1.75), track("2", 21.0, 1.75)]
    (problem,) = recorded_problems(settings(both, reactive=False), ego_at(100.0))
    assert "must not overlap, got 1 and 2 at 0 s" in problem.message
    (problem,) = recorded_problems(settings(both[:1], reactive=False), ego_at(23.0))
    assert "overlap of" in problem.message
