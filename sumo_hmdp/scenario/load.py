"""From a scenario file to a run that is ready to start."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from sumo_hmdp.decision.decide import SOLVERS
from sumo_hmdp.decision.problem_checks import planner_checks, table_checks
from sumo_hmdp.decision.registry import PlannerContext, PlannerKind, planner_kind, planner_kinds
from sumo_hmdp.documents import Document, exists, is_file, read_yaml
from sumo_hmdp.domain.maneuver import MODE_BY_LABEL
from sumo_hmdp.domain.plan import Planner
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.scene import EGO_ID, VehicleState
from sumo_hmdp.errors import InputError, Problem, SimulationError
from sumo_hmdp.scenario.checks import (
    cross_checks,
    crowd_checks,
    dead_ends,
    goal_checks,
    lane_count,
    network_checks,
    network_path,
    planner_lane_checks,
    road_end_notes,
    sequence_checks,
    start_checks,
    time_checks,
)
from sumo_hmdp.scenario.crowd import background, ego_start
from sumo_hmdp.scenario.matched_traffic import matched_traffic_checks, matched_vehicles, stretch_checks
from sumo_hmdp.scenario.network_use import rule_checks, run_notes
from sumo_hmdp.scenario.overrides import with_overrides
from sumo_hmdp.scenario.packaged import scenario_names, study_names
from sumo_hmdp.scenario.recorded import Record, recorded_settings, time_problems, with_record
from sumo_hmdp.scenario.road import road_file, road_problems, with_road
from sumo_hmdp.scenario.schema import ScenarioFile
from sumo_hmdp.scenario.vehicles import (
    belief_of,
    driver_of,
    matched_paths,
    measurement,
    spawn_of,
)
from sumo_hmdp.sim.episode import EpisodeSettings
from sumo_hmdp.sim.libsumo_world import LibsumoWorld
from sumo_hmdp.sim.measurement import Measurement
from sumo_hmdp.sim.motion import MotionKind
from sumo_hmdp.sim.network import read_network
from sumo_hmdp.sim.recorded_world import RecordedSettings, RecordedWorld, recorded_problems
from sumo_hmdp.sim.world import World
from sumo_hmdp.sim.world_checks import WorldSettings
from sumo_hmdp.traffic.spawn import DriverKind, Spawn
from sumo_hmdp.validation import FileModel, nearest, parse, shown
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
        notes: what is allowed but hardly meant, and what the network says that a reader should know, a line each.
    """

    scenario: str
    planner_name: str
    seed: int
    solver: str
    episode: EpisodeSettings
    world: WorldSettings | RecordedSettings
    spawns: tuple[Spawn, ...]
    planner: Planner[Any]
    parameters: Mapping[str, Any]
    configuration: Mapping[str, Any]
    notes: tuple[str, ...] = ()

    def open_world(self) -> World:
        """Return the run's world, to be used in a `with` statement.

        Raises:
            InputError: with every mistake in what the world is given.
        """
        if isinstance(self.world, RecordedSettings):
            return RecordedWorld(self.world, self.episode.ego)
        return LibsumoWorld(self.world, self.episode.ego, self.spawns)


def find_scenario(name_or_path: str) -> Path:
    """Return the file of a scenario, given by path or by the name of one that comes with the package.

    Raises:
        InputError: if there is neither.
    """
    path = Path(name_or_path)
    if is_file(path):
        return path
    known = scenario_names()
    if name_or_path in known:
        return known[name_or_path]
    if exists(path):
        raise InputError(["must be a file, got a directory or device. Name the YAML file in it"], name_or_path)
    remedy = "check the path" if path.suffix in {".yaml", ".yml"} else nearest(name_or_path, known)
    if name_or_path in study_names():
        remedy = f"it is a study: `sumo-hmdp study {name_or_path} --out DIR`"
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
    scenario, record, name, parameters = _checked_parts(document, options, path)
    problems = list(dead_ends(scenario, getattr(parameters, "horizon_steps", 1)))
    problems.extend(time_checks(scenario, name, parameters))
    problems.extend(matched_traffic_checks(scenario, getattr(parameters, "horizon_steps", 1)))
    problems.extend(crowd_checks(scenario, sumo_drives=planner_kind(name, "planner").sumo_driver is not None))
    if record is not None:
        return _assemble_recorded(scenario, record, name, parameters, options, path, problems)
    return _assemble_network(scenario, name, parameters, options, path, problems)


def _checked_parts(document: Document, options: RunOptions, path: Path) -> tuple[ScenarioFile, Record | None, str, Any]:
    """Return a scenario, its recorded traffic if any, and the planner's name and parameters, each checked by itself.

    Raises:
        InputError: with every mistake and its path.
    """
    content = document.content
    if isinstance(content, Mapping) and "scenarios" in content and "network" not in content:
        raise InputError(["must be a scenario, got a study; run it with `sumo-hmdp study FILE --out DIR`"], str(path))
    problems = list(document.problems)
    if isinstance(content, Mapping) and options.overrides:
        try:
            content = with_overrides(content, options.overrides)
        except InputError as error:
            problems.extend(error.problems)
    record: Record | None = None
    if isinstance(content, Mapping) and isinstance(content.get("tracks"), Mapping):
        try:
            content, record = with_record(content, path.parent)
        except InputError as error:
            raise InputError(_unique([*problems, *error.problems]), str(path)) from None
    content, scenario = _parsed(content, problems)
    raw = content if isinstance(content, Mapping) else {}
    name, parameters = None, None
    try:
        name, parameters = _planner_parameters(raw, options)
    except InputError as error:
        problems.extend(error.problems)
    problems.extend(cross_checks(raw, path.parent) if isinstance(content, Mapping) else ())
    if scenario is None or parameters is None or name is None or problems:
        raise InputError(_unique(problems), str(path))
    return scenario, record, name, parameters


def _assemble_network(
    scenario: ScenarioFile,
    name: str,
    parameters: Any,  # noqa: ANN401 - each planner's own
    options: RunOptions,
    path: Path,
    problems: list[Problem],
) -> ReadyRun:
    """Check and assemble a scenario on a network, with what has been found wrong so far.

    Raises:
        InputError: with every mistake.
    """
    network = _network(scenario, path.parent)
    road = Road(scenario.lanes.count, scenario.lanes.width_m)
    problems.extend(network_checks(network, road))
    problems.extend(() if problems else stretch_checks(scenario, read_network(network, road)))
    problems.extend(() if problems else rule_checks(scenario, read_network(network, road), name, parameters))
    if not problems:
        problems.extend(sequence_checks(scenario, name, parameters))
    if problems:
        raise InputError(problems, str(path))
    try:
        ready = _assemble(scenario, name, parameters, options, network)
    except InputError as error:
        raise InputError(error.problems, str(path)) from None
    except SimulationError as error:
        raise InputError(
            [Problem("traffic", f"must be simulated before the run begins, got: {error}")], str(path)
        ) from error
    world = ready.world
    assert isinstance(world, WorldSettings)  # noqa: S101 - it has no recorded traffic
    problems.extend(start_checks(world, ready.episode.ego, ready.spawns, ready.planner_name))
    problems.extend(goal_checks(world, ready.episode.ego, scenario.ego.goal_x_m))
    if problems:
        raise InputError(problems, str(path))
    notes = [
        *run_notes(world, ready.episode.ego, ready.spawns, ready.parameters),
        *road_end_notes(world, ready.episode, ready.parameters),
    ]
    return replace(ready, notes=tuple(notes))


def _parsed(content: Any, problems: list[Problem]) -> tuple[Any, ScenarioFile | None]:  # noqa: ANN401 - any YAML
    """Return a document as it is used, and the scenario that it is, None where that has mistakes; these are added."""
    if isinstance(content, Mapping):
        problems.extend(road_problems(content))
        content = with_road(content)
    scenario: ScenarioFile | None = None
    try:
        scenario = parse(ScenarioFile, content)
    except InputError as error:
        # What is wrong with a road is wrong with the lanes that follow from it, too.
        repeated = isinstance(content, Mapping) and content.get("road") is not None
        problems.extend(p for p in error.problems if not (repeated and p.path.startswith("lanes")))
    return content, scenario


def _network(scenario: ScenarioFile, folder: Path) -> Path:
    """Return the network's file; that of a described road is written first."""
    if scenario.road is None:
        return network_path(str(scenario.network), folder)
    try:
        return road_file(scenario.road)
    except OSError as error:
        raise InputError([Problem("road", f"must be written to a temporary file, got: {error}")]) from None


def with_planner(run: ReadyRun, planner: Planner[Any]) -> ReadyRun:
    """Return a run that a planner object drives.

    Args:
        run: assembled with a planner that leaves the ego to its commands.
        planner: an object with `period` [s], `initial_memory()` and `decide(scene, memory)`.

    Raises:
        InputError: the object is no planner.
    """
    missing = [name for name in ("period", "initial_memory", "decide") if not hasattr(planner, name)]
    if isinstance(planner, type) or missing:
        what = f"a class; call {planner.__name__}()" if isinstance(planner, type) else f"no {', '.join(missing)}"
        message = f"must be an object with period, initial_memory and decide, got {shown(planner)}"
        raise InputError([Problem("planner", f"{message}: {what}")])
    name = str(getattr(planner, "name", type(planner).__name__.lower()))
    return replace(run, planner=planner, planner_name=name, parameters={})


def _assemble_recorded(
    scenario: ScenarioFile,
    record: Record,
    name: str,
    parameters: Any,  # noqa: ANN401 - each planner's own
    options: RunOptions,
    path: Path,
    problems: list[Problem],
) -> ReadyRun:
    """Check and assemble a scenario of recorded traffic, with what has been found wrong so far.

    Raises:
        InputError: with every mistake.
    """
    section = scenario.tracks
    assert section is not None  # noqa: S101 - there is a record
    if planner_kind(name, "planner").sumo_driver is not None:
        message = f"must be one that drives the ego itself where there are `tracks`, got {name!r}: there is no SUMO"
        problems.append(Problem("--planner" if options.planner else "planner", f"{message}; choose another"))
    problems.extend(table_checks(section.belief.model_dump(), "tracks.belief", scenario.lanes.count))
    problems.extend(time_problems(section, record.traffic, scenario.duration_s))
    if scenario.ego.in_traffic:
        problems.append(Problem("ego.in_traffic", "must be false where there are `tracks`; name the ego.vehicle"))
    if not problems:
        problems.extend(sequence_checks(scenario, name, parameters))
    if problems:
        raise InputError(problems, str(path))
    road = record.traffic.road
    if record.ego is None:
        speed = 0.0 if scenario.ego.speed_mps is None else scenario.ego.speed_mps
        start = VehicleState(EGO_ID, scenario.ego.x_m, road.center_y(scenario.ego.lane), speed, scenario.ego.lane)
        if scenario.ego.speed_mps is None:
            raise InputError([Problem("ego.speed_mps", "is missing; add it, or name the ego.vehicle")], str(path))
    else:
        start = record.ego
    bicycle = BicycleParameters()
    ego = VehicleState(
        id=EGO_ID,
        x=start.x,
        y=start.y,
        speed=start.speed,
        lane=start.lane,
        mode=MODE_BY_LABEL[scenario.ego.mode],
        heading=start.heading,
        length=bicycle.length,
        width=bicycle.width,
    )
    world = recorded_settings(section, record, scenario.dt_s, scenario.duration_s)
    problems.extend(recorded_problems(world, ego))
    goal = scenario.ego.goal_x_m
    if goal is not None and not ego.x < goal < world.x_end:
        message = f"must be ahead of the ego's start at {ego.x:g} m and before the road's end at {world.x_end:g} m"
        problems.append(Problem("ego.goal_x_m", f"{message}, got {goal:g} m; move it, or leave it out"))
    if problems:
        raise InputError(problems, str(path))
    lane_change_time = scenario.ego.lane_change_time_s
    context = PlannerContext(
        lane_count=road.lane_count,
        lane_width=road.lane_width,
        dt=scenario.dt_s,
        lane_change_time=lane_change_time,
        beliefs={},
        default_belief=section.belief.belief(road.lane_count, lane_change_time),
        solver=options.solver,
    )
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
            lane_change_time=lane_change_time,
            drivers={},
            motion=MotionKind(scenario.ego.motion),
            goal_x=goal,
            measurement=Measurement(options.seed, otherwise=section.measurement.noise()),
        ),
        world=world,
        spawns=(),
        planner=planner_kind(name, "planner").build(parameters, context),
        parameters=parameters.model_dump(),
        configuration=scenario.model_dump(),
        notes=record.traffic.notes,
    )


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
    # What is no text is no planner's name, which is reported already; a list or mapping is no key either.
    for name in dict.fromkeys(name for name in (chosen, *sections) if isinstance(name, str)):
        section = sections.get(name)
        if not isinstance(section, Mapping | None):
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
    kind = planner_kind(name, "planner")
    traffic, vehicles = scenario.traffic, matched_vehicles(scenario, options.seed)
    world = WorldSettings(network, road, scenario.dt_s, options.seed)
    crowd: tuple[Spawn, ...] = ()
    if traffic is not None:
        world = replace(
            world, background=traffic.settings(), sight=traffic.sight_m, speed_limit=traffic.speed_limit_mps
        )
        crowd = background(traffic, world, scenario.duration_s)
    start, crowd = ego_start(scenario.ego, crowd)
    ego = VehicleState(
        id=EGO_ID,
        x=start.x,
        y=road.center_y(start.lane),
        speed=start.speed,
        lane=start.lane,
        mode=MODE_BY_LABEL[scenario.ego.mode],
        length=bicycle.length,
        width=bicycle.width,
    )
    context = PlannerContext(
        lane_count=road.lane_count,
        lane_width=road.lane_width,
        dt=scenario.dt_s,
        lane_change_time=scenario.ego.lane_change_time_s,
        beliefs={
            vehicle.id: belief_of(vehicle, road.lane_count, scenario.ego.lane_change_time_s) for vehicle in vehicles
        },
        default_belief=None
        if traffic is None
        else traffic.belief.belief(road.lane_count, traffic.lane_changes.duration_s),
        solver=options.solver,
    )
    sumo_driver = kind.sumo_driver(parameters, context) if kind.sumo_driver is not None else None
    model = scenario.planners.get("hmdp_mpc", {})
    paths = matched_paths(scenario, vehicles, road, model, options.seed) if scenario.noise else {}
    spawns = [spawn_of(vehicle) for vehicle in vehicles]
    if scenario.noise:
        spawns = [replace(spawn, driver=DriverKind.POSED) for spawn in spawns]
    drivers = {
        vehicle.id: driver for vehicle in vehicles if not scenario.noise and (driver := driver_of(vehicle)) is not None
    }
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
            paths=paths,
            goal_x=scenario.ego.goal_x_m,
            measurement=measurement(scenario, vehicles, options.seed),
        ),
        world=replace(world, ego_driver=sumo_driver),
        spawns=(*spawns, *crowd),
        planner=kind.build(parameters, context),
        parameters=parameters.model_dump(),
        configuration=scenario.model_dump(),
    )
