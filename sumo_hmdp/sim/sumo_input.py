"""What SUMO is started with: its options and the vehicle types of one run."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from xml.etree import ElementTree as ET

from sumo_hmdp.decision.sumo_driver import SumoDriver
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.traffic.spawn import IDM_KINDS, DriverKind, IdmParameters, Spawn

# No vehicle whose speed is commanded may be slowed to its type's top speed [m/s].
_UNLIMITED = 1000.0
# Where a scenario's limit takes the place of the network's, drivers may be above it, and so many times above it.
SPEED_FACTOR = 10.0
# SUMO refuses to insert anybody who is faster than this many times a lane's limit.
_AT_ANY_SPEED = 1e5
# A class of its own can be kept out of a lane that the traffic uses.
EGO_CLASS = "custom1"


def type_id(vehicle_id: str) -> str:
    """Return the name of a vehicle's own SUMO type."""
    return f"type-of-{vehicle_id}"


def vehicle_types(
    ego: VehicleState | None, others: Iterable[Spawn], dt: float, ego_driver: SumoDriver | None = None
) -> str:
    """Return the additional file with one vehicle type for every vehicle, as XML.

    They are written rather than set at run time: SUMO derives part of its IDM only while it reads a type.
    """
    root = ET.Element("additional")
    if ego is not None:
        element = _add_type(root, ego.id, ego.length, ego.width)
        if ego_driver is not None:
            top_speed = max(ego_driver.desired_speed, ego.speed)
            element.attrib |= _idm(ego_driver, top_speed, dt) | _lane_changes(ego_driver)
    for spawn in others:
        element = _add_type(root, spawn.id, spawn.length, spawn.width)
        if spawn.driver in IDM_KINDS:
            top_speed = spawn.speed if spawn.desired_speed is None else spawn.desired_speed
            element.attrib |= _idm(spawn.idm, top_speed, dt)
        if spawn.driver == DriverKind.BACKGROUND:
            element.set("speedFactor", repr(float(spawn.speed_factor or SPEED_FACTOR)))
    return ET.tostring(root, encoding="unicode")


def _idm(idm: IdmParameters | SumoDriver, top_speed: float, dt: float) -> dict[str, str]:
    numbers = {
        "minGap": idm.min_gap,
        "tau": idm.time_gap,
        "accel": idm.accel,
        "decel": idm.decel,
        "delta": idm.exponent,
        "maxSpeed": top_speed,
        # Above it SUMO divides the step and no longer gives the textbook value.
        "stepping": dt,
    }
    return {"carFollowModel": "IDM"} | _texts(numbers)


def _lane_changes(driver: SumoDriver) -> dict[str, str]:
    numbers = {"lcSpeedGain": driver.speed_gain, "lcKeepRight": driver.keep_right, "lcAssertive": driver.assertive}
    own_class = {"vClass": EGO_CLASS} if driver.forbidden_lanes else {}
    return {"laneChangeModel": "LC2013"} | _texts(numbers) | own_class


def _texts(numbers: Mapping[str, float]) -> dict[str, str]:
    return {name: repr(float(number)) for name, number in numbers.items()}


def _add_type(root: ET.Element, vehicle_id: str, length: float, width: float) -> ET.Element:
    return ET.SubElement(
        root,
        "vType",
        id=type_id(vehicle_id),
        length=repr(float(length)),
        width=repr(float(width)),
        minGap="0",
        speedDev="0",
        speedFactor=repr(_AT_ANY_SPEED),
        maxSpeed=repr(_UNLIMITED),
        # Without it SUMO brakes whoever drives in a lane to the right of a slower vehicle.
        lcOvertakeRight="1",
    )


def sumo_command(
    net_file: Path,
    types_file: Path,
    dt: float,
    seed: int,
    lane_change_time: float | None = None,
    *,
    finds_collisions: bool = True,
) -> list[str]:
    """Return SUMO's command line for a run without output, teleports or insertion checks.

    With a lane-change time the changes of the vehicles that SUMO moves take it, and followers in both lanes see them
    meanwhile; without one they would jump. SUMO's search for collisions, which overlooks the shape of bodies, takes two
    thirds of its step in traffic.
    """
    options = {
        "net-file": net_file,
        "additional-files": types_file,
        "step-length": dt,
        "seed": seed,
        "no-step-log": "true",
        "no-warnings": "true",
        "time-to-teleport": -1,
        "collision.action": "warn" if finds_collisions else "none",
        "collision.mingap-factor": 0,
        "insertion-checks": "none",
        "lanechange.overtake-right": "true",
    }
    if lane_change_time is not None:
        options["lanechange.duration"] = lane_change_time
    return ["sumo", *(word for name, value in options.items() for word in (f"--{name}", str(value)))]
