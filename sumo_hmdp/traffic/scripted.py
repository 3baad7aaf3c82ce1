"""Drivers of scripted vehicles: pure functions of the scene and of what they remember."""

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise

from sumo_hmdp.domain.maneuver import Mode
from sumo_hmdp.domain.scene import Scene, VehicleState
from sumo_hmdp.errors import InputError

# Switching times are met by the step that is nearest, whatever the rounding of its time.
_TIME_TOLERANCE = 1e-6


def next_speed(speed: float, accel: float, dt: float) -> float:
    """Return the speed after a step, max(0, v + a dt) [m/s]; the position then grows by it times dt."""
    return max(0.0, speed + accel * dt)


def leader(scene: Scene, vehicle: VehicleState) -> VehicleState | None:
    """Return the nearest vehicle ahead whose intended lane is the vehicle's, the ego included.

    A vehicle in a lane change so counts in its target lane only.
    """
    ahead = (
        other
        for other in (scene.ego, *scene.others)
        if other.id != vehicle.id and other.lane == vehicle.lane and other.x > vehicle.x
    )
    return min(ahead, key=lambda other: other.x, default=None)


@dataclass(frozen=True)
class ConstantSpeed:
    """Keep the speed one has."""

    def initial_memory(self) -> None:
        """Return nothing: it remembers nothing."""

    def accelerate(self, scene: Scene, vehicle: VehicleState, memory: None, dt: float) -> tuple[float, Mode, None]:
        """Return no acceleration."""
        del scene, vehicle, dt
        return 0.0, Mode.CRUISE, memory


@dataclass(frozen=True)
class GapKeeping:
    """A linear car-following law that takes over while the gap is too small.

    With e = gap - (standstill_gap + time_gap v) it latches once e < 0. Then a = gap_gain e +
    speed_gain (v_lead - v) within its limits, until it is released once e > release_surplus without closing.

    Attributes:
        standstill_gap: [m].
        time_gap: [s].
        gap_gain: [1/s2].
        speed_gain: [1/s].
        decel_max: strongest braking, positive [m/s2].
        accel_max: [m/s2].
        release_surplus: [m].
    """

    standstill_gap: float = 2.0
    time_gap: float = 1.5
    gap_gain: float = 0.25
    speed_gain: float = 0.9
    decel_max: float = 3.0
    accel_max: float = 2.0
    release_surplus: float = 4.0

    def follow(self, vehicle: VehicleState, ahead: VehicleState | None, *, latched: bool) -> float | None:
        """Return the acceleration of the law [m/s2], or None while it does not apply.

        Args:
            vehicle: who follows.
            ahead: its leader, None where there is none.
            latched: whether the law applied in the step before.
        """
        if ahead is None:
            return None
        surplus = ahead.x - ahead.length - vehicle.x - (self.standstill_gap + self.time_gap * vehicle.speed)
        closing_speed = vehicle.speed - ahead.speed
        stays = latched and not (surplus > self.release_surplus and closing_speed <= 0.0)
        if surplus >= 0.0 and not stays:
            return None
        accel = self.gap_gain * surplus - self.speed_gain * closing_speed
        return min(max(accel, -self.decel_max), self.accel_max)


class Clock(StrEnum):
    """What the times of a schedule count from.

    RUN: the start of the run.
    EGO_CHANGE: the first instant at which the ego is off the centre of its first lane because it changes lanes. That
        is one control step after the decision: an indicator alone starts no clock.
    """

    RUN = "run"
    EGO_CHANGE = "ego_change"


@dataclass(frozen=True)
class ScheduleMemory:
    """What a scheduled driver remembers.

    Attributes:
        ego_lane: the lane that the ego was in at first, None before the first scene.
        ego_decided: whether it intended another one in the scene before.
        ego_change_time: when it first was on its way to another one [s], None until then.
        latched: whether the car-following law applied in the step before.
    """

    ego_lane: int | None = None
    ego_decided: bool = False
    ego_change_time: float | None = None
    latched: bool = False


@dataclass(frozen=True)
class ModeSchedule:
    """Cruise, and switch modes at given times; optionally give way to a leader that is too near.

    Attributes:
        switches: (time [s], the mode from then on) in the order of time; cruise before the first.
        accel: of the modes, positive [m/s2].
        speed_cap: never accelerate above it [m/s].
        car_following: the law that takes over while a leader is too near, None for none.
        clock: what the times count from.
    """

    switches: tuple[tuple[float, Mode], ...]
    accel: float
    speed_cap: float = math.inf
    car_following: GapKeeping | None = None
    clock: Clock = Clock.RUN

    def __post_init__(self) -> None:
        """Refuse a schedule that cannot be followed."""
        problems = []
        times = [time for time, _ in self.switches]
        if not all(math.isfinite(time) and time >= 0.0 for time in times):
            problems.append(f"switches must have finite times of at least 0 s, got {times} s.")
        elif any(later <= earlier for earlier, later in pairwise(times)):
            problems.append(f"switches must have growing times, got {times} s. Sort them.")
        if not (math.isfinite(self.accel) and self.accel > 0.0):
            problems.append(f"accel must be finite and above 0, got {self.accel} m/s2.")
        if not self.speed_cap > 0.0:
            problems.append(f"speed_cap must be above 0, got {self.speed_cap} m/s.")
        if problems:
            raise InputError(problems)

    def initial_memory(self) -> ScheduleMemory:
        """Return the memory before the first scene."""
        return ScheduleMemory()

    def accelerate(
        self, scene: Scene, vehicle: VehicleState, memory: ScheduleMemory, dt: float
    ) -> tuple[float, Mode, ScheduleMemory]:
        """Return the acceleration over the coming step [m/s2], the mode nearest to it, and the new memory.

        The acceleration already respects standstill and the cap: v + a dt is the speed after the step.

        Args:
            scene: at the beginning of the step; the ego's lane is the one that it intends.
            vehicle: whom it drives, as in the scene.
            memory: from the step before.
            dt: the step [s].
        """
        memory = _watch_ego(memory, scene)
        law = self.car_following
        ahead = leader(scene, vehicle) if law is not None else None
        accel = law.follow(vehicle, ahead, latched=memory.latched) if law is not None else None
        memory = replace(memory, latched=accel is not None)
        if accel is None:
            accel = self.accel * self._scheduled_mode(scene.time, memory)
        if accel > 0.0:
            accel = min(accel, max(0.0, (self.speed_cap - vehicle.speed) / dt))
        accel = max(accel, -vehicle.speed / dt)
        return accel, self._nearest_mode(accel), memory

    def _scheduled_mode(self, time: float, memory: ScheduleMemory) -> Mode:
        start = 0.0 if self.clock is Clock.RUN else memory.ego_change_time
        if start is None:
            return Mode.CRUISE
        mode = Mode.CRUISE
        for switch_time, switch_mode in self.switches:
            if time - start >= switch_time - _TIME_TOLERANCE:
                mode = switch_mode
        return mode

    def _nearest_mode(self, accel: float) -> Mode:
        """Return the mode whose nominal acceleration is nearest; cruise at standstill and at the cap."""
        if abs(accel) <= 0.5 * self.accel:
            return Mode.CRUISE
        return Mode.ACCELERATE if accel > 0.0 else Mode.DECELERATE


def _watch_ego(memory: ScheduleMemory, scene: Scene) -> ScheduleMemory:
    """Note the ego's first lane, and the time at which it first is on its way to another.

    The drivers are shown the ego with what it has just decided, before it moves: its change shows in the next scene.
    """
    if memory.ego_lane is None:
        memory = replace(memory, ego_lane=scene.road.lane_at(scene.ego.y))
    if memory.ego_change_time is not None:
        return memory
    started = scene.time if memory.ego_decided else None
    return replace(memory, ego_decided=scene.ego.lane != memory.ego_lane, ego_change_time=started)
