"""The background vehicles that SUMO has: where they are, how they stand, which lanes they are in, all in arrays.

Nothing here imports SUMO: the module that talks to it comes in as an argument.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.domain.lanes import lanes_at
from sumo_hmdp.domain.maneuver import Mode
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.errors import SimulationError
from sumo_hmdp.sim.contact import Sweep, first_meeting
from sumo_hmdp.sim.getters import Getters
from sumo_hmdp.sim.network import Network
from sumo_hmdp.sim.traits import traits_of
from sumo_hmdp.traffic.spawn import Spawn

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
# Some of the columns: numbers, or all of them, which takes no copy.
Columns = slice | IntArray

# What is due at a time is not missed for its rounding [s].
SOON = 1e-6
_ALL = slice(None)
# The arrays of `Bodies` with one column a vehicle.
_COLUMNS = ("rows", "now", "_last", "traits", "lane", "origin", "arrives", "_heading", "_was", "_has_course", "_begun")
# Who moves less in a step has no course [m].
_STANDS = 1e-3
# From the rear axle to the front bumper, as a share of the length.
_LEVER = 0.8
# No lane change has a greater angle to the road [rad].
_STEEPEST = 0.3
# Beyond this angle to the road a vehicle crosses it [rad].
_CROSSING = math.pi / 4
# How far beside the road a body can still reach into it [m].
_BESIDE = 15.0


def trailing_heading(heading: FloatArray, course: FloatArray, distance: FloatArray, lever: FloatArray) -> FloatArray:
    """Return the headings after the front bumpers moved straight on: d heading / ds = sin(course - heading) / lever.

    Exact for any distance: tan((heading - course) / 2) falls by the factor exp(-distance / lever). A single step of the
    differential equation would swing ever wider where a vehicle goes farther in a step than twice the lever.

    Args:
        heading: (N,) before [rad].
        course: (N,) direction in which the front bumpers have moved [rad].
        distance: (N,) that they have moved [m].
        lever: (N,) from the front bumper to the rear axle [m], > 0.
    """
    half = np.tan(0.5 * (heading - course)) * np.exp(-distance / lever)
    return np.asarray(course + 2.0 * np.arctan(half), dtype=np.float64)


class Bodies:
    """Everybody of the background whom SUMO has; one column a vehicle, in the order in which they came.

    Attributes:
        rows: (n,) numbers of the vehicles among the spawns.
        now: (3, n) x and y of the front bumpers [m] and speeds [m/s]; NaN where a vehicle from a ramp has not been
            read yet.
        lane: (n,) the lane that a vehicle is in, or changes to.
        origin: (n,) the lane that it changes from, `lane` where it does not change.
        arrives: (n,) when its last lane change ends [s], or when it came.
        traits: (8, n) as `traits_of` gives them.
        contacts: pairs of names of vehicles that have overlapped so far, which must stay empty.
    """

    def __init__(self, sumo: Any, network: Network, dt: float, spawns: Sequence[Spawn]) -> None:  # noqa: ANN401
        """Begin with nobody.

        Args:
            sumo: libsumo, or TraCI, which has the same functions.
            network: the road.
            dt: simulation step [s].
            spawns: all background vehicles of the run, also those that enter later.
        """
        self._sumo, self._getters = sumo, Getters(sumo)
        self._network, self._road, self._dt = network, network.road, dt
        self._spawns = tuple(spawns)
        self._all_traits = traits_of(spawns)
        self.rows: IntArray = np.empty(0, dtype=np.int64)
        self.now = self._last = np.empty((3, 0))
        self.traits = np.empty((len(self._all_traits), 0))
        self.lane, self.origin, self.arrives = self.rows, self.rows, np.empty(0)
        self._heading, self._was, self._levers, self._widths = (np.empty(0) for _ in range(4))
        self._has_course = self._begun = np.empty(0, dtype=bool)
        self._vehicles: list[Spawn] = []
        self._names: list[str] = []
        self._on_road: Columns = _ALL
        self.contacts: set[tuple[str, str]] = set()

    def enter(self, rows: Sequence[int], admitted: Sequence[Spawn], arrives: float) -> None:
        """Add who comes at the end of the coming step.

        Args:
            rows: numbers among the spawns.
            admitted: the same vehicles, as they enter.
            arrives: from when on they have settled in [s].
        """
        nowhere = (math.nan, math.nan, math.nan)
        places = [
            nowhere if spawn.entry is not None else (spawn.x, self._road.center_y(spawn.lane), spawn.speed)
            for spawn in admitted
        ]
        lane = np.array([spawn.lane for spawn in admitted], dtype=np.int64)
        count, nobody_begins = len(rows), np.zeros(len(rows), dtype=bool)
        self._set(
            {
                name: np.concatenate([getattr(self, name), more], axis=-1)
                for name, more in (
                    ("rows", np.array(rows, dtype=np.int64)),
                    ("now", np.array(places).T),
                    ("_last", np.full((3, count), math.nan)),
                    ("traits", self._all_traits[:, rows]),
                    ("lane", lane),
                    ("origin", lane),
                    ("arrives", np.full(count, arrives)),
                    ("_heading", np.zeros(count)),
                    ("_was", np.zeros(count)),
                    ("_has_course", nobody_begins),
                    ("_begun", nobody_begins),
                )
            }
        )
        self._on_road = self._find_on_road()

    def _leave(self, stays: BoolArray) -> None:
        """Drop who does not stay; who is on the road is found again when everybody has been read."""
        self._set({name: getattr(self, name)[..., stays] for name in _COLUMNS})

    def _set(self, columns: Mapping[str, NDArray[Any]]) -> None:
        """Take new columns, all of them, and what follows from who is there."""
        for name in _COLUMNS:
            setattr(self, name, columns[name])
        self._vehicles = [self._spawns[row] for row in self.rows.tolist()]
        self._names = [spawn.id for spawn in self._vehicles]
        self._widths = np.array([spawn.width for spawn in self._vehicles], dtype=np.float64)
        self._levers = _LEVER * self.traits[0]

    def begin_change(self, column: int, lane: int, arrives: float) -> None:
        """Note that a vehicle has been told to change to a lane, where it arrives at a time [s]."""
        self.origin[column], self.lane[column] = self.lane[column], lane
        self.arrives[column], self._begun[column] = arrives, True

    def read(self, time: float) -> None:
        """Read everybody after a step that ended at `time` [s], and drop who has left.

        Raises:
            SimulationError: SUMO reports a state that is not finite.
        """
        arrived = self._sumo.simulation.getArrivedIDList()
        if arrived:
            self._leave(np.array([name not in arrived for name in self._names], dtype=bool))
        names = self._names
        self._last, self.now = self.now, np.empty((3, len(names)))
        try:
            self.now[:2], self.now[2] = self._getters.positions(names).T, self._getters.speeds(names)
        except self._sumo.TraCIException as error:
            raise SimulationError(f"a background vehicle must stay until the road's end, got: {error}") from error
        # SUMO answers for a vehicle that it has taken off with a large negative number.
        if names and not (math.isfinite(self.now.sum()) and self.now[2].min() >= 0.0):
            wrong = ~np.isfinite(self.now.sum(axis=0)) | ~(self.now[2] >= 0.0)
            name, place = names[int(np.flatnonzero(wrong)[0])], self.now[:2, wrong][:, 0]
            raise SimulationError(f"the state of {name} must be finite, got x = {place} (t = {time:g} s).")
        self._turn()
        self._settle_changes(time)
        self._on_road = self._find_on_road()
        self._note_contacts(self._on_road)

    def _turn(self) -> None:
        """Turn the bodies: the rear axle follows the front bumper as a trailer follows its hitch (eq. 18)."""
        dx, dy = self.now[0] - self._last[0], self.now[1] - self._last[1]
        distance, course = np.hypot(dx, dy), np.arctan2(dy, dx)
        turned, known = trailing_heading(self._heading, course, distance, self._levers), self._has_course.copy()
        # Who stands keeps its heading; who has just come has none yet.
        moved = distance > _STANDS
        if not (moved & self._has_course).all():
            turned = np.where(moved, np.where(self._has_course, turned, course), self._heading)
            self._has_course |= moved
        # SUMO lets a change take its time however slow the vehicle is; a body does not turn across the road for it.
        changing = self.origin != self.lane
        if changing.any():
            turned[changing] = np.minimum(np.maximum(turned[changing], -_STEEPEST), _STEEPEST)
        self._was, self._heading = np.where(known, self._heading, turned), turned

    def _settle_changes(self, time: float) -> None:
        """Take back the changes that SUMO has not begun, and end those whose time is over.

        SUMO refuses a change that would not be complete before the vehicle turns off.
        """
        if self._begun.any():
            refused = self._begun & (np.abs(self.now[1] - self._last[1]) < _STANDS)
            self.lane[refused], self.arrives[refused] = self.origin[refused], time
            self._begun[:] = False
        np.copyto(self.origin, self.lane, where=self.arrives <= time + SOON)

    def on_road(self) -> Columns:
        """Return the columns of those who drive along the road, in a lane of it; others are on ramps or cross it."""
        return self._on_road

    def columns(self, some: Columns) -> IntArray:
        """Return some columns as numbers."""
        return np.arange(len(self.rows))[some]

    def _find_on_road(self) -> Columns:
        (x, y, _), road = self.now, self._road
        lane = (road.lane_count + 1) / 2 - y / road.lane_width + 0.5
        # Who comes by a ramp is nowhere, with an x that is not a number, before it has been read once.
        inside = (lane >= 1.0) & (lane < road.lane_count + 1) & (np.abs(self._heading) <= _CROSSING) & np.isfinite(x)
        if not inside.all():
            return self._where_lanes_exist(np.flatnonzero(inside), lane)
        exists = self._network.lane_exists(x)
        return _ALL if exists.all() else self._where_lanes_exist(np.arange(len(x)), lane)

    def _where_lanes_exist(self, columns: IntArray, lane: FloatArray) -> IntArray:
        exists = self._network.lane_exists(self.now[0, columns])
        return columns[exists[np.arange(len(columns)), lane[columns].astype(np.int64) - 1]]

    def states(self, x: float, reach: float) -> list[VehicleState]:
        """Return who drives along the road within `reach` of `x` [m], in the lane of its front centre, at cruise."""
        near = np.flatnonzero(np.abs(self.now[0, self._on_road] - x) <= reach)
        return self._states(near if isinstance(self._on_road, slice) else self._on_road[near])

    def crossing(self, x: float, reach: float) -> list[VehicleState]:
        """Return who is on or beside the road within `reach` of `x` [m] and does not drive along it."""
        away = np.ones(len(self.rows), dtype=bool)
        away[self._on_road] = False
        beside = 0.5 * self._road.lane_count * self._road.lane_width + _BESIDE
        near = (np.abs(self.now[0] - x) <= reach) & (np.abs(self.now[1]) <= beside)
        return self._states(np.flatnonzero(away & near))

    def _states(self, columns: IntArray) -> list[VehicleState]:
        """Return some vehicles; who has just come has neither accelerated nor moved sideways yet."""
        if not len(columns):
            return []
        now = self.now.take(columns, axis=1)
        change = (now - self._last.take(columns, axis=1)) / self._dt
        if math.isnan(change.sum()):
            change[:, np.isnan(change[1])] = 0.0
        (x, y, speed), (_, lateral_speed, accel) = now.tolist(), change.tolist()
        lane, heading = lanes_at(self._road, now[1]).tolist(), self._heading.take(columns).tolist()
        vehicles, cruise = self._vehicles, Mode.CRUISE
        # Positional: twice as fast, and done for everybody in sight at every step.
        return [
            VehicleState(spawn.id, x, y, speed, lane, cruise, accel, heading, spawn.length, spawn.width, lateral_speed)
            for spawn, x, y, speed, lane, accel, heading, lateral_speed in zip(
                [vehicles[column] for column in columns.tolist()],
                x, y, speed, lane, accel, heading, lateral_speed, strict=True,
            )
        ]  # fmt: skip

    def _note_contacts(self, some: Columns) -> None:
        """Note vehicles that meet in the step: those whose ways along and across the road come near each other."""
        number = self.columns(some)
        # Who has just come has not moved.
        ends = self.now[:2].take(number, axis=1)
        starts = self._last[:2].take(number, axis=1)
        starts = np.where(np.isnan(starts), ends, starts)
        length, width = self.traits[0].take(number), self._widths.take(number)
        reach = 0.5 * width + length * np.abs(np.sin(self._heading.take(number)))
        low, high = np.minimum(starts, ends), np.maximum(starts, ends)
        low, high = low - np.stack([length + 0.5 * width, reach]), high + np.stack([0.5 * width, reach])
        order = np.argsort(low[0], kind="stable")
        low, high = low.take(order, axis=1), high.take(order, axis=1)
        for shift in range(1, len(order)):
            along = low[0, shift:] < high[0, :-shift]
            # Sorted by where they begin: where no such two reach each other, no two farther apart do.
            if not along.any():
                break
            near = along & (low[1, shift:] < high[1, :-shift]) & (low[1, :-shift] < high[1, shift:])
            for i in np.flatnonzero(near).tolist():
                a, b = number[order[i]], number[order[i + shift]]
                if first_meeting(self._sweep(a), self._sweep(b)) is not None:
                    first, second = sorted((self._names[a], self._names[b]))
                    self.contacts.add((first, second))

    def _sweep(self, column: int) -> Sweep:
        """Return how a vehicle moved in the step; one that has just come has not."""
        (end,) = self._states(np.array([column]))
        x, y = self._last[:2, column].tolist()
        start = replace(end, x=x, y=y, heading=float(self._was[column])) if math.isfinite(x) else end
        return Sweep(start, end)
