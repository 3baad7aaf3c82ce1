"""From a scenario file to a run that is ready to start."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sumo_hmdp.documents import Document, read_yaml
from sumo_hmdp.domain.maneuver import MODE_BY_LABEL
from sumo_hmdp.domain.plan import Planner
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import EGO_ID, VehicleState
from sumo_hmdp.errors import InputError, Problem
from sumo_hmdp.hmdp.policy import ScheduledPolicy
from sumo_hmdp.planning.decide import SOLVERS
from sumo_hmdp.planning.planner import Belief
from sumo_hmdp.planning.problem_checks import planner_checks
from sumo_hmdp.planning.registry import PlannerContext, PlannerKind, planner_kind, planner_kinds
from sumo_hmdp.scenario.checks import (
    cross_checks,
    data_folder,
    dead_ends,
    lane_count,
    network_path,
    planner_lane_checks,
    start_checks,
    time_checks,
)
from sumo_hmdp.scenario.overrides import with_overrides
from sumo_hmdp.scenario.schema import (
    ConstantSpeedFile,
    IdmFile,
    ModeScheduleFile,
    ScenarioFile,
    VehicleFile,
)
from sumo_hmdp.sim.episode import Driver, EpisodeSettings
from sumo_hmdp.sim.motion import MotionKind
from sumo_hmdp.sim.world_checks import WorldSettings
from sumo_hmdp.traffic.scripted import Clock, ConstantSpeed, GapKeeping, ModeSchedule
from sumo_hmdp.traffic.spawn import DriverKind, IdmParameters, Spawn
from sumo_hmdp.validation import FileModel, nearest, parse
from sumo_hmdp.vehicle.bicycle import BicycleParameters


@dataclass(frozen=True)
class RunOptions:
    """What the command line may change.

    Attributes:
        planner: None takes the scenario's own.
        solver: a name of `SOLVERS`.
        seed: of everything random.
        risk_level: epsilon of the planner, None takes the scenario's.
        overrides: values that take the place of the scenario's, by path such as `ego.speed_mps`.
    """

    planner: str | None = None
    solver: str = "milp"
    seed: int = 0
    risk_level: float | None = None
    overrides: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class ReadyRun:
    """A run that only has to be started.

    Attributes:
        scenario: the scenario's name.
        planner_name: the planner's name.
        seed: the seed.
        solver: the solver's name.
        episode: what happens.
        world: network and step.
        spawns: the surrounding vehicles.
        planner: who decides.
        parameters: of the planner, as in the file form.
        configuration: the whole scenario as it was used.
    """

    scenario: str
    planner_name: str
    seed: int
    solver: str
    episode: EpisodeSettings
    world: WorldSettings
    spawns: tuple[Spawn, ...]
    planner: Planner[Any]
    parameters: Mapping[str, Any]
    configuration: Mapping[str, Any]


def scenario_names() -> dict[str, Path]:
    """Return the scenarios that come with the package, by name."""
    return {path.stem: path for path in sorted(data_folder("scenarios").glob("*.yaml"))}


def find_scenario(name_or_path: str) -> Path:
    """Return the file of a scenario, given by path or by the name of one that comes with the package.

    Raises:
        InputError: if there is neither.
    """
    path = Path(name_or_path)
    if path.is_file():
        return path
    known = scenario_names()
    if name_or_path in known:
        return known[name_or_path]
    if path.exists():
        raise InputError(["must be a file, got a directory or device. Name the YAML file in it"], name_or_path)
    remedy = "check the path" if path.suffix in {".yaml", ".yml"} else nearest(name_or_path, known)
    raise InputError([f"must be a scenario file or name, got {name_or_path!r} (no such file); {remedy}"])


def load_scenario(path: Path, options: RunOptions | None = None) -> ReadyRun:
    """Read, check and assemble a scenario.

    Args:
        path: the YAML file.
        options: what the command line changes.

    Raises:
        InputError: with every mistake and its path.
    """
    return assemble_scenario(read_yaml(path), options or RunOptions(), path)


def assemble_scenario(document: Document, options: RunOptions, path: Path) -> ReadyRun:
    """Check and assemble a scenario that has been read.

    Args:
        document: the scenario; the `configuration` of a run is one, too.
        options: what is changed.
        path: its file, for the messages and for networks given by a path from there.

    Raises:
        InputError: with every mistake and its path.
    """
    content = document.content
    problems = list(document.problems)
    if isinstance(content, Mapping) and options.overrides:
        try:
            content = with_overrides(content, options.overrides)
        except InputError as error:
            problems.extend(error.problems)
    scenario: ScenarioFile | None = None
    try:
        scenario = parse(ScenarioFile, content)
    except InputError as error:
        problems.extend(error.problems)
    raw = content if isinstance(content, Mapping) else {}
    name, parameters = None, None
    try:
        name, parameters = _planner_parameters(raw, options)
    except InputError as error:
        problems.extend(error.problems)
    problems.extend(cross_checks(raw, path.parent))
    if scenario is None or parameters is None or name is None or problems:
        raise InputError(_unique(problems), str(path))
    problems.extend(dead_ends(scenario, getattr(parameters, "horizon_steps", 1)))
    problems.extend(time_checks(scenario, name, parameters))
    if problems:
        raise InputError(problems, str(path))
    ready = _assemble(scenario, name, parameters, options, network_path(scenario.network, path.parent))
    problems.extend(start_checks(ready.world, ready.episode.ego, ready.spawns, ready.planner_name))
    if problems:
        raise InputError(problems, str(path))
    return ready


def _unique(problems: list[Problem]) -> list[Problem]:
    return list(dict.fromkeys(problems))


def _planner_parameters(raw: Mapping[str, Any], options: RunOptions) -> tuple[str, Any]:
    """Return the planner's name and its checked parameters; the sections of other planners are checked too."""
    problems: list[Problem] = []
    if options.solver not in SOLVERS:
        remedy = nearest(options.solver, SOLVERS)
        problems.append(Problem("--solver", f"must be a known solver, got {options.solver!r}; {remedy}"))
    chosen = options.planner or raw.get("planner")
    sections = raw.get("planners")
    sections = sections if isinstance(sections, Mapping) else {}
    parameters: Any = None
    for name in dict.fromkeys([chosen, *sections]):
        section = sections.get(name)
        if not isinstance(name, str) or not isinstance(section, Mapping | None):
            continue
        try:
            if name == chosen:
                kind = planner_kind(name, "--planner" if options.planner else "planner")
                parameters = _section(kind, section, options.risk_level, lane_count(raw))
            else:
                _section(planner_kind(name, f"planners.{name}"), section, None, lane_count(raw))
        except InputError as error:
            problems.extend(error.problems)
    if "planners" not in raw or not set(sections) <= set(planner_kinds()):
        # That its section is missing, or misspelt, is reported already.
        problems = [problem for problem in problems if problem.path != f"planners.{chosen}"]
    if parameters is None or problems:
        raise InputError(problems)
    return str(chosen), parameters


def _section(
    kind: PlannerKind, section: Mapping[str, Any] | None, risk_level: float | None, lane_count: int | None
) -> FileModel:
    """Check what a scenario holds for one planner; None where it holds nothing."""
    path, values = f"planners.{kind.name}", dict(section or {})
    fields = kind.parameters.model_fields
    if risk_level is not None:
        if "risk_level" not in fields:
            message = f"must go with a planner that has a risk level, got {kind.name!r}; leave it out"
            raise InputError([Problem("--epsilon", message)])
        values["risk_level"] = risk_level
    required = [name for name, field in fields.items() if field.is_required() and name not in values]
    if section is None and required:
        raise InputError([Problem(path, f"is missing; add it with {', '.join(required)}")])
    problems: list[Problem] = []
    try:
        parameters = parse(kind.parameters, values)
    except InputError as error:
        for problem in error.problems:
            option = risk_level is not None and problem.path == "risk_level"
            problems.append(Problem("--epsilon" if option else f"{path}.{problem.path}", problem.message))
    problems.extend(planner_checks(values, path))
    problems.extend(planner_lane_checks(values, path, lane_count))
    if problems:
        raise InputError(problems)
    return parameters


def _assemble(
    scenario: ScenarioFile,
    name: str,
    parameters: Any,  # noqa: ANN401 - each planner's own
    options: RunOptions,
    network: Path,
) -> ReadyRun:
    road = Road(scenario.lanes.count, scenario.lanes.width_m)
    bicycle = BicycleParameters()
    ego = VehicleState(
        id=EGO_ID,
        x=scenario.ego.x_m,
        y=road.center_y(scenario.ego.lane),
        speed=scenario.ego.speed_mps,
        lane=scenario.ego.lane,
        mode=MODE_BY_LABEL[scenario.ego.mode],
        length=bicycle.length,
        width=bicycle.width,
    )
    context = PlannerContext(
        lane_count=road.lane_count,
        lane_width=road.lane_width,
        dt=scenario.dt_s,
        lane_change_time=scenario.ego.lane_change_time_s,
        beliefs={vehicle.id: _belief(vehicle, road.lane_count) for vehicle in scenario.vehicles},
        default_belief=None,
        solver=options.solver,
    )
    kind = planner_kind(name, "planner")
    sumo_driver = kind.sumo_driver(parameters, context) if kind.sumo_driver is not None else None
    drivers = {vehicle.id: driver for vehicle in scenario.vehicles if (driver := _driver(vehicle)) is not None}
    return ReadyRun(
        scenario=scenario.name,
        planner_name=name,
        seed=options.seed,
        solver=options.solver,
        episode=EpisodeSettings(
            road=road,
            dt=scenario.dt_s,
            duration=scenario.duration_s,
            ego=ego,
            bicycle=bicycle,
            lane_change_time=scenario.ego.lane_change_time_s,
            drivers=drivers,
            motion=MotionKind(scenario.ego.motion) if sumo_driver is None else MotionKind.SUMO,
        ),
        world=WorldSettings(network, road, scenario.dt_s, options.seed, sumo_driver),
        spawns=tuple(_spawn(vehicle) for vehicle in scenario.vehicles),
        planner=kind.build(parameters, context),
        parameters=parameters.model_dump(),
        configuration=scenario.model_dump(),
    )


def _belief(vehicle: VehicleFile, lane_count: int) -> Belief:
    entries = sorted(((entry.from_s, entry.policy(lane_count)) for entry in vehicle.policy), key=lambda item: item[0])
    return Belief(ScheduledPolicy(tuple(entries)), vehicle.noise())


def _driver(vehicle: VehicleFile) -> Driver | None:
    """Return the driver of a scripted vehicle, None for one that SUMO drives."""
    match vehicle.driver:
        case ConstantSpeedFile():
            return ConstantSpeed()
        case ModeScheduleFile() as file:
            following = file.car_following
            return ModeSchedule(
                switches=tuple((s.from_s, MODE_BY_LABEL[s.mode]) for s in file.switches),
                accel=file.accel_mps2,
                speed_cap=file.speed_max_mps,
                car_following=None
                if following is None
                else GapKeeping(
                    standstill_gap=following.standstill_gap_m,
                    time_gap=following.time_gap_s,
                    gap_gain=following.gap_gain_ps2,
                    speed_gain=following.speed_gain_ps,
                    decel_max=following.decel_max_mps2,
                    accel_max=following.accel_max_mps2,
                    release_surplus=following.release_surplus_m,
                ),
                clock=Clock(file.clock),
            )
        case _:
            return None


def _spawn(vehicle: VehicleFile) -> Spawn:
    common: dict[str, Any] = {
        "id": vehicle.id, "lane": vehicle.lane, "x": vehicle.x_m, "speed": vehicle.speed_mps,
        "length": vehicle.length_m, "width": vehicle.width_m,
    }  # fmt: skip
    if isinstance(vehicle.driver, IdmFile):
        idm = vehicle.driver
        return Spawn(
            **common,
            driver=DriverKind.IDM,
            desired_speed=idm.desired_speed_mps,
            idm=IdmParameters(idm.min_gap_m, idm.time_gap_s, idm.accel_mps2, idm.decel_mps2, idm.exponent),
        )
    return Spawn(**common, driver=DriverKind.SCRIPTED)
