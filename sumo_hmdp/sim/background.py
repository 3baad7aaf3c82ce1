"""The background drivers of a world: SUMO's IDM along the road, MOBIL across it, all of them in arrays.

Nothing here imports SUMO: the module that talks to it comes in as an argument.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.errors import SimulationError
from sumo_hmdp.sim.bodies import SOON, Bodies, Columns
from sumo_hmdp.sim.courtesy import Courtesy
from sumo_hmdp.sim.ghost import image_lane, second_lane
from sumo_hmdp.sim.limits import SpeedLimits, keep_lines
from sumo_hmdp.sim.network import Network
from sumo_hmdp.sim.routes import Routes
from sumo_hmdp.sim.traits import stranger_traits
from sumo_hmdp.traffic.car_following import Drivers
from sumo_hmdp.traffic.courtesy import CourtesyRule
from sumo_hmdp.traffic.mobil import LaneChangeRule, Vehicles, choose_lanes
from sumo_hmdp.traffic.spawn import Spawn

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Beyond the way that it takes to brake comfortably, a lane is given up this far before its end [m].
_GIVE_UP = 10.0


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
    """All background drivers of one world, as it commands them; a row is a driver's number among the spawns.

    Attributes:
        bodies: those on the road.
    """

    def __init__(
        self,
        sumo: Any,  # noqa: ANN401 - libsumo, or TraCI, which has the same functions
        settings: BackgroundSettings,
        network: Network,
        dt: float,
        spawns: Sequence[Spawn],
    ) -> None:
        """Set up; nobody is on the road yet.

        Args:
            sumo: libsumo or a module with the same functions.
            settings: common to all drivers.
            network: the road.
            dt: simulation step [s].
            spawns: all background vehicles of the run, also those that enter later.
        """
        self._sumo, self._settings, self._dt = sumo, settings, dt
        self._network, self._road = network, network.road
        self._routes = Routes(network)
        self._exits: list[str | None] = [spawn.exit for spawn in spawns]
        self._spawns = tuple(spawns)
        self._every = max(1, round(settings.period / dt))
        self._waiting = sorted(range(len(spawns)), key=lambda row: (spawns[row].time, spawns[row].id))
        willing = np.array([spawn.courteous for spawn in spawns], dtype=bool)
        self._courtesy = Courtesy(settings.courtesy, self._routes, willing, settings.rule.least_gap, dt)
        self.bodies = Bodies(sumo, network, dt, spawns)
        self._limits = SpeedLimits.of(network, spawns)

    def enter(self, time: float, add: Callable[[Spawn], None], others: Sequence[VehicleState] = ()) -> None:
        """Let in who is due at `time` [s]: all of them at the start, later each as soon as there is room.

        A newcomer enters no faster than its leader, and at a gap of at least what it wants at that speed. It leaves as
        much to one of the `others` behind it; of the background nobody is there.

        Args:
            time: [s].
            add: inserts a vehicle at the end of the coming step.
            others: everybody on the road who is no background vehicle.
        """
        if not self._waiting or self._spawns[self._waiting[0]].time > time + SOON:
            return
        still_waiting: list[int] = []
        entered: dict[int, Spawn] = {}
        full: set[int] = set()
        for place, row in enumerate(self._waiting):
            spawn = self._spawns[row]
            if spawn.time > time + SOON:
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
                entered[row] = admitted
        self._waiting = still_waiting
        if entered:
            # A newcomer has to settle in before it looks for another lane.
            self.bodies.enter(list(entered), list(entered.values()), time if time > 0.0 else -math.inf)

    def _admitted(self, spawn: Spawn, others: Sequence[VehicleState]) -> Spawn | None:
        """Return the newcomer with the speed at which it may enter, None where there is no room yet."""
        bodies, some = self.bodies, self.bodies.on_road()
        here = bodies.columns(some)[(bodies.lane[some] == spawn.lane) | (bodies.origin[some] == spawn.lane)]
        strangers = [v for v in others if spawn.lane in {image_lane(v.y, self._road), _other_lane(v, self._road)}]
        rear = spawn.x - spawn.length
        x, _, speeds = bodies.now[:, here].tolist()
        in_lane = [
            *zip(x, bodies.traits[0, here].tolist(), speeds, strict=True),
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
        bodies = self.bodies
        if step % self._every or not len(bodies.rows):
            return
        now, some = (step - 1) * self._dt, bodies.on_road()
        rows, arrives = bodies.rows[some], bodies.arrives[some]
        vehicles = self._vehicles(some, arrives > now + SOON, others)
        may_change = np.zeros(len(vehicles.x), dtype=bool)
        may_change[: len(rows)] = arrives + self._settings.interval <= now + SOON
        # SUMO lets nobody begin a change inside a junction.
        may_change &= ~self._network.in_junction(vehicles.x)
        quick = vehicles.speed >= self._settings.least_speed
        allowed = self._network.lane_exists(vehicles.x)
        keep_lines(self._network, vehicles, allowed, self._settings.lane_change_time)
        ends, bias = None, None
        if self._routes.needed:
            ends, bias = self._route_needs(rows, vehicles)
            here = ends[np.arange(len(ends)), vehicles.lane - 1][:, None]
            far = ends - vehicles.x[:, None] > self._settings.route_time * vehicles.drivers.desired_speed[:, None]
            allowed &= far | (ends >= here)
            # Whose lane ends has to leave it, even from a standstill.
            quick |= bias.max(axis=1) > 0.0
            self._courtesy.look(rows, vehicles, ends)
        moves = choose_lanes(vehicles, self._settings.rule, allowed, may_change & quick, bias, ends)
        movers = np.flatnonzero(moves)
        for column, move in zip(bodies.columns(some)[movers].tolist(), moves[movers].tolist(), strict=True):
            self._begin(column, move, now)

    def make_room(self, others: Sequence[VehicleState]) -> None:
        """Slow down who holds back in the coming step, for somebody who has to leave its lane.

        SUMO's IDM goes on: the lower one of its speed and the commanded one counts.

        Args:
            others: everybody on the road who is no background vehicle.
        """
        bodies, some = self.bodies, self.bodies.on_road()

        def seen(others: Sequence[VehicleState]) -> Vehicles:
            return self._vehicles(some, bodies.origin[some] != bodies.lane[some], others)

        for row, speed in self._courtesy.speeds(bodies.rows[some], bodies.rows, others, seen).items():
            self._sumo.vehicle.setSpeed(self._spawns[row].id, speed)

    def _route_needs(self, rows: IntArray, vehicles: Vehicles) -> tuple[FloatArray, FloatArray]:
        """Return where lanes end, shape (n, lanes), and the incentive by the route to go left or right, shape (n, 2).

        Who has come too near to the end of its lane gives its exit up, or takes the one that its lane serves.
        """
        x, speeds, desired_speeds = vehicles.x, vehicles.speed, vehicles.drivers.desired_speed
        ends = np.full((len(x), self._road.lane_count), np.inf)
        bias = np.zeros((len(x), 2))
        exits = [self._exits[row] for row in rows.tolist()]
        for name in dict.fromkeys(exits):
            same = np.array([index for index, other in enumerate(exits) if other == name])
            ends[same] = self._routes.lane_ends(name, x[same])
        lanes = np.arange(self._road.lane_count)
        for index in np.flatnonzero(np.isfinite(ends[: len(rows)]).any(axis=1)).tolist():
            row = int(rows[index])
            own = int(vehicles.lane[index]) - 1
            left = ends[index, own] - x[index]
            if not math.isfinite(left):
                continue
            if left < speeds[index] ** 2 / (2.0 * self._spawns[row].idm.decel) + _GIVE_UP:
                self._give_up(row, float(x[index]), own + 1, float(ends[index, own]))
            better = lanes[ends[index] > ends[index, own]]
            if len(better):
                side = 0 if better[np.abs(better - own).argmin()] < own else 1
                share = 1.0 - left / (self._settings.route_time * desired_speeds[index])
                bias[index, side] = self._settings.route_bias * max(0.0, share)
                bias[index, 1 - side] = -bias[index, side]
        return ends, bias

    def _give_up(self, row: int, x: float, lane: int, end: float) -> None:
        """Let a vehicle that cannot reach its lane any more go where the lane that it is in leads to.

        That is along the road if the lane goes on, else by the turn that it serves; it may not stand there for good.
        """
        for way in (None, self._routes.turn_of(end, lane)):
            if way != self._exits[row] and self._routes.lane_ends(way, np.array([x]))[0, lane - 1] > end:
                number = self._network.place(x, lane).number
                self._sumo.vehicle.setRoute(self._spawns[row].id, list(self._routes.edges(number, way)))
                self._exits[row] = way
                return

    def _vehicles(self, some: Columns, changing: NDArray[np.bool_], others: Sequence[VehicleState]) -> Vehicles:
        """Return some of the background, then the others, as drivers see them."""
        bodies = self.bodies
        x, _, speed = bodies.now[:, some]
        traits = self._limits.applied(bodies.rows[some], x, bodies.traits[:, some])
        both = np.concatenate([traits, stranger_traits(others)], axis=1)
        second = np.where(changing, bodies.origin[some], 0)
        return Vehicles(
            x=np.concatenate([x, [other.x for other in others]]),
            speed=np.concatenate([speed, [other.speed for other in others]]),
            lane=np.concatenate([bodies.lane[some], _lanes(image_lane(v.y, self._road) for v in others)]),
            second_lane=np.concatenate([second, _lanes(_other_lane(v, self._road) for v in others)]),
            length=both[0],
            politeness=both[1],
            drivers=Drivers(*both[2:]),
        )

    def _begin(self, column: int, move: int, now: float) -> None:
        bodies = self.bodies
        lane = int(bodies.lane[column]) + move
        index = self._network.lane_index(float(bodies.now[0, column]), lane)
        bodies.begin_change(column, lane, now + self._settings.lane_change_time)
        self._sumo.vehicle.changeLane(self._spawns[bodies.rows[column]].id, index, self._dt)

    def spawns(self) -> tuple[Spawn, ...]:
        """Return everybody on the road as it would enter at time 0, then who still waits, with its time.

        Whoever is inside a junction is left out, since SUMO lets nobody enter there.

        Raises:
            SimulationError: somebody is between two lanes.
        """
        bodies, some = self.bodies, self.bodies.on_road()
        if (bodies.origin != bodies.lane).any():
            raise SimulationError("everybody must be in a lane. Let no change begin shortly before.")
        (x, _, speed), lane = bodies.now[:, some].tolist(), bodies.lane[some].tolist()
        present = [
            replace(self._spawns[row], lane=lane, x=x, speed=speed, time=0.0, entry=None, exit=self._exits[row])
            for row, lane, x, speed in zip(bodies.rows[some].tolist(), lane, x, speed, strict=True)
            if not self._network.in_junction(x)
        ]
        return (*present, *(self._spawns[row] for row in self._waiting))


def _other_lane(vehicle: VehicleState, road: Road) -> int:
    """Return the second lane that others see a vehicle in or about to enter, 0 where there is none."""
    own = image_lane(vehicle.y, road)
    if vehicle.lane != own:
        return vehicle.lane
    return second_lane(vehicle, road) or 0


def _lanes(lanes: Iterable[int]) -> IntArray:
    return np.fromiter(lanes, dtype=np.int64)
