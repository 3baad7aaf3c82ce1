"""Planners to compare with: rules instead of prediction and optimisation."""

import math
import time
from dataclasses import dataclass, field, replace
from typing import Literal

from pydantic import Field

from sumo_hmdp.decision.idm import Idm
from sumo_hmdp.decision.mobil import Goal, Mobil, follow_in_lane, leader_in_lane
from sumo_hmdp.decision.problem_schema import ENTRIES_MAX, Exponent, NonNegative, Number, Positive
from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.domain.occupancy import body_lanes
from sumo_hmdp.domain.plan import Command, Decision, Status
from sumo_hmdp.domain.scene import Scene
from sumo_hmdp.validation import FileModel

# A rule has no modes: an acceleration below this is recorded as cruising, and nothing depends on it [m/s2].
CRUISE_ACCEL = 0.5


class GoalFile(FileModel):
    """`goal` of `idm_mobil`: the lane that the route needs, and by where.

    The numbers with a default are those of the traffic around the ego.
    """

    lane: int
    x_m: Number
    bias_mps2: NonNegative = 2.0
    time_s: Positive = 30.0

    def goal(self, desired_speed: float) -> Goal:
        """Return the goal of a driver with a desired speed [m/s]."""
        return Goal(lane=self.lane, x=self.x_m, distance=self.time_s * desired_speed, bias=self.bias_mps2)


class IdmMobilFile(FileModel):
    """The keys of `idm_mobil` in a scenario; the defaults are those of the published rule-based baseline.

    `occupancy: swept` and `goal` are extensions, for roads with junctions and routes. As published a vehicle in a lane
    change counts in its target lane only, the ego for itself too, and nobody has a route.
    """

    desired_speed_mps: Positive = 30.0
    min_gap_m: NonNegative = 2.0
    time_gap_s: NonNegative = 1.5
    accel_mps2: Positive = 8.0
    decel_mps2: Positive = 4.0
    exponent: Exponent = 6.0
    decel_max_mps2: Positive = 5.0
    lateral_period_s: Positive = 0.6
    politeness: NonNegative = 0.3
    threshold_mps2: NonNegative = 0.10
    safe_decel_mps2: Positive = 3.0
    leader_range_m: NonNegative = 95.0
    forbidden_lanes: list[int] = Field(default_factory=list, max_length=ENTRIES_MAX)
    occupancy: Literal["target", "swept"] = "target"
    goal: GoalFile | None = None

    def idm(self) -> Idm:
        """Return the car-following model."""
        return Idm(
            desired_speed=self.desired_speed_mps,
            min_gap=self.min_gap_m,
            time_gap=self.time_gap_s,
            accel=self.accel_mps2,
            decel=self.decel_mps2,
            exponent=self.exponent,
            decel_max=self.decel_max_mps2,
        )

    def mobil(self) -> Mobil:
        """Return the lane-change model."""
        goal = None if self.goal is None else self.goal.goal(self.desired_speed_mps)
        return Mobil(
            politeness=self.politeness,
            threshold=self.threshold_mps2,
            safe_decel=self.safe_decel_mps2,
            leader_range=self.leader_range_m,
            forbidden_lanes=frozenset(self.forbidden_lanes),
            goal=goal,
            swept=self.occupancy == "swept",
        )


@dataclass(frozen=True)
class LaneChangeMemory:
    """What the rule-based planner remembers.

    Attributes:
        free_from: the first step in which its latest lane change is over.
    """

    free_from: int = 0


@dataclass(frozen=True)
class IdmMobilPlanner:
    """The published rule-based baseline: IDM along the road, MOBIL across it (docs/formulation.md, section 13).

    The published loop names a step by its end: what it does "at 6.0 s" it decides from everybody's state at
    5.85 s. So a lane change may begin in every step that ENDS at a multiple of the lateral period, and no
    earlier than 0.6 s; the decision is recorded at the beginning of that step, and 6.0 s is the first instant
    at which the ego is off its lane's centre. All vehicles react to the state at the beginning of a step and
    then move at once. A change lasts for the first whole number of steps that covers its time (54 steps, 8.1 s,
    for 8 s), during which the next one is not considered. From the very step in which it begins, the ego
    counts in its target lane only, for itself and for those behind it.

    Attributes:
        dt: control step, and the time between two decisions along the road [s].
        lane_change_time: of the ego [s].
        lateral_period: time between two decisions across the road [s], a multiple of dt.
        idm: how it, and in its mind everybody, follows a leader.
        mobil: when it changes lanes.
        name: as in the registry.
    """

    dt: float
    lane_change_time: float
    lateral_period: float = 0.6
    idm: Idm = field(default_factory=Idm)
    mobil: Mobil = field(default_factory=Mobil)
    name: str = "idm_mobil"

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
        lateral = Lateral.KEEP
        if step >= memory.free_from and self._ends_a_lateral_period(step):
            lateral = self.mobil.choose(scene, scene.ego, self.idm)
        if lateral is not Lateral.KEEP:
            # Rounding may not add a step: 4.2 / 0.6 is 7.000000000000001.
            memory = LaneChangeMemory(step + math.ceil(self.lane_change_time / self.dt - 1e-6))
        lane = scene.ego.lane + lateral
        accel = min(follow_in_lane(scene, scene.ego, lane, self.idm), self._behind_others(scene))
        decision = rule_decision(scene, Command(lane, accel), lateral)
        return replace(decision, solve_time=time.perf_counter() - started), memory

    def _behind_others(self, scene: Scene) -> float:
        """Return the acceleration behind the leaders of all lanes that the ego's body is over [m/s2]."""
        if not self.mobil.swept:
            return math.inf
        over = body_lanes(scene.road, scene.ego.y, scene.ego.width)
        return min(self.idm.follow(scene.ego, leader_in_lane(scene, scene.ego, lane)) for lane in over)

    def _ends_a_lateral_period(self, step: int) -> bool:
        return (step + 1) % round(self.lateral_period / self.dt) == 0


class ConstantFile(FileModel):
    """`constant` has no keys."""


@dataclass(frozen=True)
class ConstantPlanner:
    """Keeps lane and speed, whatever happens: the lower end of any comparison.

    Attributes:
        dt: time between two decisions [s].
        name: as in the registry.
    """

    dt: float
    name: str = "constant"

    @property
    def period(self) -> float:
        """Time between two decisions [s]."""
        return self.dt

    def initial_memory(self) -> None:
        """Return None: nothing is remembered."""

    def decide(self, scene: Scene, memory: None) -> tuple[Decision, None]:
        """Answer one scene."""
        return rule_decision(scene, Command(scene.ego.lane, 0.0), Lateral.KEEP), memory


def rule_decision(scene: Scene, command: Command, lateral: Lateral) -> Decision:
    """Return the decision of a rule: it has no plan, so neither cost nor violation."""
    if abs(command.accel) < CRUISE_ACCEL:
        mode = Mode.CRUISE
    else:
        mode = Mode.ACCELERATE if command.accel > 0.0 else Mode.DECELERATE
    return Decision(
        time=scene.time, status=Status.RULE, command=command, lateral=lateral, mode=mode, violation=None, solver="rule"
    )
