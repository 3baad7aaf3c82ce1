"""The closed loop: observe, decide when due, track, apply, advance, record."""

import hashlib
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from sumo_hmdp.decision.contract import require_decision, steps_per_decision
from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.domain.plan import Command, Decision, Observer, Planner, Status
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import Scene, StopLine, VehicleState
from sumo_hmdp.errors import SimulationError
from sumo_hmdp.sim.contact import Contact, Snapshot, contacts, contacts_between
from sumo_hmdp.sim.measurement import Measurement
from sumo_hmdp.sim.motion import Motion, MotionKind, motion_of
from sumo_hmdp.sim.signals import Breaches
from sumo_hmdp.sim.world import World
from sumo_hmdp.traffic.matched import MatchedPath
from sumo_hmdp.vehicle.bicycle import BicycleParameters
from sumo_hmdp.vehicle.tracking import TrackingInfo

# Time, x, y, heading, speed and acceleration of a vehicle, its lane and its mode.
_NUMBERS = struct.Struct("<6d2q")


class Driver(Protocol):
    """Who decides the acceleration of a scripted vehicle."""

    def initial_memory(self) -> Any:  # noqa: ANN401 - each driver's own
        """Return the memory before the first step."""
        ...

    def accelerate(
        self,
        scene: Scene,
        vehicle: VehicleState,
        memory: Any,  # noqa: ANN401 - each driver's own
        dt: float,
    ) -> tuple[float, Mode, Any]:
        """Return acceleration [m/s2], the mode that it stands for, and the new memory."""
        ...


@dataclass(frozen=True)
class EpisodeSettings:
    """What a run is, besides world and planner.

    Attributes:
        road: lanes.
        dt: control and simulation step T_l [s].
        duration: [s], a multiple of dt.
        ego: where the ego starts.
        bicycle: its body and limits.
        lane_change_time: of the ego's quintic [s].
        drivers: of the scripted vehicles, by id.
        motion: how the ego carries out its commands, or that SUMO drives it.
        paths: of the vehicles drawn from the model, by id.
        measurement: how the planner measures the others.
        goal_x: where the run ends before its time [m], None for nowhere.
    """

    road: Road
    dt: float
    duration: float
    ego: VehicleState
    bicycle: BicycleParameters
    lane_change_time: float
    drivers: Mapping[str, Driver]
    motion: MotionKind = MotionKind.BICYCLE
    paths: Mapping[str, MatchedPath] = field(default_factory=dict)
    measurement: Measurement = field(default_factory=Measurement)
    goal_x: float | None = None

    @property
    def steps(self) -> int:
        """Number of simulation steps."""
        return round(self.duration / self.dt)


@dataclass(frozen=True)
class Moment:
    """One recorded instant.

    Attributes:
        step: 0 at the start.
        scene: everybody, as seen before a decision changed what the ego intends.
        decision: the decision taken at this instant, None between decisions.
        contacts: of the ego since the instant before.
        sumo_contacts: what SUMO reported of the ego since the instant before.
        tracking: how the tracking QP of the step went, None at the last instant and for a motion without one.
        breaches: rules that the ego broke in the step before.
        background_contacts: pairs of background vehicles that have overlapped so far.
        goal_reached: whether the ego is where the run shall end; None where it ends with time alone.
    """

    step: int
    scene: Scene
    decision: Decision | None
    contacts: tuple[Contact, ...]
    sumo_contacts: tuple[tuple[str, str], ...]
    tracking: TrackingInfo | None
    breaches: Breaches = field(default_factory=Breaches)
    background_contacts: int = 0
    goal_reached: bool | None = None


@dataclass(frozen=True)
class Carry:
    """All that goes from one step to the next; `ego` is the state of its motion, `told` the last decision's lines."""

    ego: Any
    command: Command
    mode: Mode
    planner_memory: Any
    driver_memories: Mapping[str, Any]
    driver_modes: Mapping[str, Mode]
    told: tuple[StopLine, ...] = ()


@dataclass
class TraceHash:
    """A hash of everything that a run did, in the exact bits; wall-clock times stay out."""

    _digest: Any = field(default_factory=hashlib.sha256)

    def add(self, moment: Moment) -> None:
        """Take one instant in."""
        time = moment.scene.time
        parts: list[bytes] = []
        for v in (moment.scene.ego, *moment.scene.others):
            parts += v.id.encode(), _NUMBERS.pack(time, v.x, v.y, v.heading, v.speed, v.accel, v.lane, v.mode)
        self._digest.update(b"".join(parts))
        if moment.decision is not None:
            decision = moment.decision
            self._digest.update(f"{decision.status}{decision.lateral}{decision.mode}".encode())
            self._digest.update(struct.pack("<d", decision.command.accel))

    def hexdigest(self) -> str:
        """Return the hash so far."""
        return str(self._digest.hexdigest())


class Loop:
    """One episode that is carried on a step at a time, from an open world at time 0 on.

    Attributes:
        now: the present instant; its decision is None until one is taken by `step`.
        ended: whether it is the last: the time is over, the ego is at its goal, or it has had a contact.
    """

    def __init__(
        self, settings: EpisodeSettings, world: World, planner: Planner[Any], observe: Callable[[Moment], None]
    ) -> None:
        """Look at the first instant.

        Args:
            settings: the run.
            world: an open world at time 0.
            planner: decides every `planner.period`, a multiple of dt.
            observe: called with every instant, in order; what it keeps is the record.

        Raises:
            decision.contract.PlannerError: if the planner's period cannot be kept.
        """
        self._settings, self._world, self._planner, self._observe = settings, world, planner, observe
        self._motion = motion_of(
            settings.motion, settings.bicycle, settings.road, settings.lane_change_time, settings.dt
        )
        self._carry = start(settings, self._motion, planner)
        self._every = steps_per_decision(planner, settings.dt)
        self._before: Snapshot | None = None
        self.now, self.ended = self._look(0, ())

    def perceived(self) -> Scene:
        """Return the present scene as the planner measures it."""
        return self._settings.measurement.perceive(self.now.scene, self.now.step)

    def step(self, order: Command | Decision | None = None) -> Moment:
        """Carry the episode on by one step of dt.

        Args:
            order: what the ego does from now on; None leaves it to the planner where its next decision is due, and
                otherwise to the last decision.

        Returns:
            The next instant.

        Raises:
            SimulationError: the episode has ended.
            decision.contract.PlannerError: if a decision cannot be carried out.
        """
        if self.ended:
            raise SimulationError(
                f"the run must go on to be stepped, got its end at {self.now.scene.time:g} s; reset it"
            )
        settings, motion, scene, step = self._settings, self._motion, self.now.scene, self.now.step
        carry, decision, planner = self._carry, None, self._planner
        observer, due = planner if isinstance(planner, Observer) else None, order is None and step % self._every == 0
        measured = self.perceived() if due or observer else scene
        if observer:
            carry = replace(carry, planner_memory=observer.observe(measured, carry.planner_memory))
        if order is not None:
            decision = order if isinstance(order, Decision) else commanded(order, scene)
            require_decision(decision, settings.road)
            carry = take_command(motion, carry, decision, carry.planner_memory, scene)
        elif due:
            decision, memory = planner.decide(measured, carry.planner_memory)
            require_decision(decision, settings.road)
            carry = take_command(motion, carry, decision, memory, scene)
        carry, speeds, tracking = drive(settings, motion, carry, scene)
        self._observe(replace(self.now, decision=decision, tracking=tracking))
        poses = drawn_poses(settings, scene, (step + 1) * settings.dt)
        world = self._world
        world.advance(ego_state(settings, motion, carry) if motion.moves_ego else None, speeds, poses)
        self._carry = replace(carry, ego=motion.read(carry.ego, world.ego()))
        self.now, self.ended = self._look(step + 1, world.sumo_contacts())
        return self.now

    def _look(self, step: int, sumo_contacts: tuple[tuple[str, str], ...]) -> tuple[Moment, bool]:
        """Return an instant, and whether it is the last, which is observed at once."""
        settings, world = self._settings, self._world
        scene = observe_scene(settings, self._motion, world, self._carry, step)
        seen = Snapshot(scene.time, scene.ego, (*scene.others, *world.crossing()))
        self._before, touching = meet(self._before, seen, world.x_end)
        arrived = None if settings.goal_x is None else scene.ego.x >= settings.goal_x
        moment = Moment(
            step=step,
            scene=scene,
            decision=None,
            contacts=touching,
            sumo_contacts=sumo_contacts,
            tracking=None,
            breaches=world.breaches(),
            background_contacts=len(world.background_contacts()),
            goal_reached=arrived,
        )
        ended = bool(step == settings.steps or touching or arrived)
        if ended:
            self._observe(moment)
        return moment, ended


def run_episode(
    settings: EpisodeSettings, world: World, planner: Planner[Any], observe: Callable[[Moment], None]
) -> None:
    """Run one episode to its end, to the ego's goal or to its first contact.

    Args:
        settings: the run.
        world: an open world at time 0.
        planner: decides every `planner.period`, a multiple of dt.
        observe: called with every instant, in order; what it keeps is the record.

    Raises:
        decision.contract.PlannerError: if the planner's period or a decision cannot be carried out.
    """
    loop = Loop(settings, world, planner, observe)
    while not loop.ended:
        loop.step()


def commanded(command: Command, scene: Scene) -> Decision:
    """Return the decision that a command stands for: the lateral action towards its lane, the mode of its sign."""
    change = command.lane - scene.ego.lane
    return Decision(
        scene.time,
        Status.RULE,
        command,
        lateral=Lateral((change > 0) - (change < 0)),
        mode=Mode((command.accel > 0) - (command.accel < 0)),
        violation=None,
    )


def meet(before: Snapshot | None, now: Snapshot, x_end: float) -> tuple[Snapshot, tuple[Contact, ...]]:
    """Return everybody now, and whom the ego has met since the instant before, None at the start.

    Args:
        before: everybody at the instant before.
        now: everybody now.
        x_end: where the road ends [m].
    """
    if before is None:
        return now, contacts(now.ego, now.others, now.time)
    return now, contacts_between(before, now, x_end)


def start(settings: EpisodeSettings, motion: Motion[Any], planner: Planner[Any]) -> Carry:
    """Return what the first step starts from."""
    return Carry(
        ego=motion.start(settings.ego),
        command=Command(lane=settings.ego.lane, accel=0.0),
        mode=settings.ego.mode,
        planner_memory=planner.initial_memory(),
        driver_memories={name: driver.initial_memory() for name, driver in settings.drivers.items()},
        driver_modes=dict.fromkeys(settings.drivers, Mode.CRUISE),
    )


def ego_state(settings: EpisodeSettings, motion: Motion[Any], carry: Carry) -> VehicleState:
    """Return the ego as others see it: its front bumper, and the lane and mode it intends."""
    return motion.place(carry.ego, settings.ego, carry.command.lane, carry.mode)


def observe_scene(settings: EpisodeSettings, motion: Motion[Any], world: World, carry: Carry, step: int) -> Scene:
    """Read the world; a scripted vehicle's mode is the one it has been driving in up to now.

    A vehicle drawn from the model has the mode and the lane intent that were drawn for it.
    """
    time = step * settings.dt

    def known(other: VehicleState) -> VehicleState:
        if other.id in carry.driver_modes:
            return replace(other, mode=carry.driver_modes[other.id])
        if other.id in settings.paths:
            drawn = settings.paths[other.id].at(time)
            return replace(other, mode=drawn.mode, lane=drawn.lane, accel=drawn.accel)
        return other

    others = world.observe()
    if carry.driver_modes or settings.paths:
        others = tuple(known(other) for other in others)
    ego = ego_state(settings, motion, carry)
    return Scene(time, settings.road, ego, others, world.stop_lines(others, carry.told), world.rules)


def drawn_poses(settings: EpisodeSettings, scene: Scene, time: float) -> list[VehicleState]:
    """Return where the vehicles drawn from the model that are on the road go by a time [s]."""
    return [settings.paths[other.id].at(time) for other in scene.others if other.id in settings.paths]


def take_command(
    motion: Motion[Any],
    carry: Carry,
    decision: Decision,
    memory: Any,  # noqa: ANN401 - each planner's own
    scene: Scene,
) -> Carry:
    """Start what a decision orders, from the present state; a running lane change to the same lane goes on."""
    ego = motion.take(carry.ego, decision.command, scene.time)
    return replace(
        carry,
        ego=ego,
        command=decision.command,
        mode=decision.mode,
        planner_memory=memory,
        told=scene.stop_lines,
    )


def drive(
    settings: EpisodeSettings, motion: Motion[Any], carry: Carry, scene: Scene
) -> tuple[Carry, dict[str, float], TrackingInfo | None]:
    """Return the carry with the ego one step on, the speeds that the scripted vehicles take, and the QP's report."""
    ego, tracking = motion.move(carry.ego, scene.time)
    if not settings.drivers:
        return replace(carry, ego=ego), {}, tracking
    # The record is of what was seen; the others react to what was decided.
    decided = replace(scene, ego=replace(scene.ego, lane=carry.command.lane, mode=carry.mode))
    memories, modes, speeds = dict(carry.driver_memories), dict(carry.driver_modes), {}
    for vehicle in scene.others:
        driver = settings.drivers.get(vehicle.id)
        if driver is None:
            continue
        accel, modes[vehicle.id], memories[vehicle.id] = driver.accelerate(
            decided, vehicle, memories[vehicle.id], settings.dt
        )
        speeds[vehicle.id] = max(0.0, vehicle.speed + accel * settings.dt)
    return (
        replace(carry, ego=ego, driver_memories=memories, driver_modes=modes),
        speeds,
        tracking,
    )
