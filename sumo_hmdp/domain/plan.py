"""What a planner answers: the maneuver to carry out now, the plan behind it, and why."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import Any, Protocol, TypeVar, runtime_checkable

from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.domain.scene import Scene


class Status(StrEnum):
    """How a decision came about.

    OPTIMAL: the best plan that keeps every distance.
    INCUMBENT: a plan that keeps every distance, the best known when an enforced deadline came; perhaps not the best.
    RELAXED: none keeps them all; the plan with the least violation, then the least cost.
    FALLBACK: even the least violation means contact; brake in lane.
    RULE: a rule's answer; there was no plan that could be best.
    """

    OPTIMAL = "optimal"
    INCUMBENT = "incumbent"
    RELAXED = "relaxed"
    FALLBACK = "fallback"
    RULE = "rule"

    @property
    def keeps_distances(self) -> bool:
        """Whether its plans claim to keep every distance."""
        return self in {Status.OPTIMAL, Status.INCUMBENT}

    @property
    def departs(self) -> bool:
        """Whether it is worth a mark: the decision is planned, but not the best plan that keeps every distance."""
        return self in {Status.INCUMBENT, Status.RELAXED, Status.FALLBACK}


# Statuses of planners that plan: their shares add up to 1.
PLANNED_STATUSES = tuple(status for status in Status if status is not Status.RULE)


@dataclass(frozen=True)
class PlanStep:
    """The ego at the end of one step of its plan.

    Attributes:
        step: 1..H.
        lateral: the step's lateral action.
        mode: the mode during the step, which is the mode after the step's action.
        lane: the intended lane after the step.
        x: front bumper [m].
        speed: [m/s].
    """

    step: int
    lateral: Lateral
    mode: Mode
    lane: int
    x: float
    speed: float


@dataclass(frozen=True)
class PredictedBranch:
    """One retained branch of one vehicle, for display and audit; arrays as tuples over the steps 1..H.

    Attributes:
        vehicle_id: whose.
        probability: of the whole action sequence.
        lanes: intended lane per step.
        modes: mode per step, after the step's action.
        x: mean front bumper per step [m].
        y: mean per step [m].
        x_std: standard deviation of x per step [m].
        y_std: standard deviation of y per step [m].
    """

    vehicle_id: str
    probability: float
    lanes: tuple[int, ...]
    modes: tuple[Mode, ...]
    x: tuple[float, ...]
    y: tuple[float, ...]
    x_std: tuple[float, ...]
    y_std: tuple[float, ...]


@dataclass(frozen=True)
class PredictedMotion:
    """The whole prediction of one vehicle, all branches together, by which it can be scored; arrays over steps 1..H.

    Attributes:
        vehicle_id: whose.
        pruned: probability of all that was dropped.
        lanes: probability of intending each lane, leftmost first, per step; sums to 1 - pruned.
        x_mean: front bumper per step [m]; this and all below as if what was dropped were spread as what was kept.
        x_std: per step [m].
        y_mean: per step [m].
        y_std: per step [m].
        x_quantiles: of x per step, at 2.5, 5, 25, 75, 95 and 97.5 % [m].
    """

    vehicle_id: str
    pruned: float
    lanes: tuple[tuple[float, ...], ...]
    x_mean: tuple[float, ...]
    x_std: tuple[float, ...]
    y_mean: tuple[float, ...]
    y_std: tuple[float, ...]
    x_quantiles: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class ForbiddenInterval:
    """A stretch of one lane at one step that the ego may not be in.

    Attributes:
        step: 1..H.
        lane: the lane.
        x_from: lower end [m].
        x_to: upper end [m].
        leaving_x: up to where the body may still be in the lane while it leaves it [m], None where it may not at all.
    """

    step: int
    lane: int
    x_from: float
    x_to: float
    leaving_x: float | None = None


@dataclass(frozen=True)
class PlanBound:
    """What bounds a plan at one step on one side: of all branches that share a lane with it, the tightest.

    Attributes:
        step: 1..H.
        ahead: whether the branch is ahead of the plan.
        room: how far the plan could go that way before it would be too near, negative where that is missing [m].
        vehicle_id: whose branch it is; `stop line` where it is one.
        probability: of the branch, None for a stop line.
        x: mean of the branch's front bumper, or the line [m].
        distance: that is asked for at the plan's speed, margin included; before a line, the way to rest [m].
    """

    step: int
    ahead: bool
    room: float
    vehicle_id: str
    probability: float | None
    x: float
    distance: float


class Cause(StrEnum):
    """Why a vehicle may come too near to a plan.

    COMES_OVER: it takes up no lane of the plan now, and may change lanes.
    CHANGES_SPEED: it is in a lane of the plan, and may change its speed.
    PLACE: it is in a lane of the plan, and may be too near even at its present mode, by where it is or may be.
    """

    COMES_OVER = "comes_over"
    CHANGES_SPEED = "changes_speed"
    PLACE = "place"


@dataclass(frozen=True)
class RiskShare:
    """What one vehicle adds to the risk of a plan.

    Attributes:
        vehicle_id: which.
        total: over the horizon; the sum over all vehicles bounds the probability that any distance falls short.
        parts: at each step 1..H.
        step: at which it adds most.
        cause: why, there; None for a plan that was given up.
        lane: that it intends now.
        ahead: whether it is ahead of the ego now.
    """

    vehicle_id: str
    total: float
    parts: tuple[float, ...]
    step: int
    cause: Cause | None
    lane: int
    ahead: bool

    @property
    def reason(self) -> str:
        """The cause in words."""
        if self.cause is Cause.COMES_OVER:
            return f"may come over from lane {self.lane}"
        where = f"{'ahead' if self.ahead else 'behind'} in lane {self.lane}"
        if self.cause is Cause.CHANGES_SPEED:
            return f"{where}, may {'brake' if self.ahead else 'accelerate'}"
        return where if self.cause is None else f"{where}, may be too near in its present mode"


@dataclass(frozen=True)
class TriedAction:
    """One first action that could be taken instead of the decision's, or the decision's own.

    Attributes:
        lateral: the lateral action.
        mode: the mode.
        chosen: whether it is the decision's.
        verdict: `feasible`; `short`, where every plan that begins with it falls short of a distance; `contact`, where
            every one ends in contact; `inadmissible`, where a rule forbids it.
        reason: why its best plan is not feasible, in words; empty where it is.
        objective: cost of its best plan, None where it has none.
        violation: total violation of its best plan [m], None where it has none.
        risk: of its best plan, None where it has none or the risk of plans is not computed.
    """

    lateral: Lateral
    mode: Mode
    chosen: bool
    verdict: str
    reason: str
    objective: float | None
    violation: float | None
    risk: float | None = None


@dataclass(frozen=True)
class Command:
    """What the vehicle is told to do until the next decision.

    Attributes:
        lane: the lane to go to, or to stay in.
        accel: the longitudinal acceleration to hold [m/s2]; a decelerating vehicle stops at zero speed.
    """

    lane: int
    accel: float


# A number, yes or no, or words.
Note = float | str | bool


@dataclass(frozen=True)
class Decision:
    """One answer of a planner.

    Attributes:
        time: of the scene that it answers [s].
        status: how it came about.
        command: what to do until the next decision.
        lateral: the lateral action taken.
        mode: the longitudinal mode taken.
        plan: the whole plan, empty where there is none.
        objective: cost of the plan, None where there is none.
        violation: total violation of the distances by the plan [m], 0 when optimal, None for a fallback or a rule.
        reason: why it is not optimal, empty when it is.
        solver: which solver answered.
        solve_time: wall-clock seconds spent [s], NaN where it is not known; never part of a trace hash.
        pruned_prob: the largest pruned probability of any vehicle; under `joint` what was dropped, of all vehicles.
        branch_count: how many branches were retained; under `joint` how many places at the end of the horizon.
        vehicles: ids of the vehicles that the plan keeps its distance to, None where that is not known.
        stage_cost: cost of the step now taken, None where there is none.
        objective_bound: what the stability theorem allows the objective to be at most, None where it says nothing.
        shifted_feasible: whether the plan before, shifted by a step, is still feasible; None where there is none.
        shifted_reason: why it is not, empty where it is.
        risk_taken: upper bound of the probability that any distance falls short within the horizon, by the plan; None
            where it is not computed.
        risk_least: the same of the least risky plan.
        contact_risk: upper bound of the probability that the plan ends in contact.
        evidence: what else can be shown of it, worked out only when asked for; None for planners that have none.
        notes: what the planner says of why it decided so, by names that end in their unit; shown, and nothing depends
            on it. Kept as a copy that cannot be changed.
    """

    time: float
    status: Status
    command: Command
    lateral: Lateral = Lateral.KEEP
    mode: Mode = Mode.CRUISE
    plan: tuple[PlanStep, ...] = ()
    objective: float | None = None
    violation: float | None = 0.0
    reason: str = ""
    solver: str = ""
    solve_time: float = 0.0
    pruned_prob: float = 0.0
    branch_count: int = 0
    vehicles: tuple[str, ...] | None = None
    stage_cost: float | None = None
    objective_bound: float | None = None
    shifted_feasible: bool | None = None
    shifted_reason: str = ""
    risk_taken: float | None = None
    risk_least: float | None = None
    contact_risk: float | None = None
    evidence: "Evidence | None" = None
    notes: Mapping[str, Note] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        """Freeze the notes: a planner may go on with the mapping that it made."""
        object.__setattr__(self, "notes", MappingProxyType(dict(self.notes)))


class Evidence(Protocol):
    """What a decision rests on. It takes longer to write down than to decide, so few runs ask for it."""

    def branches(self) -> tuple[PredictedBranch, ...]:
        """Return predicted branches: of each sequence of lanes the likeliest, then the likeliest of the others."""
        ...

    def forbidden(self) -> tuple[ForbiddenInterval, ...]:
        """Return the forbidden intervals of the lanes."""
        ...

    def bounds(self) -> tuple[PlanBound, ...]:
        """Return what bounds the plan at each step, ahead and behind; empty where there is no plan."""
        ...

    def problem_json(self) -> str:
        """Return the decision problem in its file form."""
        ...


@runtime_checkable
class WeighsActions(Protocol):
    """Evidence that can also tell what every other first action would have led to; a planner need not offer it."""

    def tried(self) -> tuple[TriedAction, ...]:
        """Return every first action; empty where they cannot be worked out."""
        ...


@runtime_checkable
class Foretells(Protocol):
    """Evidence that can also tell its whole prediction; a planner need not offer it."""

    def prediction(self) -> tuple[PredictedMotion, ...]:
        """Return the whole prediction of each vehicle."""
        ...


@runtime_checkable
class SharesRisk(Protocol):
    """Evidence that can also tell from whom the risk of the plan comes; a planner need not offer it."""

    def risk_shares(self) -> tuple[RiskShare, ...]:
        """Return what each vehicle adds, the most first; empty where the risk of plans is not computed."""
        ...


Memory = TypeVar("Memory")


@runtime_checkable
class Observer(Protocol):
    """A planner that sees the scene between its decisions as well."""

    def observe(self, scene: Scene, memory: Any) -> Any:  # noqa: ANN401 - each planner's own
        """Take in the scene of a simulation step, as measured, and return the new memory."""
        ...


class Planner(Protocol[Memory]):
    """A planner as a plug-in: everything it remembers goes in and comes out, so any decision can be replayed."""

    @property
    def name(self) -> str:
        """As in the registry."""
        ...

    @property
    def period(self) -> float:
        """Time between two decisions [s]."""
        ...

    def initial_memory(self) -> Memory:
        """Return the memory before the first decision."""
        ...

    def decide(self, scene: Scene, memory: Memory) -> tuple[Decision, Memory]:
        """Answer one scene."""
        ...
