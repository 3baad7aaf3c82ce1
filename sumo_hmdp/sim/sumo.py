"""SUMO as this package uses it, and the only file that imports it: start, step, insert, move, read, end."""

import math
import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path

from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.errors import SimulationError
from sumo_hmdp.sim import window
from sumo_hmdp.sim import world_checks as checks
from sumo_hmdp.sim.network import Network
from sumo_hmdp.sim.routes import Routes
from sumo_hmdp.sim.sumo_input import EGO_CLASS, SPEED_FACTOR, sumo_command, type_id, vehicle_types
from sumo_hmdp.traffic.spawn import DriverKind, Spawn

__all__ = [
    "IN_WINDOW",
    "give_rights",
    "insert",
    "keep_out",
    "libsumo",
    "lights",
    "move",
    "obey_limits",
    "read_vehicle",
    "simulation",
    "step",
    "sumo_version",
]

# SUMO's Python package prints a notice about pyarrow to standard output without it.
os.environ.setdefault("LIBSUMO_AS_TRACI", "quiet")
# `sumo-hmdp watch` shows the run in SUMO's window, over TraCI, which has the same functions.
IN_WINDOW = window.DELAY in os.environ
if IN_WINDOW:
    import traci as libsumo
else:
    import libsumo

_ROUTE = "along"
_KEEP_POSITION = 3  # moveToXY: the exact position, and the route stays
# Speed modes: with 0 no rule of SUMO changes a commanded speed; 32 is the same for a vehicle that moveToXY
# moves (31 clips the speed that its followers see); 31 is SUMO's own driving. So is 27, but who is told to be slower
# may brake harder than comfortably where its leader or a signal makes it.
_SPEED_MODE = {DriverKind.SCRIPTED: 0, DriverKind.POSED: 32, DriverKind.IDM: 31, DriverKind.BACKGROUND: 27}
_SUMO_ERRORS = (libsumo.TraCIException, libsumo.FatalTraCIError)


@contextmanager
def simulation(
    settings: checks.WorldSettings, network: Network, ego: VehicleState | None, others: Iterable[Spawn]
) -> Iterator[None]:
    """Start SUMO with the vehicle types of a run and an empty road, and end it whatever happens."""
    if not IN_WINDOW and libsumo.isLoaded():
        raise SimulationError("a process must have one world open at a time, got two. Close the first.")
    with tempfile.TemporaryDirectory(prefix="sumo-hmdp-") as folder:
        types_file = Path(folder) / "types.add.xml"
        types_file.write_text(vehicle_types(ego, others, settings.dt, settings.ego_driver))
        try:
            command = sumo_command(
                settings.net_file,
                types_file,
                settings.dt,
                settings.seed,
                settings.lane_change_time,
                finds_collisions=settings.background is None,
            )
            if IN_WINDOW and ego is not None:
                command = window.command(command)
            _load(command, settings.net_file)
            if settings.speed_limit is not None:
                _set_limit(network, settings.speed_limit)
            # What SUMO says reaches nobody raw, whatever it was asked.
            try:
                yield
            except _SUMO_ERRORS as error:
                raise SimulationError(f"SUMO must carry out what it is told, got: {_words(error)}") from error
        finally:
            _close()


def _load(command: list[str], net_file: Path) -> None:
    try:
        libsumo.start(command)
    except _SUMO_ERRORS as error:
        raise SimulationError(f"SUMO must load {net_file}, got: {_words(error)}") from error


def _words(error: Exception) -> str:
    return " ".join(str(error).split())


def _set_limit(network: Network, limit: float) -> None:
    """Put a limit in the place of the network's; turning vehicles are held to what a turn allows.

    Drivers may be faster than the limit, but not in a turn.
    """
    for lane in libsumo.lane.getIDList():
        if lane.startswith(":") and lane not in network.lane_of:
            libsumo.lane.setMaxSpeed(lane, libsumo.lane.getMaxSpeed(lane) / SPEED_FACTOR)
        else:
            libsumo.lane.setMaxSpeed(lane, limit)


def obey_limits(name: str) -> None:
    """Let a vehicle that SUMO drives keep to the limits of its lanes, from the coming step on."""
    libsumo.vehicle.setSpeedFactor(name, 1.0)


def keep_out(network: Network, lanes: Iterable[int]) -> None:
    """Keep the ego's own class out of lanes, and give it in all others the rights of a passenger car."""
    forbidden = frozenset(lanes)
    parts = [(number, part) for s in network.stretches for number, part in enumerate(s.lane_parts, 1) if part]
    for number, part in parts:
        if number in forbidden or not part.is_open:
            libsumo.lane.setDisallowed(part.id, [*libsumo.lane.getDisallowed(part.id), EGO_CLASS])


def give_rights(network: Network) -> None:
    """Give the ego's own class the rights of a passenger car."""
    for stretch in network.stretches:
        for part in filter(None, stretch.lane_parts):
            allowed = libsumo.lane.getAllowed(part.id)
            if part.is_open and allowed and EGO_CLASS not in allowed:
                libsumo.lane.setAllowed(part.id, [*allowed, EGO_CLASS])
            for direction, may in ((1, part.left), (-1, part.right)):
                classes = libsumo.lane.getChangePermissions(part.id, direction)
                if may and classes and EGO_CLASS not in classes:
                    libsumo.lane.setChangePermissions(part.id, [*classes, EGO_CLASS], direction)


def lights(network: Network) -> dict[str, str]:
    """Return the state of every traffic light on the road by its name."""
    return {signal.name: libsumo.trafficlight.getRedYellowGreenState(signal.name) for signal in network.signals}


def step(time: float) -> None:
    """Let SUMO take the step that ends at `time` [s].

    Raises:
        SimulationError: SUMO fails.
    """
    try:
        libsumo.simulationStep()
    except _SUMO_ERRORS as error:
        raise SimulationError(f"SUMO must complete a step, got: {error} (t = {time} s).") from error


def insert(routes: Routes, vehicle: VehicleState | Spawn, name: str, lane: int, kind: DriverKind) -> None:
    """Ask SUMO to insert a vehicle at the end of the coming step."""
    way_out = vehicle.exit if isinstance(vehicle, Spawn) else None
    if isinstance(vehicle, Spawn) and vehicle.entry is not None:
        route, edges = f"{vehicle.entry}-{way_out}", routes.entry_edges(vehicle.entry, way_out)
        lane_index, position = 0, "base"
    else:
        place = routes.network.place(vehicle.x, lane)
        route, edges = f"{_ROUTE}-{place.number}-{way_out}", routes.edges(place.number, way_out)
        lane_index, position = place.lane_index, repr(float(place.position))
    if route not in libsumo.route.getIDList():
        libsumo.route.add(route, list(edges))
    libsumo.vehicle.add(
        name,
        route,
        typeID=type_id(vehicle.id),
        departLane=str(lane_index),
        departPos=position,
        departSpeed=repr(float(vehicle.speed)),
    )
    libsumo.vehicle.setLaneChangeMode(name, 0)
    libsumo.vehicle.setSpeedMode(name, _SPEED_MODE[kind])


def move(name: str, x: float, y: float, heading: float, speed: float) -> None:
    """Command pose [m, rad] and speed [m/s] for the end of the coming step."""
    degrees = (90.0 - math.degrees(heading)) % 360.0
    libsumo.vehicle.moveToXY(name, "", -1, float(x), float(y), degrees, _KEEP_POSITION)
    libsumo.vehicle.setSpeed(name, float(speed))


def read_vehicle(spawn: Spawn | VehicleState, road: Road) -> VehicleState:
    """Return a vehicle as SUMO has it.

    Raises:
        SimulationError: SUMO reports a state that is not finite.
    """
    vehicle = libsumo.vehicle
    x, y = vehicle.getPosition(spawn.id)
    speed = vehicle.getSpeed(spawn.id)
    accel = vehicle.getAcceleration(spawn.id)
    heading = math.remainder(math.radians(90.0 - vehicle.getAngle(spawn.id)), math.tau)
    if not math.isfinite(x + y + speed + accel + heading):
        raise SimulationError(f"the state of {spawn.id} must be finite, got x = {x}, y = {y}, speed = {speed}.")
    return VehicleState(
        id=spawn.id,
        x=x,
        y=y,
        speed=speed,
        lane=road.lane_at(y),
        accel=accel,
        heading=heading,
        length=spawn.length,
        width=spawn.width,
        # SUMO reports none for a vehicle that is moved by its pose.
        lateral_speed=speed * math.sin(heading),
    )


def _close() -> None:
    """End SUMO; a move that no step follows would corrupt the next run of the process, so step once more."""
    if IN_WINDOW or libsumo.isLoaded():
        try:
            with suppress(*_SUMO_ERRORS):
                libsumo.simulationStep()
        finally:
            libsumo.close()


def sumo_version() -> str:
    """Return SUMO's version, such as `SUMO 1.28.0`."""
    return f"SUMO {version('traci')}" if IN_WINDOW else str(libsumo.getVersion()[1])
