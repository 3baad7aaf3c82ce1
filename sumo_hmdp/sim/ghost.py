"""Where a vehicle that straddles a line needs a second image, so that followers in both lanes see it.

SUMO keeps a vehicle in the one lane that holds its front centre. Followers in the other lane drive as if it
were not there and brake hard when it jumps over. A ghost stands in for it in the lane that SUMO does not see.
"""

import math
from dataclasses import replace

from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import VehicleState

_TOUCHING = 1e-6


def image_lane(y: float, road: Road) -> int:
    """Return the lane in which SUMO sees a front centre at y [m]; on a line, the lane to its right."""
    lane = math.floor((road.lane_count + 1) / 2 - y / road.lane_width + 0.5)
    return min(max(lane, 1), road.lane_count)


def body_y_range(vehicle: VehicleState) -> tuple[float, float]:
    """Return the lowest and highest y that the rectangular body covers [m]."""
    y_rear = vehicle.y - vehicle.length * math.sin(vehicle.heading)
    half = 0.5 * vehicle.width * math.cos(vehicle.heading)
    return min(vehicle.y, y_rear) - half, max(vehicle.y, y_rear) + half


def second_lane(vehicle: VehicleState, road: Road) -> int | None:
    """Return the lane beside the vehicle's own that its body reaches into, None where there is none.

    Where it reaches into both neighbours, which takes an extreme heading, the one that it covers more of.

    Args:
        vehicle: with |heading| < pi/2.
        road: the road it is on.
    """
    low, high = body_y_range(vehicle)
    own = image_lane(vehicle.y, road)
    half_lane = 0.5 * road.lane_width
    best, best_overlap = None, _TOUCHING
    for lane in (own - 1, own + 1):
        if not road.has_lane(lane):
            continue
        center = road.center_y(lane)
        overlap = min(high, center + half_lane) - max(low, center - half_lane)
        if overlap > best_overlap:
            best, best_overlap = lane, overlap
    return best


def ghost_of(vehicle: VehicleState, road: Road, last_lane: int | None) -> VehicleState | None:
    """Return where the vehicle's ghost must be, or None where it needs none.

    The ghost stands on a lane centre beside the vehicle, with its speed. It moves along in the step in which
    the body returns to one lane, because followers react to the state before the step; then it can go.

    Args:
        vehicle: as it will be at the end of the step.
        road: the road it is on.
        last_lane: the lane of its ghost until now, None where it has none.
    """
    lane = second_lane(vehicle, road) or last_lane
    if lane is None or lane == image_lane(vehicle.y, road):
        return None
    return replace(vehicle, y=road.center_y(lane), heading=0.0, lane=lane)
