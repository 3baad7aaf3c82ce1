"""A scene as the arrays of the traffic's IDM and MOBIL, so that rule-based planners drive by the same code.

The ego is the last row: of two at the same x the later one counts as ahead, and whoever is level with the ego is
behind it.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from sumo_hmdp.decision.stop_lines import nearest_line
from sumo_hmdp.domain.maneuver import Lateral
from sumo_hmdp.domain.occupancy import LaneState, body_lanes
from sumo_hmdp.domain.scene import Scene, VehicleState
from sumo_hmdp.traffic.car_following import Drivers, FloatArray
from sumo_hmdp.traffic.incentive import Weighed, accel_in_lanes, weigh_changes
from sumo_hmdp.traffic.lane_change import LaneChangeRule, Vehicles
from sumo_hmdp.traffic.spawn import IdmParameters

# What drivers take a standing vehicle's desired speed to be; the IDM divides by it [m/s].
_LEAST_DESIRED_SPEED = 1.0


@dataclass(frozen=True)
class Goal:
    """The lane that the ego's route needs: what it adds to the incentive, growing along the road (eq. 26).

    Attributes:
        lane: to be in.
        x: by where [m].
        distance: how far before x the incentive begins to grow from 0 [m].
        bias: what a change toward the lane gains at x, and one away from it loses [m/s2].
    """

    lane: int
    x: float
    distance: float
    bias: float

    def pull(self, vehicle: VehicleState, lane: int) -> float:
        """Return what is added to the incentive to change into a lane [m/s2]; nothing once x is passed."""
        if vehicle.x > self.x:
            return 0.0
        share = max(0.0, 1.0 - (self.x - vehicle.x) / self.distance)
        return self.bias * share * (abs(vehicle.lane - self.lane) - abs(lane - self.lane))


@dataclass(frozen=True)
class LaneRules:
    """How a rule-based ego follows and chooses lanes.

    Attributes:
        idm: how it follows, and how it takes everybody to follow.
        desired_speed: its own on a free road [m/s].
        politeness: weight of what followers gain or lose by its change.
        rule: when a change is safe and worth it, and which variant of the models counts.
        forbidden_lanes: never changed into.
    """

    idm: IdmParameters
    desired_speed: float
    politeness: float
    rule: LaneChangeRule
    forbidden_lanes: frozenset[int] = field(default_factory=frozenset)


@dataclass(frozen=True)
class Seen:
    """A scene in arrays.

    Attributes:
        vehicles: the others in the scene's order, then the ego.
        ends: x where stop lines close each lane to the ego, infinite for all others [m], shape (n, lane_count).
        rules: of the ego.
        lane_count: of the road.
    """

    vehicles: Vehicles
    ends: FloatArray
    rules: LaneRules
    lane_count: int

    @property
    def ego(self) -> int:
        """The ego's row."""
        return len(self.vehicles.x) - 1

    def accels(self) -> FloatArray:
        """Return the ego's acceleration behind the leader, and before the stop line, of every lane [m/s2]."""
        rule = self.rules.rule
        return accel_in_lanes(self.vehicles, rule.idm, self.ego, self.ends, self.lane_count, by_front=rule.published)

    def changes(self, lanes: list[int]) -> Weighed:
        """Return what the ego's changes into lanes beside its own would mean."""
        return weigh_changes(self.vehicles, self.rules.rule, self.ego, np.array(lanes), self.ends, self.lane_count)


def see(scene: Scene, rules: LaneRules) -> Seen:
    """Return a scene in arrays.

    As published everybody is in the lane that it intends and drives like the ego. Otherwise a vehicle is in every lane
    that it intends or that its body is over (two at most), and wants to keep the speed that it has, as the traffic
    takes vehicles that it does not know.
    """
    everybody = (*scene.others, scene.ego)
    published = rules.rule.published
    speeds = np.array([one.speed for one in everybody])
    count = len(everybody)
    desired = np.full(count, rules.desired_speed)
    if not published:
        desired[:-1] = np.maximum(speeds[:-1], _LEAST_DESIRED_SPEED)
    idm = rules.idm
    numbers = (idm.min_gap, idm.time_gap, idm.accel, idm.decel, idm.exponent)
    return Seen(
        vehicles=Vehicles(
            x=np.array([one.x for one in everybody]),
            speed=speeds,
            lane=np.array([one.lane for one in everybody]),
            second_lane=np.array([0 if published else _second_lane(scene, one) for one in everybody]),
            length=np.array([one.length for one in everybody]),
            politeness=np.full(count, rules.politeness),
            drivers=Drivers(desired, *(np.full(count, number) for number in numbers)),
        ),
        ends=lane_ends(scene, published=published),
        rules=rules,
        lane_count=scene.road.lane_count,
    )


def lane_ends(scene: Scene, *, published: bool) -> FloatArray:
    """Return where stop lines close each lane to the ego [m], shape (n, lane_count); the ego is the last row.

    Into the merging room behind a line (`leaving_x`) the ego may only go while its body leaves that lane; in the eyes
    of the published rules it has left it at once.
    """
    ego, count = scene.ego, scene.road.lane_count
    left = set() if published else {*body_lanes(scene.road, ego.y, ego.width)} - {ego.lane}
    ends = np.full((len(scene.others) + 1, count), np.inf)
    for lane in range(1, count + 1):
        lines = [line for line in scene.stop_lines if lane in line.lanes]
        line = nearest_line(ego, lines, LaneState(ego.lane, ((lane, 1),)) if lane in left else LaneState(lane))
        ends[-1, lane - 1] = math.inf if line is None else line.x
    return ends


def merging_room(scene: Scene) -> float | None:
    """Return how far the ego may go while it leaves a lane that ends [m], None where no line says so."""
    line = nearest_line(scene.ego, scene.stop_lines, LaneState(scene.ego.lane))
    if line is None or line.leaving_x is None or line.leaving_x <= line.x:
        return None
    return line.leaving_x - scene.ego.x


def _second_lane(scene: Scene, vehicle: VehicleState) -> int:
    """Return another lane than the intended one that a body is over, the one that it covers most; 0 for none."""
    over = [lane for lane in body_lanes(scene.road, vehicle.y, vehicle.width) if lane != vehicle.lane]
    return min(over, key=lambda lane: abs(scene.road.center_y(lane) - vehicle.y), default=0)


def limited(rules: LaneRules, scene: Scene, duration: float) -> LaneRules:
    """Return rules that want no more than the speed limit where the ego is, and change lanes only where it is allowed.

    A lane beside the ego's counts as forbidden while its body would cross a solid line.

    Args:
        rules: of the ego.
        scene: the scene.
        duration: of a lane change, during which the ego gets no faster than it wants to be, or is [s].
    """
    ego = scene.ego
    # Never below its own speed, where the free-road term would brake far harder than a limit asks (`allowed_accel`).
    speed = min(rules.desired_speed, max(ego.speed, scene.rules.speed_limit(ego.lane, ego.x)))
    ahead = ego.x + max(ego.speed, speed) * duration
    barred = {
        ego.lane + lateral
        for lateral in (Lateral.LEFT, Lateral.RIGHT)
        if not scene.rules.may_change(ego.lane, lateral, ego.x - ego.length, ahead)
    }
    return replace(rules, desired_speed=speed, forbidden_lanes=rules.forbidden_lanes | barred)


def allowed_accel(scene: Scene, lane: int, decel: float, dt: float) -> float:
    """Return the greatest acceleration of the ego in a step of dt [s] by the road's speed limits in a lane [m/s2]."""
    return scene.rules.allowed_accel(lane, scene.ego.x, scene.ego.speed, decel, dt)
