"""The background drivers of a world who hold back, so that somebody who has to leave its lane gets in."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.sim.ghost import image_lane
from sumo_hmdp.sim.routes import Routes
from sumo_hmdp.traffic.courtesy import Approach, CourtesyRule, Patience, asked_lanes, give_way
from sumo_hmdp.traffic.mobil import Vehicles
from sumo_hmdp.traffic.spawn import IdmParameters

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Told to SUMO, this ends a speed that was commanded.
FREE = -1.0
_ORDINARY = IdmParameters()
_NO_ROWS: IntArray = np.empty(0, dtype=np.int64)


class Courtesy:
    """Who asks for room, and who holds back for it; one row a background vehicle."""

    def __init__(self, rule: CourtesyRule, routes: Routes, willing: NDArray[np.bool_], keep: float, dt: float) -> None:
        """Begin with nobody asking.

        Args:
            rule: what holds for all drivers.
            routes: where lanes end.
            willing: who lets others in, shape (rows,).
            keep: the least gap into which somebody may change [m].
            dt: simulation step [s].
        """
        self._rule, self._routes, self._willing, self._keep, self._dt = rule, routes, willing, keep, dt
        self._patience = Patience(len(willing), rule.patience)
        self._asked: IntArray = np.zeros(len(willing), dtype=np.int64)
        self._told: dict[int, float] = {}
        self._nobody = not (routes.needed and willing.any())

    def look(self, rows: IntArray, vehicles: Vehicles, ends: FloatArray) -> None:
        """Note which of the background ask for room, until it next looks for a better lane.

        Args:
            rows: of those on the road.
            vehicles: the same, then others.
            ends: where the lanes of the same end for them [m], shape (vehicles, lanes).
        """
        n, exists = len(rows), self._routes.network.lane_exists
        there = Approach(vehicles.x[:n], vehicles.speed[:n], vehicles.lane[:n], vehicles.drivers.decel[:n])
        self._asked[rows] = asked_lanes(self._rule, there, ends[:n], exists(there.x))

    def speeds(
        self,
        rows: IntArray,
        active: IntArray,
        others: Sequence[VehicleState],
        seen: Callable[[Sequence[VehicleState]], Vehicles],
    ) -> dict[int, float]:
        """Return the speeds [m/s] that some rows may not exceed in the coming step, `FREE` for those held back no more.

        Args:
            rows: of those on the road.
            active: of those whom SUMO has.
            others: everybody on the road who is no background vehicle. What it intends is no matter: its body is.
            seen: gives the background in `rows` and then the others as drivers see them.
        """
        if self._nobody:
            return {}
        before, self._told = self._told, {}
        waits = _NO_ROWS
        others = [replace(other, lane=image_lane(other.y, self._routes.network.road)) for other in others]
        asked = np.concatenate([self._asked[rows], self._asked_by(others)])
        if asked.any():
            vehicles = seen(others)
            willing = np.zeros(len(asked), dtype=bool)
            willing[: len(rows)] = self._willing[rows] & ~self._patience.over[rows]
            room = give_way(vehicles, asked, willing, self._keep, self._dt)
            slower = np.maximum(0.0, vehicles.speed[room.driver] + room.accel * self._dt)
            self._told = dict(zip(rows[room.driver].tolist(), slower.tolist(), strict=True))
            waits = rows[room.driver[room.waits]]
        self._patience.note(waits, self._dt)
        ended = [row for row in before if row not in self._told and (active == row).any()]
        return self._told | dict.fromkeys(ended, FREE)

    def _asked_by(self, others: Sequence[VehicleState]) -> IntArray:
        """Return in which lane each of the others asks for room, 0 for none; they go to the end of the road."""
        x, speed = (np.array([getattr(other, name) for other in others], dtype=np.float64) for name in ("x", "speed"))
        lane = np.array([other.lane for other in others], dtype=np.int64)
        ends = self._routes.lane_ends(None, x)
        there = Approach(x, speed, lane, np.full(len(x), _ORDINARY.decel))
        return asked_lanes(self._rule, there, ends, self._routes.network.lane_exists(x))
