"""SUMO's order of the vehicles of a lane, along which it looks for leaders, after some drove through each other."""

from collections.abc import Collection, Set
from itertools import pairwise
from typing import Any

from sumo_hmdp.errors import SimulationError


def restore_order(api: Any, lanes: Collection[str], moved: Set[str]) -> None:  # noqa: ANN401 - a module
    """Put moved vehicles back into their lane's order where it is wrong.

    SUMO takes for granted that nobody overtakes within a lane: a vehicle that is moved by its pose keeps its place in
    the order. After driving through another it would stay behind it in SUMO's eyes, and whoever comes from behind would
    look past the nearer of the two. It finds its place where it is taken to another lane and back.

    Args:
        api: libsumo.
        lanes: names of all lanes.
        moved: names of the vehicles that are moved by their poses.

    Raises:
        SimulationError: there is no other lane to do that with.
    """
    for lane in lanes:
        places = {name: api.vehicle.getLanePosition(name) for name in api.lane.getLastStepVehicleIDs(lane)}
        if all(behind <= ahead for behind, ahead in pairwise(places.values())):
            continue
        edge = api.lane.getEdgeID(lane)
        other = next((name for name in lanes if name != lane and api.lane.getEdgeID(name) == edge), None)
        if other is None:
            raise SimulationError(
                f"vehicles that drive through each other must have a second lane beside {lane}, where SUMO sorts them "
                "anew. Use a wider road, or another planner than `sumo`."
            )
        for name in sorted(moved & places.keys()):
            api.vehicle.moveTo(name, other, places[name])
            api.vehicle.moveTo(name, lane, places[name])
