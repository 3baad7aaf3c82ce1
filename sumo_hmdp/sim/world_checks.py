"""What a simulated world is given, and the checks of it that need no simulator."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from sumo_hmdp.decision.sumo_driver import SumoDriver
from sumo_hmdp.domain.distance import TOUCH
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import EGO_ID, VehicleState
from sumo_hmdp.errors import Problem
from sumo_hmdp.sim.background import BackgroundSettings
from sumo_hmdp.sim.contact import overlap_depth
from sumo_hmdp.sim.ghost import image_lane, second_lane
from sumo_hmdp.sim.network import Network
from sumo_hmdp.traffic.spawn import DriverKind, Spawn, spawn_problems

_MILLISECOND = 1e-3
_MAX_SEED = 2**31 - 1


@dataclass(frozen=True)
class WorldSettings:
    """What a world is besides its vehicles.

    Attributes:
        net_file: a built SUMO network of one straight edge along x.
        road: the same road; opening the world checks that they agree.
        dt: simulation step, a multiple of 1 ms [s].
        seed: SUMO's seed. Nothing random is left for SUMO to decide.
        ego_driver: how SUMO drives the ego, None where the ego is moved by its pose.
        background: what the background drivers have in common, None where there are none.
        sight: background vehicles farther from the ego along the road are not observed [m].
        speed_limit: of the whole road, instead of what the network says; None obeys the network [m/s].
    """

    net_file: Path
    road: Road
    dt: float
    seed: int
    ego_driver: SumoDriver | None = None
    background: BackgroundSettings | None = None
    sight: float = 200.0
    speed_limit: float | None = None

    @property
    def lane_change_time(self) -> float | None:
        """How long SUMO lets a lane change take [s], None where nobody whom it moves changes lanes."""
        if self.background is not None:
            return self.background.lane_change_time
        return None if self.ego_driver is None else self.ego_driver.lane_change_time


def world_problems(settings: WorldSettings, ego: VehicleState, others: Sequence[Spawn]) -> list[Problem]:
    """List every mistake in the arguments of a world, taken by themselves."""
    problems = [*_settings_mistakes(settings), *(Problem("ego", text) for text in pose_mistakes(ego))]
    if ego.id != EGO_ID:
        problems.append(Problem("ego.id", f"id must be {EGO_ID!r}, got {ego.id!r}."))
    driver = settings.ego_driver
    # In traffic the ego takes over the speed of somebody who may want to be faster, and slows down to its own.
    if driver is not None and settings.background is None and not driver.desired_speed >= ego.speed:
        message = (
            f"desired_speed must be at least the speed {ego.speed} m/s at which the ego starts, got "
            f"{driver.desired_speed} m/s; SUMO would brake it as in an emergency. Raise it."
        )
        problems.append(Problem("ego.desired_speed", message))
    problems += spawn_problems(others, settings.road)
    return problems


def _settings_mistakes(settings: WorldSettings) -> Iterator[Problem]:
    steps = settings.dt / _MILLISECOND
    if not (math.isfinite(steps) and steps > 0.5 and abs(steps - round(steps)) < 1e-6):
        yield Problem("dt", f"dt must be a positive multiple of 0.001 s, SUMO's resolution, got {settings.dt} s.")
    if not 0 <= settings.seed <= _MAX_SEED:
        yield Problem("seed", f"seed must be in 0..{_MAX_SEED}, got {settings.seed}.")
    if not settings.net_file.is_file():
        yield Problem("net_file", f"net_file must exist, got {settings.net_file}. See networks/README.md.")


def start_problems(network: Network, ego: VehicleState, others: Sequence[Spawn], dt: float) -> list[Problem]:
    """List who starts beside the road or in another vehicle."""
    problems = []
    starts: dict[str, VehicleState | Spawn] = {
        "ego": ego,
        # Who comes by a ramp is not on the road yet.
        **{f"vehicle {spawn.id}": spawn for spawn in others if spawn.entry is None},
    }
    for where, start in starts.items():
        first = network.x_begin + start.length
        if not first <= start.x < network.x_end:
            message = f"x must be at least {first} and below {network.x_end} m, got {start.x} m."
            problems.append(Problem(where, f"{message} The whole vehicle must be on the road."))
        elif isinstance(start, Spawn) and not network.lane_exists(start.x)[start.lane - 1]:
            problems.append(
                Problem(f"{where}.lane", f"lane {_lane_at(network, start.x, start.lane)}, got {start.lane}.")
            )
        elif isinstance(start, VehicleState) and not network.holds(start.x, start.y):
            lane = network.road.lane_at(start.y)
            message = f"lane {_lane_at(network, start.x, lane)}, got y = {start.y} m. Change the lane or x."
            problems.append(Problem("ego.lane", message))
    states = [spawn_state(spawn, network.road) for spawn in others if entry_step(spawn, dt) == 0]
    for i, state in enumerate((ego, *states)):
        for other in states[i:]:
            depth = overlap_depth(state, other)
            if depth > TOUCH:
                message = f"{state.id} and {other.id} must not start in each other, got an overlap of {depth:.2f} m"
                problems.append(Problem("", f"{message}. Move one of them."))
    return problems


def _lane_at(network: Network, x: float, lane: int) -> str:
    """Say what a lane must be at x [m], where a car may not start in it."""
    if network.is_closed(x, lane):
        return f"must be open to passenger cars at x = {x} m"
    return f"must exist at x = {x} m"


def spawn_state(spawn: Spawn, road: Road) -> VehicleState:
    """Return a vehicle as it enters."""
    y = road.center_y(spawn.lane)
    return VehicleState(spawn.id, spawn.x, y, spawn.speed, spawn.lane, length=spawn.length, width=spawn.width)


def entry_step(spawn: Spawn, dt: float) -> int:
    """Return the step at whose end a vehicle enters; 0 is the start of the run."""
    return round(spawn.time / dt)


def blocks(other: VehicleState, spawn: Spawn, road: Road, dt: float) -> bool:
    """Tell whether a vehicle, in any lane it straddles, may be in a newcomer's place a step from now."""
    lanes = (image_lane(other.y, road), second_lane(other, road))
    reach = other.speed * dt
    return spawn.lane in lanes and -spawn.length - reach < other.x - spawn.x < other.length


def entering(
    waiting: Sequence[Spawn], present: Iterable[VehicleState], step: int, settings: WorldSettings
) -> tuple[list[Spawn], list[Spawn]]:
    """Return who enters at the end of a step and who still waits; at the start nobody is in anybody's way.

    Args:
        waiting: in the order in which they may enter.
        present: who is on the road.
        step: the step, 0 is the start.
        settings: road and step length.
    """
    due, still_waiting = [], []
    taken = list(present) if step else []
    for spawn in waiting:
        if entry_step(spawn, settings.dt) > step or any(
            blocks(other, spawn, settings.road, settings.dt) for other in taken
        ):
            still_waiting.append(spawn)
        else:
            due.append(spawn)
            if step:
                taken.append(spawn_state(spawn, settings.road))
    return due, still_waiting


def pose_mistakes(vehicle: VehicleState) -> Iterator[str]:
    """Yield what makes a pose unusable: SUMO accepts NaN without a word and then returns nonsense."""
    for name in ("x", "y", "speed", "heading"):
        value = getattr(vehicle, name)
        if not math.isfinite(value):
            yield f"{name} of {vehicle.id} must be finite, got {value}."
    if vehicle.speed < 0.0:
        yield f"speed of {vehicle.id} must be at least 0, got {vehicle.speed} m/s."
    if abs(vehicle.heading) >= 0.5 * math.pi:
        yield f"heading of {vehicle.id} must point forward, within -pi/2 and pi/2, got {vehicle.heading} rad."
    if not (vehicle.length > 0.0 and vehicle.width > 0.0):
        yield f"length and width of {vehicle.id} must be above 0, got {vehicle.length} and {vehicle.width} m."


def command_problems(
    moved: Sequence[VehicleState],
    speeds: Mapping[str, float],
    kinds: Mapping[str, DriverKind],
    *,
    sumo_drives_ego: bool = False,
) -> list[Problem]:
    """List what is wrong with the commands of one step.

    Args:
        moved: the ego first, unless SUMO drives it, then the posed vehicles.
        speeds: [m/s] of the scripted vehicles.
        kinds: the driver of every surrounding vehicle on the road.
        sumo_drives_ego: whether it does.
    """
    problems = [Problem(vehicle.id, text) for vehicle in moved for text in pose_mistakes(vehicle)]
    posed = [vehicle.id for vehicle in moved]
    if not sumo_drives_ego:
        if posed[:1] != [EGO_ID]:
            problems.append(Problem("ego", f"the first pose must be the ego's, got {posed[:1]}."))
        posed = posed[1:]
    problems += _membership("poses", posed, DriverKind.POSED, kinds)
    problems += _membership("speeds", speeds, DriverKind.SCRIPTED, kinds)
    for vehicle_id, speed in speeds.items():
        if not (math.isfinite(speed) and speed >= 0.0):
            problems.append(Problem(f"speeds.{vehicle_id}", f"speed must be finite and at least 0, got {speed} m/s."))
    return problems


def _membership(
    name: str, given: Iterable[str], kind: DriverKind, kinds: Mapping[str, DriverKind]
) -> Iterator[Problem]:
    wanted = {vehicle_id for vehicle_id, driver in kinds.items() if driver == kind}
    got = list(given)
    if set(got) != wanted or len(got) != len(wanted):
        yield Problem(
            name,
            f"{name} must name every {kind} vehicle on the road once, {sorted(wanted)}, got {sorted(got)}. "
            "Take the vehicles from observe().",
        )
