"""MOBIL: whether a lane change is worth it to its driver, and safe for those behind (docs/formulation.md, eq. 21).

Kesting, Treiber, Helbing, "General lane-changing model MOBIL for car-following models", 2007.
"""

from dataclasses import dataclass

from sumo_hmdp.domain.maneuver import Lateral
from sumo_hmdp.domain.scene import EGO_ID, Scene, VehicleState
from sumo_hmdp.planning.idm import Idm
from sumo_hmdp.planning.stop_lines import nearest_line


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
    """

    politeness: float = 0.3
    threshold: float = 0.10
    safe_decel: float = 3.0
    leader_range: float = 95.0
    forbidden_lanes: frozenset[int] = frozenset()

    def choose(self, scene: Scene, vehicle: VehicleState, idm: Idm) -> Lateral:
        """Return the change with the largest incentive above the threshold, or to keep the lane.

        Args:
            scene: everybody; a vehicle in a lane change counts in its target lane only.
            vehicle: who decides, as in the scene.
            idm: how it and those around it follow their leaders.
        """
        ahead, _ = neighbours(scene, vehicle, vehicle.lane)
        leaders = (ahead, line_ahead(scene, vehicle, vehicle.lane))
        if all(leader is None or leader.x - vehicle.x >= self.leader_range for leader in leaders):
            return Lateral.KEEP
        best, best_incentive = Lateral.KEEP, self.threshold
        for lateral in (Lateral.LEFT, Lateral.RIGHT):
            lane = vehicle.lane + lateral
            if not scene.road.has_lane(lane) or lane in self.forbidden_lanes:
                continue
            incentive = self.incentive(scene, vehicle, lane, idm)
            if incentive is not None and incentive > best_incentive:
                best, best_incentive = lateral, incentive
        return best

    def incentive(self, scene: Scene, vehicle: VehicleState, lane: int, idm: Idm) -> float | None:
        """Return the incentive to change into a lane [m/s2], None where the change is not safe.

            a'(vehicle) - a(vehicle) + politeness * sum over both followers of (a' - a),

        with the accelerations a before and a' after the change. It is safe where a' >= -safe_decel for both.

        Args:
            scene: everybody.
            vehicle: who would change, as in the scene.
            lane: the one beside its own.
            idm: how all of them follow.
        """
        ahead_here, behind_here = neighbours(scene, vehicle, vehicle.lane)
        ahead_there, behind_there = neighbours(scene, vehicle, lane)
        incentive = follow_in_lane(scene, vehicle, lane, idm) - follow_in_lane(scene, vehicle, vehicle.lane, idm)
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


def follow_in_lane(scene: Scene, vehicle: VehicleState, lane: int, idm: Idm) -> float:
    """Return the acceleration in a lane [m/s2]: behind the vehicle ahead or a stop line, whichever asks for less.

    The line counts even where a vehicle is before it, which may pass it before it turns up as the next leader.
    """
    ahead, _ = neighbours(scene, vehicle, lane)
    return min(idm.follow(vehicle, ahead), idm.follow(vehicle, line_ahead(scene, vehicle, lane)))


def line_ahead(scene: Scene, vehicle: VehicleState, lane: int) -> VehicleState | None:
    """Return the nearest stop line ahead in a lane as a leader that stands there, None for all but the ego."""
    line = nearest_line(vehicle, scene.stop_lines, {lane}) if vehicle.id == EGO_ID else None
    return None if line is None else VehicleState("stop line", line.x, vehicle.y, 0.0, lane, length=0.0)


def neighbours(scene: Scene, vehicle: VehicleState, lane: int) -> tuple[VehicleState | None, VehicleState | None]:
    """Return the nearest vehicles ahead and behind whose intended lane is `lane`; one side by side is behind."""
    in_lane = [other for other in (scene.ego, *scene.others) if other.id != vehicle.id and other.lane == lane]
    ahead = min((other for other in in_lane if other.x > vehicle.x), key=_x, default=None)
    behind = max((other for other in in_lane if other.x <= vehicle.x), key=_x, default=None)
    return ahead, behind


def _x(vehicle: VehicleState) -> float:
    return vehicle.x
