"""What SUMO is started with: its options, the vehicle types of one run, and a built network."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState
from sumo_hmdp.errors import InputError, Problem
from sumo_hmdp.planning.sumo_driver import SumoDriver
from sumo_hmdp.traffic.spawn import DriverKind, IdmParameters, Spawn

# No vehicle whose speed is commanded may be slowed to its type's top speed [m/s].
_UNLIMITED = 1000.0
_SAME = 1e-6
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
            element.attrib |= _idm(ego_driver, ego_driver.desired_speed, dt) | _lane_changes(ego_driver)
    for spawn in others:
        element = _add_type(root, spawn.id, spawn.length, spawn.width)
        if spawn.driver in {DriverKind.IDM, DriverKind.BACKGROUND}:
            top_speed = spawn.speed if spawn.desired_speed is None else spawn.desired_speed
            element.attrib |= _idm(spawn.idm, top_speed, dt)
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
        maxSpeed=repr(_UNLIMITED),
        # Without it SUMO brakes whoever drives in a lane to the right of a slower vehicle.
        lcOvertakeRight="1",
    )


def sumo_command(
    net_file: Path, types_file: Path, dt: float, seed: int, lane_change_time: float | None = None
) -> list[str]:
    """Return SUMO's command line for a run without output, teleports or insertion checks.

    With a lane-change time the changes of the vehicles that SUMO moves take it, and followers in both lanes see them
    meanwhile; without one they would jump.
    """
    options = {
        "net-file": net_file,
        "additional-files": types_file,
        "step-length": dt,
        "seed": seed,
        "no-step-log": "true",
        "no-warnings": "true",
        "time-to-teleport": -1,
        "collision.action": "warn",
        "collision.mingap-factor": 0,
        "insertion-checks": "none",
        "lanechange.overtake-right": "true",
    }
    if lane_change_time is not None:
        options["lanechange.duration"] = lane_change_time
    return ["sumo", *(word for name, value in options.items() for word in (f"--{name}", str(value)))]


@dataclass(frozen=True)
class Network:
    """A straight road as SUMO has it.

    Attributes:
        edge: the name of its edge.
        road: its lanes.
        x_begin: where it begins [m].
        x_end: where it ends, and vehicles leave it [m].
    """

    edge: str
    road: Road
    x_begin: float
    x_end: float

    def holds(self, x: float, y: float) -> bool:
        """Tell whether a front centre at (x, y) [m] is on the road."""
        return self.x_begin <= x < self.x_end and abs(y) <= 0.5 * self.road.lane_count * self.road.lane_width


def read_network(net_file: Path, road: Road) -> Network:
    """Read a built network and check that it is the road.

    Raises:
        InputError: it cannot be read, has more than one edge, or its lanes are not the road's.
    """
    try:
        root = ET.parse(net_file).getroot()  # noqa: S314 (a network is the user's own file)
    except (OSError, ET.ParseError) as error:
        raise InputError([f"the network must be readable XML, got: {error}."], str(net_file)) from error
    edges = [edge for edge in root.iter("edge") if edge.get("function") is None]
    if len(edges) != 1:
        raise InputError([f"the network must have one edge, got {len(edges)}."], str(net_file))
    lanes = edges[0].findall("lane")
    try:
        shapes = [[tuple(map(float, point.split(","))) for point in lane.attrib["shape"].split()] for lane in lanes]
        # SUMO's default width, which netconvert leaves out.
        widths = [float(lane.get("width", "3.2")) for lane in lanes]
    except (KeyError, ValueError) as error:
        raise InputError([f"the lanes must have shapes of numbers, got: {error}."], str(net_file)) from error
    problems = list(_lane_mistakes(shapes, widths, road))
    if problems:
        raise InputError(problems, str(net_file))
    return Network(edges[0].attrib["id"], road, shapes[0][0][0], shapes[0][-1][0])


def _lane_mistakes(shapes: list[list[tuple[float, ...]]], widths: list[float], road: Road) -> Iterator[Problem]:
    """Yield where lanes, given by SUMO's index, differ from the road's."""
    if len(shapes) != road.lane_count:
        yield Problem("lane_count", f"lane_count must equal the network's {len(shapes)}, got {road.lane_count}.")
        return
    for index, (shape, width) in enumerate(zip(shapes, widths, strict=True)):
        lane = road.lane_of_sumo_index(index)
        center = road.center_y(lane)
        if abs(width - road.lane_width) > _SAME:
            message = f"lane_width must equal the network's {width} m (lane {lane}), got {road.lane_width} m."
            yield Problem("lane_width", message)
        elif any(abs(point[1] - center) > _SAME for point in shape) or shape[0][0] >= shape[-1][0]:
            yield Problem(
                "lanes",
                f"lane {lane} must run along y = {center} m with growing x, got {shape}. "
                'Build the network with spreadType="center" and --offset.disable-normalization true.',
            )
