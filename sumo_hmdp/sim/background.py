"""The background drivers of a world: SUMO's IDM along the road, MOBIL across it, all of them in arrays.

Nothing here imports SUMO: the module that talks to it comes in as an argument.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.domain.maneuver import Mode
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.errors import SimulationError
from sumo_hmdp.sim.contact import overlap_depth
from sumo_hmdp.sim.courtesy import Courtesy
from sumo_hmdp.sim.getters import Getters
from sumo_hmdp.sim.ghost import image_lane, second_lane
from sumo_hmdp.sim.network import Network
from sumo_hmdp.sim.routes import Routes
from sumo_hmdp.traffic.car_following import Drivers
from sumo_hmdp.traffic.courtesy import CourtesyRule
from sumo_hmdp.traffic.mobil import LaneChangeRule, Vehicles, choose_lanes
from sumo_hmdp.traffic.spawn import IdmParameters, Spawn

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# A look for a better lane that is due is not missed for the rounding of a time [s].
_SOON = 1e-6
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
# Beyond the way that it takes to brake comfortably, a lane is given up this far before its end [m].
_GIVE_UP = 10.0
_ORDINARY = IdmParameters()
# Length, politeness, and what the IDM takes.
_TRAIT_COUNT = 2 + len(fields(Drivers))


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


@dataclass(frozen=True)
class BackgroundSettings:
    """What all background drivers have in common.

    Attributes:
        rule: how they choose lanes.
        lane_change_time: from one lane's centre to the next [s].
        interval: least time from one change of a driver to its next [s].
        least_speed: below which nobody begins a change, unless the lane ends [m/s]: in a queue one does not move
            sideways.
        period: time between two looks for a better lane [s], rounded to the simulation step.
        route_time: how long before its lane ends a driver begins to look for the one that its route needs, at its
            desired speed [s]; enough for three changes with their intervals.
        route_bias: what the route adds to the incentive just before the lane ends, growing from 0 [m/s2]; as much as
            a comfortable deceleration.
        courtesy: when they let in who has to leave its lane.
    """

    rule: LaneChangeRule
    lane_change_time: float = 4.0
    interval: float = 4.0
    period: float = 0.4
    least_speed: float = 3.0
    route_time: float = 30.0
    route_bias: float = 2.0
    courtesy: CourtesyRule = field(default_factory=CourtesyRule)


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
        network: Network,
        dt: float,
        spawns: Sequence[Spawn],
    ) -> None:
        """Set up the rows; nobody is on the road yet.

        Args:
            sumo: libsumo or a module with the same functions.
            settings: common to all drivers.
            network: the road.
            dt: simulation step [s].
            spawns: all background vehicles of the run, also those that enter later.
        """
        self._sumo, self._getters, self._settings, self._dt = sumo, Getters(sumo), settings, dt
        self._network, self._road = network, network.road
        self._routes = Routes(network)
        self._exits: list[str | None] = [spawn.exit for spawn in spawns]
        self._spawns = tuple(spawns)
        self._ids = [spawn.id for spawn in spawns]
        self._row = {name: row for row, name in enumerate(self._ids)}
        self._traits = traits_of(spawns)
        self._levers = _LEVER * self._traits[0]
        self._every = max(1, round(settings.period / dt))
        count = len(self._spawns)
        self._now = np.full((3, count), math.nan)
        self._x, self._y, self._speed = self._now
        self._heading = np.zeros(count)
        self._has_course = np.zeros(count, dtype=bool)
        self._just_begun: list[int] = []
        self._last = np.full((3, count), math.nan)
        self._target = np.array([spawn.lane for spawn in spawns], dtype=np.int64)
        self._origin = self._target.copy()
        self._arrives = np.full(count, -math.inf)
        self._waiting = sorted(range(count), key=lambda row: (spawns[row].time, spawns[row].id))
        willing = np.array([spawn.courteous for spawn in spawns], dtype=bool)
        self._courtesy = Courtesy(settings.courtesy, self._routes, willing, settings.rule.least_gap, dt)
        self.active: IntArray = np.empty(0, dtype=np.int64)
        self._names: list[str] = []
        self._on_road: IntArray | None = None
        self.contacts: set[tuple[str, str]] = set()
        self.change_count = 0

    def enter(self, time: float, add: Callable[[Spawn], None], others: Sequence[VehicleState] = ()) -> None:
        """Let in who is due at `time` [s]: all of them at the start, later each as soon as there is room.

        A newcomer enters no faster than its leader, and at a gap of at least what it wants at that speed. It leaves as
        much to one of the `others` behind it; of the background nobody is there.

        Args:
            time: [s].
            add: inserts a vehicle at the end of the coming step.
            others: everybody on the road who is no background vehicle.
        """
        if not self._waiting or self._spawns[self._waiting[0]].time > time + _SOON:
            return
        still_waiting: list[int] = []
        entered: list[int] = []
        full: set[int] = set()
        for place, row in enumerate(self._waiting):
            spawn = self._spawns[row]
            if spawn.time > time + _SOON:
                still_waiting += self._waiting[place:]
                break
            if time <= 0.0 or spawn.entry is not None:
                admitted: Spawn | None = spawn
            else:
                admitted = None if spawn.lane in full else self._admitted(spawn, others)
            if admitted is None:
                full.add(spawn.lane)
                still_waiting.append(row)
            else:
                # One newcomer a lane and step: the next one has to see it first.
                if spawn.entry is None:
                    full.add(spawn.lane)
                add(admitted)
                entered.append(row)
                if admitted.entry is None:
                    self._x[row], self._y[row] = admitted.x, self._road.center_y(admitted.lane)
                    self._speed[row] = admitted.speed
                # A newcomer has to settle in before it looks for another lane.
                self._arrives[row] = time if time > 0.0 else -math.inf
        self._waiting = still_waiting
        if entered:
            self._let_drive(np.concatenate([self.active, np.array(entered, dtype=np.int64)]))

    def _let_drive(self, rows: IntArray) -> None:
        """Note who is on the road from now on."""
        self.active, self._on_road = rows, None
        self._names = [self._ids[row] for row in rows.tolist()]

    def _admitted(self, spawn: Spawn, others: Sequence[VehicleState]) -> Spawn | None:
        """Return the newcomer with the speed at which it may enter, None where there is no room yet."""
        rows = self.on_road()
        here = rows[(self._target[rows] == spawn.lane) | (self._origin[rows] == spawn.lane)]
        strangers = [v for v in others if spawn.lane in {image_lane(v.y, self._road), _other_lane(v, self._road)}]
        rear = spawn.x - spawn.length
        in_lane = [
            *zip(self._x[here].tolist(), self._traits[0, here].tolist(), self._speed[here].tolist(), strict=True),
            *((v.x, v.length, v.speed) for v in strangers),
        ]
        ahead = [one for one in in_lane if one[0] > rear]
        idm, admitted = spawn.idm, spawn
        if ahead:
            # Of two that are level, the one whose rear is nearer leads, as in `find_neighbours`.
            x, length, lead_speed = min(ahead, key=lambda one: one[0] - one[1])
            admitted = replace(spawn, speed=min(spawn.speed, lead_speed))
            if x - length - spawn.x < idm.min_gap + admitted.speed * idm.time_gap:
                return None
        closed_in_on = any(v.x <= rear < v.x + idm.min_gap + v.speed * idm.time_gap for v in strangers)
        return None if closed_in_on else admitted

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
        rows = self.on_road()
        vehicles = self._vehicles(rows, self._arrives[rows] > now + _SOON, others)
        may_change = np.zeros(len(vehicles.x), dtype=bool)
        may_change[: len(rows)] = self._arrives[rows] + self._settings.interval <= now + _SOON
        # SUMO lets nobody begin a change inside a junction.
        may_change &= ~self._network.in_junction(vehicles.x)
        quick = vehicles.speed >= self._settings.least_speed
        allowed = self._network.lane_exists(vehicles.x)
        ends, bias = None, None
        if self._routes.needed:
            ends, bias = self._route_needs(rows, len(others))
            here = ends[np.arange(len(ends)), vehicles.lane - 1][:, None]
            far = ends - vehicles.x[:, None] > self._settings.route_time * vehicles.drivers.desired_speed[:, None]
            allowed &= far | (ends >= here)
            # Whose lane ends has to leave it, even from a standstill.
            quick |= bias.max(axis=1) > 0.0
            self._courtesy.look(rows, vehicles, ends)
        moves = choose_lanes(vehicles, self._settings.rule, allowed, may_change & quick, bias, ends)
        for index in np.flatnonzero(moves).tolist():
            self._begin(int(rows[index]), int(moves[index]), now)

    def make_room(self, others: Sequence[VehicleState]) -> None:
        """Slow down who holds back in the coming step, for somebody who has to leave its lane.

        SUMO's IDM goes on: the lower one of its speed and the commanded one counts.

        Args:
            others: everybody on the road who is no background vehicle.
        """
        rows = self.on_road()

        def seen(others: Sequence[VehicleState]) -> Vehicles:
            return self._vehicles(rows, self._origin[rows] != self._target[rows], others)

        for row, speed in self._courtesy.speeds(rows, self.active, others, seen).items():
            self._sumo.vehicle.setSpeed(self._ids[row], speed)

    def _route_needs(self, rows: IntArray, strangers: int) -> tuple[FloatArray, FloatArray]:
        """Return where lanes end, shape (n, lanes), and the incentive by the route to go left or right, shape (n, 2).

        Who has come too near to the end of its lane gives its exit up, or takes the one that its lane serves.
        """
        ends = np.full((len(rows) + strangers, self._road.lane_count), np.inf)
        bias = np.zeros((len(rows) + strangers, 2))
        exits = [self._exits[row] for row in rows.tolist()]
        for name in dict.fromkeys(exits):
            same = np.array([index for index, other in enumerate(exits) if other == name])
            ends[same] = self._routes.lane_ends(name, self._x[rows[same]])
        lanes = np.arange(self._road.lane_count)
        for index in np.flatnonzero(np.isfinite(ends[: len(rows)]).any(axis=1)).tolist():
            row = int(rows[index])
            own = int(self._target[row]) - 1
            left = ends[index, own] - self._x[row]
            if not math.isfinite(left):
                continue
            speed = self._speed[row]
            if left < speed**2 / (2.0 * self._spawns[row].idm.decel) + _GIVE_UP:
                self._give_up(row, own + 1, float(ends[index, own]))
            better = lanes[ends[index] > ends[index, own]]
            if len(better):
                side = 0 if better[np.abs(better - own).argmin()] < own else 1
                share = 1.0 - left / (self._settings.route_time * self._traits[2, row])
                bias[index, side] = self._settings.route_bias * max(0.0, share)
                bias[index, 1 - side] = -bias[index, side]
        return ends, bias

    def _give_up(self, row: int, lane: int, end: float) -> None:
        """Let a vehicle that cannot reach its lane any more go where the lane that it is in leads to.

        That is along the road if the lane goes on, else by the turn that it serves; it may not stand there for good.
        """
        for way in (None, self._routes.turn_of(end, lane)):
            if way != self._exits[row] and self._routes.lane_ends(way, self._x[[row]])[0, lane - 1] > end:
                number = self._network.place(float(self._x[row]), lane).number
                self._sumo.vehicle.setRoute(self._spawns[row].id, list(self._routes.edges(number, way)))
                self._exits[row] = way
                return

    def _vehicles(self, rows: IntArray, changing: NDArray[np.bool_], others: Sequence[VehicleState]) -> Vehicles:
        """Return the background in some rows, then the others, as drivers see them."""
        strangers = _columns([_stranger_traits(other) for other in others])
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
        self._just_begun.append(row)
        self._sumo.vehicle.changeLane(
            self._spawns[row].id, self._network.lane_index(float(self._x[row]), lane), self._dt
        )

    def read(self, time: float) -> None:
        """Read everybody after a step that ended at `time` [s], and drop who has left.

        Raises:
            SimulationError: SUMO reports a state that is not finite.
        """
        gone = [self._row[name] for name in self._sumo.simulation.getArrivedIDList() if name in self._row]
        if gone:
            self._let_drive(self.active[~np.isin(self.active, gone)])
        rows, names, self._on_road = self.active, self._names, None
        self._last = self._now.copy()
        try:
            places, speeds = self._getters.positions(names), self._getters.speeds(names)
        except self._sumo.TraCIException as error:
            raise SimulationError(f"a background vehicle must stay until the road's end, got: {error}") from error
        self._x[rows], self._y[rows], self._speed[rows] = places[:, 0], places[:, 1], speeds
        self._turn(rows, places)
        # SUMO answers for a vehicle that it has taken off with a large negative number.
        if len(rows) and not (math.isfinite(places.sum()) and speeds.min() >= 0.0):
            wrong = ~np.isfinite(places.sum(axis=1)) | ~(speeds >= 0.0)
            name = names[int(np.flatnonzero(wrong)[0])]
            raise SimulationError(f"the state of {name} must be finite, got x = {places[wrong][0]} (t = {time:g} s).")
        self._settle_changes(rows, time)
        self._note_contacts(self.on_road())

    def _turn(self, rows: IntArray, places: FloatArray) -> None:
        """Turn the bodies: the rear axle follows the front bumper as a trailer follows its hitch (eq. 18)."""
        dx, dy = places[:, 0] - self._last[0].take(rows), places[:, 1] - self._last[1].take(rows)
        distance = np.hypot(dx, dy)
        # Who stands keeps its heading; who has just come has none yet.
        moved = distance > _STANDS
        course = np.arctan2(dy, dx)
        if not moved.all():
            rows, distance, course = rows[moved], distance[moved], course[moved]
        turned = trailing_heading(self._heading.take(rows), course, distance, self._levers.take(rows))
        known = self._has_course.take(rows)
        if not known.all():
            turned = np.where(known, turned, course)
            self._has_course[rows] = True
        self._heading[rows] = turned
        # SUMO lets a change take its time however slow the vehicle is; a body does not turn across the road for it.
        changing = rows[self._origin.take(rows) != self._target.take(rows)]
        if len(changing):
            self._heading[changing] = np.clip(self._heading[changing], -_STEEPEST, _STEEPEST)

    def _settle_changes(self, rows: IntArray, time: float) -> None:
        """Take back the changes that SUMO has not begun, and end those whose time is over.

        SUMO refuses a change that would not be complete before the vehicle turns off.
        """
        if self._just_begun:
            begun = np.array(self._just_begun, dtype=np.int64)
            self._just_begun.clear()
            refused = begun[np.abs(self._y[begun] - self._last[1, begun]) < _STANDS]
            self._target[refused], self._arrives[refused] = self._origin[refused], time
            self.change_count += len(begun) - len(refused)
        arrived = self._arrives[rows] <= time + _SOON
        self._origin[rows[arrived]] = self._target[rows[arrived]]

    def on_road(self) -> IntArray:
        """Return the rows of those who drive along the road, in a lane of it; others are on ramps or cross it."""
        if self._on_road is None:
            self._on_road = self._find_on_road()
        return self._on_road

    def _find_on_road(self) -> IntArray:
        rows = self.active
        x, y, heading = self._x.take(rows), self._y.take(rows), self._heading.take(rows)
        lane = (self._road.lane_count + 1) / 2 - y / self._road.lane_width + 0.5
        # Who comes by a ramp is nowhere, with an x that is not a number, before it has been read once.
        inside = (lane >= 1.0) & (lane < self._road.lane_count + 1) & (np.abs(heading) <= _CROSSING) & np.isfinite(x)
        if not inside.all():
            rows, x, lane = rows[inside], x[inside], lane[inside]
        exists = self._network.lane_exists(x)[np.arange(len(rows)), lane.astype(np.int64) - 1]
        return rows if exists.all() else rows[exists]

    def states(self, x: float, reach: float) -> list[VehicleState]:
        """Return who drives along the road within `reach` of `x` [m], in the lane of its front centre, at cruise."""
        rows = self.on_road()
        return self._states(rows[np.abs(self._x[rows] - x) <= reach])

    def crossing(self, x: float, reach: float) -> list[VehicleState]:
        """Return who is on or beside the road within `reach` of `x` [m] and does not drive along it."""
        rows = self.active[~np.isin(self.active, self.on_road())]
        beside = 0.5 * self._road.lane_count * self._road.lane_width + _BESIDE
        near = (np.abs(self._x[rows] - x) <= reach) & (np.abs(self._y[rows]) <= beside)
        return self._states(rows[near])

    def spawns(self) -> tuple[Spawn, ...]:
        """Return everybody on the road as it would enter at time 0, then who still waits, with its time.

        Whoever is inside a junction is left out, since SUMO lets nobody enter there.

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
                entry=None,
                exit=self._exits[row],
            )
            for row in self.on_road().tolist()
            if not self._network.in_junction(self._x[row])
        ]
        return (*present, *(self._spawns[row] for row in self._waiting))

    def _states(self, rows: IntArray) -> list[VehicleState]:
        """Return the vehicles of some rows; who has just come has neither accelerated nor moved sideways yet."""
        if not len(rows):
            return []
        x, y, speed = self._x[rows], self._y[rows], self._speed[rows]
        accel, lateral_speed = (speed - self._last[2, rows]) / self._dt, (y - self._last[1, rows]) / self._dt
        new = np.isnan(lateral_speed)
        if new.any():
            accel[new], lateral_speed[new] = 0.0, 0.0
        columns = (x, y, speed, _lanes_at(self._road, y), accel, self._heading[rows], lateral_speed)
        spawns, cruise = self._spawns, Mode.CRUISE
        # Positional: twice as fast, and done for everybody in sight at every step.
        return [
            VehicleState(spawn.id, x, y, speed, lane, cruise, accel, heading, spawn.length, spawn.width, lateral_speed)
            for spawn, x, y, speed, lane, accel, heading, lateral_speed in zip(
                [spawns[row] for row in rows.tolist()], *(column.tolist() for column in columns), strict=True
            )
        ]

    def _note_contacts(self, rows: IntArray) -> None:
        """Note background vehicles that overlap: next to each other in a lane, or in either lane of a change."""
        target, origin = self._target.take(rows), self._origin.take(rows)
        two = np.flatnonzero(origin != target)
        row = np.concatenate([rows, rows.take(two)])
        lane = np.concatenate([target, origin.take(two)])
        x = self._x.take(row)
        order = np.lexsort((x, lane))
        row, lane, x = row.take(order), lane.take(order), x.take(order)
        behind, ahead = row[:-1], row[1:]
        near = (lane[:-1] == lane[1:]) & (x[1:] - self._traits[0].take(ahead) < x[:-1])
        for i, j in zip(behind[near].tolist(), ahead[near].tolist(), strict=True):
            if i != j and overlap_depth(*self._states(np.array([i, j]))) > 0.0:
                first, second = sorted((self._spawns[i].id, self._spawns[j].id))
                self.contacts.add((first, second))


def _other_lane(vehicle: VehicleState, road: Road) -> int:
    """Return the second lane that others see a vehicle in or about to enter, 0 where there is none."""
    own = image_lane(vehicle.y, road)
    if vehicle.lane != own:
        return vehicle.lane
    return second_lane(vehicle, road) or 0


def _lanes_at(road: Road, y: FloatArray) -> IntArray:
    """Return `road.lane_at` of many y [m]."""
    lanes = np.rint((road.lane_count + 1) / 2 - y / road.lane_width).astype(np.int64)
    return np.minimum(np.maximum(lanes, 1), road.lane_count)


def _lanes(lanes: Iterable[int]) -> IntArray:
    return np.fromiter(lanes, dtype=np.int64)


def traits_of(spawns: Sequence[Spawn]) -> FloatArray:
    """Return length, politeness and the IDM's parameters in the order of `Drivers`, one column a vehicle."""
    return _columns(
        [
            _traits(
                spawn.length,
                spawn.politeness,
                spawn.speed if spawn.desired_speed is None else spawn.desired_speed,
                spawn.idm,
            )
            for spawn in spawns
        ]
    )


def _traits(length: float, politeness: float, desired_speed: float, idm: IdmParameters) -> tuple[float, ...]:
    return length, politeness, desired_speed, idm.min_gap, idm.time_gap, idm.accel, idm.decel, idm.exponent


def _stranger_traits(vehicle: VehicleState) -> tuple[float, ...]:
    """Return what background drivers take another vehicle to be: a driver like themselves who keeps its speed."""
    return _traits(vehicle.length, Spawn.politeness, max(vehicle.speed, 1.0), _ORDINARY)


def _columns(rows: list[tuple[float, ...]]) -> FloatArray:
    """Return the traits of vehicles, one column a vehicle, also of none."""
    return np.array(rows, dtype=np.float64).reshape(-1, _TRAIT_COUNT).T
