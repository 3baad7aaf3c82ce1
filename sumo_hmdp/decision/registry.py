"""Planners by name: those of this package and those that other packages offer as entry points."""

import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.metadata import EntryPoint
from typing import Any, Literal

from sumo_hmdp.decision.baselines import ConstantFile, ConstantPlanner, IdmMobilFile, IdmMobilPlanner
from sumo_hmdp.decision.file_planner import FilePlannerFile, build_from_file
from sumo_hmdp.decision.names import offered
from sumo_hmdp.decision.planner import HmdpPlanner, predictor_context
from sumo_hmdp.decision.plugin_source import PlannerPackage, package_of
from sumo_hmdp.decision.predictors import Belief, build_predictor
from sumo_hmdp.decision.problem_schema import NonNegative, PlannerFile
from sumo_hmdp.decision.published_rules import PublishedFile, PublishedPlanner
from sumo_hmdp.decision.sumo_driver import SumoDriver, SumoFile, SumoPlanner
from sumo_hmdp.domain.plan import Planner
from sumo_hmdp.errors import InputError, Problem
from sumo_hmdp.validation import FileModel, nearest, shown


class HmdpParameters(PlannerFile):
    """The keys of `hmdp_mpc` in a scenario: those of a decision file, and how far it sees.

    In a scenario `occupancy` is `swept` unless it says otherwise, since under the paper's `target` a leader is dropped
    the instant the intent changes; and `lane_change_time_s` is the ego's. `followers: all`, the paper's rule, keeps the
    distance to whoever is behind as well. `other_lanes` leaves that to those behind who are in, or intend, a lane
    that the ego's body is over: a prediction that does not react would have them drive into an ego that stops.
    `predictor` names what says how the others go on (docs/predictors.md); left out, it is what the scenario states.
    """

    sensing_range_m: NonNegative = 200.0
    followers: Literal["all", "other_lanes"] = "all"
    occupancy: Literal["target", "swept"] = "swept"
    predictor: str | None = None


@dataclass(frozen=True)
class PlannerContext:
    """What a scenario offers to any planner.

    Attributes:
        lane_count: of the road.
        lane_width: of the road [m].
        dt: control step [s].
        lane_change_time: of the ego [s].
        beliefs: what the scenario says of each vehicle's policy and noise.
        default_belief: of the vehicles it says nothing of.
        solver: the name given with `--solver`.
    """

    lane_count: int
    lane_width: float
    dt: float
    lane_change_time: float
    beliefs: Mapping[str, Belief]
    default_belief: Belief | None
    solver: str


@dataclass(frozen=True)
class PlannerKind:
    """A planner that scenarios can name.

    Attributes:
        name: in scenarios and on the command line.
        summary: one line for `sumo-hmdp list`.
        parameters: what its section in a scenario may hold.
        build: makes the planner.
        sumo_driver: says how SUMO drives the ego, for a planner that leaves it to SUMO; None where its commands do.
        version: raised when the same parameters lead to other decisions, so that a study that is resumed runs its cells
            again instead of mixing old runs with new ones.
    """

    name: str
    summary: str
    parameters: type[FileModel]
    build: Callable[[Any, PlannerContext], Planner[Any]]
    sumo_driver: Callable[[Any, PlannerContext], SumoDriver] | None = None
    version: int = 1


def _build_hmdp(parameters: HmdpParameters, context: PlannerContext) -> HmdpPlanner:
    settings = parameters.settings()
    if "lane_change_time_s" not in parameters.model_fields_set:
        settings = replace(settings, lane_change_time=context.lane_change_time)
    return HmdpPlanner(
        settings=settings,
        beliefs=context.beliefs,
        default_belief=context.default_belief,
        sensing_range=parameters.sensing_range_m,
        yields_to_followers=parameters.followers == "all",
        solver=context.solver,
        predictor=build_predictor(
            parameters.predictor, predictor_context(settings, context.beliefs, context.default_belief)
        ),
    )


HMDP_MPC = PlannerKind(
    "hmdp_mpc", "hybrid-MDP prediction, chance-constrained MILP over maneuvers", HmdpParameters, _build_hmdp
)


def _build_idm_mobil(parameters: IdmMobilFile, context: PlannerContext) -> IdmMobilPlanner:
    goal = parameters.goal
    return IdmMobilPlanner(
        dt=context.dt,
        lane_change_time=context.lane_change_time,
        rules=parameters.rules(),
        goal=None if goal is None else goal.goal(parameters.desired_speed_mps),
        interval=parameters.interval_s,
    )


# Version 1 of this name was the published code, which is `idm_mobil_published` now.
IDM_MOBIL = PlannerKind(
    "idm_mobil",
    "rules: IDM along the road and MOBIL across it, by the traffic's own code and parameters",
    IdmMobilFile,
    _build_idm_mobil,
    version=2,
)


def _build_published(parameters: PublishedFile, context: PlannerContext) -> PublishedPlanner:
    return PublishedPlanner(
        dt=context.dt,
        lane_change_time=context.lane_change_time,
        lateral_period=parameters.lateral_period_s,
        leader_range=parameters.leader_range_m,
        rules=parameters.rules(),
    )


PUBLISHED = PlannerKind(
    "idm_mobil_published",
    "the rule-based baseline published with the paper, for its Case 2",
    PublishedFile,
    _build_published,
)


def _build_constant(parameters: ConstantFile, context: PlannerContext) -> ConstantPlanner:
    del parameters
    return ConstantPlanner(context.dt)


CONSTANT = PlannerKind("constant", "keeps lane and speed, whatever the traffic does", ConstantFile, _build_constant)


def _build_sumo(parameters: SumoFile, context: PlannerContext) -> SumoPlanner:
    del parameters
    return SumoPlanner(context.dt)


def _sumo_driver(parameters: SumoFile, context: PlannerContext) -> SumoDriver:
    return parameters.driver(context.lane_change_time)


SUMO = PlannerKind(
    "sumo", "SUMO drives the ego: its IDM along the road, its LC2013 across it", SumoFile, _build_sumo, _sumo_driver
)
PYTHON = PlannerKind("python", "a planner or trained agent from a Python file", FilePlannerFile, build_from_file)
BUILT_IN = (HMDP_MPC, IDM_MOBIL, PUBLISHED, CONSTANT, SUMO, PYTHON)


def planner_kinds() -> dict[str, PlannerKind]:
    """Return every known planner by name.

    Raises:
        InputError: if two packages offer the same name, or one offers what cannot be imported or is no planner.
    """
    kinds = {kind.name: kind for kind in BUILT_IN}
    problems = []
    for entry in offered():
        try:
            kind = entry.load()
        except Exception as error:  # noqa: BLE001 - anything may go wrong in somebody's module
            problems.append(Problem(f"planner {entry.name}", _not_loaded(entry, error)))
            continue
        if not isinstance(kind, PlannerKind):
            problems.append(Problem(f"planner {entry.name}", f"{entry.value} must be a PlannerKind, got {kind!r}"))
            continue
        if kind.name in kinds:
            problems.append(Problem(f"planner {kind.name}", f"must be offered once, got it again from {entry.value}"))
        kinds[kind.name] = kind
    if problems:
        raise InputError(problems)
    return kinds


def _not_loaded(entry: EntryPoint, error: Exception) -> str:
    """Say why a planner cannot be imported, and the last line of its own code in which it broke."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if "importlib" not in frame.filename]
    where = f" ({frames[-1].filename}, line {frames[-1].lineno})" if len(frames) > 1 else ""
    return f"must be importable from {entry.value}, got {type(error).__name__}: {error}{where}. Correct or uninstall it"


def planner_kind(name: str, path: str) -> PlannerKind:
    """Return a planner by name.

    Raises:
        InputError: if there is none, with the nearest known name.
    """
    kinds = planner_kinds()
    if name not in kinds:
        raise InputError([Problem(path, f"must be a known planner, got {shown(name)}; {nearest(name, kinds)}")])
    return kinds[name]


def planner_package(name: str) -> PlannerPackage | None:
    """Return the package that offers a planner, None for the planners of this one."""
    return _planner_package(name, offered())


@lru_cache(maxsize=64)
def _planner_package(name: str, entries: tuple[EntryPoint, ...]) -> PlannerPackage | None:
    """Look once a process, which runs what it has imported whatever becomes of the files."""
    if name in {kind.name for kind in BUILT_IN}:
        return None
    found = (entry for entry in entries if getattr(entry.load(), "name", None) == name)
    entry = next(found, None)
    return None if entry is None else package_of(entry)
