"""Predictors: what `hmdp_mpc` takes the surrounding vehicles to do next (docs/predictors.md).

A predictor sees the scene at every simulation step and answers at each decision. It remembers nothing itself: its
memory goes in and comes out, and what it answers is part of the decision problem, so that every decision can be
replayed from its file.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from importlib.metadata import entry_points
from typing import Any, Protocol

from sumo_hmdp.decision.lane_change_belief import LaneChangeRates, lane_change_policies
from sumo_hmdp.decision.rollout import FADE_TIME, rollout_policies
from sumo_hmdp.domain.maneuver import ManeuverState, Mode
from sumo_hmdp.domain.scene import Scene, VehicleState
from sumo_hmdp.errors import InputError, Problem
from sumo_hmdp.prediction.branches import Drift, PredictedVehicle
from sumo_hmdp.prediction.dynamics import Noise
from sumo_hmdp.prediction.lateral import LaneFollowing
from sumo_hmdp.prediction.policy import Policy, ScheduledPolicy
from sumo_hmdp.prediction.reading import read_maneuver
from sumo_hmdp.validation import nearest, shown

ENTRY_POINT_GROUP = "sumo_hmdp.predictors"
# A vehicle in traffic that is slower than this stands or is about to start [m/s]. Starting is a branch of its own; the
# noise of one that moves would have it roll backwards by a metre or two within the horizon, and whoever has stopped
# behind it be too near for as long as both stand.
STANDSTILL = 0.5


@dataclass(frozen=True)
class Belief:
    """What a scenario says of one surrounding vehicle.

    Attributes:
        policy: how it chooses its actions, by time.
        noise: how uncertain its motion is.
        following: how it moves across the road.
        rates: of lane changes by the incentive for them, in place of the policy's; None takes the policy's.
    """

    policy: ScheduledPolicy
    noise: Noise
    following: LaneFollowing = field(default_factory=LaneFollowing)
    rates: LaneChangeRates | None = None


@dataclass(frozen=True)
class Forecast:
    """What a predictor says at a decision.

    Attributes:
        vehicles: by id: maneuver, policy over the horizon, noise and lateral motion. A vehicle that is left out is one
            of which nothing is known; the planner ends the run if it must keep a distance to it.
        memory: of the predictor from here on.
    """

    vehicles: Mapping[str, PredictedVehicle]
    memory: Any


class Predictor(Protocol):
    """A predictor as a plug-in."""

    @property
    def name(self) -> str:
        """As in the registry."""
        ...

    def initial_memory(self) -> Any:  # noqa: ANN401 - each predictor's own
        """Return the memory before the first scene."""
        ...

    def observe(self, scene: Scene, memory: Any) -> Any:  # noqa: ANN401 - each predictor's own
        """Take in the scene of a simulation step, as measured, and return the new memory."""
        ...

    def predict(self, scene: Scene, memory: Any) -> Forecast:  # noqa: ANN401 - each predictor's own
        """Answer for the vehicles of a scene that has just been observed; only those in sensing range are in it."""
        ...


@dataclass(frozen=True)
class PredictorContext:
    """What the planner offers to any predictor.

    Attributes:
        beliefs: what the scenario says of described vehicles, by id.
        default_belief: of all others; None where it says nothing.
        accel: of the modes [m/s2].
        period: of a step of the horizon [s].
        horizon_steps: H.
    """

    beliefs: Mapping[str, Belief]
    default_belief: Belief | None
    accel: float
    period: float
    horizon_steps: int


@dataclass(frozen=True)
class PredictorKind:
    """A predictor that scenarios can name.

    Attributes:
        name: the value of the key `predictor`.
        summary: one line.
        build: makes the predictor.
    """

    name: str
    summary: str
    build: Callable[[PredictorContext], Predictor]


Reading = Mapping[str, ManeuverState]
Said = Mapping[str, tuple[Policy, Drift]]
Policies = Callable[[Scene, Reading, Belief, PredictorContext], Said]


def _stated_policies(scene: Scene, read: Reading, belief: Belief, context: PredictorContext) -> Said:
    """Return the policies that the scenario states, or those by its rates where it has rates."""
    if belief.rates is None:
        return {}
    longitudinal = belief.policy.at(scene.time).longitudinal
    horizon = context.period * context.horizon_steps
    found = lane_change_policies(scene, read, belief.rates, longitudinal, horizon)
    return {name: (policy, ()) for name, policy in found.items()}


def _rollout_policies(scene: Scene, read: Reading, belief: Belief, context: PredictorContext) -> Said:
    """Return the policies by the incentive along an IDM rollout."""
    return rollout_policies(
        scene,
        read,
        belief.rates or LaneChangeRates(),
        belief.policy.at(scene.time).longitudinal,
        (context.period, context.horizon_steps),
        belief.following,
    )


def fading_drift(accel: float, speed: float, period: float, steps: int) -> Drift:
    """Return how an acceleration that fades as a exp(-t / tau) moves a vehicle after each step (eq. 46).

        dv = a tau (1 - exp(-t / tau)),   dx = a tau (t - tau (1 - exp(-t / tau)))

    Nobody drives backwards: of harder braking, what ends in rest at the end of the horizon is taken.

    Args:
        accel: measured, a [m/s2].
        speed: [m/s].
        period: of a step [s].
        steps: H.
    """
    tau = FADE_TIME
    accel = max(accel, -speed / (tau * (1.0 - math.exp(-steps * period / tau))))
    times = [period * (k + 1) for k in range(steps)]
    gone = [1.0 - math.exp(-t / tau) for t in times]
    return tuple((accel * tau * (t - tau * g), accel * tau * g) for t, g in zip(times, gone, strict=True))


def _fading_policies(scene: Scene, read: Reading, belief: Belief, context: PredictorContext) -> Said:
    """Return the policies along the rollout, with the measured acceleration as the motion."""
    states = {other.id: other for other in scene.others}
    return {
        name: (policy, fading_drift(states[name].accel, states[name].speed, context.period, context.horizon_steps))
        for name, (policy, _) in _rollout_policies(scene, read, belief, context).items()
    }


@dataclass(frozen=True)
class BeliefPredictor:
    """Described vehicles as the scenario says; all others with the maneuver read from their motion.

    Readings have hysteresis (`prediction/reading.py`); the memory is the readings of the decision before.

    Attributes:
        context: what the scenario says.
        name: as in the registry.
        policies: of the vehicles that nobody describes; one that is left out has the default policy.
    """

    context: PredictorContext
    name: str
    policies: Policies = _stated_policies

    def initial_memory(self) -> Reading:
        """Return no readings."""
        return {}

    def observe(self, scene: Scene, memory: Reading) -> Reading:
        """Return the memory unchanged: maneuvers are read once a decision."""
        del scene
        return memory

    def predict(self, scene: Scene, memory: Reading) -> Forecast:
        """Read the maneuvers and state the policies."""
        context, belief = self.context, self.context.default_belief
        read = {
            other.id: read_maneuver(other, scene.road, context.accel, memory.get(other.id))
            for other in scene.others
            if other.id not in context.beliefs
        }
        policies = {} if belief is None or not read else self.policies(scene, read, belief, context)
        vehicles = {}
        for other in scene.others:
            maneuver = read.get(other.id)
            believed = belief if maneuver is not None else context.beliefs[other.id]
            if believed is not None:
                policy, drift = policies.get(other.id) or (believed.policy.at(scene.time), ())
                # The modes of a vehicle that may come to rest say how it stops; else its acceleration is in the drift.
                if drift and other.speed < context.horizon_steps * context.accel * context.period:
                    drift = ()
                if drift and maneuver is not None:
                    maneuver = ManeuverState(maneuver.lane, Mode.CRUISE)
                vehicles[other.id] = replace(_predicted(other, maneuver, policy, believed), drift=drift)
        return Forecast(vehicles, read)


def _predicted(state: VehicleState, maneuver: ManeuverState | None, policy: Policy, belief: Belief) -> PredictedVehicle:
    noise = belief.noise
    if maneuver is not None:
        if (state.lane, state.mode) != (maneuver.lane, maneuver.mode):
            state = replace(state, lane=maneuver.lane, mode=maneuver.mode)
        if state.speed < STANDSTILL:
            noise = Noise(position_var=noise.position_var, lateral_var=noise.lateral_var)
    return PredictedVehicle(state, policy, noise, belief.following)


@dataclass(frozen=True)
class ConstantVelocity:
    """Everybody keeps speed and lane for sure, with the noise that the scenario believes.

    Attributes:
        context: what the scenario says.
        name: as in the registry.
    """

    context: PredictorContext
    name: str = "constant_velocity"

    def initial_memory(self) -> None:
        """Return None: nothing is remembered."""

    def observe(self, scene: Scene, memory: None) -> None:
        """Remember nothing."""

    def predict(self, scene: Scene, memory: None) -> Forecast:
        """Answer for every vehicle of which there is a belief."""
        del memory
        certain = Policy(((0.0, 1.0, 0.0),) * scene.road.lane_count, (0.0, 1.0, 0.0))
        vehicles = {}
        for other in scene.others:
            belief = self.context.beliefs.get(other.id, self.context.default_belief)
            if belief is not None:
                lane = scene.road.lane_at(other.y)
                vehicles[other.id] = _predicted(other, ManeuverState(lane, Mode.CRUISE), certain, belief)
        return Forecast(vehicles, None)


def _build_given(context: PredictorContext) -> Predictor:
    if context.default_belief is not None:
        message = "must not be `given` where `traffic` has vehicles that nobody describes; take `belief`"
        raise InputError([Problem("planners.hmdp_mpc.predictor", message)])
    return BeliefPredictor(context, "given")


def _without_rates(context: PredictorContext) -> PredictorContext:
    belief = context.default_belief
    return context if belief is None else replace(context, default_belief=replace(belief, rates=None))


def _with_rates(context: PredictorContext) -> PredictorContext:
    belief = context.default_belief
    if belief is None or belief.rates is not None:
        return context
    return replace(context, default_belief=replace(belief, rates=LaneChangeRates()))


BUILT_IN = (
    PredictorKind("given", "described vehicles alone, by the policies of the scenario", _build_given),
    PredictorKind(
        "fixed",
        "the scenario's policy for everybody, whatever the incentive",
        lambda context: BeliefPredictor(_without_rates(context), "fixed"),
    ),
    PredictorKind(
        "belief",
        "lane changes by the MOBIL incentive of now, the same over the horizon",
        lambda context: BeliefPredictor(_with_rates(context), "belief"),
    ),
    PredictorKind("constant_velocity", "everybody keeps speed and lane for sure", ConstantVelocity),
    PredictorKind(
        "idm_rollout",
        "motion by an IDM rollout of all vehicles, lane changes by the MOBIL incentive at each step of it",
        lambda context: BeliefPredictor(_with_rates(context), "idm_rollout", _rollout_policies),
    ),
    PredictorKind(
        "fading_acceleration",
        "motion by the measured acceleration, which fades; lane changes as under idm_rollout",
        lambda context: BeliefPredictor(_with_rates(context), "fading_acceleration", _fading_policies),
    ),
)


def stated(context: PredictorContext) -> Predictor:
    """Return the predictor of a scenario that names none: what the scenario says, with rates only if it has them."""
    return BeliefPredictor(context, "stated")


def predictor_kinds() -> dict[str, PredictorKind]:
    """Return every known predictor by name.

    Raises:
        InputError: if a package offers what cannot be imported, is no predictor, or has a name that is taken.
    """
    kinds, problems = {kind.name: kind for kind in BUILT_IN}, []
    for entry in entry_points(group=ENTRY_POINT_GROUP):
        path = f"predictor {entry.name}"
        try:
            kind = entry.load()
        except Exception as error:  # noqa: BLE001 - anything may go wrong in somebody's module
            message = f"must be importable from {entry.value}, got {type(error).__name__}: {error}"
            problems.append(Problem(path, f"{message}. Correct or uninstall it"))
            continue
        if not isinstance(kind, PredictorKind):
            problems.append(Problem(path, f"{entry.value} must be a PredictorKind, got {kind!r}"))
        elif kind.name in kinds:
            problems.append(Problem(path, f"must be offered once, got {kind.name} again from {entry.value}"))
        else:
            kinds[kind.name] = kind
    if problems:
        raise InputError(problems)
    return kinds


def build_predictor(
    name: str | None, context: PredictorContext, path: str = "planners.hmdp_mpc.predictor"
) -> Predictor:
    """Return a predictor by name; None takes what the scenario states.

    Args:
        name: as in the registry.
        context: what the planner offers.
        path: of the name, for the messages.

    Raises:
        InputError: if there is none of this name, with the nearest known one.
    """
    if name is None:
        return stated(context)
    kinds = predictor_kinds()
    if name not in kinds:
        message = f"must be a known predictor, got {shown(name)}; {nearest(name, kinds)}"
        raise InputError([Problem(path, message)])
    return kinds[name].build(context)
