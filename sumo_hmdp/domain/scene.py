"""What is known of the traffic at one instant.

Everywhere in the package a vehicle's (x, y) is the centre of its FRONT bumper, as in SUMO.
"""

from dataclasses import dataclass, field

from sumo_hmdp.domain.maneuver import Mode
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.road_rules import RoadRules

EGO_ID = "ego"


@dataclass(frozen=True)
class VehicleState:
    """One vehicle at one instant.

    Attributes:
        id: its name, `ego` for the ego.
        x: front bumper along the road [m].
        y: front bumper across the road, to the left [m].
        speed: along its heading [m/s], >= 0.
        accel: along its heading [m/s2].
        heading: counter-clockwise from the road's direction [rad].
        lane: the lane that it intends to be in, 1 is leftmost.
        mode: its longitudinal mode.
        length: [m].
        width: [m].
        lateral_speed: dy/dt [m/s].
    """

    id: str
    x: float
    y: float
    speed: float
    lane: int
    mode: Mode = Mode.CRUISE
    accel: float = 0.0
    heading: float = 0.0
    length: float = 4.5
    width: float = 1.8
    lateral_speed: float = 0.0


@dataclass(frozen=True)
class StopLine:
    """A line that the ego's front bumper may not pass: a red signal, the end of a lane, an exit that is blocked.

    Attributes:
        lanes: the lanes that it closes.
        x: where it is along the road [m].
        leaving_x: where it is, at x or beyond, for a body that is only leaving these lanes and for an ego that is
            beyond x now; None where that is x too [m].
    """

    lanes: frozenset[int]
    x: float
    leaving_x: float | None = None


@dataclass(frozen=True)
class Scene:
    """All vehicles at one instant.

    Attributes:
        time: since the start of the run [s].
        road: the road they are on.
        ego: the ego.
        others: the surrounding vehicles, ordered by id.
        stop_lines: that are closed to the ego now.
        rules: what the road forbids to everybody.
    """

    time: float
    road: Road
    ego: VehicleState
    others: tuple[VehicleState, ...]
    stop_lines: tuple[StopLine, ...] = ()
    rules: RoadRules = field(default_factory=RoadRules)
