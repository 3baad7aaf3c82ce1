"""The traffic simulation: one road with the ego and everybody else on it.

Time 0 of a run is SUMO's first step, which only inserts. From there `advance` carries the world on:
at the end of a step the ego stands exactly where it was told to, and SUMO has moved the rest. Where SUMO
drives the ego, it is not told where to, and `ego` says where it is.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from types import TracebackType
from typing import NoReturn, Self

from sumo_hmdp.decision.sumo_driver import SumoDriver
from sumo_hmdp.domain.road_rules import RoadRules
from sumo_hmdp.domain.scene import EGO_ID, StopLine, VehicleState
from sumo_hmdp.errors import InputError, Problem, SimulationError
from sumo_hmdp.sim import sumo, window
from sumo_hmdp.sim import world_checks as checks
from sumo_hmdp.sim.background import Background
from sumo_hmdp.sim.ghost import ghost_of, image_lane, second_lane
from sumo_hmdp.sim.lane_order import restore_order
from sumo_hmdp.sim.network import read_network
from sumo_hmdp.sim.network_rules import rules_in_force
from sumo_hmdp.sim.routes import Routes
from sumo_hmdp.sim.signals import Breaches, breaches, closed_lines
from sumo_hmdp.sim.sumo import libsumo
from sumo_hmdp.traffic.spawn import GHOST_PREFIX, DriverKind, Spawn

# Nobody who crosses the road farther away can touch the ego in a step [m].
_CROSSING_SIGHT = 50.0
_OWN_LANE_CHANGES = 1621  # lane-change mode: SUMO's default, in which it changes lanes by its own model


class LibsumoWorld:
    """One simulated road, as a context manager; a process can have one open at a time.

    Attributes:
        settings: as given.
        step: steps taken since the start.
    """

    def __init__(self, settings: checks.WorldSettings, ego: VehicleState, others: tuple[Spawn, ...]) -> None:
        """Read the network and check everything that can be checked without SUMO.

        Args:
            settings: network, road, step and seed.
            ego: where the ego starts; its id is `ego`.
            others: every surrounding vehicle of the run, also those that enter later.

        Raises:
            InputError: with every mistake in the arguments.
        """
        _refuse(checks.world_problems(settings, ego, others))
        self._network = read_network(settings.net_file, settings.road)
        _refuse(checks.start_problems(self._network, ego, others, settings.dt))
        self.settings = settings
        self.step = 0
        self._ego = ego
        listed, self._crowd = split(others)
        self._spawns = {spawn.id: spawn for spawn in listed}
        self._waiting = sorted(listed, key=lambda spawn: (checks.entry_step(spawn, settings.dt), spawn.id))
        self._background: Background | None = None
        self._routes = Routes(self._network)
        self._breaches = Breaches()
        self._ghosts: dict[str, int] = {}
        self._on_road: tuple[VehicleState, ...] = ()
        self._colliding: frozenset[tuple[str, str]] = frozenset()
        self._contacts: set[tuple[str, str]] = set()
        self._resources: ExitStack | None = None
        self._rules = rules_in_force(self._network, settings.speed_limit)
        self._too_fast: dict[str, float] = {}

    @property
    def rules(self) -> RoadRules:
        """What the road forbids to everybody, the ego too."""
        return self._rules

    @property
    def time(self) -> float:
        """Time since the start [s]."""
        return self.step * self.settings.dt

    @property
    def x_end(self) -> float:
        """Where the road ends [m]."""
        return self._network.x_end

    def __enter__(self) -> Self:
        """Start SUMO with everybody exactly where they start.

        Raises:
            SimulationError: SUMO does not start, or another world is open in this process.
        """
        with ExitStack() as stack:
            everybody = (*self._spawns.values(), *self._crowd)
            stack.enter_context(sumo.simulation(self.settings, self._network, self._ego, everybody))
            self._start()
            self._resources = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End SUMO, also after an error; one of SUMO's own leaves in this package's words."""
        if self._resources is not None:
            resources, self._resources = self._resources, None
            resources.__exit__(kind, error, trace)

    def observe(self) -> tuple[VehicleState, ...]:
        """Return the surrounding vehicles that are on the road, ordered by id; of the background those in sight.

        The lane is the one that SUMO has them in and the mode is left at cruise: intentions cannot be seen.
        A vehicle that has reached the end of the road is no longer listed.

        Raises:
            SimulationError: the world is not open.
        """
        self._require_open()
        if self._background is None:
            return self._on_road
        near = self._background.bodies.states(self._ego.x, self.settings.sight)
        return tuple(sorted((*self._on_road, *near), key=_name))

    def ego(self) -> VehicleState:
        """Return the ego: as SUMO has driven it, in the lane that SUMO has it in, or as it was last commanded.

        Raises:
            SimulationError: the world is not open.
        """
        self._require_open()
        return self._ego

    def advance(
        self, ego: VehicleState | None, speeds: Mapping[str, float], poses: Iterable[VehicleState] = ()
    ) -> None:
        """Carry the world on by one step, at whose end the ego and the posed vehicles are as commanded.

        A scripted vehicle moves by its new speed, x+ = x + v+ dt. IDM vehicles react to the state before.

        Args:
            ego: pose and speed at the end of the step, None where SUMO drives it.
            speeds: [m/s] of every scripted vehicle that `observe` lists.
            poses: pose and speed at the end of the step of every posed vehicle that `observe` lists.

        Raises:
            InputError: a speed or pose is missing, unexpected or not finite.
            SimulationError: the ego leaves the road or vanishes, or the world is not open.
        """
        self._require_open()
        moved = (*poses,) if ego is None else (ego, *poses)
        driven = self.settings.ego_driver is not None
        kinds = {vehicle.id: self._spawns[vehicle.id].driver for vehicle in self._on_road}
        _refuse(checks.command_problems(moved, speeds, kinds, sumo_drives_ego=driven))
        if len(moved) > (ego is not None) and (driven or self._background is not None):
            # Somebody looks along the lanes for a leader.
            names = {vehicle.id for vehicle in moved}
            restore_order(libsumo, self._network.lane_of, names | {GHOST_PREFIX + name for name in self._ghosts})
        for vehicle in moved:
            if not self._network.holds(vehicle.x, vehicle.y):
                if vehicle.id == EGO_ID:
                    self._lose_ego(vehicle, "It was sent off the road.")
                libsumo.vehicle.remove(vehicle.id)
                self._drop_ghost(vehicle.id)
            else:
                self._place(vehicle)
        for vehicle_id, speed in speeds.items():
            libsumo.vehicle.setSpeed(vehicle_id, float(speed))
        self.step += 1
        self._insert_due(ego or self._ego)
        if self._background is not None:
            lane = (ego or self._ego).lane
            seen = self._ego if self._ego.lane == lane else replace(self._ego, lane=lane)
            others = (seen, *self._on_road)
            self._background.change_lanes(self.step, others)
            self._background.make_room(others)
        self._slow_down()
        lights = sumo.lights(self._network)
        sumo.step(self.time)
        for vehicle in moved:
            if vehicle.id in self._ghosts and second_lane(vehicle, self.settings.road) is None:
                self._drop_ghost(vehicle.id)
        before, self._ego = self._ego, self._checked_ego(ego)
        if lights:
            lane = image_lane(self._ego.y, self.settings.road)
            self._breaches = breaches(self._routes, lights, before, self._ego, lane)
        self._note_contacts()
        self._on_road = self._read()

    def crossing(self) -> tuple[VehicleState, ...]:
        """Return background vehicles near the ego that do not drive along the road: on ramps, or across a junction.

        Raises:
            SimulationError: the world is not open.
        """
        self._require_open()
        if self._background is None or not self._routes.crossed:
            return ()
        return tuple(sorted(self._background.bodies.crossing(self._ego.x, _CROSSING_SIGHT), key=_name))

    def stop_lines(self, others: Iterable[VehicleState], told: Sequence[StopLine] = ()) -> tuple[StopLine, ...]:
        """Return the stop lines that are closed to the ego now.

        Args:
            others: who drives along the road, as from `observe`.
            told: the lines that were closed when the ego last decided.

        Raises:
            SimulationError: the world is not open.
        """
        self._require_open()
        if not self._routes.lines:
            return ()
        return closed_lines(self._routes, sumo.lights(self._network), self._ego, others, told)

    def breaches(self) -> Breaches:
        """Return the rules that the ego broke in the last step.

        Raises:
            SimulationError: the world is not open.
        """
        self._require_open()
        return self._breaches

    def background_contacts(self) -> tuple[tuple[str, str], ...]:
        """Return the pairs of background vehicles that have overlapped so far, sorted.

        Raises:
            SimulationError: the world is not open.
        """
        self._require_open()
        return () if self._background is None else tuple(sorted(self._background.bodies.contacts))

    def sumo_contacts(self) -> tuple[tuple[str, str], ...]:
        """Return SUMO's own (collider, victim) pairs with the ego that are new since the last call, sorted.

        SUMO looks along one lane only and sees the positions before the ego is moved: a cross-check only, and none
        where there is background traffic.

        Raises:
            SimulationError: the world is not open.
        """
        self._require_open()
        pairs, self._contacts = tuple(sorted(self._contacts)), set()
        return pairs

    def _start(self) -> None:
        settings, start, driver = self.settings, self._ego, self.settings.ego_driver
        kind = DriverKind.POSED if driver is None else DriverKind.IDM
        if driver is not None and driver.forbidden_lanes:
            sumo.give_rights(self._network)
        self._add(start, EGO_ID, image_lane(start.y, settings.road), kind)
        if driver is None:
            self._place(start)
        else:
            self._too_fast[EGO_ID] = driver.decel
        if settings.background is not None:
            self._background = Background(libsumo, settings.background, self._network, settings.dt, self._crowd)
        self._insert_due(start)
        sumo.step(self.time)
        self._checked_ego(start)
        if sumo.IN_WINDOW:
            window.follow_ego(libsumo)
        if driver is not None:
            self._let_change_lanes(driver)
        self._on_road = self._read()
        self._note_contacts()
        self._slow_down()

    def _let_change_lanes(self, driver: SumoDriver) -> None:
        """Leave the ego's lane changes to SUMO; it can also be kept out of a lane in which it starts, and leaves it."""
        libsumo.vehicle.setLaneChangeMode(EGO_ID, _OWN_LANE_CHANGES)
        if driver.forbidden_lanes:
            sumo.keep_out(self._network, driver.forbidden_lanes)

    def _slow_down(self) -> None:
        """Let those whom SUMO drives, and who have started too fast, come down to what they want and may drive.

        SUMO would brake them as in an emergency. From then on SUMO keeps them to the limits of their lanes.
        """
        for vehicle in (self._ego, *self._on_road) if self._too_fast else ():
            decel = self._too_fast.get(vehicle.id)
            if decel is None:
                continue
            wanted = self._wanted_speed(vehicle.id)
            limit = self._rules.speed_limit(self.settings.road.lane_at(vehicle.y), vehicle.x)
            allowed = min(wanted, limit)
            if vehicle.speed > allowed:
                libsumo.vehicle.setMaxSpeed(vehicle.id, max(allowed, vehicle.speed - decel * self.settings.dt))
                continue
            if vehicle.speed > wanted or limit < wanted:
                libsumo.vehicle.setMaxSpeed(vehicle.id, wanted)
            sumo.obey_limits(vehicle.id)
            del self._too_fast[vehicle.id]

    def _wanted_speed(self, name: str) -> float:
        driver = self.settings.ego_driver
        if name == EGO_ID and driver is not None:
            return driver.desired_speed
        spawn = self._spawns[name]
        return spawn.speed if spawn.desired_speed is None else spawn.desired_speed

    def _insert_due(self, ego: VehicleState) -> None:
        """Let the vehicles in whose time has come; after the start, each as soon as its place is free."""
        crowd = () if self._background is None or not self._waiting else self._background.bodies.states(ego.x, math.inf)
        present = (ego, *self._on_road, *crowd)
        due, self._waiting = checks.entering(self._waiting, present, self.step, self.settings)
        for spawn in due:
            self._add(spawn, spawn.id, spawn.lane, spawn.driver)
            if spawn.driver == DriverKind.IDM:
                self._too_fast[spawn.id] = spawn.idm.decel
        if self._background is not None:
            others = (ego, *self._on_road)
            self._background.enter(self.time, lambda s: self._add(s, s.id, s.lane, s.driver), others)

    def _add(self, vehicle: VehicleState | Spawn, name: str, lane: int, kind: DriverKind) -> None:
        """Ask SUMO to insert a vehicle, or a ghost under another name, at the end of the coming step."""
        sumo.insert(self._routes, vehicle, name, lane, kind)

    def _place(self, vehicle: VehicleState) -> None:
        """Command the vehicle and, where its body reaches into a second lane, its ghost there.

        When the front centre crosses the line, SUMO's image of it and the ghost swap lanes in one step.
        """
        y, heading = vehicle.y, vehicle.heading
        if self.settings.lane_change_time is not None:
            # SUMO then lets changes take their time, and would never free the lane that a moved vehicle has left.
            road = self.settings.road
            y, heading = road.center_y(image_lane(vehicle.y, road)), 0.0
        sumo.move(vehicle.id, vehicle.x, y, heading, vehicle.speed)
        ghost = ghost_of(vehicle, self.settings.road, self._ghosts.get(vehicle.id))
        if ghost is not None and not self._network.lane_exists(ghost.x)[ghost.lane - 1]:
            # Nobody follows there, and SUMO lets no car in.
            self._drop_ghost(vehicle.id)
        elif ghost is not None:
            name = GHOST_PREFIX + vehicle.id
            if vehicle.id not in self._ghosts:
                self._add(ghost, name, ghost.lane, DriverKind.POSED)
            sumo.move(name, ghost.x, ghost.y, ghost.heading, ghost.speed)
            self._ghosts[vehicle.id] = ghost.lane

    def _drop_ghost(self, vehicle_id: str) -> None:
        if self._ghosts.pop(vehicle_id, None) is not None:
            libsumo.vehicle.remove(GHOST_PREFIX + vehicle_id)

    def _read(self) -> tuple[VehicleState, ...]:
        if self._background is not None:
            self._background.bodies.read(self.time)
        names = sorted(name for name in libsumo.vehicle.getIDList() if name in self._spawns) if self._spawns else []
        return tuple(sumo.read_vehicle(self._spawns[name], self.settings.road) for name in names)

    def _note_contacts(self) -> None:
        # SUMO keeps listing a pair long after it has separated, so only new pairs count.
        pairs = frozenset((c.collider, c.victim) for c in libsumo.simulation.getCollisions())
        for pair in pairs - self._colliding:
            if EGO_ID in pair and not any(name.startswith(GHOST_PREFIX) for name in pair):
                self._contacts.add(pair)
        self._colliding = pairs

    def _checked_ego(self, ego: VehicleState | None) -> VehicleState:
        """Return the ego as SUMO has it, and raise where it was sent somewhere else."""
        try:
            # It has no lane where it is known but not on the road.
            gone = libsumo.vehicle.getLaneIndex(EGO_ID) < 0
        except libsumo.TraCIException:
            gone = True
        if gone:
            self._lose_ego(ego or self._ego, "SUMO took it off the road.")
        if ego is None:
            now = sumo.read_vehicle(self._ego, self.settings.road)
            return replace(now, lateral_speed=(now.y - self._ego.y) / self.settings.dt)
        x, y = libsumo.vehicle.getPosition(EGO_ID)
        road = self.settings.road
        wanted_y = ego.y if self.settings.lane_change_time is None else road.center_y(image_lane(ego.y, road))
        if not math.hypot(x - ego.x, y - wanted_y) < 1e-6:
            self._lose_ego(ego, f"SUMO has it at x = {x} m, y = {y} m.")
        return ego

    def _lose_ego(self, ego: VehicleState, reason: str) -> NoReturn:
        low, high = self._network.x_begin, self._network.x_end
        if ego.x + ego.speed * self.settings.dt >= high:
            raise SimulationError(
                f"the ego must not reach the road's end at {high:g} m before its run ends, got there after "
                f"{self.time:g} s. Set ego.goal_x_m below it, so that the run ends there, or shorten duration_s."
            )
        raise SimulationError(
            f"the ego must stay on the road, x from {low} to {high} m, got x = {ego.x} m, y = {ego.y} m "
            f"(t = {self.time} s). {reason}"
        )

    def _require_open(self) -> None:
        if self._resources is None:
            raise SimulationError("the world must be open. Use it in a `with` statement.")


def _refuse(problems: list[Problem]) -> None:
    if problems:
        raise InputError(problems)


def _name(vehicle: VehicleState) -> str:
    return vehicle.id


def split(spawns: Iterable[Spawn]) -> tuple[list[Spawn], list[Spawn]]:
    """Return the vehicles that somebody described one by one, and the background."""
    listed: list[Spawn] = []
    crowd: list[Spawn] = []
    for spawn in spawns:
        (crowd if spawn.driver == DriverKind.BACKGROUND else listed).append(spawn)
    return listed, crowd
