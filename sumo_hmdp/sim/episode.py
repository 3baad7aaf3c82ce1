"""The closed loop: observe, decide when due, track, apply, advance, record."""

import hashlib
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Protocol

from sumo_hmdp.decision.contract import require_decision, steps_per_decision
from sumo_hmdp.domain.maneuver import Mode
from sumo_hmdp.domain.plan import Command, Decision, Observer, Planner
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import Scene, StopLine, VehicleState
from sumo_hmdp.sim.contact import Contact, Snapshot, contacts, contacts_between
from sumo_hmdp.sim.libsumo_world import LibsumoWorld
from sumo_hmdp.sim.measurement import Measurement
from sumo_hmdp.sim.motion import Motion, MotionKind, motion_of
from sumo_hmdp.sim.signals import Breaches
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


def run_episode(
    settings: EpisodeSettings, world: LibsumoWorld, planner: Planner[Any], observe: Callable[[Moment], None]
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
    motion = motion_of(settings.motion, settings.bicycle, settings.road, settings.lane_change_time, settings.dt)
    carry = start(settings, motion, planner)
    sumo_contacts: tuple[tuple[str, str], ...] = ()
    every = steps_per_decision(planner, settings.dt)
    before: Snapshot | None = None
    for step in range(settings.steps + 1):
        scene = observe_scene(settings, motion, world, carry, step)
        before, touching = meet(
            before, Snapshot(scene.time, scene.ego, (*scene.others, *world.crossing())), world.x_end
        )
        arrived = None if settings.goal_x is None else scene.ego.x >= settings.goal_x
        moment = partial(
            Moment,
            step=step,
            scene=scene,
            contacts=touching,
            sumo_contacts=sumo_contacts,
            breaches=world.breaches(),
            background_contacts=len(world.background_contacts()),
            goal_reached=arrived,
        )
        decision = None
        if step == settings.steps or touching or arrived:
            observe(moment(decision=None, tracking=None))
            return
        due, observer = step % every == 0, planner if isinstance(planner, Observer) else None
        measured = settings.measurement.perceive(scene, step) if due or observer else scene
        if observer:
            carry = replace(carry, planner_memory=observer.observe(measured, carry.planner_memory))
        if due:
            decision, memory = planner.decide(measured, carry.planner_memory)
            require_decision(decision, settings.road)
            carry = take_command(motion, carry, decision, memory, scene)
        carry, speeds, tracking = drive(settings, motion, carry, scene)
        observe(moment(decision=decision, tracking=tracking))
        poses = drawn_poses(settings, scene, (step + 1) * settings.dt)
        world.advance(ego_state(settings, motion, carry) if motion.moves_ego else None, speeds, poses)
        carry = replace(carry, ego=motion.read(carry.ego, world.ego()))
        sumo_contacts = world.sumo_contacts()


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


def observe_scene(
    settings: EpisodeSettings, motion: Motion[Any], world: LibsumoWorld, carry: Carry, step: int
) -> Scene:
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
