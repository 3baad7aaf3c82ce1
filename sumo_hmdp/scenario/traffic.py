"""The `traffic` section of a scenario: background vehicles that nobody describes one by one."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, Literal

from pydantic import Field

from sumo_hmdp.decision.lane_change_belief import LaneChangeRates
from sumo_hmdp.decision.predictors import Belief
from sumo_hmdp.decision.problem_schema import (
    ENTRIES_MAX,
    NAME_MAX,
    Exponent,
    LaneFollowingFile,
    Length,
    NoiseFile,
    NonNegative,
    Number,
    PolicyFile,
    Positive,
    Speed,
)
from sumo_hmdp.errors import Problem
from sumo_hmdp.prediction.policy import ScheduledPolicy
from sumo_hmdp.sim.background import BackgroundSettings
from sumo_hmdp.sim.measurement import MeasurementNoise
from sumo_hmdp.traffic.courtesy import CourtesyRule
from sumo_hmdp.traffic.demand import Demand
from sumo_hmdp.traffic.drivers import (
    HIGHWAY_CLASSES,
    URBAN_CLASSES,
    TruncatedNormal,
    VehicleClass,
    class_problems,
    limited,
    mean_traits,
)
from sumo_hmdp.traffic.mobil import LaneChangeRule, Passing
from sumo_hmdp.traffic.theory import Lane
from sumo_hmdp.validation import FileModel

POPULATIONS: dict[str, tuple[VehicleClass, ...]] = {"highway": HIGHWAY_CLASSES, "urban": URBAN_CLASSES}
# All vehicles of a run are drawn before it begins.
VEHICLES_DRAWN_MAX, LENGTH_MIN = 50_000, 0.5
_PER_KM, _PER_HOUR = 1e-3, 1.0 / 3600.0


class SpreadFile(FileModel):
    """A normal distribution that is cut off on both sides."""

    mean: Number
    std: NonNegative = 0.0
    min: Number
    max: Number

    def distribution(self) -> TruncatedNormal:
        """Return the distribution."""
        return TruncatedNormal(self.mean, self.std, self.min, self.max)


class ClassFile(FileModel):
    """`traffic.classes[i]`: one kind of vehicles and their drivers."""

    name: Annotated[str, Field(max_length=NAME_MAX)]
    share: Annotated[float, Field(ge=0, le=1)]
    length_m: Length
    width_m: Length
    desired_speed_mps: SpreadFile
    time_gap_s: SpreadFile
    politeness: SpreadFile
    min_gap_m: Positive = 2.0
    accel_mps2: Positive = 1.4
    decel_mps2: Positive = 2.0
    exponent: Exponent = 4.0

    def problems(self) -> Iterator[Problem]:
        """Yield what is wrong with the distributions."""
        for key in ("desired_speed_mps", "time_gap_s", "politeness"):
            spread: SpreadFile = getattr(self, key)
            if not spread.min <= spread.mean <= spread.max:
                message = f"must have min <= mean <= max, got {spread.min:g}, {spread.mean:g} and {spread.max:g}"
                yield Problem(key, f"{message}; move the mean or the limits")
            if key == "politeness" and spread.min < 0.0:
                yield Problem(f"{key}.min", f"must be at least 0, got {spread.min:g}; raise it")
            if key != "politeness" and spread.min <= 0.0:
                yield Problem(f"{key}.min", f"must be above 0, got {spread.min:g}; raise it")

    def vehicle_class(self) -> VehicleClass:
        """Return the class as the demand uses it."""
        return VehicleClass(
            name=self.name,
            share=self.share,
            length=self.length_m,
            width=self.width_m,
            desired_speed=self.desired_speed_mps.distribution(),
            time_gap=self.time_gap_s.distribution(),
            politeness=self.politeness.distribution(),
            min_gap=self.min_gap_m,
            accel=self.accel_mps2,
            decel=self.decel_mps2,
            exponent=self.exponent,
        )


class LaneChangesFile(FileModel):
    """`traffic.lane_changes`: MOBIL, the same for all drivers but for their politeness."""

    passing: Literal["any_side", "left_only"] = "any_side"
    threshold_mps2: NonNegative = 0.1
    safe_decel_mps2: Positive = 4.0
    right_bias_mps2: NonNegative = 0.0
    critical_speed_mps: Speed = 60.0 / 3.6
    least_gap_m: NonNegative = 2.0
    duration_s: Positive = 4.0
    interval_s: NonNegative = 4.0
    period_s: Positive = 0.4
    speed_min_mps: Speed = 3.0

    def settings(self) -> BackgroundSettings:
        """Return the settings as the world uses them."""
        rule = LaneChangeRule(
            passing=Passing(self.passing),
            threshold=self.threshold_mps2,
            safe_decel=self.safe_decel_mps2,
            right_bias=self.right_bias_mps2,
            critical_speed=self.critical_speed_mps,
            least_gap=self.least_gap_m,
        )
        return BackgroundSettings(rule, self.duration_s, self.interval_s, self.period_s, self.speed_min_mps)


class CourtesyFile(FileModel):
    """`traffic.courtesy`: how drivers let in who has to leave its lane."""

    share: Annotated[float, Field(ge=0, le=1)] = 1.0
    distance_m: NonNegative = 50.0
    patience_s: NonNegative = 10.0

    def rule(self) -> CourtesyRule:
        """Return the rule as the world uses it."""
        return CourtesyRule(self.share, self.distance_m, self.patience_s)


class LaneChangeRatesFile(FileModel):
    """`traffic.belief.lane_change_rates`: probabilities of starting a lane change to one side in a period.

    `ending` is that of leaving one of the `ending_lanes`, where the change is safe.
    """

    unsafe: Annotated[float, Field(ge=0, le=0.5)] = LaneChangeRates.unsafe
    unwanted: Annotated[float, Field(ge=0, le=0.5)] = LaneChangeRates.unwanted
    undecided: Annotated[float, Field(ge=0, le=0.5)] = LaneChangeRates.undecided
    wanted: Annotated[float, Field(ge=0, le=0.5)] = LaneChangeRates.wanted
    ending: Annotated[float, Field(ge=0, le=0.5)] = LaneChangeRates.ending
    ending_lanes: Annotated[list[int], Field(max_length=ENTRIES_MAX)] = Field(default_factory=list)

    def rates(self) -> LaneChangeRates:
        """Return the rates as the planner uses them."""
        return LaneChangeRates(
            self.unsafe, self.unwanted, self.undecided, self.wanted, self.ending, tuple(self.ending_lanes)
        )


class BeliefFile(PolicyFile, NoiseFile, LaneFollowingFile):
    """`traffic.belief`: what the planner believes of every vehicle that nobody describes.

    With `lane_change_rates` the planner weighs each vehicle's lane changes by its own IDM and MOBIL, and takes these
    rates by the incentive in place of `lateral_probs`.

    The present mode and the lane intent are read from the vehicle's motion; from there on it acts by this policy. Its
    lane changes take the time of `traffic.lane_changes`, unless it says otherwise.
    """

    lane_change_rates: LaneChangeRatesFile | None = None

    def belief(self, lane_count: int, lane_change_time: float) -> Belief:
        """Return the belief as the planner uses it.

        Args:
            lane_count: of the road.
            lane_change_time: of the background [s].
        """
        policy = ScheduledPolicy(((0.0, self.policy(lane_count)),))
        rates = None if self.lane_change_rates is None else self.lane_change_rates.rates()
        return Belief(policy, self.noise(), self.following(lane_change_time), rates)


class MeasurementFile(FileModel):
    """`traffic.measurement`: how exactly the planner measures the background."""

    position_std_m: NonNegative = 0.0
    speed_std_mps: NonNegative = 0.0

    def noise(self) -> MeasurementNoise:
        """Return the noise."""
        return MeasurementNoise(self.position_std_m, self.speed_std_mps)


class TrafficFile(FileModel):
    """`traffic`: exactly one of density and flow is given; classes that are left out are those of the population.

    `ramp_flow_vph` comes from each on-ramp and `side_flow_vph` from each side street; `exit_share` of all vehicles
    leave the road before its end, by an exit that is drawn among those ahead of them. `speed_limit_mps` takes the place
    of the network's limits, for everybody: it slows the classes whose drivers want to go faster on average.
    """

    density_vpkm_per_lane: NonNegative | None = None
    flow_vph_per_lane: NonNegative | None = None
    stretch_m: Annotated[list[Number], Field(min_length=2, max_length=2)]
    lanes: Annotated[list[int], Field(min_length=1, max_length=ENTRIES_MAX)] | None = None
    inflow: bool = True
    ramp_flow_vph: NonNegative = 0.0
    side_flow_vph: NonNegative = 0.0
    exit_share: Annotated[float, Field(ge=0, le=1)] = 0.0
    warm_up_s: Annotated[float, Field(ge=0, le=600)] = 30.0
    speed_limit_mps: Positive | None = None
    population: Literal["highway", "urban"] = "highway"
    classes: Annotated[list[ClassFile], Field(min_length=1, max_length=ENTRIES_MAX)] | None = None
    lane_changes: LaneChangesFile = Field(default_factory=LaneChangesFile)
    courtesy: CourtesyFile = Field(default_factory=CourtesyFile)
    measurement: MeasurementFile = Field(default_factory=MeasurementFile)
    sight_m: Positive = 200.0
    belief: BeliefFile

    def problems(self, lane_count: int, dt: float, duration: float = 0.0) -> Iterator[Problem]:
        """Yield every mistake that takes more than one key.

        Args:
            lane_count: of the road.
            dt: the scenario's step [s].
            duration: of the run [s].
        """
        if self.stretch_m[0] >= self.stretch_m[1]:
            yield Problem("traffic.stretch_m", f"must be [from, to] with from < to, got {self.stretch_m}; swap them")
        for index, lane in enumerate(self.lanes or ()):
            if not 1 <= lane <= lane_count:
                yield Problem(f"traffic.lanes[{index}]", f"must be 1..{lane_count}, got {lane}; take it out")
        rates = self.belief.lane_change_rates
        for index, lane in enumerate(() if rates is None else rates.ending_lanes):
            if not 1 <= lane <= lane_count:
                path = f"traffic.belief.lane_change_rates.ending_lanes[{index}]"
                yield Problem(path, f"must be 1..{lane_count}, got {lane}; take it out")
        if self.lanes is not None and len(set(self.lanes)) < len(self.lanes):
            yield Problem("traffic.lanes", f"must name a lane once, got {self.lanes}; take one out")
        steps = self.warm_up_s / dt
        if abs(steps - round(steps)) > 1e-6:
            yield Problem("traffic.warm_up_s", f"must be a multiple of dt_s ({dt:g} s), got {self.warm_up_s:g} s")
        mistakes = list(self._demand_problems())
        yield from mistakes
        if not mistakes:
            yield from self._size_problems(lane_count, duration)

    def _size_problems(self, lane_count: int, duration: float) -> Iterator[Problem]:
        """Yield that more vehicles would be drawn than one run can hold; they are drawn before it begins."""
        capacity = Lane.of([mean_traits(self.vehicle_classes())]).capacity()[0] / _PER_HOUR
        per_lane = capacity if self.flow_vph_per_lane is None else self.flow_vph_per_lane
        time = (self.warm_up_s + duration) * _PER_HOUR if self.inflow else 0.0
        count = time * (per_lane * lane_count + self.ramp_flow_vph + self.side_flow_vph)
        if count > VEHICLES_DRAWN_MAX:
            message = f"must let at most {VEHICLES_DRAWN_MAX} vehicles enter, got up to {count:.0f} in {duration:g} s"
            yield Problem("duration_s", f"{message}; shorten it, or set traffic.inflow to false")
        for index, kind in enumerate(self.classes or ()):
            if kind.length_m < LENGTH_MIN:
                message = f"must be at least {LENGTH_MIN:g} where traffic is drawn, got {kind.length_m:g}; raise it"
                yield Problem(f"traffic.classes[{index}].length_m", message)

    def _demand_problems(self) -> Iterator[Problem]:
        """Yield what is wrong with the classes, then with how much traffic they are to be."""
        spreads = [
            Problem(f"traffic.classes[{index}].{problem.path}", problem.message)
            for index, kind in enumerate(self.classes or ())
            for problem in kind.problems()
        ]
        yield from spreads
        if spreads:
            return
        classes = self.vehicle_classes()
        mistakes = list(class_problems(classes))
        yield from (Problem("traffic.classes", mistake.message) for mistake in mistakes)
        if mistakes:
            return
        lane = Lane.of([mean_traits(classes)])
        density, flow = self.density_vpkm_per_lane, self.flow_vph_per_lane
        if (density is None) == (flow is None):
            remedy = "neither; add one" if density is None else "both; remove one"
            yield Problem("traffic", f"must have one of density_vpkm_per_lane and flow_vph_per_lane, got {remedy}")
        elif density is not None and density * _PER_KM >= lane.jam_density:
            limit = f"{lane.jam_density / _PER_KM:.1f} vehicles/km, where its vehicles stand"
            message = f"must be below the jam density of a lane, {limit}, got {density:g}; lower it"
            yield Problem("traffic.density_vpkm_per_lane", message)
        capacity = lane.capacity()[0] / _PER_HOUR
        for key in ("flow_vph_per_lane", "ramp_flow_vph", "side_flow_vph"):
            value = getattr(self, key)
            if value is not None and value > capacity:
                message = f"must be at most the capacity of a lane, {capacity:.0f} vehicles/h, got {value:g}; lower it"
                yield Problem(f"traffic.{key}", message)

    def settings(self) -> BackgroundSettings:
        """Return what all drivers have in common, as the world uses it."""
        return replace(self.lane_changes.settings(), courtesy=self.courtesy.rule())

    def demand(self, limit: float | None = None) -> Demand:
        """Return the demand of each lane; `problems` is empty.

        Args:
            limit: of the network, where the section has none [m/s].
        """
        return Demand(
            classes=self.vehicle_classes(limit),
            density=None if self.density_vpkm_per_lane is None else self.density_vpkm_per_lane * _PER_KM,
            flow=None if self.flow_vph_per_lane is None else self.flow_vph_per_lane * _PER_HOUR,
        )

    def flow(self, vehicles_per_hour: float, limit: float | None = None) -> Demand | None:
        """Return the demand of a ramp or side street, None for no flow."""
        if vehicles_per_hour == 0.0:
            return None
        return Demand(classes=self.vehicle_classes(limit), flow=vehicles_per_hour * _PER_HOUR)

    def vehicle_classes(self, limit: float | None = None) -> tuple[VehicleClass, ...]:
        """Return the classes of the background as they drive here, under a limit of the network [m/s]."""
        classes = POPULATIONS[self.population]
        if self.classes is not None:
            classes = tuple(kind.vehicle_class() for kind in self.classes)
        limit = limit if self.speed_limit_mps is None else self.speed_limit_mps
        return classes if limit is None else tuple(limited(kind, limit) for kind in classes)
