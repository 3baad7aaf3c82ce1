"""A world of recorded traffic: vehicles follow their records, or react to the ego; no SUMO is needed.

With `reactive: idm` a vehicle leaves its record once its leader is the ego, or a vehicle that has left its own, and the
Intelligent Driver Model would not keep up with the record. From then on it drives by the model along its recorded path,
never ahead of its record, and joins it again where the model keeps up.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import NoReturn, Self

import numpy as np

from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.road_rules import RoadRules
from sumo_hmdp.domain.scene import StopLine, VehicleState
from sumo_hmdp.errors import InputError, Problem, SimulationError
from sumo_hmdp.sim.contact import overlap_depth
from sumo_hmdp.sim.signals import Breaches
from sumo_hmdp.tracks.along import EXTENSION, SOON, RoadTrack
from sumo_hmdp.tracks.load import RecordedTraffic
from sumo_hmdp.traffic.car_following import Drivers, idm_accel
from sumo_hmdp.traffic.spawn import IdmParameters

# An ego that took a vehicle over is where the record has it within this [m].
_ON_RECORD = 0.05
# A vehicle that has fallen behind may drive this much faster than it was ever recorded, and this fast at least [m/s].
_CATCH_UP, _LEAST_SPEED = 1.2, 5.0
# Bodies that pass each other by less are in each other's way [m].
_ROOM = 0.2
# Leaders farther ahead do not matter to the model [m].
_SIGHT = 150.0
# Recorded boxes are not exact: they may overlap by this [m].
OVERLAP_MAX = 0.3


@dataclass(frozen=True)
class RecordedSettings:
    """What a world of recorded traffic is.

    Attributes:
        traffic: the record along its road.
        dt: simulation step [s].
        start: time of the record at which the run begins [s].
        duration: of the run [s].
        reactive: whether vehicles leave their records behind the ego.
        drivers: of the vehicles that have left; each desires its own speed.
        ego_track: the recorded vehicle whose place the ego takes, None for none.
    """

    traffic: RecordedTraffic
    dt: float
    start: float
    duration: float
    reactive: bool
    drivers: IdmParameters = field(default_factory=IdmParameters)
    ego_track: str | None = None

    @property
    def road(self) -> Road:
        """Lanes of one width."""
        return self.traffic.road

    @property
    def x_begin(self) -> float:
        """Where the road begins [m]."""
        return -EXTENSION

    @property
    def x_end(self) -> float:
        """Where the road ends [m]."""
        return self.traffic.shape.length + EXTENSION


@dataclass(frozen=True)
class _Left:
    """A vehicle that has left its record: front bumper [m], speed [m/s] and acceleration [m/s2]."""

    x: float
    speed: float
    accel: float


class RecordedWorld:
    """Recorded traffic around the ego, as a context manager.

    Attributes:
        settings: as given.
        step: steps taken since the start.
    """

    def __init__(self, settings: RecordedSettings, ego: VehicleState) -> None:
        """Put everybody where the record has them.

        Args:
            settings: the record and how it is played.
            ego: where the ego starts.
        """
        self.settings = settings
        self.step = 0
        self._ego = ego
        self._tracks = [t for _, t in sorted(settings.traffic.tracks.items()) if t.id != settings.ego_track]
        self._left: dict[str, _Left] = {}
        self._others = self._recorded(settings.start)
        self._touching: set[tuple[str, str]] = set()
        self._is_open = False

    @property
    def left(self) -> frozenset[str]:
        """Ids of the vehicles that are not on their records now."""
        return frozenset(self._left)

    @property
    def rules(self) -> RoadRules:
        """What the road forbids: records say nothing of it."""
        return RoadRules()

    @property
    def time(self) -> float:
        """Time since the start [s]."""
        return self.step * self.settings.dt

    @property
    def x_end(self) -> float:
        """Where the road ends [m]."""
        return self.settings.x_end

    def __enter__(self) -> Self:
        """Open the world."""
        self._is_open = True
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the world."""
        self._is_open = False

    def observe(self) -> tuple[VehicleState, ...]:
        """Return the surrounding vehicles, ordered by id.

        Raises:
            SimulationError: the world is not open.
        """
        self._require_open()
        return self._others

    def ego(self) -> VehicleState:
        """Return the ego as it was last commanded.

        Raises:
            SimulationError: the world is not open.
        """
        self._require_open()
        return self._ego

    def advance(
        self, ego: VehicleState | None, speeds: Mapping[str, float], poses: Iterable[VehicleState] = ()
    ) -> None:
        """Carry the world on by one step, at whose end the ego is as commanded; others react to the state before.

        Args:
            ego: pose and speed at the end of the step.
            speeds: empty: recorded vehicles are not scripted.
            poses: empty, likewise.

        Raises:
            InputError: somebody else is commanded, or the ego is not.
            SimulationError: the ego leaves the road, or the world is not open.
        """
        self._require_open()
        if ego is None or speeds or tuple(poses):
            raise InputError(["in recorded traffic the ego and nobody else must be commanded, got another command"])
        half = 0.5 * self.settings.road.lane_count * self.settings.road.lane_width
        if not (self.settings.x_begin <= ego.x < self.settings.x_end and abs(ego.y) <= half):
            self._lose_ego(ego)
        time = self.settings.start + self.time
        following = self._following(time) if self.settings.reactive else self._recorded(time + self.settings.dt)
        self.step += 1
        self._ego, self._others = ego, following
        self._touching.update(_overlaps(following))

    def crossing(self) -> tuple[VehicleState, ...]:
        """Return nobody: who crosses the road is refused with the record."""
        return ()

    def stop_lines(self, others: Iterable[VehicleState], told: Sequence[StopLine] = ()) -> tuple[StopLine, ...]:
        """Return none: the record has no signals."""
        del others, told
        return ()

    def breaches(self) -> Breaches:
        """Return none: records say nothing of rules."""
        return Breaches()

    def background_contacts(self) -> tuple[tuple[str, str], ...]:
        """Return the pairs of surrounding vehicles that have overlapped so far, sorted."""
        return tuple(sorted(self._touching))

    def sumo_contacts(self) -> tuple[tuple[str, str], ...]:
        """Return none: there is no SUMO."""
        return ()

    def _recorded(self, time: float) -> tuple[VehicleState, ...]:
        road = self.settings.road
        return tuple(track.at(time, road) for track in self._tracks if track.holds(time))

    def _following(self, time: float) -> tuple[VehicleState, ...]:
        """Return everybody one step after `time` of the record [s], on its record or behind it."""
        end = time + self.settings.dt
        present = {vehicle.id: vehicle for vehicle in self._others}
        has_left = [present[name] for name in self._left]
        leading = [*has_left, self._ego] if self._ego_deviates(time) else has_left
        everybody = [*self._others, self._ego]
        left: dict[str, _Left] = {}
        states = []
        for track in self._tracks:
            now = present.get(track.id)
            if now is None:
                if track.holds(end) and track.id not in self._left:
                    states += self._entering(track, end)
                continue
            behind = self._by_model(track, now, everybody if track.id in self._left else leading)
            record = track.at(end, self.settings.road) if track.holds(end) else None
            if record is None and track.id not in self._left:
                continue
            x_record = float(track.ahead[-1]) if record is None else record.x
            if behind is None or behind.x >= x_record:
                # Joined again; or at the end of a record whose time is over.
                states += [] if record is None else [record]
                continue
            left[track.id] = behind
            states.append(self._on_path(track, behind))
        self._left = left
        return tuple(states)

    def _entering(self, track: RoadTrack, end: float) -> list[VehicleState]:
        """Return a vehicle whose record begins, unless the ego or somebody who has left is there: then never."""
        state = track.at(end, self.settings.road)
        blocked = any(overlap_depth(state, other) > 0.0 for other in (self._ego, *self._others))
        return [] if blocked else [state]

    def _by_model(self, track: RoadTrack, now: VehicleState, others: Sequence[VehicleState]) -> _Left | None:
        """Return where the model has a vehicle after the step, None where nobody is in its way."""
        leader = self._leader(track, now, others)
        if leader is None and track.id not in self._left:
            return None
        idm = self.settings.drivers
        wish = max(_LEAST_SPEED, _CATCH_UP * float(track.speed.max()))
        gap, lead_speed = (np.inf, 0.0) if leader is None else (leader.x - leader.length - now.x, leader.speed)
        drivers = Drivers.of([(idm, wish)])
        accel = float(idm_accel(drivers, np.array([now.speed]), np.array([gap]), np.array([lead_speed]))[0])
        dt = self.settings.dt
        speed = max(0.0, now.speed + accel * dt)
        return _Left(now.x + 0.5 * (now.speed + speed) * dt, speed, (speed - now.speed) / dt)

    def _leader(self, track: RoadTrack, now: VehicleState, others: Sequence[VehicleState]) -> VehicleState | None:
        """Return the nearest vehicle ahead that is in the lane, or in the way, of the recorded path."""
        road = self.settings.road
        ahead = [other for other in others if other.id != now.id and now.x < other.x <= now.x + _SIGHT + other.length]

        def is_in_way(other: VehicleState) -> bool:
            rear = other.x - other.length
            places = np.interp([now.x, 0.5 * (now.x + rear), max(now.x, rear)], track.ahead, track.y)
            room = 0.5 * (now.width + other.width) + _ROOM
            in_lane = road.lane_at(other.y) == road.lane_at(now.y)
            return in_lane or bool((np.abs(places - other.y) < room).any())

        return min(filter(is_in_way, ahead), key=lambda other: other.x - other.length, default=None)

    def _on_path(self, track: RoadTrack, left: _Left) -> VehicleState:
        """Return a vehicle that has left its record, on its recorded path."""
        y, heading = (float(np.interp(left.x, track.ahead, column)) for column in (track.y, track.heading))
        return VehicleState(
            id=track.id,
            x=left.x,
            y=y,
            speed=left.speed,
            lane=self.settings.road.lane_at(y),
            accel=left.accel,
            heading=heading,
            length=track.length,
            width=track.width,
            lateral_speed=left.speed * float(np.sin(heading)),
        )

    def _ego_deviates(self, time: float) -> bool:
        """Tell whether the ego is not where the record has the vehicle whose place it took."""
        name = self.settings.ego_track
        track = None if name is None else self.settings.traffic.tracks[name]
        if track is None or not track.holds(time):
            return True
        record = track.at(time, self.settings.road)
        return max(abs(record.x - self._ego.x), abs(record.y - self._ego.y)) > _ON_RECORD

    def _lose_ego(self, ego: VehicleState) -> NoReturn:
        if ego.x >= self.settings.x_end:
            raise SimulationError(
                f"the ego must not reach the road's end at {self.settings.x_end:g} m before its run ends, got there "
                f"after {self.time:g} s. Set ego.goal_x_m below it, so that the run ends there, or shorten duration_s."
            )
        raise SimulationError(
            f"the ego must stay on the road, got x = {ego.x:g} m, y = {ego.y:g} m (t = {self.time} s)."
        )

    def _require_open(self) -> None:
        if not self._is_open:
            raise SimulationError("the world must be open. Use it in a `with` statement.")


def recorded_problems(settings: RecordedSettings, ego: VehicleState) -> Iterator[Problem]:
    """Yield overlaps in the part of the record that a run plays, and an ego that starts in somebody or off the road."""
    steps = np.arange(settings.start, settings.start + settings.duration + SOON, settings.traffic.dt)
    tracks = list(settings.traffic.tracks.values())
    for time in steps.tolist():
        states = [track.at(time, settings.road) for track in tracks if track.holds(time)]
        for first, second in _overlaps(states, OVERLAP_MAX):
            message = f"vehicles of the record must not overlap, got {first} and {second} at {time:g} s"
            yield Problem("tracks.file", f"{message}. List one of them in tracks.leave_out")
            return
    half = 0.5 * settings.road.lane_count * settings.road.lane_width
    if not (settings.x_begin + ego.length <= ego.x < settings.x_end and abs(ego.y) <= half):
        message = f"must be from {settings.x_begin + ego.length:g} to {settings.x_end:g} m on the road, got"
        yield Problem("ego.x_m", f"{message} x = {ego.x:g} m, y = {ego.y:g} m")
    for other in RecordedWorld(settings, ego)._others:  # noqa: SLF001 - the same file's
        depth = overlap_depth(ego, other)
        if depth > 0.0:
            message = f"must not start in another vehicle, got an overlap of {depth:.2f} m with {other.id}"
            yield Problem("ego.x_m", f"{message}. Move it, or take that one's place by ego.vehicle")


def _overlaps(states: Sequence[VehicleState], depth: float = OVERLAP_MAX) -> Iterator[tuple[str, str]]:
    """Yield the pairs whose bodies overlap by more than a depth [m]; only neighbours along the road are looked at."""
    ordered = sorted(states, key=lambda state: state.x)
    # A turned body reaches forward or back by its length and width at most.
    longest = max((state.length + 2.0 * state.width for state in states), default=0.0)
    for index, rear in enumerate(ordered):
        for front in ordered[index + 1 :]:
            if front.x - longest > rear.x:
                break
            if abs(front.y - rear.y) < front.length + rear.length and overlap_depth(rear, front) > depth:
                first, second = sorted((rear.id, front.id))
                yield first, second
