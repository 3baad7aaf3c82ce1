"""What a vehicle seems to be doing: its mode from its acceleration, its intended lane from its lateral motion.

For traffic of which nobody says what it intends. Both readings have a dead band, and hysteresis: what has been read
stays until the measurement clearly says otherwise, so that noise about a threshold does not make a maneuver.
"""

from dataclasses import dataclass

from sumo_hmdp.domain.maneuver import ManeuverState, Mode
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState


@dataclass(frozen=True)
class ReadingThresholds:
    """Where a measurement begins and ceases to mean a maneuver.

    A mode stands for an acceleration of +-a, so one beyond a / 2 is nearer to it than to cruising; the band about that
    is a fifth of a to each side. Lane keeping in traffic moves sideways by 0.1 to 0.2 m/s, a lane change of 4 m in 4 s
    by 1 m/s on average.

    Attributes:
        accel_begins: beyond it a mode is read, as a share of the modes' acceleration.
        accel_ceases: a mode that was read stays down to it, likewise.
        lateral_begins: lateral speed from which a lane change is read [m/s].
        lateral_ceases: a lane change that was read stays down to it [m/s].
    """

    accel_begins: float = 0.6
    accel_ceases: float = 0.4
    lateral_begins: float = 0.3
    lateral_ceases: float = 0.15


_STATED = ReadingThresholds()


def read_maneuver(
    vehicle: VehicleState,
    road: Road,
    accel: float,
    last: ManeuverState | None,
    thresholds: ReadingThresholds | None = None,
) -> ManeuverState:
    """Return the lane that a vehicle seems to intend, and its mode.

    Args:
        vehicle: as measured; its own `lane` and `mode` are not looked at.
        road: the road.
        accel: of the modes, positive [m/s2].
        last: what was read of it before, None where it is new.
        thresholds: None takes the stated ones.
    """
    limits = thresholds or _STATED
    return ManeuverState(_lane(vehicle, road, last, limits), _mode(vehicle.accel / accel, last, limits))


def _mode(share: float, last: ManeuverState | None, limits: ReadingThresholds) -> Mode:
    """Return the mode of an acceleration, given as a share of the modes' own (docs/formulation.md, eq. 28)."""
    for mode in (Mode.ACCELERATE, Mode.DECELERATE):
        held = last is not None and last.mode is mode
        if share * mode > (limits.accel_ceases if held else limits.accel_begins):
            return mode
    return Mode.CRUISE


def _lane(vehicle: VehicleState, road: Road, last: ManeuverState | None, limits: ReadingThresholds) -> int:
    """Return the lane it moves toward, or the one it is in (docs/formulation.md, eq. 29)."""
    here = road.lane_at(vehicle.y)
    speed = vehicle.lateral_speed
    ahead = road.lane_headed_for(vehicle.y, speed)
    changing = last is not None and last.lane == ahead != here
    if abs(speed) > (limits.lateral_ceases if changing else limits.lateral_begins):
        return ahead
    return here
