"""The planner `hmdp_mpc`: predict with the hybrid MDP, choose with the chance-constrained MILP."""

import json
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from sumo_hmdp.decision.audit import Audit, audit, shifted
from sumo_hmdp.decision.corridors import forbidden_intervals
from sumo_hmdp.decision.decide import Answer, answer
from sumo_hmdp.decision.explain_risk import risk_shares, risky_intervals
from sumo_hmdp.decision.first_actions import first_actions
from sumo_hmdp.decision.plan_bounds import plan_bounds
from sumo_hmdp.decision.predictors import Belief, Forecast, Predictor, PredictorContext, stated
from sumo_hmdp.decision.problem import DecisionProblem, PlannerSettings
from sumo_hmdp.decision.problem_file import problem_document
from sumo_hmdp.decision.road_rules import rules_ahead
from sumo_hmdp.decision.search import SearchTooLargeError
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
from sumo_hmdp.prediction.branches import Branches, covariances, lateral_means
from sumo_hmdp.prediction.distribution import distributions

__all__ = ["Belief", "HmdpPlanner"]

# Branches are shown down to this many a vehicle; decisions use all of them.
SHOWN_BRANCHES = 12


class UnknownVehicleError(SumoHmdpError):
    """A vehicle is in sight of which the planner was told nothing."""


@dataclass(frozen=True)
class PlannerMemory:
    """What the planner remembers.

    Attributes:
        predictor: memory of the predictor.
        problem: the problem of one period ago, for the audit and as a start for the MILP; None before the first.
        answer: its answer.
    """

    predictor: Any
    problem: DecisionProblem | None = None
    answer: Answer | None = None


@dataclass(frozen=True)
class HmdpPlanner:
    """The hybrid-MDP planner.

    Attributes:
        settings: horizon, distances, risk, cost.
        beliefs: what the scenario says of vehicles, by id.
        default_belief: of a vehicle that is not listed, whose maneuver is read from its motion; None makes such a
            vehicle an error.
        sensing_range: vehicles farther along the road than this are not seen [m].
        solver: a name of `decision.decide.SOLVERS`.
        yields_to_followers: whether vehicles behind that are in, or intend, a lane that the ego's body is over are kept
            at a distance by the ego; otherwise that is theirs to do.
        predictor: what says how the others go on; None takes the beliefs as they are.
        name: as in the registry.
    """

    settings: PlannerSettings
    beliefs: Mapping[str, Belief]
    default_belief: Belief | None = None
    sensing_range: float = 200.0
    solver: str = "milp"
    yields_to_followers: bool = True
    predictor: Predictor | None = None
    name: str = "hmdp_mpc"

    @property
    def period(self) -> float:
        """Time between two decisions [s]."""
        return self.settings.period

    @cached_property
    def forecaster(self) -> Predictor:
        """The predictor in use."""
        return self.predictor or stated(predictor_context(self.settings, self.beliefs, self.default_belief))

    def initial_memory(self) -> PlannerMemory:
        """Return the memory before the first scene: nothing was decided."""
        return PlannerMemory(self.forecaster.initial_memory())

    def observe(self, scene: Scene, memory: PlannerMemory) -> PlannerMemory:
        """Take in the scene of a simulation step, as measured."""
        return replace(memory, predictor=self.forecaster.observe(self._in_range(scene), memory.predictor))

    def decide(self, scene: Scene, memory: PlannerMemory | None) -> tuple[Decision, PlannerMemory]:
        """Answer one scene, which has been observed; the ego's lane and mode in it are those it intends.

        Args:
            scene: as measured.
            memory: None stands for `initial_memory`.

        Raises:
            UnknownVehicleError: for a vehicle in range of which the predictor says nothing.
            decision.optimiser.SolverError: if the solver proves nothing.
        """
        started = time.perf_counter()
        memory = memory or self.initial_memory()
        forecast = self.forecast(scene, memory)
        problem = self.problem(scene, memory, forecast)
        result = answer(problem, self.solver)
        solve_time = time.perf_counter() - started
        checked = audit(problem, result, _decided(memory))
        return to_decision(problem, result, checked, scene.time, solve_time), PlannerMemory(
            forecast.memory, problem, result
        )

    def forecast(self, scene: Scene, memory: PlannerMemory | None = None) -> Forecast:
        """Return what the predictor says of the vehicles in range."""
        memory = memory or self.initial_memory()
        return self.forecaster.predict(self._in_range(scene), memory.predictor)

    def problem(
        self, scene: Scene, memory: PlannerMemory | None = None, forecast: Forecast | None = None
    ) -> DecisionProblem:
        """Return the decision problem of a scene; the MILP starts from what is left of the plan before.

        Args:
            scene: the scene.
            memory: of the decision before.
            forecast: of the predictor; None asks it here.

        Raises:
            UnknownVehicleError: for a vehicle in range of which the predictor says nothing.
        """
        predicted = (forecast or self.forecast(scene, memory)).vehicles
        minded = self._minded(scene, {name: vehicle.state.lane for name, vehicle in predicted.items()})
        for state in minded:
            if state.id not in predicted:
                raise UnknownVehicleError(
                    f"every vehicle in range must have a policy, got none for {state.id!r} (at {scene.time:g} s). "
                    "Give it one in the scenario, in `vehicles` or for all in `traffic.belief`."
                )
        vehicles = tuple(predicted[state.id] for state in minded)
        last = None if memory is None else _decided(memory)
        start = None if last is None or last[1].sequence is None else shifted(*last)
        rules = rules_ahead(scene.rules, scene.ego, self.settings)
        return DecisionProblem(scene.road, self.settings, scene.ego, vehicles, start, scene.stop_lines, rules)

    def _seen(self, scene: Scene) -> list[VehicleState]:
        return [other for other in scene.others if abs(other.x - scene.ego.x) <= self.sensing_range]

    def _in_range(self, scene: Scene) -> Scene:
        return replace(scene, others=tuple(self._seen(scene)))

    def _minded(self, scene: Scene, lanes: Mapping[str, int]) -> list[VehicleState]:
        """Return the vehicles that the plan must keep clear of, optionally without followers in the ego's own lanes."""
        if self.yields_to_followers:
            return self._seen(scene)
        road = scene.road
        own = set(body_lanes(road, scene.ego.y, scene.ego.width))
        return [
            v
            for v in self._seen(scene)
            if v.x > scene.ego.x or own.isdisjoint({lanes.get(v.id, v.lane), *body_lanes(road, v.y, v.width)})
        ]


def _decided(memory: PlannerMemory) -> tuple[DecisionProblem, Answer] | None:
    """Return the decision before, None where there is none."""
    return None if memory.problem is None or memory.answer is None else (memory.problem, memory.answer)


def predictor_context(
    settings: PlannerSettings, beliefs: Mapping[str, Belief], default_belief: Belief | None
) -> PredictorContext:
    """Return what the planner offers to its predictor."""
    return PredictorContext(beliefs, default_belief, settings.accel, settings.period, settings.horizon_steps)


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
