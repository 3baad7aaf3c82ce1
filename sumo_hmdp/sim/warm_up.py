"""Background traffic that drives by itself for a while before a run begins."""

from collections.abc import Sequence
from dataclasses import replace

from sumo_hmdp.sim import sumo
from sumo_hmdp.sim import world_checks as checks
from sumo_hmdp.sim.background import Background
from sumo_hmdp.sim.network import read_network
from sumo_hmdp.sim.routes import Routes
from sumo_hmdp.traffic.spawn import Spawn


def warm_up(settings: checks.WorldSettings, spawns: Sequence[Spawn], duration: float) -> tuple[Spawn, ...]:
    """Let background traffic drive by itself, and return it as it enters a run that begins when it is warm.

    The result hangs on nothing but the arguments, so planners that share them meet the same traffic. No change begins
    within the last lane-change time, so that everybody ends in a lane.

    Args:
        settings: with a background.
        spawns: background vehicles, with their times since the warm-up began.
        duration: [s].

    Raises:
        InputError: with every mistake in the arguments.
        SimulationError: SUMO does not start, or a world is open in this process.
    """
    assert settings.background is not None  # noqa: S101 - the caller's own mistake
    network = read_network(settings.net_file, settings.road)
    background = Background(sumo.libsumo, settings.background, network, settings.dt, spawns)
    steps = round(duration / settings.dt)
    last_change = duration - settings.background.lane_change_time
    routes = Routes(network)

    def add(spawn: Spawn) -> None:
        sumo.insert(routes, spawn, spawn.id, spawn.lane, spawn.driver)

    with sumo.simulation(settings, network, None, spawns):
        for step in range(steps + 1):
            time = step * settings.dt
            background.enter(time, add)
            if 0.0 < time <= last_change:
                background.change_lanes(step, ())
            background.make_room(())
            sumo.step(time)
            background.bodies.read(time)
        # Who still waits for room enters as soon as there is some, but not at the start, where nobody looks for it.
        return tuple(
            replace(spawn, time=max(settings.dt, spawn.time - duration) if spawn.time > 0.0 else 0.0)
            for spawn in background.spawns()
        )
