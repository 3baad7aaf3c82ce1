"""Planners to compare with: rules instead of prediction and optimisation."""

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

from pydantic import Field

from sumo_hmdp.decision.lane_rules import Goal, LaneRules, Seen, allowed_accel, limited, merging_room, see
from sumo_hmdp.decision.problem_schema import ENTRIES_MAX, Exponent, NonNegative, Number, Positive
from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.domain.occupancy import body_lanes
from sumo_hmdp.domain.plan import Command, Decision, Note, Status
from sumo_hmdp.domain.scene import Scene
from sumo_hmdp.traffic.drivers import HIGHWAY_CLASSES
from sumo_hmdp.traffic.incentive import Weighed
from sumo_hmdp.traffic.lane_change import LaneChangeRule
from sumo_hmdp.traffic.spawn import IdmParameters
from sumo_hmdp.validation import FileModel

# A rule has no modes: an acceleration below this is recorded as cruising, and nothing depends on it [m/s2].
CRUISE_ACCEL = 0.5
# Slower than this nobody begins a change that has room for its body: it would stand across two lanes [m/s].
LEAST_SPEED = 3.0
# The ego's defaults are those of the mean car of the traffic.
_CAR, _RULE = HIGHWAY_CLASSES[0], LaneChangeRule()

# How hard the planner `constant` brakes before a lower speed limit, as comfortable as the drivers around it [m/s2].
CONSTANT_DECEL = 2.0


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
    """The keys of `idm_mobil` in a scenario; the defaults are those of the mean car of the highway's traffic."""

    # Keys that the planner of this name had while it was the published code.
    moved: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("decel_max_mps2", "lateral_period_s", "leader_range_m"),
        "is a key of `idm_mobil_published`, the published rules; remove it, or name that planner",
    ) | {"occupancy": "is no choice any more: the body always counts; remove it"}

    desired_speed_mps: Positive = _CAR.desired_speed.mean
    min_gap_m: NonNegative = _CAR.min_gap
    time_gap_s: NonNegative = _CAR.time_gap.mean
    accel_mps2: Positive = _CAR.accel
    decel_mps2: Positive = _CAR.decel
    exponent: Exponent = _CAR.exponent
    politeness: NonNegative = _CAR.politeness.mean
    threshold_mps2: NonNegative = _RULE.threshold
    safe_decel_mps2: Positive = _RULE.safe_decel
    least_gap_m: NonNegative = _RULE.least_gap
    interval_s: NonNegative = 4.0
    forbidden_lanes: list[int] = Field(default_factory=list, max_length=ENTRIES_MAX)
    goal: GoalFile | None = None

    def rules(self) -> LaneRules:
        """Return how it follows and chooses lanes."""
        return LaneRules(
            idm=IdmParameters(self.min_gap_m, self.time_gap_s, self.accel_mps2, self.decel_mps2, self.exponent),
            desired_speed=self.desired_speed_mps,
            politeness=self.politeness,
            rule=LaneChangeRule(
                threshold=self.threshold_mps2, safe_decel=self.safe_decel_mps2, least_gap=self.least_gap_m
            ),
            forbidden_lanes=frozenset(self.forbidden_lanes),
        )


@dataclass(frozen=True)
class LaneChangeMemory:
    """What a rule-based planner remembers.

    Attributes:
        free_from: step from which on it may begin a lane change.
    """

    free_from: int = 0


@dataclass(frozen=True)
class IdmMobilPlanner:
    """IDM along the road and MOBIL across it, by the code and the parameters of the traffic.

    It keeps behind the leaders of all lanes that it intends or its body is over, and brakes as hard as the traffic may.
    A change has to be safe for the new follower and for the ego itself, and to have room for its body.

    Attributes:
        dt: control step, and the time between two decisions [s].
        lane_change_time: of the ego [s].
        rules: how it follows and chooses lanes.
        goal: the lane that its route needs, None for no route.
        interval: least time from the end of a change to the next one [s].
        name: as in the registry.
    """

    dt: float
    lane_change_time: float
    rules: LaneRules
    goal: Goal | None = None
    interval: float = 4.0
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
        step, ego = round(scene.time / self.dt), scene.ego
        rules = limited(self.rules, scene, self.lane_change_time)
        seen = see(scene, rules)
        accels = seen.accels()
        over = {ego.lane, *body_lanes(scene.road, ego.y, ego.width)}
        notes: dict[str, Note] = {f"lane_{lane}_accel_mps2": float(accels[lane - 1]) for lane in sorted(over)}
        lateral = Lateral.KEEP
        if step >= memory.free_from and over == {ego.lane}:
            lateral, told = self._choose(scene, seen)
            notes |= told
        else:
            notes["lane_change"] = "under way" if len(over) > 1 else "just made: no other yet"
        if lateral is not Lateral.KEEP:
            memory = LaneChangeMemory(step + steps_of(self.lane_change_time + self.interval, self.dt))
            # From now on it only leaves its lane, perhaps by way of a merging room.
            accels = see(replace(scene, ego=replace(ego, lane=ego.lane + lateral)), rules).accels()
        accel = min(float(accels[lane - 1]) for lane in {*over, ego.lane + lateral})
        # At twice that it comes down to a limit that it is above: its comfortable deceleration.
        accel = min(accel, allowed_accel(scene, ego.lane + lateral, 0.5 * rules.idm.decel, self.dt))
        decision = rule_decision(scene, Command(ego.lane + lateral, accel), lateral)
        return replace(decision, notes=notes, solve_time=time.perf_counter() - started), memory

    def _choose(self, scene: Scene, seen: Seen) -> tuple[Lateral, dict[str, Note]]:
        """Return the safe change with the largest incentive above the threshold, and what speaks for and against each.

        The left one is taken where both are equal.
        """
        ego, rule = scene.ego, seen.rules.rule
        sides = [side for side in (Lateral.LEFT, Lateral.RIGHT) if scene.road.has_lane(ego.lane + side)]
        lanes = [ego.lane + side for side in sides]
        weighed = seen.changes(lanes)
        best, most = Lateral.KEEP, rule.threshold
        notes: dict[str, Note] = {}
        for i, (side, lane) in enumerate(zip(sides, lanes, strict=True)):
            incentive = float(weighed.incentive[i])
            if self.goal is not None:
                incentive += self.goal.pull(ego, lane)
            against = self._against(scene, seen.rules, weighed, i, lane)
            notes[f"lane_{lane}_accel_mps2"] = float(weighed.go[i])
            notes[f"lane_{lane}_incentive_mps2"] = incentive
            notes[f"lane_{lane}_safe"] = f"no: {against}" if against else "yes"
            if not against and incentive > most:
                best, most = side, incentive
        return best, notes

    def _against(self, scene: Scene, rules: LaneRules, weighed: Weighed, i: int, lane: int) -> str:
        """Return why the ego may not change into a lane, empty where it may.

        The bound on its own braking has no exception, unlike the traffic's for who brakes as hard already: two
        accelerations that are clipped alike would hide any danger.
        """
        rule, speed = rules.rule, scene.ego.speed
        ahead, behind = float(weighed.gap_ahead[i]), float(weighed.gap_behind[i])
        room = merging_room(scene) if speed < LEAST_SPEED else -math.inf
        reasons = (
            (lane in rules.forbidden_lanes, "the lane is forbidden"),
            (room is None or ahead < room, f"too slow to begin a change ({speed:.1f} m/s)"),
            (min(ahead, behind) < 0.0, "no room, somebody is beside it"),
            (ahead < rule.least_gap, f"{ahead:.1f} m of room ahead"),
            (behind < rule.least_gap, f"{behind:.1f} m of room behind"),
            (
                weighed.new_follower[i] < -rule.safe_decel,
                f"the follower would have to brake with {-weighed.new_follower[i]:.1f} m/s2",
            ),
            (weighed.go[i] < -rule.safe_decel, f"it would have to brake with {-weighed.go[i]:.1f} m/s2 itself"),
        )
        return next((reason for holds, reason in reasons if holds), "")


class ConstantFile(FileModel):
    """`constant` has no keys."""


@dataclass(frozen=True)
class ConstantPlanner:
    """Keeps lane and speed, whatever the traffic does: the lower end of any comparison.

    Where the road's speed limit is below its speed it comes down to it, by `CONSTANT_DECEL`.

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
        accel = min(0.0, allowed_accel(scene, scene.ego.lane, CONSTANT_DECEL, self.dt))
        return rule_decision(scene, Command(scene.ego.lane, accel), Lateral.KEEP), memory


def rule_decision(scene: Scene, command: Command, lateral: Lateral) -> Decision:
    """Return the decision of a rule: it has no plan, so neither cost nor violation."""
    if abs(command.accel) < CRUISE_ACCEL:
        mode = Mode.CRUISE
    else:
        mode = Mode.ACCELERATE if command.accel > 0.0 else Mode.DECELERATE
    return Decision(
        time=scene.time, status=Status.RULE, command=command, lateral=lateral, mode=mode, violation=None, solver="rule"
    )


def steps_of(duration: float, dt: float) -> int:
    """Return how many steps of dt a duration takes [s], the last one whole."""
    # Rounding may not add a step: 4.2 / 0.6 is 7.000000000000001.
    return math.ceil(duration / dt - 1e-6)
