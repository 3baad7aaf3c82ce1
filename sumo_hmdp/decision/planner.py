"""The planner `hmdp_mpc`: predict with the hybrid MDP, choose with the chance-constrained MILP."""

import json
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from sumo_hmdp.decision.audit import Audit, audit, shifted
from sumo_hmdp.decision.corridors import forbidden_intervals
from sumo_hmdp.decision.decide import Answer, answer
from sumo_hmdp.decision.explain_risk import risk_shares, risky_intervals
from sumo_hmdp.decision.first_actions import first_actions
from sumo_hmdp.decision.lane_change_belief import LaneChangeRates, lane_change_policies
from sumo_hmdp.decision.plan_bounds import plan_bounds
from sumo_hmdp.decision.problem import DecisionProblem, PlannerSettings
from sumo_hmdp.decision.problem_file import problem_document
from sumo_hmdp.decision.road_rules import rules_ahead
from sumo_hmdp.decision.search import SearchTooLargeError
from sumo_hmdp.domain.maneuver import ManeuverState
from sumo_hmdp.domain.occupancy import body_lanes
from sumo_hmdp.domain.plan import (
    Command,
    Decision,
    ForbiddenInterval,
    PlanBound,
    PredictedBranch,
    PredictedMotion,
    RiskShare,
    TriedAction,
)
from sumo_hmdp.domain.scene import Scene, VehicleState
from sumo_hmdp.errors import SumoHmdpError
from sumo_hmdp.prediction.branches import Branches, PredictedVehicle, covariances, lateral_means
from sumo_hmdp.prediction.distribution import distributions
from sumo_hmdp.prediction.dynamics import Noise
from sumo_hmdp.prediction.lateral import LaneFollowing
from sumo_hmdp.prediction.policy import Policy, ScheduledPolicy
from sumo_hmdp.prediction.reading import read_maneuver

# Branches are shown down to this many a vehicle; decisions use all of them.
SHOWN_BRANCHES = 12
# A vehicle in traffic that is slower than this stands or is about to start [m/s]. Starting is a branch of its own; the
# noise of one that moves would have it roll backwards by a metre or two within the horizon, and whoever has stopped
# behind it be too near for as long as both stand.
STANDSTILL = 0.5


class UnknownVehicleError(SumoHmdpError):
    """A vehicle is in sight of which the planner was told nothing."""


@dataclass(frozen=True)
class Belief:
    """What is believed of one surrounding vehicle.

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
class LastDecision:
    """What the planner remembers: the decision before, for the audit and as a start for the MILP.

    Attributes:
        problem: the problem of one period ago.
        answer: its answer.
        read: what was read of the maneuvers of vehicles without a belief of their own, by id.
    """

    problem: DecisionProblem
    answer: Answer
    read: Mapping[str, ManeuverState] = field(default_factory=dict)


@dataclass(frozen=True)
class HmdpPlanner:
    """The hybrid-MDP planner.

    Attributes:
        settings: horizon, distances, risk, cost.
        beliefs: by vehicle id.
        default_belief: of a vehicle that is not listed, whose maneuver is read from its motion; None makes such a
            vehicle an error.
        sensing_range: vehicles farther along the road than this are not seen [m].
        solver: a name of `decision.decide.SOLVERS`.
        yields_to_followers: whether vehicles behind that are in, or intend, a lane that the ego's body is over are kept
            at a distance by the ego; otherwise that is theirs to do.
        name: as in the registry.
    """

    settings: PlannerSettings
    beliefs: Mapping[str, Belief]
    default_belief: Belief | None = None
    sensing_range: float = 200.0
    solver: str = "milp"
    yields_to_followers: bool = True
    name: str = "hmdp_mpc"

    @property
    def period(self) -> float:
        """Time between two decisions [s]."""
        return self.settings.period

    def initial_memory(self) -> LastDecision | None:
        """Return None: nothing was decided before."""
        return None

    def decide(self, scene: Scene, memory: LastDecision | None) -> tuple[Decision, LastDecision]:
        """Answer one scene; the ego's lane and mode in it are those it intends.

        Raises:
            UnknownVehicleError: for a vehicle in range without a belief.
            decision.optimiser.SolverError: if the solver proves nothing.
        """
        started = time.perf_counter()
        read = self.read(scene, memory)
        problem = self.problem(scene, memory, read)
        result = answer(problem, self.solver)
        solve_time = time.perf_counter() - started
        checked = audit(problem, result, None if memory is None else (memory.problem, memory.answer))
        return to_decision(problem, result, checked, scene.time, solve_time), LastDecision(problem, result, read)

    def read(self, scene: Scene, memory: LastDecision | None = None) -> dict[str, ManeuverState]:
        """Return the lane intent and mode of every vehicle in range of which the scenario says nothing."""
        last = {} if memory is None else memory.read
        return {
            other.id: read_maneuver(other, scene.road, self.settings.accel, last.get(other.id))
            for other in self._seen(scene)
            if other.id not in self.beliefs
        }

    def problem(
        self, scene: Scene, memory: LastDecision | None = None, read: Mapping[str, ManeuverState] | None = None
    ) -> DecisionProblem:
        """Return the decision problem of a scene; the MILP starts from what is left of the plan before.

        Args:
            scene: the scene.
            memory: of the decision before.
            read: as `read` returns it; None reads it here.
        """
        maneuvers = self.read(scene, memory) if read is None else read
        policies = self._policies(scene, maneuvers)
        vehicles = tuple(
            self._predicted(other, maneuvers.get(other.id), policies.get(other.id), scene.time)
            for other in self._minded(scene, maneuvers)
        )
        start = None if memory is None or memory.answer.sequence is None else shifted(memory.problem, memory.answer)
        rules = rules_ahead(scene.rules, scene.ego, self.settings)
        return DecisionProblem(scene.road, self.settings, scene.ego, vehicles, start, scene.stop_lines, rules)

    def _seen(self, scene: Scene) -> list[VehicleState]:
        return [other for other in scene.others if abs(other.x - scene.ego.x) <= self.sensing_range]

    def _minded(self, scene: Scene, maneuvers: Mapping[str, ManeuverState]) -> list[VehicleState]:
        """Return whom the ego keeps a distance to: perhaps not those who come from behind to where it already is."""
        if self.yields_to_followers:
            return self._seen(scene)
        road = scene.road
        own = set(body_lanes(road, scene.ego.y, scene.ego.width))
        return [
            v
            for v in self._seen(scene)
            if v.x > scene.ego.x or own.isdisjoint({maneuvers.get(v.id, v).lane, *body_lanes(road, v.y, v.width)})
        ]

    def _policies(self, scene: Scene, read: Mapping[str, ManeuverState]) -> dict[str, Policy]:
        """Return the policies of vehicles whose lane changes are believed by their incentive, by id."""
        belief = self.default_belief
        if belief is None or belief.rates is None:
            return {}
        horizon = self.settings.period * self.settings.horizon_steps
        return lane_change_policies(scene, read, belief.rates, belief.policy.at(scene.time).longitudinal, horizon)

    def _predicted(
        self, state: VehicleState, maneuver: ManeuverState | None, policy: Policy | None, now: float
    ) -> PredictedVehicle:
        belief = self.beliefs.get(state.id, self.default_belief)
        if belief is None:
            raise UnknownVehicleError(
                f"every vehicle in range must have a policy, got none for {state.id!r} (at {now:g} s). "
                "Give it one in the scenario, in `vehicles` or for all in `traffic.belief`."
            )
        noise = belief.noise
        if maneuver is not None:
            if (state.lane, state.mode) != (maneuver.lane, maneuver.mode):
                state = replace(state, lane=maneuver.lane, mode=maneuver.mode)
            if state.speed < STANDSTILL:
                noise = Noise(position_var=noise.position_var, lateral_var=noise.lateral_var)
        return PredictedVehicle(state, policy or belief.policy.at(now), noise, belief.following)


def to_decision(problem: DecisionProblem, result: Answer, checked: Audit, now: float, solve_time: float) -> Decision:
    """Turn the answer to a problem into a decision with everything that is recorded of it; both times in [s]."""
    accel = result.mode * problem.settings.accel if result.brake is None else -result.brake
    lane = problem.ego.lane + result.lateral
    return Decision(
        time=now,
        status=result.status,
        command=Command(lane=lane, accel=float(accel)),
        lateral=result.lateral,
        mode=result.mode,
        plan=result.plan,
        objective=result.objective,
        violation=result.violation,
        reason=result.reason,
        solver=result.solver,
        solve_time=solve_time,
        pruned_prob=result.pruned,
        branch_count=result.branch_count,
        vehicles=tuple(vehicle.state.id for vehicle in problem.vehicles),
        stage_cost=checked.stage_cost,
        objective_bound=checked.objective_bound,
        shifted_feasible=checked.shifted_feasible,
        shifted_reason=checked.shifted_reason,
        risk_taken=None if result.risk is None else result.risk.taken,
        risk_least=None if result.risk is None else result.risk.least,
        contact_risk=None if result.risk is None else result.risk.contact,
        evidence=HmdpEvidence(problem, result),
    )


@dataclass(frozen=True)
class HmdpEvidence:
    """What a decision of this planner rests on.

    Attributes:
        problem: the problem.
        answer: its answer.
    """

    problem: DecisionProblem
    answer: Answer

    def branches(self) -> tuple[PredictedBranch, ...]:
        """Return the likeliest branches of each vehicle."""
        return shown_branches(self.problem, self.answer.branches)

    def prediction(self) -> tuple[PredictedMotion, ...]:
        """Return the whole prediction of each vehicle, from all branches."""
        problem = self.problem
        return tuple(
            PredictedMotion(
                vehicle_id=found.vehicle_id,
                pruned=found.pruned,
                lanes=tuple(map(tuple, found.lanes.tolist())),
                x_mean=tuple(found.x_mean.tolist()),
                x_std=tuple(found.x_std.tolist()),
                y_mean=tuple(found.y_mean.tolist()),
                y_std=tuple(found.y_std.tolist()),
                x_quantiles=tuple(map(tuple, found.x_quantiles.tolist())),
            )
            for found in distributions(self.answer.branches, problem.road, problem.settings.prediction())
        )

    def forbidden(self) -> tuple[ForbiddenInterval, ...]:
        """Return what is forbidden in each lane taken alone, at the ego's present speed.

        Under `joint` that is where the ego would risk more at one step than epsilon allows for all.
        """
        if self.answer.situation.joint:
            return risky_intervals(self.answer)
        return forbidden_intervals(self.problem, self.answer.lattice, self.answer.branches, self.answer.margin)

    def bounds(self) -> tuple[PlanBound, ...]:
        """Return what bounds the plan at each step, ahead and behind; under `joint` no single distance does."""
        if self.answer.situation.joint:
            return ()
        return tuple(plan_bounds(self.problem, self.answer))

    def tried(self) -> tuple[TriedAction, ...]:
        """Return every first action with what it leads to; empty where the horizon is too long for the search."""
        with suppress(SearchTooLargeError):
            return tuple(
                TriedAction(
                    action.lateral, action.mode, action.chosen, str(action.verdict), action.reason, action.objective,
                    action.violation, action.risk,
                )
                for action in first_actions(self.problem, self.answer)
            )  # fmt: skip
        return ()

    def risk_shares(self) -> tuple[RiskShare, ...]:
        """Return what each vehicle adds to the risk of the plan."""
        return risk_shares(self.answer)

    def problem_json(self) -> str:
        """Return the problem in its file form."""
        return json.dumps(problem_document(self.problem))


def shown_branches(problem: DecisionProblem, branches: Branches) -> tuple[PredictedBranch, ...]:
    """Return branches of each vehicle with their spread along and across the road, at most `SHOWN_BRANCHES` a vehicle.

    The likeliest of each sequence of lanes come before a second one with the same lanes, so that whoever reads them
    knows which lanes were thought possible.
    """
    prediction = problem.settings.prediction()
    y = lateral_means(branches, problem.road, prediction)
    shown = []
    for index, vehicle in enumerate(branches.vehicles):
        rows = np.flatnonzero(branches.vehicle == index)
        likeliest = rows[np.argsort(-branches.probability[rows], kind="stable")]
        _, firsts = np.unique(branches.lanes[likeliest], axis=0, return_index=True)
        others = np.setdiff1d(np.arange(len(likeliest)), firsts)
        chosen = np.sort(np.concatenate([np.sort(firsts), others])[:SHOWN_BRANCHES])
        for row in likeliest[chosen].tolist():
            variances = np.diagonal(covariances(branches, row, prediction), axis1=1, axis2=2)
            shown.append(
                PredictedBranch(
                    vehicle_id=vehicle.state.id,
                    probability=float(branches.probability[row]),
                    lanes=tuple(branches.lanes[row].tolist()),
                    modes=tuple(branches.modes[row].tolist()),
                    x=tuple(branches.x[row].tolist()),
                    y=tuple(y[row].tolist()),
                    x_std=tuple(np.sqrt(variances[:, 0]).tolist()),
                    y_std=tuple(np.sqrt(variances[:, 1]).tolist()),
                )
            )
    return tuple(shown)
