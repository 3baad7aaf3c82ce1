"""The planner `sumo`: SUMO drives the ego as it drives its own vehicles, and the planner reports what it does."""

import math
from dataclasses import dataclass, replace

from pydantic import Field

from sumo_hmdp.decision.baselines import rule_decision
from sumo_hmdp.decision.problem_schema import NonNegative, Positive
from sumo_hmdp.domain.maneuver import Lateral
from sumo_hmdp.domain.plan import Command, Decision
from sumo_hmdp.domain.scene import Scene
from sumo_hmdp.validation import FileModel


@dataclass(frozen=True)
class SumoDriver:
    """How SUMO drives the ego: its IDM along the road, its LC2013 across it.

    Attributes:
        lane_change_time: from one lane's centre to the next [s], at constant lateral speed.
        desired_speed: on a free road [m/s]; an ego that starts faster, in traffic, comes down to it by `decel`.
        min_gap: gap at standstill [m].
        time_gap: desired [s].
        accel: largest acceleration [m/s2].
        decel: comfortable deceleration, positive [m/s2]; SUMO lets an emergency reach 9.
        exponent: of the free-road term.
        speed_gain: eagerness to change lanes for speed, SUMO's lcSpeedGain; 0 never does.
        keep_right: eagerness to return to the right, SUMO's lcKeepRight; 0 never does.
        assertive: by what factor it accepts smaller gaps, SUMO's lcAssertive.
        forbidden_lanes: lanes that it never enters.
    """

    lane_change_time: float
    desired_speed: float = 30.0
    min_gap: float = 2.0
    time_gap: float = 1.5
    accel: float = 1.5
    decel: float = 2.0
    exponent: float = 4.0
    speed_gain: float = 1.0
    keep_right: float = 0.0
    assertive: float = 1.0
    forbidden_lanes: frozenset[int] = frozenset()


class SumoFile(FileModel):
    """The keys of `sumo` in a scenario.

    Along the road the defaults are those of a surrounding vehicle with the driver `idm`, so that the ego drives like
    its traffic; the desired speed is that of `idm_mobil`. Across it they are SUMO's own, but for keeping right: no
    other planner has such a rule, and neither has the traffic. SUMO's own value is 1. Nor is it forbidden to
    overtake on the right, to anybody.
    """

    desired_speed_mps: Positive = 30.0
    min_gap_m: Positive = 2.0
    time_gap_s: Positive = 1.5
    accel_mps2: Positive = 1.5
    decel_mps2: Positive = 2.0
    exponent: Positive = 4.0
    speed_gain_weight: NonNegative = 1.0
    keep_right_weight: NonNegative = 0.0
    assertive_weight: Positive = 1.0
    forbidden_lanes: list[int] = Field(default_factory=list)

    def driver(self, lane_change_time: float) -> SumoDriver:
        """Return what SUMO is told.

        Args:
            lane_change_time: of the ego [s].
        """
        return SumoDriver(
            lane_change_time=lane_change_time,
            desired_speed=self.desired_speed_mps,
            min_gap=self.min_gap_m,
            time_gap=self.time_gap_s,
            accel=self.accel_mps2,
            decel=self.decel_mps2,
            exponent=self.exponent,
            speed_gain=self.speed_gain_weight,
            keep_right=self.keep_right_weight,
            assertive=self.assertive_weight,
            forbidden_lanes=frozenset(self.forbidden_lanes),
        )


@dataclass(frozen=True)
class SumoPlanner:
    """Decides nothing: it reads off the scene what SUMO has decided, and nobody carries out its commands.

    SUMO decides on a lane change at the end of a step, from the positions that it has just reached, and makes the
    first lateral step at once. So a change is reported at the instant of those positions, and there y is already a
    step's worth off the lane's centre. The acceleration reported is that of the step before.

    Attributes:
        dt: time between two reports [s].
        name: as in the registry.
    """

    dt: float
    name: str = "sumo"

    @property
    def period(self) -> float:
        """Time between two reports [s]: every control step."""
        return self.dt

    def initial_memory(self) -> None:
        """Return None: nothing is remembered."""

    def decide(self, scene: Scene, memory: None) -> tuple[Decision, None]:
        """Report one scene; `lateral` is not `keep` only where a lane change begins.

        Args:
            scene: the ego's lane in it is the one it has intended up to now.
            memory: None.
        """
        ego = scene.ego
        lane = scene.road.lane_headed_for(ego.y, ego.lateral_speed)
        lateral = Lateral((lane > ego.lane) - (lane < ego.lane))
        decision = rule_decision(scene, Command(lane, ego.accel), lateral)
        # SUMO decides within its step, so its time cannot be told from that of the simulation.
        return replace(decision, solver="sumo", solve_time=math.nan), memory
