"""The worlds that a run can take place in, and how one is opened by its settings."""

from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.sim.libsumo_world import LibsumoWorld
from sumo_hmdp.sim.recorded_world import RecordedSettings, RecordedWorld
from sumo_hmdp.sim.world_checks import WorldSettings
from sumo_hmdp.traffic.spawn import Spawn

World = LibsumoWorld | RecordedWorld


def open_world(settings: WorldSettings | RecordedSettings, ego: VehicleState, spawns: tuple[Spawn, ...]) -> World:
    """Return the world of a run, a context manager.

    Args:
        settings: SUMO's road, or a record.
        ego: where the ego starts.
        spawns: every surrounding vehicle; none in recorded traffic.
    """
    if isinstance(settings, RecordedSettings):
        return RecordedWorld(settings, ego)
    return LibsumoWorld(settings, ego, spawns)
