"""The rule-based baseline that was published with the paper, as it was published: IDM and MOBIL for an open motorway.

It is not a careful driver: it asks nothing of its own braking and of the room for its body, brakes with at most 5 m/s2,
and so changes into gaps that end in contact in dense traffic. `idm_mobil` is the baseline for everything else.
"""

import time
from dataclasses import dataclass, field, replace

from pydantic import Field

from sumo_hmdp.decision.baselines import LaneChangeMemory, rule_decision, steps_of
from sumo_hmdp.decision.lane_rules import LaneRules, Seen, allowed_accel, limited, see
from sumo_hmdp.decision.problem_schema import NonNegative, Positive
from sumo_hmdp.domain.maneuver import Lateral
from sumo_hmdp.domain.plan import Command, Decision, Note
from sumo_hmdp.domain.scene import Scene
from sumo_hmdp.traffic.car_following import PUBLISHED_IDM
from sumo_hmdp.traffic.lane_change import LaneChangeRule
from sumo_hmdp.traffic.spawn import IdmParameters
from sumo_hmdp.validation import FileModel

PUBLISHED_RULE = LaneChangeRule(threshold=0.10, safe_decel=3.0, least_gap=0.0, published=True, idm=PUBLISHED_IDM)


class PublishedFile(FileModel):
    """The keys of `idm_mobil_published` in a scenario; the defaults are the published values."""

    desired_speed_mps: Positive = 30.0
    min_gap_m: NonNegative = 2.0
    time_gap_s: NonNegative = 1.5
    accel_mps2: Positive = 8.0
    decel_mps2: Positive = 4.0
    exponent: Positive = 6.0
    decel_max_mps2: Positive = PUBLISHED_IDM.decel_max
    lateral_period_s: Positive = 0.6
    politeness: NonNegative = 0.3
    threshold_mps2: NonNegative = PUBLISHED_RULE.threshold
    safe_decel_mps2: Positive = PUBLISHED_RULE.safe_decel
    leader_range_m: NonNegative = 95.0
    forbidden_lanes: list[int] = Field(default_factory=list)

    def rules(self) -> LaneRules:
        """Return how it follows and chooses lanes."""
        return LaneRules(
            idm=IdmParameters(self.min_gap_m, self.time_gap_s, self.accel_mps2, self.decel_mps2, self.exponent),
            desired_speed=self.desired_speed_mps,
            politeness=self.politeness,
            rule=replace(
                PUBLISHED_RULE,
                threshold=self.threshold_mps2,
                safe_decel=self.safe_decel_mps2,
                idm=replace(PUBLISHED_IDM, decel_max=self.decel_max_mps2),
            ),
            forbidden_lanes=frozenset(self.forbidden_lanes),
        )


@dataclass(frozen=True)
class PublishedPlanner:
    """IDM along the road at every step, MOBIL across it in steps that end at a multiple of `lateral_period`.

    In its eyes a vehicle, itself included, is in the lane that it intends and in no other, and everybody drives like
    itself.

    Attributes:
        dt: control step, and the time between two decisions along the road [s].
        lane_change_time: of the ego [s].
        lateral_period: time between two decisions across the road [s], a multiple of dt.
        leader_range: a change is considered only while the leader in its lane is nearer than this, measured between the
            front bumpers [m].
        rules: how it follows and chooses lanes.
        name: as in the registry.
    """

    dt: float
    lane_change_time: float
    lateral_period: float = 0.6
    leader_range: float = 95.0
    rules: LaneRules = field(default_factory=PublishedFile().rules)
    name: str = "idm_mobil_published"

    @property
    def period(self) -> float:
        """Time between two decisions [s]: every control step."""
        return self.dt

    def initial_memory(self) -> LaneChangeMemory:
        """Return the memory of an ego that is in no lane change."""
        return LaneChangeMemory()

    def decide(self, scene: Scene, memory: LaneChangeMemory) -> tuple[Decision, LaneChangeMemory]:
        """Answer one scene; `lateral` is not `keep` only where a lane change begins.

        Args:
            scene: the ego's lane in it is the one it intends.
            memory: from the step before.
        """
        started = time.perf_counter()
        step = round(scene.time / self.dt)
        rules = limited(self.rules, scene, self.lane_change_time)
        seen = see(scene, rules)
        accels = seen.accels()
        notes: dict[str, Note] = {f"lane_{scene.ego.lane}_accel_mps2": float(accels[scene.ego.lane - 1])}
        lateral = Lateral.KEEP
        if step >= memory.free_from and self._ends_a_lateral_period(step):
            lateral, told = self._choose(scene, seen)
            notes |= told
        if lateral is not Lateral.KEEP:
            memory = LaneChangeMemory(step + steps_of(self.lane_change_time, self.dt))
        lane = scene.ego.lane + lateral
        accel = min(float(accels[lane - 1]), allowed_accel(scene, lane, 0.5 * rules.idm.decel, self.dt))
        decision = rule_decision(scene, Command(lane, accel), lateral)
        return replace(decision, notes=notes, solve_time=time.perf_counter() - started), memory

    def _choose(self, scene: Scene, seen: Seen) -> tuple[Lateral, dict[str, Note]]:
        """Return the change with the largest incentive above the threshold, and what speaks for and against each.

        The incentive is that of docs/formulation.md, eq. 21; stop lines (eq. 23) are leaders that stand.
        """
        ego = scene.ego
        ahead = [other.x for other in scene.others if other.lane == ego.lane and other.x > ego.x]
        nearest = min([*ahead, float(seen.ends[-1, ego.lane - 1])])
        if not nearest - ego.x < self.leader_range:
            return Lateral.KEEP, {"lane_change": f"not considered: nobody within {self.leader_range:g} m ahead"}
        sides = [side for side in (Lateral.LEFT, Lateral.RIGHT) if scene.road.has_lane(ego.lane + side)]
        lanes = [ego.lane + side for side in sides]
        weighed = seen.changes(lanes)
        best, most = Lateral.KEEP, seen.rules.rule.threshold
        notes: dict[str, Note] = {}
        for i, (side, lane) in enumerate(zip(sides, lanes, strict=True)):
            incentive, safe = float(weighed.incentive[i]), bool(weighed.safe[i])
            forbidden = lane in seen.rules.forbidden_lanes
            notes[f"lane_{lane}_accel_mps2"] = float(weighed.go[i])
            notes[f"lane_{lane}_incentive_mps2"] = incentive
            against = "the lane is forbidden" if forbidden else "a follower would have to brake too hard"
            notes[f"lane_{lane}_safe"] = "yes" if safe and not forbidden else f"no: {against}"
            if safe and not forbidden and incentive > most:
                best, most = side, incentive
        return best, notes

    def _ends_a_lateral_period(self, step: int) -> bool:
        return (step + 1) % round(self.lateral_period / self.dt) == 0
