"""A busy run as text, for comparing runs; as a script it prints the run of its own process."""

import math
import sys
from dataclasses import replace
from pathlib import Path

from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.sim.libsumo_world import LibsumoWorld
from sumo_hmdp.sim.sumo import libsumo
from sumo_hmdp.sim.world_checks import WorldSettings
from sumo_hmdp.traffic.spawn import DriverKind, Spawn

NET = Path(__file__).parents[2] / "networks" / "highway_3x4m.net.xml"
ROAD = Road(lane_count=3, lane_width=4.0)
EGO = VehicleState("ego", x=0.0, y=0.0, speed=20.0, lane=2)
CHANGE_TIME = 4.0


def settings(dt=0.2, seed=1):
    return WorldSettings(NET, ROAD, dt=dt, seed=seed)


def lane_change(time, start, y_from, y_to, ego=EGO):
    """The ego at constant speed on a quintic lane change of 4 s that begins at `start`."""
    s = min(max((time - start) / CHANGE_TIME, 0.0), 1.0)
    y = y_from + (y_to - y_from) * (10 * s**3 - 15 * s**4 + 6 * s**5)
    vy = (y_to - y_from) * (30 * s**2 - 60 * s**3 + 30 * s**4) / CHANGE_TIME
    vx = math.sqrt(ego.speed**2 - vy**2)
    return replace(ego, x=ego.x + ego.speed * time, y=y, heading=math.atan2(vy, vx))


def trace(seed=1):
    """Return every state of 20 s with all kinds of vehicles and two lane changes, in full precision."""
    idm = [
        Spawn(
            f"i{k}",
            lane=k % 3 + 1,
            x=-150.0 + 21.0 * k,
            speed=19.0 + k % 4,
            driver=DriverKind.IDM,
            desired_speed=27,
        )
        for k in range(6)
    ]
    others = (
        *idm,
        Spawn("s", lane=1, x=80.0, speed=18.0),
        Spawn("late", lane=3, x=-900.0, speed=25.0, time=3.0),
    )
    lines = []
    with LibsumoWorld(settings(seed=seed), EGO, others) as world:
        for step in range(1, 101):
            time = step * 0.2
            ego = lane_change(time, 2.0, 0.0, 4.0) if time < 8.0 else lane_change(time, 8.0, 4.0, 0.0)
            world.advance(ego, {v.id: 18.0 if v.id == "s" else 25.0 for v in world.observe() if v.id in {"s", "late"}})
            lines.append(repr((world.time, world.observe(), world.sumo_contacts())))
    return "\n".join(lines)


def leave_moves_unstepped():
    """Close a world whose posed vehicles, named as IDM vehicles of the trace, have moves that no step follows."""
    names = [f"i{k}" for k in range(6)]
    posed = tuple(Spawn(name, 3, 50.0 + 20 * k, 20.0, DriverKind.POSED) for k, name in enumerate(names))
    with LibsumoWorld(settings(), EGO, posed):
        for k, name in enumerate(names):
            libsumo.vehicle.moveToXY(name, "", -1, 777.0 + 7 * k, 4.0, 90.0, 3)


if __name__ == "__main__":
    if sys.argv[1:] == ["after-unstepped-moves"]:
        trace()
        leave_moves_unstepped()
    print(trace())
