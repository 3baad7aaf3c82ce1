"""What a scenario file may hold. Every key ends in its unit; unknown keys are errors."""

from typing import Annotated, Any, Literal

from pydantic import Field

from sumo_hmdp.decision.problem_schema import (
    ENTRIES_MAX,
    NAME_MAX,
    VEHICLES_MAX,
    Exponent,
    LaneFollowingFile,
    LanesFile,
    Length,
    ModeName,
    NoiseFile,
    NonNegative,
    Number,
    PolicyFile,
    Positive,
    Speed,
)
from sumo_hmdp.scenario.recorded import TracksFile
from sumo_hmdp.scenario.road import RoadFile
from sumo_hmdp.scenario.traffic import BeliefFile, TrafficFile
from sumo_hmdp.validation import FileModel

# A day; a step in which a car at 30 m/s moves by seven of its lengths.
DURATION_MAX, STEP_MAX = 86_400.0, 1.0
# All instants of a run are kept until its end.
STEPS_MAX = 100_000


class EgoFile(FileModel):
    """`ego`: where the ego starts, and how it moves; (x, y) is the centre of the front bumper, y that of its lane.

    With `in_traffic` it takes the place and the speed of the background vehicle in its lane that is nearest to `x_m`
    when the run begins; then `speed_mps` is left out. In recorded traffic it takes the place of the recorded `vehicle`,
    or starts where a `planning_problem` of the file does; then place, lane and speed are left out.
    """

    x_m: Number
    lane: int
    speed_mps: Speed | None = None
    in_traffic: bool = False
    mode: ModeName = "cruise"
    lane_change_time_s: Positive = 4.0
    motion: Literal["bicycle", "point_mass", "point_mass_published"] = "bicycle"
    goal_x_m: Number | None = None
    vehicle: str | int | None = None
    planning_problem: str | int | None = None


class SwitchFile(FileModel):
    """One entry of a mode schedule."""

    from_s: NonNegative
    mode: ModeName


class CarFollowingFile(FileModel):
    """Car following of a mode schedule: surplus = gap - (standstill_gap + time_gap * speed)."""

    standstill_gap_m: NonNegative = 2.0
    time_gap_s: NonNegative = 1.5
    gap_gain_ps2: NonNegative = 0.25
    speed_gain_ps: NonNegative = 0.9
    decel_max_mps2: Positive = 3.0
    accel_max_mps2: Positive = 2.0
    release_surplus_m: Number = 4.0


class ConstantSpeedFile(FileModel):
    """`driver: {kind: constant_speed}`."""

    kind: Literal["constant_speed"]


class ModeScheduleFile(FileModel):
    """`driver: {kind: mode_schedule}`: modes by the time since the run, or the ego's first lane change, began."""

    kind: Literal["mode_schedule"]
    switches: Annotated[list[SwitchFile], Field(min_length=1, max_length=ENTRIES_MAX)]
    clock: Literal["run", "ego_change"] = "run"
    accel_mps2: Positive
    speed_max_mps: Positive
    car_following: CarFollowingFile | None = None


class IdmFile(FileModel):
    """`driver: {kind: idm}`: SUMO's Intelligent Driver Model."""

    kind: Literal["idm"]
    desired_speed_mps: Positive
    min_gap_m: Positive = 2.0
    time_gap_s: Positive = 1.5
    accel_mps2: Positive = 1.5
    decel_mps2: Positive = 2.0
    exponent: Exponent = 4.0


DriverFile = Annotated[ConstantSpeedFile | ModeScheduleFile | IdmFile, Field(discriminator="kind")]


class TimedPolicyFile(PolicyFile):
    """A policy that holds from a time on."""

    from_s: NonNegative = 0.0


class VehicleFile(NoiseFile, LaneFollowingFile):
    """One surrounding vehicle: where it starts, who drives it, and what the planner believes of it."""

    id: Annotated[str, Field(max_length=NAME_MAX, pattern=r"^[A-Za-z0-9_.-]+$")]
    x_m: Number
    lane: int
    speed_mps: Speed
    length_m: Length = 4.5
    width_m: Length = 1.8
    driver: DriverFile
    policy: Annotated[list[TimedPolicyFile], Field(min_length=1, max_length=ENTRIES_MAX)]


class MatchedTrafficFile(NoiseFile, LaneFollowingFile):
    """`matched_traffic`: vehicles laid out in every lane at a density, all believed alike; with `noise` alone.

    The vehicles of a lane start at its speed, about as far from each other as the density says, and one of them is left
    out for the ego.
    """

    density_vpkm_per_lane: Positive
    stretch_m: Annotated[list[Number], Field(min_length=2, max_length=2)]
    lane_speeds_mps: Annotated[list[Speed], Field(max_length=ENTRIES_MAX)]
    length_m: Length = 4.5
    width_m: Length = 1.8
    policy: Annotated[list[TimedPolicyFile], Field(min_length=1, max_length=ENTRIES_MAX)]


class PublishedFile(FileModel):
    """`published`: what somebody else's run of this scenario gave; printed beside ours, never asserted."""

    lane_change_first_s: NonNegative | None = None


class ScenarioFile(FileModel):
    """A scenario; with `road` there is neither `network` nor `lanes`, which follow from it.

    With `noise` the described vehicles are drawn from the model that the planner `hmdp_mpc` has of them: maneuvers from
    their policy, motion with the noise that is believed of them, measured with theirs. Then their `driver` plays no
    part. `noise_scale` multiplies the standard deviations of the motion behind the planner's back.
    """

    name: Annotated[str, Field(max_length=NAME_MAX, pattern=r"^[a-z0-9_]+$")]
    description: str
    network: str | None = None
    lanes: LanesFile
    road: RoadFile | None = None
    duration_s: Annotated[Positive, Field(le=DURATION_MAX)]
    dt_s: Annotated[Positive, Field(le=STEP_MAX)]
    ego: EgoFile
    vehicles: Annotated[list[VehicleFile], Field(max_length=VEHICLES_MAX)] = Field(default_factory=list)
    traffic: TrafficFile | None = None
    matched_traffic: MatchedTrafficFile | None = None
    tracks: TracksFile | None = None
    noise: bool = False
    noise_scale: Positive = 1.0
    published: PublishedFile | None = None
    planner: str
    planners: dict[str, dict[str, Any]]

    def unseen_belief(self) -> tuple[str, BeliefFile] | None:
        """Return what is believed of vehicles that nobody describes, after where it stands; None for nothing."""
        for path, section in (("traffic", self.traffic), ("tracks", self.tracks)):
            if section is not None:
                return f"{path}.belief", section.belief
        return None
