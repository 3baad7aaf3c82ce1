"""How the ego moves: as a bicycle with a tracking MPC or exactly, as commanded, or as SUMO drives it."""

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, Protocol, TypeVar

from sumo_hmdp.domain.maneuver import Mode
from sumo_hmdp.domain.plan import Command
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.vehicle import bicycle, point_mass
from sumo_hmdp.vehicle.bicycle import BicycleParameters, BicycleState
from sumo_hmdp.vehicle.point_mass import PointMass
from sumo_hmdp.vehicle.reference import Reference, follow
from sumo_hmdp.vehicle.tracking import TrackingInfo, TrackingMpc, TrackingWeights

# Steps that the tracking MPC looks ahead: 1.8 s at 0.15 s, longer than any limit takes to build up.
TRACKING_STEPS = 12

State = TypeVar("State")


class MotionKind(StrEnum):
    """Names of the motions; those but the last are in scenario files.

    BICYCLE: a kinematic bicycle with limits, which a tracking MPC steers.
    POINT_MASS: a point that moves exactly as told.
    POINT_MASS_PUBLISHED: a point that moves by the new speed of each step, as in the published rule-based code.
    SUMO: as SUMO drives it; commands are only reports. It comes with the planner, not with the scenario.
    """

    BICYCLE = "bicycle"
    POINT_MASS = "point_mass"
    POINT_MASS_PUBLISHED = "point_mass_published"
    SUMO = "sumo"


class Motion(Protocol[State]):
    """A motion as pure functions of its own state."""

    @property
    def moves_ego(self) -> bool:
        """Tell whether the world is told where the ego is; otherwise the world tells it."""
        ...

    def start(self, ego: VehicleState) -> State:
        """Return the state of an ego that keeps its lane."""
        ...

    def take(self, state: State, command: Command, time: float) -> State:
        """Begin what a decision orders; a running lane change to the same lane goes on."""
        ...

    def move(self, state: State, time: float) -> tuple[State, TrackingInfo | None]:
        """Return the state one step after `time`, and how the tracking went where there is any."""
        ...

    def read(self, state: State, ego: VehicleState) -> State:
        """Return the state after a step at whose end the world has the ego so."""
        ...

    def place(self, state: State, ego: VehicleState, lane: int, mode: Mode) -> VehicleState:
        """Return the ego with the lane and mode that it intends, its pose, speed and acceleration as in the state."""
        ...


@dataclass(frozen=True)
class TrackedBicycle:
    """A bicycle and what it follows."""

    vehicle: BicycleState
    reference: Reference | None = None


@dataclass(frozen=True)
class BicycleMotion:
    """The nonlinear bicycle behind a tracking MPC.

    Attributes:
        road: lanes.
        lane_change_time: of the quintic [s].
        tracker: of the vehicle, set up for the step.
    """

    road: Road
    lane_change_time: float
    tracker: TrackingMpc

    @property
    def moves_ego(self) -> bool:
        """Return True."""
        return True

    def start(self, ego: VehicleState) -> TrackedBicycle:
        """Return the bicycle without a reference; a decision is due before it first moves."""
        parameters = self.tracker.parameters
        return TrackedBicycle(bicycle.from_front_bumper(ego.x, ego.y, ego.heading, ego.speed, parameters))

    def take(self, state: TrackedBicycle, command: Command, time: float) -> TrackedBicycle:
        """Begin the command's reference at the present state."""
        reference = follow(
            command,
            state.vehicle,
            self.tracker.parameters,
            state.reference,
            road=self.road,
            time=time,
            lane_change_time=self.lane_change_time,
        )
        return replace(state, reference=reference)

    def move(self, state: TrackedBicycle, time: float) -> tuple[TrackedBicycle, TrackingInfo]:
        """Track the reference over one step."""
        assert state.reference is not None  # noqa: S101 - a decision is due at step 0
        controls, info = self.tracker.control(state.vehicle, state.reference, time)
        vehicle = bicycle.advance(state.vehicle, controls, self.tracker.parameters, self.tracker.dt)
        return replace(state, vehicle=vehicle), info

    def read(self, state: TrackedBicycle, ego: VehicleState) -> TrackedBicycle:
        """Return the state: the world has the ego where it was told to."""
        del ego
        return state

    def place(self, state: TrackedBicycle, ego: VehicleState, lane: int, mode: Mode) -> VehicleState:
        """Return the ego where the bicycle's front bumper is."""
        x, y = bicycle.front_bumper(state.vehicle, self.tracker.parameters)
        now = state.vehicle
        return replace(ego, x=x, y=y, speed=now.speed, lane=lane, mode=mode, accel=now.accel, heading=now.heading)


@dataclass(frozen=True)
class CommandedPoint:
    """A point and the acceleration it is told to hold [m/s2]."""

    vehicle: PointMass
    accel: float = 0.0


@dataclass(frozen=True)
class PointMassMotion:
    """A point without a vehicle.

    Attributes:
        road: lanes.
        lane_change_time: of the quintic [s].
        dt: the step [s].
        as_published: whether it moves as in the published rule-based code, and not exactly.
    """

    road: Road
    lane_change_time: float
    dt: float
    as_published: bool = False

    @property
    def moves_ego(self) -> bool:
        """Return True."""
        return True

    def start(self, ego: VehicleState) -> CommandedPoint:
        """Return the point in its lane."""
        return CommandedPoint(point_mass.in_lane(ego.x, ego.y, ego.speed, ego.lane))

    def take(self, state: CommandedPoint, command: Command, time: float) -> CommandedPoint:
        """Hold the command's acceleration from now on, and begin its lane change."""
        del time
        y_end = self.road.center_y(command.lane)
        vehicle = point_mass.change_lane(state.vehicle, command.lane, y_end, self.lane_change_time)
        return CommandedPoint(vehicle, command.accel)

    def move(self, state: CommandedPoint, time: float) -> tuple[CommandedPoint, None]:
        """Move the point; there is nothing to track."""
        del time
        advance = point_mass.advance_as_published if self.as_published else point_mass.advance
        return replace(state, vehicle=advance(state.vehicle, state.accel, self.dt)), None

    def read(self, state: CommandedPoint, ego: VehicleState) -> CommandedPoint:
        """Return the state: the world has the ego where it was told to."""
        del ego
        return state

    def place(self, state: CommandedPoint, ego: VehicleState, lane: int, mode: Mode) -> VehicleState:
        """Return the ego where the point is."""
        now = state.vehicle
        return replace(
            ego, x=now.x, y=now.y, speed=now.speed, lane=lane, mode=mode, accel=now.accel, heading=now.heading
        )


@dataclass(frozen=True)
class SumoMotion:
    """SUMO's own driving; the state is the ego as the world has it."""

    @property
    def moves_ego(self) -> bool:
        """Return False."""
        return False

    def start(self, ego: VehicleState) -> VehicleState:
        """Return the ego."""
        return ego

    def take(self, state: VehicleState, command: Command, time: float) -> VehicleState:
        """Return the state: the command only reports what SUMO does."""
        del command, time
        return state

    def move(self, state: VehicleState, time: float) -> tuple[VehicleState, None]:
        """Return the state: it is the world that moves the ego."""
        del time
        return state, None

    def read(self, state: VehicleState, ego: VehicleState) -> VehicleState:
        """Return the ego as the world has it."""
        del state
        return ego

    def place(self, state: VehicleState, ego: VehicleState, lane: int, mode: Mode) -> VehicleState:
        """Return the ego as the world has it, with the lane and mode that are reported of it."""
        del ego
        return replace(state, lane=lane, mode=mode)


def motion_of(
    kind: MotionKind, parameters: BicycleParameters, road: Road, lane_change_time: float, dt: float
) -> Motion[Any]:
    """Return a motion by its name.

    Args:
        kind: which.
        parameters: of the bicycle.
        road: lanes.
        lane_change_time: [s].
        dt: the step [s].
    """
    if kind is MotionKind.SUMO:
        return SumoMotion()
    if kind in (MotionKind.POINT_MASS, MotionKind.POINT_MASS_PUBLISHED):
        return PointMassMotion(road, lane_change_time, dt, as_published=kind is MotionKind.POINT_MASS_PUBLISHED)
    return BicycleMotion(road, lane_change_time, TrackingMpc(parameters, TrackingWeights(), TRACKING_STEPS, dt))
