"""One decision problem, as frozen data: what the ego knows at a decision instant and what it wants."""

from dataclasses import dataclass, field
from enum import StrEnum

from sumo_hmdp.domain.distance import DistanceRule, RssParameters, SafeDistance
from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.domain.occupancy import Occupancy
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.road_rules import RoadRules
from sumo_hmdp.domain.scene import StopLine, VehicleState
from sumo_hmdp.prediction.branches import PredictedVehicle, PredictionSettings
from sumo_hmdp.prediction.dynamics import LateralGains

# A distance that misses its bound by less than this holds [m].
DISTANCE_TOLERANCE = 1e-6
# A speed that leaves its band by less than this is inside [m/s].
SPEED_TOLERANCE = 1e-9


class RiskAllocation(StrEnum):
    """How the risk level is shared among the single constraints; `decision/risk.py` states each claim."""

    INDIVIDUAL = "individual"
    UNIFORM = "uniform"
    MIXTURE = "mixture"
    JOINT = "joint"


class WayOut(StrEnum):
    """What a plan must leave at the end of its horizon under `joint`; `decision/way_out.py` states it.

    NONE: nothing is asked beyond the horizon.
    BRAKING: from the last state, braking keeps the distance to every vehicle ahead, within the risk level.
    """

    NONE = "none"
    BRAKING = "braking"


@dataclass(frozen=True)
class Preferences:
    """What the ego likes: the stage and terminal cost (docs/formulation.md, eqs. 12 and 13).

    Attributes:
        maneuver_cost: rows accelerate, cruise, decelerate; columns left, keep, right.
        speed_weight: cost of each m/s outside the dead band around the desired speed [1/(m/s)].
        desired_speed: [m/s].
        speed_deadband: [m/s].
        lane_weight: cost of each lane away from the goal lane.
        goal_lane: None where no lane is preferred.
        terminal_weight: factor of the terminal cost; 0 leaves it out.
    """

    maneuver_cost: tuple[tuple[float, float, float], ...] = (
        (6.0, 5.0, 6.0),
        (2.0, 0.0, 2.0),
        (11.0, 9.0, 11.0),
    )
    speed_weight: float = 0.0
    desired_speed: float = 0.0
    speed_deadband: float = 0.0
    lane_weight: float = 0.0
    goal_lane: int | None = None
    terminal_weight: float = 0.0

    def maneuver(self, mode: int, lateral: int) -> float:
        """Return c[mode][lateral] for a mode and a lateral action in {-1, 0, 1}."""
        return self.maneuver_cost[1 - mode][lateral + 1]


@dataclass(frozen=True)
class PlannerSettings:
    """Everything about the decision that is not the scene.

    Attributes:
        period: T_h, time between decisions and length of a step [s].
        horizon_steps: H.
        accel: nominal acceleration of the modes, for the ego and for the others [m/s2].
        speed_min: least allowed speed of the ego [m/s].
        speed_max: greatest allowed speed of the ego [m/s].
        safe_distance: d_safe, between front bumpers [m].
        risk_level: epsilon, in (0, 0.5].
        risk_allocation: how epsilon is shared.
        sequence_threshold: delta_seq, in (0, 1].
        action_threshold: delta, in [0, 1).
        forbidden_lanes: lanes that the ego may not choose.
        preferences: the cost.
        gains: of the paper's law of how others move across the road; None for lane changes that take their time.
        account_pruned: whether `uniform` takes the pruned probability off the risk level.
        occupancy: which lanes a vehicle takes up.
        lane_change_time: of the ego, for `swept` [s].
        distance_rule: what the safe distance is; `safe_distance` is its constant part, unused by `rss`.
        time_headway: factor of the ego's speed under `time_headway` [s].
        rss: parameters of `rss`.
        stopping: whether the ego may come to rest within a step, as the others may.
        way_out: what a plan must leave at the end of its horizon under `joint`.
        enforce_deadline: whether a solve ends after one period with what it has; the answer then depends on the
            machine's speed.
    """

    period: float
    horizon_steps: int
    accel: float
    speed_min: float
    speed_max: float
    safe_distance: float
    risk_level: float
    risk_allocation: RiskAllocation
    sequence_threshold: float
    action_threshold: float = 0.0
    forbidden_lanes: frozenset[int] = frozenset()
    preferences: Preferences = field(default_factory=Preferences)
    gains: LateralGains | None = None
    account_pruned: bool = False
    occupancy: Occupancy = Occupancy.TARGET
    lane_change_time: float = 4.0
    distance_rule: DistanceRule = DistanceRule.FIXED
    time_headway: float = 1.5
    rss: RssParameters = field(default_factory=RssParameters)
    stopping: bool = False
    enforce_deadline: bool = False
    way_out: WayOut = WayOut.NONE

    @property
    def distance(self) -> SafeDistance:
        """The rule of the safe distance with its numbers."""
        return SafeDistance(self.safe_distance, self.distance_rule, self.time_headway, self.rss)

    @property
    def distance_hangs_on_speed(self) -> bool:
        """Tell whether the safe distance differs from one speed of the ego to another."""
        if self.distance_rule is DistanceRule.TIME_HEADWAY:
            return self.time_headway > 0.0
        return self.distance_rule is DistanceRule.RSS

    @property
    def distance_needs_other_speed(self) -> bool:
        """Tell whether the safe distance differs from one speed of the other vehicle to another."""
        return self.distance_rule is DistanceRule.RSS

    def prediction(self) -> PredictionSettings:
        """Return what the prediction needs of this."""
        return PredictionSettings(
            self.horizon_steps,
            self.period,
            self.accel,
            self.sequence_threshold,
            self.action_threshold,
            self.gains,
        )


@dataclass(frozen=True)
class DecisionProblem:
    """One decision: the scene, what is believed of the others, and how to choose.

    Attributes:
        road: lanes.
        settings: of the planner.
        ego: the ego; its lane is the one it intends.
        vehicles: the surrounding vehicles with their policies and noise.
        start: a sequence to start the MILP from, such as what is left of the plan before; it costs nothing if it is
            not feasible, and changes at most which of several best plans is found.
        stop_lines: that are closed to the ego for the whole horizon; one that it has passed has no effect.
        rules: what the road forbids near the ego (`decision/road_rules.py`).
    """

    road: Road
    settings: PlannerSettings
    ego: VehicleState
    vehicles: tuple[PredictedVehicle, ...]
    start: "ManeuverSequence | None" = None
    stop_lines: tuple[StopLine, ...] = ()
    rules: RoadRules = field(default_factory=RoadRules)


@dataclass(frozen=True)
class ManeuverSequence:
    """What a solver chooses, step by step.

    Attributes:
        laterals: lateral action of each step.
        modes: mode during each step, which is the mode after its action.
        proven: whether it is proven to be the best; false for what was known at an enforced deadline, and for a relaxed
            plan of least violation of which HiGHS could not tell whether it is the cheapest.
    """

    laterals: tuple[Lateral, ...]
    modes: tuple[Mode, ...]
    proven: bool = True
