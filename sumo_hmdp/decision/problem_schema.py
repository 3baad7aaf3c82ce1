"""The file form of a decision problem: its keys, their types and their ranges."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Discriminator, Field, Tag

from sumo_hmdp.decision.problem import (
    DecisionProblem,
    ManeuverSequence,
    PlannerSettings,
    Preferences,
    RiskAllocation,
    WayOut,
)
from sumo_hmdp.domain.distance import DistanceRule, RssParameters
from sumo_hmdp.domain.maneuver import LATERAL_BY_LABEL, MODE_BY_LABEL
from sumo_hmdp.domain.occupancy import Occupancy
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.road_rules import NoChange, RoadRules, SpeedZone
from sumo_hmdp.domain.scene import EGO_ID, StopLine, VehicleState
from sumo_hmdp.prediction.branches import PredictedVehicle
from sumo_hmdp.prediction.dynamics import LateralGains, Noise
from sumo_hmdp.prediction.lateral import LaneFollowing
from sumo_hmdp.prediction.policy import Policy, Probabilities
from sumo_hmdp.validation import FileModel

# Of a road, and of the lists in a file; far beyond any use, so that a file cannot cost more than it is worth.
LANES_MAX, VEHICLES_MAX, ENTRIES_MAX, NAME_MAX, HORIZON_MAX = 12, 500, 1000, 100, 20


def _not_tiny(value: float) -> float:
    """Refuse what would be divided by although it is nearly nothing."""
    if value < 1e-3:
        raise ValueError("must be at least 0.001")
    return value


# Beyond these no road, car or price is meant, and the arithmetic of a decision would overflow.
Number = Annotated[float, Field(ge=-1e6, le=1e6)]
Positive = Annotated[float, Field(gt=0, le=1e6), AfterValidator(_not_tiny)]
Length = Annotated[float, Field(gt=0, le=100), AfterValidator(_not_tiny)]
Exponent = Annotated[float, Field(gt=0, le=20), AfterValidator(_not_tiny)]
NonNegative = Annotated[float, Field(ge=0, le=1e6)]
Speed = Annotated[float, Field(ge=0, le=1e3)]
Step = Annotated[float, Field(ge=1e-2, le=1e3)]
Probability = Annotated[float, Field(ge=0, le=1)]
ModeName = Literal["accelerate", "cruise", "decelerate"]
CostRow = Annotated[list[NonNegative], Field(min_length=3, max_length=3)]


class LanesFile(FileModel):
    """`lanes`: the road."""

    count: Annotated[int, Field(ge=1, le=LANES_MAX)]
    width_m: Length


class PlannerFile(FileModel):
    """`planner`: how to decide. Keys with a default may be left out.

    `lateral_model` says how others move across the road: `pd`, the paper's law, which the gains belong to, or
    `lane_change`. Left out it is `pd` where a gain is given, and `lane_change` otherwise.
    """

    period_s: Step
    horizon_steps: Annotated[int, Field(ge=1, le=HORIZON_MAX)]
    accel_mps2: Step
    speed_min_mps: Speed
    speed_max_mps: Annotated[float, Field(gt=0, le=1e3)]
    safe_distance_m: NonNegative
    risk_level: Annotated[float, Field(gt=0, le=0.5)]
    risk_allocation: Literal["individual", "uniform", "mixture", "joint"] = "joint"
    sequence_threshold: Annotated[float, Field(gt=0, le=1)]
    action_threshold: Annotated[float, Field(ge=0, lt=1)] = 0.0
    maneuver_cost: Annotated[list[CostRow], Field(min_length=3, max_length=3)]
    speed_weight: NonNegative = 0.0
    desired_speed_mps: Speed = 0.0
    speed_deadband_mps: NonNegative = 0.0
    lane_weight: NonNegative = 0.0
    goal_lane: int | None = None
    terminal_weight: NonNegative = 0.0
    forbidden_lanes: list[int] = Field(default_factory=list, max_length=ENTRIES_MAX)
    lateral_model: Literal["lane_change", "pd"] | None = None
    lateral_gain_k1_ps2: NonNegative | None = None
    lateral_gain_k2_ps: NonNegative | None = None
    account_pruned: bool = False
    occupancy: Literal["target", "swept"] = "target"
    lane_change_time_s: Positive = 4.0
    distance_rule: Literal["fixed", "time_headway", "rss"] = "fixed"
    time_headway_s: NonNegative = 1.5
    rss_response_time_s: NonNegative = 0.5
    rss_accel_max_mps2: NonNegative = 2.0
    rss_brake_min_mps2: Positive = 4.0
    rss_brake_max_mps2: Positive = 8.0
    stopping: bool = False
    enforce_deadline: bool = False
    way_out: Literal["none", "braking"] = "none"

    def settings(self) -> PlannerSettings:
        """Return the settings as the planner uses them."""
        cost = tuple((row[0], row[1], row[2]) for row in self.maneuver_cost)
        return PlannerSettings(
            period=self.period_s,
            horizon_steps=self.horizon_steps,
            accel=self.accel_mps2,
            speed_min=self.speed_min_mps,
            speed_max=self.speed_max_mps,
            safe_distance=self.safe_distance_m,
            risk_level=self.risk_level,
            risk_allocation=RiskAllocation(self.risk_allocation),
            sequence_threshold=self.sequence_threshold,
            action_threshold=self.action_threshold,
            forbidden_lanes=frozenset(self.forbidden_lanes),
            preferences=Preferences(
                maneuver_cost=cost,
                speed_weight=self.speed_weight,
                desired_speed=self.desired_speed_mps,
                speed_deadband=self.speed_deadband_mps,
                lane_weight=self.lane_weight,
                goal_lane=self.goal_lane,
                terminal_weight=self.terminal_weight,
            ),
            gains=self.gains(),
            account_pruned=self.account_pruned,
            occupancy=Occupancy(self.occupancy),
            lane_change_time=self.lane_change_time_s,
            distance_rule=DistanceRule(self.distance_rule),
            time_headway=self.time_headway_s,
            rss=RssParameters(
                self.rss_response_time_s, self.rss_accel_max_mps2, self.rss_brake_min_mps2, self.rss_brake_max_mps2
            ),
            stopping=self.stopping,
            enforce_deadline=self.enforce_deadline,
            way_out=WayOut(self.way_out),
        )

    def gains(self) -> LateralGains | None:
        """Return the gains of the paper's law across the road, None where it is not taken."""
        given = {"k1": self.lateral_gain_k1_ps2, "k2": self.lateral_gain_k2_ps}
        named = {name: value for name, value in given.items() if value is not None}
        return LateralGains(**named) if named or self.lateral_model == "pd" else None


class LateralFile(FileModel):
    """A distribution over the lateral action."""

    left: Probability
    keep: Probability
    right: Probability

    def probabilities(self) -> Probabilities:
        """Return left, keep, right."""
        return self.left, self.keep, self.right


class LongitudinalFile(FileModel):
    """A distribution over the next mode."""

    accelerate: Probability
    cruise: Probability
    decelerate: Probability

    def probabilities(self) -> Probabilities:
        """Return decelerate, cruise, accelerate."""
        return self.decelerate, self.cruise, self.accelerate


LATERAL_KEYS = ("left", "keep", "right")


def lateral_form(value: Any) -> str:  # noqa: ANN401 - anything may stand in a file
    """Tell a table for every lane from one table a lane, also where it has mistakes."""
    if isinstance(value, Mapping):
        rows = any(isinstance(row, (Mapping, LateralFile)) for row in value.values())
        one_for_all = not {*LATERAL_KEYS}.isdisjoint(value) or (len(value) > 0 and not rows)
    else:
        one_for_all = isinstance(value, LateralFile)
    return "one" if one_for_all else "by_lane"


LateralTables = Annotated[
    Annotated[LateralFile, Tag("one")] | Annotated[dict[str, LateralFile], Tag("by_lane")],
    Discriminator(lateral_form),
]


class PolicyFile(FileModel):
    """The policy keys of a vehicle: one lateral table for every lane, or one per lane keyed by its number."""

    lateral_probs: LateralTables
    longitudinal_probs: LongitudinalFile

    def policy(self, lane_count: int) -> Policy:
        """Return the policy with one lateral row a lane."""
        return Policy(lateral_rows(self.lateral_probs, lane_count), self.longitudinal_probs.probabilities())


def lateral_rows(tables: LateralFile | Mapping[str, LateralFile], lane_count: int) -> tuple[Probabilities, ...]:
    """Return the lateral probabilities of each lane 1..n."""
    if isinstance(tables, LateralFile):
        return (tables.probabilities(),) * lane_count
    return tuple(tables[str(lane)].probabilities() for lane in range(1, lane_count + 1))


class NoiseFile(FileModel):
    """The uncertainty keys of a vehicle."""

    position_var_m2: NonNegative = 0.0
    speed_var_m2ps2: NonNegative = 0.0
    process_position_var_m2: NonNegative = 0.0
    process_speed_var_m2ps2: NonNegative = 0.0
    lateral_var_m2: NonNegative | None = None
    process_lateral_var_m2: NonNegative = 0.0

    def noise(self) -> Noise:
        """Return the noise."""
        return Noise(
            self.position_var_m2,
            self.speed_var_m2ps2,
            self.process_position_var_m2,
            self.process_speed_var_m2ps2,
            self.lateral_var_m2,
            self.process_lateral_var_m2,
        )


class LaneFollowingFile(FileModel):
    """The keys of how a vehicle moves across the road."""

    lane_change_time_s: Step | None = None
    lane_keeping_time_s: Step = 2.0

    def following(self, lane_change_time: float = 4.0) -> LaneFollowing:
        """Return it.

        Args:
            lane_change_time: where the file has none [s].
        """
        return LaneFollowing(self.lane_change_time_s or lane_change_time, self.lane_keeping_time_s)


class StateFile(FileModel):
    """The state keys of a vehicle; (x, y) is the centre of its front bumper."""

    x_m: Number
    y_m: Number
    speed_mps: Speed
    lane: int
    mode: ModeName
    length_m: Length = 4.5
    width_m: Length = 1.8
    lateral_speed_mps: Number = 0.0

    def state(self, vehicle_id: str) -> VehicleState:
        """Return the state."""
        return VehicleState(
            id=vehicle_id,
            x=self.x_m,
            y=self.y_m,
            speed=self.speed_mps,
            lane=self.lane,
            mode=MODE_BY_LABEL[self.mode],
            length=self.length_m,
            width=self.width_m,
            lateral_speed=self.lateral_speed_mps,
        )


class DriftFile(FileModel):
    """How much farther and faster a vehicle is after a step than its modes alone lead to."""

    x_m: Number
    speed_mps: Number


class VehicleFile(StateFile, PolicyFile, NoiseFile, LaneFollowingFile):
    """One surrounding vehicle.

    `lateral_probs_later` holds the lateral tables of the second step of the horizon and those after it, where they
    differ from step to step; the last one holds for all steps that remain. `drift` is how much farther and faster it is
    after each step than its modes alone lead to.
    """

    id: Annotated[str, Field(min_length=1, max_length=NAME_MAX)]
    lateral_probs_later: Annotated[list[LateralTables], Field(max_length=HORIZON_MAX - 1)] = Field(default_factory=list)

    drift: Annotated[list[DriftFile], Field(max_length=HORIZON_MAX)] = Field(default_factory=list)

    def policy(self, lane_count: int) -> Policy:
        """Return the policy with one lateral row a lane and step."""
        later = tuple(lateral_rows(tables, lane_count) for tables in self.lateral_probs_later)
        return replace(super().policy(lane_count), later=later)


class ManeuverFile(FileModel):
    """One step of a starting plan."""

    lateral: Literal["left", "keep", "right"]
    mode: ModeName


class StopLineFile(FileModel):
    """One stop line."""

    lanes: Annotated[list[int], Field(min_length=1, max_length=ENTRIES_MAX)]
    x_m: Number
    leaving_x_m: Number | None = None


class SpeedZoneFile(FileModel):
    """One stretch of a lane with a speed limit."""

    lane: int
    x_begin_m: Number
    x_end_m: Number
    speed_mps: Positive


class NoChangeFile(FileModel):
    """One stretch of a lane that may not be left to one side."""

    lane: int
    to: Literal["left", "right"]
    x_begin_m: Number
    x_end_m: Number


class ProblemFile(FileModel):
    """A decision problem."""

    lanes: LanesFile
    planner: PlannerFile
    ego: StateFile
    vehicles: Annotated[list[VehicleFile], Field(max_length=VEHICLES_MAX)]
    start_plan: Annotated[list[ManeuverFile], Field(max_length=ENTRIES_MAX)] | None = None
    stop_lines: Annotated[list[StopLineFile], Field(max_length=ENTRIES_MAX)] = Field(default_factory=list)
    speed_zones: Annotated[list[SpeedZoneFile], Field(max_length=ENTRIES_MAX)] = Field(default_factory=list)
    no_change: Annotated[list[NoChangeFile], Field(max_length=ENTRIES_MAX)] = Field(default_factory=list)

    def problem(self) -> DecisionProblem:
        """Return the problem as the planner uses it."""
        steps = self.start_plan
        start = (
            None
            if steps is None
            else ManeuverSequence(
                tuple(LATERAL_BY_LABEL[step.lateral] for step in steps),
                tuple(MODE_BY_LABEL[step.mode] for step in steps),
            )
        )
        return DecisionProblem(
            road=Road(self.lanes.count, self.lanes.width_m),
            settings=self.planner.settings(),
            ego=self.ego.state(EGO_ID),
            vehicles=tuple(
                PredictedVehicle(
                    vehicle.state(vehicle.id),
                    vehicle.policy(self.lanes.count),
                    vehicle.noise(),
                    vehicle.following(),
                    tuple((step.x_m, step.speed_mps) for step in vehicle.drift),
                )
                for vehicle in self.vehicles
            ),
            start=start,
            stop_lines=tuple(StopLine(frozenset(line.lanes), line.x_m, line.leaving_x_m) for line in self.stop_lines),
            rules=RoadRules(
                tuple(SpeedZone(zone.lane, zone.x_begin_m, zone.x_end_m, zone.speed_mps) for zone in self.speed_zones),
                tuple(
                    NoChange(rule.lane, LATERAL_BY_LABEL[rule.to], rule.x_begin_m, rule.x_end_m)
                    for rule in self.no_change
                ),
            ),
        )
