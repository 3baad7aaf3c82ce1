"""The background drivers of a world: SUMO's IDM along the road, MOBIL across it, all of them in arrays.

Nothing here imports SUMO: the module that talks to it comes in as an argument.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.errors import SimulationError
from sumo_hmdp.sim.contact import overlap_depth
from sumo_hmdp.sim.ghost import image_lane, second_lane
from sumo_hmdp.traffic.car_following import Drivers
from sumo_hmdp.traffic.mobil import LaneChangeRule, Vehicles, choose_lanes
from sumo_hmdp.traffic.spawn import IdmParameters, Spawn

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# A look for a better lane that is due is not missed for the rounding of a time [s].
_SOON = 1e-6


@dataclass(frozen=True)
class BackgroundSettings:
    """What all background drivers have in common.

    Attributes:
        rule: how they choose lanes.
        lane_change_time: from one lane's centre to the next [s].
        interval: least time from one change of a driver to its next [s].
        period: time between two looks for a better lane [s], rounded to the simulation step.
    """

    rule: LaneChangeRule
    lane_change_time: float = 4.0
    interval: float = 4.0
    period: float = 0.4


class Background:
    """All background vehicles of one world, as it reads and commands them.

    One row a vehicle, in the order of the spawns; `active` holds the rows of those on the road.

    Attributes:
        contacts: pairs of background vehicles that have overlapped so far, which must stay empty.
        change_count: lane changes begun so far.
    """

    def __init__(
        self,
        sumo: Any,  # noqa: ANN401 - libsumo, or TraCI, which has the same functions
        settings: BackgroundSettings,
        road: Road,
        dt: float,
        spawns: Sequence[Spawn],
    ) -> None:
        """Set up the rows; nobody is on the road yet.

        Args:
            sumo: libsumo or a module with the same functions.
            settings: common to all drivers.
            road: the lanes.
            dt: simulation step [s].
            spawns: all background vehicles of the run, also those that enter later.
        """
        self._sumo, self._settings, self._road, self._dt = sumo, settings, road, dt
        self._spawns = tuple(spawns)
        self._row = {spawn.id: row for row, spawn in enumerate(spawns)}
        self._traits = traits_of(spawns)
        self._every = max(1, round(settings.period / dt))
        count = len(self._spawns)
        self._x, self._y, self._speed = (np.full(count, math.nan) for _ in range(3))
        self._last = np.full((3, count), math.nan)
        self._target = np.array([spawn.lane for spawn in spawns], dtype=np.int64)
        self._origin = self._target.copy()
        self._arrives = np.full(count, -math.inf)
        self._waiting = sorted(range(count), key=lambda row: (spawns[row].time, spawns[row].id))
        self.active: IntArray = np.empty(0, dtype=np.int64)
        self.contacts: set[tuple[str, str]] = set()
        self.change_count = 0

    def enter(self, time: float, add: Callable[[Spawn], None]) -> None:
        """Let in who is due at `time` [s]: all of them at the start, later each as soon as there is room.

        A newcomer enters no faster than its leader, and at a gap of at least what it wants at that speed.
        """
        still_waiting: list[int] = []
        entered: list[int] = []
        full: set[int] = set()
        for place, row in enumerate(self._waiting):
            spawn = self._spawns[row]
            if spawn.time > time + _SOON:
                still_waiting += self._waiting[place:]
                break
            if time <= 0.0:
                admitted: Spawn | None = spawn
            else:
                admitted = None if spawn.lane in full else self._admitted(spawn)
            if admitted is None:
                full.add(spawn.lane)
                still_waiting.append(row)
            else:
                # One newcomer a lane and step: the next one has to see it first.
                full.add(spawn.lane)
                add(admitted)
                entered.append(row)
                self._x[row], self._y[row] = admitted.x, self._road.center_y(admitted.lane)
                self._speed[row] = admitted.speed
                # A newcomer has to settle in before it looks for another lane.
                self._arrives[row] = time if time > 0.0 else -math.inf
        self._waiting = still_waiting
        if entered:
            self.active = np.concatenate([self.active, np.array(entered, dtype=np.int64)])

    def _admitted(self, spawn: Spawn) -> Spawn | None:
        """Return the newcomer with the speed at which it may enter, None where there is no room yet."""
        here = self.active[(self._target[self.active] == spawn.lane) | (self._origin[self.active] == spawn.lane)]
        ahead = here[self._x[here] > spawn.x - spawn.length]
        if not len(ahead):
            return spawn
        nearest = ahead[np.argmin(self._x[ahead])]
        speed = min(spawn.speed, float(self._speed[nearest]))
        gap = float(self._x[nearest] - self._traits[0, nearest] - spawn.x)
        if gap < spawn.idm.min_gap + speed * spawn.idm.time_gap:
            return None
        return replace(spawn, speed=speed)

    def change_lanes(self, step: int, others: Sequence[VehicleState]) -> None:
        """Let every driver look for a better lane where a look is due, and begin the changes.

        Args:
            step: the step that ends next.
            others: everybody on the road who is no background vehicle, in the lane that it intends; drivers see its
                indicator, so a vehicle about to change counts in both lanes.
        """
        if step % self._every or not len(self.active):
            return
        now = (step - 1) * self._dt
        rows = self.active
        vehicles = self._vehicles(rows, self._arrives[rows] > now + _SOON, others)
        may_change = np.zeros(len(vehicles.x), dtype=bool)
        may_change[: len(rows)] = self._arrives[rows] + self._settings.interval <= now + _SOON
        allowed = np.ones((len(vehicles.x), self._road.lane_count), dtype=bool)
        moves = choose_lanes(vehicles, self._settings.rule, allowed, may_change)
        for index in np.flatnonzero(moves).tolist():
            self._begin(int(rows[index]), int(moves[index]), now)

    def _vehicles(self, rows: IntArray, changing: NDArray[np.bool_], others: Sequence[VehicleState]) -> Vehicles:
        """Return the background in some rows, then the others, as drivers see them."""
        strangers = traits_of([_stranger(other) for other in others])
        both = np.concatenate([self._traits[:, rows], strangers], axis=1)
        second = np.where(changing, self._origin[rows], 0)
        return Vehicles(
            x=np.concatenate([self._x[rows], [other.x for other in others]]),
            speed=np.concatenate([self._speed[rows], [other.speed for other in others]]),
            lane=np.concatenate([self._target[rows], _lanes(image_lane(v.y, self._road) for v in others)]),
            second_lane=np.concatenate([second, _lanes(_other_lane(v, self._road) for v in others)]),
            length=both[0],
            politeness=both[1],
            drivers=Drivers(*both[2:]),
        )

    def _begin(self, row: int, move: int, now: float) -> None:
        lane = int(self._target[row]) + move
        self._origin[row], self._target[row] = self._target[row], lane
        self._arrives[row] = now + self._settings.lane_change_time
        self.change_count += 1
        self._sumo.vehicle.changeLane(self._spawns[row].id, self._road.sumo_index(lane), self._dt)

    def read(self, time: float) -> None:
        """Read everybody after a step that ended at `time` [s], and drop who has left.

        Raises:
            SimulationError: SUMO reports a state that is not finite.
        """
        gone = [self._row[name] for name in self._sumo.simulation.getArrivedIDList() if name in self._row]
        if gone:
            self.active = self.active[~np.isin(self.active, gone)]
        rows = self.active
        position, speed = self._sumo.vehicle.getPosition, self._sumo.vehicle.getSpeed
        names = [self._spawns[row].id for row in rows.tolist()]
        self._last = np.stack([self._x, self._y, self._speed])
        try:
            places = np.array([position(name) for name in names]).reshape(-1, 2)
            self._speed[rows] = [speed(name) for name in names]
        except self._sumo.TraCIException as error:
            raise SimulationError(f"a background vehicle must stay until the road's end, got: {error}") from error
        self._x[rows], self._y[rows] = places[:, 0], places[:, 1]
        # SUMO answers for a vehicle that it has taken off with a large negative number.
        wrong = ~np.isfinite(places[:, 0] + self._speed[rows]) | (self._speed[rows] < 0.0)
        if wrong.any():
            name = names[int(np.flatnonzero(wrong)[0])]
            raise SimulationError(f"the state of {name} must be finite, got x = {places[wrong][0]} (t = {time:g} s).")
        arrived = self._arrives[rows] <= time + _SOON
        self._origin[rows[arrived]] = self._target[rows[arrived]]
        self._note_contacts(rows)

    def states(self, x: float, reach: float) -> list[VehicleState]:
        """Return who is within `reach` of `x` along the road [m], in the lane of its front centre, at cruise."""
        rows = self.active[np.abs(self._x[self.active] - x) <= reach]
        return [self._state(row) for row in rows.tolist()]

    def spawns(self) -> tuple[Spawn, ...]:
        """Return everybody on the road as it would enter at time 0, then who still waits, with its time.

        Raises:
            SimulationError: somebody is between two lanes.
        """
        if (self._origin[self.active] != self._target[self.active]).any():
            raise SimulationError("everybody must be in a lane. Let no change begin shortly before.")
        present = [
            replace(
                self._spawns[row],
                lane=int(self._target[row]),
                x=float(self._x[row]),
                speed=float(self._speed[row]),
                time=0.0,
            )
            for row in self.active.tolist()
        ]
        return (*present, *(self._spawns[row] for row in self._waiting))

    def _state(self, row: int) -> VehicleState:
        spawn = self._spawns[row]
        x, y, speed = float(self._x[row]), float(self._y[row]), float(self._speed[row])
        last_x, last_y, last_speed = self._last[:, row].tolist()
        new = math.isnan(last_x)
        return VehicleState(
            id=spawn.id,
            x=x,
            y=y,
            speed=speed,
            lane=self._road.lane_at(y),
            accel=0.0 if new else (speed - last_speed) / self._dt,
            heading=0.0 if new or y == last_y else math.atan2(y - last_y, x - last_x),
            length=spawn.length,
            width=spawn.width,
            lateral_speed=0.0 if new else (y - last_y) / self._dt,
        )

    def _note_contacts(self, rows: IntArray) -> None:
        """Note background vehicles that overlap: next to each other in a lane, or in either lane of a change."""
        both = rows[self._origin[rows] != self._target[rows]]
        row = np.concatenate([rows, both])
        lane = np.concatenate([self._target[rows], self._origin[both]])
        order = np.lexsort((self._x[row], lane))
        row, lane = row[order], lane[order]
        behind, ahead = row[:-1], row[1:]
        near = (lane[:-1] == lane[1:]) & (self._x[ahead] - self._traits[0, ahead] < self._x[behind])
        for i, j in zip(behind[near].tolist(), ahead[near].tolist(), strict=True):
            if i != j and overlap_depth(self._state(i), self._state(j)) > 0.0:
                first, second = sorted((self._spawns[i].id, self._spawns[j].id))
                self.contacts.add((first, second))


def _other_lane(vehicle: VehicleState, road: Road) -> int:
    """Return the second lane that others see a vehicle in or about to enter, 0 where there is none."""
    own = image_lane(vehicle.y, road)
    if vehicle.lane != own:
        return vehicle.lane
    return second_lane(vehicle, road) or 0


def _lanes(lanes: Iterable[int]) -> IntArray:
    return np.fromiter(lanes, dtype=np.int64)


def traits_of(spawns: Sequence[Spawn]) -> FloatArray:
    """Return length, politeness and the IDM's parameters in the order of `Drivers`, one column a vehicle."""
    rows = [
        (
            spawn.length,
            spawn.politeness,
            spawn.speed if spawn.desired_speed is None else spawn.desired_speed,
            spawn.idm.min_gap,
            spawn.idm.time_gap,
            spawn.idm.accel,
            spawn.idm.decel,
            spawn.idm.exponent,
        )
        for spawn in spawns
    ]
    return np.array(rows, dtype=np.float64).reshape(-1, 2 + len(fields(Drivers))).T


def _stranger(vehicle: VehicleState) -> Spawn:
    """Return what background drivers take another vehicle to be: a driver like themselves who keeps its speed."""
    speed = max(vehicle.speed, 1.0)
    return Spawn(
        vehicle.id, 1, vehicle.x, vehicle.speed, desired_speed=speed, length=vehicle.length, idm=IdmParameters()
    )
