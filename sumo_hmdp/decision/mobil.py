"""MOBIL: whether a lane change is worth it to its driver, and safe for those behind (docs/formulation.md, eq. 21).

Kesting, Treiber, Helbing, "General lane-changing model MOBIL for car-following models", 2007.
"""

from dataclasses import dataclass

from sumo_hmdp.decision.idm import Idm
from sumo_hmdp.decision.stop_lines import nearest_line
from sumo_hmdp.domain.maneuver import Lateral
from sumo_hmdp.domain.occupancy import LaneState
from sumo_hmdp.domain.scene import EGO_ID, Scene, VehicleState

# Slower than this nobody begins a change that has room for its body: it would stand across two lanes [m/s].
LEAST_SPEED = 3.0


@dataclass(frozen=True)
class Goal:
    """The lane that the ego's route needs, an extension of the published rules: what it adds to the incentive.

    It grows along the road as for the traffic around the ego (docs/formulation.md, eq. 26).

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
class Mobil:
    """Parameters of the lane changes; the defaults are those of the published rule-based baseline.

    Attributes:
        politeness: weight of what both followers gain or lose.
        threshold: incentive above which one changes [m/s2].
        safe_decel: how hard either follower may have to brake after the change, a positive magnitude [m/s2].
        leader_range: a change is considered only while the leader in one's lane is nearer than this, measured
            between the front bumpers [m].
        forbidden_lanes: never changed into.
        goal: the lane that the route needs, None as published.
        swept: whether the body has to have room as well, which as published it has not: beyond safety for both
            followers the ego itself need not brake harder than safe_decel, unless it does so already, both gaps are
            at least the IDM's at standstill, and no change begins below `LEAST_SPEED` but before the end of a lane with
            a merging room that is free in the new lane too.
    """

    politeness: float = 0.3
    threshold: float = 0.10
    safe_decel: float = 3.0
    leader_range: float = 95.0
    forbidden_lanes: frozenset[int] = frozenset()
    goal: Goal | None = None
    swept: bool = False

    def choose(self, scene: Scene, vehicle: VehicleState, idm: Idm) -> Lateral:
        """Return the change with the largest incentive above the threshold, or to keep the lane.

        Args:
            scene: everybody; a vehicle in a lane change counts in its target lane only.
            vehicle: who decides, as in the scene.
            idm: how it and those around it follow their leaders.
        """
        ahead, _ = neighbours(scene, vehicle, vehicle.lane)
        leaders = (ahead, line_ahead(scene, vehicle, vehicle.lane))
        slowed = any(leader is not None and leader.x - vehicle.x < self.leader_range for leader in leaders)
        best, best_incentive = Lateral.KEEP, self.threshold
        for lateral in (Lateral.LEFT, Lateral.RIGHT):
            lane = vehicle.lane + lateral
            if not scene.road.has_lane(lane) or lane in self.forbidden_lanes:
                continue
            if not slowed and self._pull(vehicle, lane) <= 0.0:
                continue
            incentive = self.incentive(scene, vehicle, lane, idm)
            if incentive is not None and incentive > best_incentive:
                best, best_incentive = lateral, incentive
        return best

    def incentive(self, scene: Scene, vehicle: VehicleState, lane: int, idm: Idm) -> float | None:
        """Return the incentive to change into a lane [m/s2], None where the change is not safe.

            a'(vehicle) - a(vehicle) + politeness * sum over both followers of (a' - a) + pull of the goal,

        with the accelerations a before and a' after the change. It is safe where a' >= -safe_decel for both.

        Args:
            scene: everybody.
            vehicle: who would change, as in the scene.
            lane: the one beside its own.
            idm: how all of them follow.
        """
        ahead_here, behind_here = neighbours(scene, vehicle, vehicle.lane)
        ahead_there, behind_there = neighbours(scene, vehicle, lane)
        stay, go = (follow_in_lane(scene, vehicle, there, idm) for there in (vehicle.lane, lane))
        if self.swept and not (go >= min(stay, -self.safe_decel) and self._has_room(scene, vehicle, lane, idm)):
            return None
        incentive = go - stay + self._pull(vehicle, lane)
        for follower, leader_before, leader_after in (
            (behind_there, ahead_there, vehicle),
            (behind_here, vehicle, ahead_here),
        ):
            if follower is None:
                continue
            accel = idm.follow(follower, leader_after)
            if accel < -self.safe_decel:
                return None
            incentive += self.politeness * (accel - idm.follow(follower, leader_before))
        return incentive

    def _pull(self, vehicle: VehicleState, lane: int) -> float:
        return 0.0 if self.goal is None else self.goal.pull(vehicle, lane)

    @staticmethod
    def _has_room(scene: Scene, vehicle: VehicleState, lane: int, idm: Idm) -> bool:
        ahead, behind = neighbours(scene, vehicle, lane)
        leaders = [
            leader.x - leader.length for leader in (ahead, line_ahead(scene, vehicle, lane)) if leader is not None
        ]
        gaps = [rear - vehicle.x for rear in leaders]
        if vehicle.speed < LEAST_SPEED:
            room = merging_room(scene, vehicle)
            if room is None or any(gap < room for gap in gaps):
                return False
        gaps += [] if behind is None else [vehicle.x - vehicle.length - behind.x]
        return all(gap >= idm.min_gap for gap in gaps)


def follow_in_lane(scene: Scene, vehicle: VehicleState, lane: int, idm: Idm) -> float:
    """Return the acceleration in a lane [m/s2]: behind the vehicle ahead or a stop line, whichever asks for less.

    The line counts even where a vehicle is before it, which may pass it before it turns up as the next leader.
    """
    ahead, _ = neighbours(scene, vehicle, lane)
    return min(idm.follow(vehicle, ahead), idm.follow(vehicle, line_ahead(scene, vehicle, lane)))


def line_ahead(scene: Scene, vehicle: VehicleState, lane: int) -> VehicleState | None:
    """Return the nearest stop line ahead in a lane as a leader that stands there, None for all but the ego."""
    line = nearest_line(vehicle, scene.stop_lines, LaneState(lane)) if vehicle.id == EGO_ID else None
    return None if line is None else VehicleState("stop line", line.x, vehicle.y, 0.0, lane, length=0.0)


def merging_room(scene: Scene, vehicle: VehicleState) -> float | None:
    """Return how far a vehicle may go while it leaves a lane that ends [m], None where no line says so."""
    line = nearest_line(vehicle, scene.stop_lines, LaneState(vehicle.lane)) if vehicle.id == EGO_ID else None
    if line is None or line.leaving_x is None or line.leaving_x <= line.x:
        return None
    return line.leaving_x - vehicle.x


def leader_in_lane(scene: Scene, vehicle: VehicleState, lane: int) -> VehicleState | None:
    """Return the nearest vehicle ahead that intends a lane or has its front centre in it, None where there is none."""
    ahead = (v for v in scene.others if v.x > vehicle.x and lane in {v.lane, scene.road.lane_at(v.y)})
    return min(ahead, key=_x, default=None)


def neighbours(scene: Scene, vehicle: VehicleState, lane: int) -> tuple[VehicleState | None, VehicleState | None]:
    """Return the nearest vehicles ahead and behind whose intended lane is `lane`; one side by side is behind."""
    in_lane = [other for other in (scene.ego, *scene.others) if other.id != vehicle.id and other.lane == lane]
    ahead = min((other for other in in_lane if other.x > vehicle.x), key=_x, default=None)
    behind = max((other for other in in_lane if other.x <= vehicle.x), key=_x, default=None)
    return ahead, behind


def _x(vehicle: VehicleState) -> float:
    return vehicle.x
