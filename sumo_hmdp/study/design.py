"""From a study file to cells and seeds: which runs a study consists of, checked before any of them starts."""

import itertools
import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from sumo_hmdp.decision.registry import planner_kinds
from sumo_hmdp.documents import Document, exists, is_file, read_yaml
from sumo_hmdp.errors import InputError, Problem
from sumo_hmdp.scenario.load import ReadyRun, RunOptions, assemble_scenario, find_scenario
from sumo_hmdp.scenario.packaged import scenario_names, study_names
from sumo_hmdp.scenario.schema import ScenarioFile
from sumo_hmdp.sim.recorded_world import RecordedSettings
from sumo_hmdp.study.factors import OPTION_FACTORS, Setting, factor_problems, settings_of
from sumo_hmdp.study.identity import cell_id_of, study_run_id
from sumo_hmdp.study.schema import CELL_COUNT_MAX, RUN_COUNT_MAX, SEED_MAX, SeedsFile, StoppingFile, StudyFile
from sumo_hmdp.study.stopping import metric_problem
from sumo_hmdp.validation import nearest, parse, shown


@dataclass(frozen=True)
class Cell:
    """One scenario with one combination of values: all of its runs differ in their seeds alone.

    Attributes:
        id: its name, from its content.
        factors: the values by their paths, as the study file gives them; a value that means nothing to the cell's
            planner is left out.
        ready: its run with the first seed.
        document: the scenario as it is run, from which it can be assembled again without any file.
    """

    id: str
    factors: Mapping[str, Any]
    ready: ReadyRun
    document: Mapping[str, Any]

    def run_id(self, seed: int) -> str:
        """Return the name of the cell's run with a seed."""
        return study_run_id(self.id, seed)


@dataclass(frozen=True)
class Design:
    """What a study runs.

    Attributes:
        file: the study file's content.
        cells: in the order of scenarios and factors.
        stages: seeds, batch by batch; without a rule for stopping there is one batch.
        notes: what a reader would not expect, such as combinations that are the same cell.
    """

    file: StudyFile
    cells: tuple[Cell, ...]
    stages: tuple[tuple[int, ...], ...]
    notes: tuple[str, ...] = ()

    @property
    def seeds(self) -> tuple[int, ...]:
        """All seeds, those that a rule for stopping may spare included."""
        return tuple(itertools.chain.from_iterable(self.stages))


def find_study(name_or_path: str) -> Path:
    """Return a study file, given by path or by the name of one that comes with the package.

    Raises:
        InputError: if there is neither.
    """
    known = study_names()
    path = Path(name_or_path)
    if is_file(path) or name_or_path in known:
        return path if is_file(path) else known[name_or_path]
    if exists(path):
        raise InputError(["must be a file, got a directory or device. Name the YAML file in it"], name_or_path)
    remedy = nearest(name_or_path, known)
    if name_or_path in scenario_names():
        remedy = f"it is a scenario: `sumo-hmdp run {name_or_path}`"
    raise InputError([f"must be a study file or name, got {name_or_path!r} (no such file); {remedy}"])


def load_design(path: Path, solver: str | None = None) -> Design:
    """Read a study file and check every run that it asks for.

    Args:
        path: the YAML file.
        solver: in place of the file's.

    Raises:
        InputError: with every mistake, its path and remedy.
    """
    return design_of(read_yaml(path), path, solver)


def design_of(document: Document, path: Path, solver: str | None = None) -> Design:
    """Check every run that a study asks for.

    Args:
        document: the study file's content.
        path: the file, for the messages and for what it names by paths from there.
        solver: in place of the file's.

    Raises:
        InputError: with every mistake, its path and remedy.
    """
    if (
        isinstance(document.content, Mapping)
        and "scenarios" not in document.content
        and ({"network", "road"} & set(document.content))
    ):
        raise InputError(["must be a study, got a scenario; run it with `sumo-hmdp run FILE`"], str(path))
    problems = list(document.problems)
    file = _read_study(document.content, problems)
    if solver is not None:
        file = file.model_copy(update={"solver": solver})
    problems += _own_problems(file, solver_given=solver is not None)
    large = list(_size_problems(file))
    if large:
        raise InputError(dict.fromkeys(problems + large), str(path))
    scenarios: dict[str, tuple[Path, Document]] = {}
    for index, name in enumerate(file.scenarios):
        try:
            scenarios[name] = _read_scenario(name, path.parent)
        except InputError as error:
            problems += [Problem(f"scenarios[{index}]", p.message) for p in error.problems]
    cells, notes = _cells(file, scenarios, problems)
    if problems:
        raise InputError(dict.fromkeys(problems), str(path))
    notes += tuple(
        dict.fromkeys(f"scenario {cell.ready.scenario}: {note}" for cell in cells for note in cell.ready.notes)
    )
    return Design(file, cells, _stages(file.seeds, file.stopping), notes)


def _read_study(content: Any, problems: list[Problem]) -> StudyFile:  # noqa: ANN401 - any YAML
    """Check a study file's form; what has no mistake of form is returned even if the rest has, to be checked further.

    Raises:
        InputError: if there is nothing to check further.
    """
    try:
        return parse(StudyFile, content)
    except InputError as error:
        if not isinstance(content, Mapping):
            raise
        problems += error.problems
        broken = {re.split(r"[.\[]", problem.path)[0] for problem in error.problems}
    sound = {key: value for key, value in content.items() if key in StudyFile.model_fields and key not in broken}
    seeds = {} if "stopping" in sound else {"count": 1}
    file = parse(StudyFile, {"name": "unnamed", "scenarios": ["none"], "seeds": seeds} | sound)
    return file if "scenarios" in sound else file.model_copy(update={"scenarios": []})


def _size_problems(file: StudyFile) -> Iterator[Problem]:
    """Yield that there are more combinations than can be tried."""
    cells = len(file.scenarios) * math.prod(len(values) for values in file.factors.values())
    if cells > CELL_COUNT_MAX:
        yield Problem("factors", f"must make at most {CELL_COUNT_MAX} cells, got {shown(cells)}; take values out")
    seeds, stopping = file.seeds, file.stopping
    if isinstance(seeds, SeedsFile):
        count = seeds.count or (1 if stopping is None else stopping.seeds_max)
    else:
        count = len(seeds)
    if cells <= CELL_COUNT_MAX and cells * count > RUN_COUNT_MAX:
        yield Problem("seeds", f"must make at most {RUN_COUNT_MAX} runs, got {cells * count}; lower their number")


def _read_scenario(name: str, folder: Path) -> tuple[Path, Document]:
    beside = folder / name
    found = beside if is_file(beside) else find_scenario(name)
    return found, read_yaml(found)


def _own_problems(file: StudyFile, *, solver_given: bool) -> Iterator[Problem]:
    if len(set(file.scenarios)) < len(file.scenarios):
        yield Problem("scenarios", "must name every scenario once; remove the others")
    given = solver_given or "solver" in file.model_fields_set
    yield from factor_problems(file.factors, solver_given=given)
    yield from _seed_problems(file.seeds, file.stopping)


def _seed_problems(seeds: SeedsFile | Sequence[int], stopping: StoppingFile | None) -> Iterator[Problem]:
    if isinstance(seeds, SeedsFile):
        if (seeds.count is None) == (stopping is None):
            message = "is missing; add it" if stopping is None else "must be left out, stopping.seeds_max bounds it"
            yield Problem("seeds.count", message)
        last = seeds.first + (seeds.count or (stopping.seeds_max if stopping else 1)) - 1
        if last > SEED_MAX:
            yield Problem("seeds.first", f"must leave all seeds at most {SEED_MAX}, got up to {last}. Lower it")
    elif stopping is not None:
        yield Problem("seeds", "must be {first: ...} with `stopping`, got a list; stopping.seeds_max bounds it")
    elif len(set(seeds)) < len(seeds):
        yield Problem("seeds", "must name every seed once; remove the others")
    if stopping is not None:
        if stopping.seeds_max < stopping.seeds_min:
            message = f"must be at least seeds_min ({stopping.seeds_min}), got {stopping.seeds_max}"
            yield Problem("stopping.seeds_max", f"{message}. Raise it")
        message = metric_problem(stopping.metric)
        if message:
            yield Problem("stopping.metric", message)


def _stages(seeds: SeedsFile | Sequence[int], stopping: StoppingFile | None) -> tuple[tuple[int, ...], ...]:
    if not isinstance(seeds, SeedsFile):
        return (tuple(seeds),)
    if stopping is None:
        return (tuple(range(seeds.first, seeds.first + (seeds.count or 0))),)
    bounds = [0, *range(stopping.seeds_min, stopping.seeds_max, stopping.batch_count), stopping.seeds_max]
    return tuple(tuple(range(seeds.first + a, seeds.first + b)) for a, b in itertools.pairwise(bounds))


def _cells(
    file: StudyFile, scenarios: Mapping[str, tuple[Path, Document]], problems: list[Problem]
) -> tuple[tuple[Cell, ...], tuple[str, ...]]:
    """Assemble every combination; those whose difference means nothing to their planner are one cell."""
    cells: dict[str, Cell] = {}
    merged = 0
    factors = [settings_of(factor, values) for factor, values in file.factors.items()]
    for name, settings in itertools.product(scenarios, itertools.product(*factors)):
        chosen = dict(zip(file.factors, settings, strict=True))
        try:
            cell = _cell(file, *scenarios[name], chosen)
        except InputError as error:
            problems += [_located(problem, chosen, name) for problem in error.problems]
            continue
        same = cells.get(cell.id)
        if same is None:
            cells[cell.id] = cell
            continue
        merged += 1
        # A value that makes no difference is no property of the cell.
        alike = {f: v for f, v in same.factors.items() if f in cell.factors and cell.factors[f] == v}
        cells[cell.id] = replace(same, factors=alike)
    notes = []
    if merged:
        notes.append(
            f"{merged} combinations are the same cell as another one, since their difference means nothing to the "
            "planner (a risk level to a planner without one, a parameter of a planner that does not drive)"
        )
    return tuple(cells.values()), tuple(notes)


def _cell(file: StudyFile, path: Path, document: Document, chosen: Mapping[str, Setting]) -> Cell:
    content = document.content if isinstance(document.content, Mapping) else {}
    values = {place: value for setting in chosen.values() for place, value in setting.sets.items()}
    overrides = {factor: value for factor, value in values.items() if factor not in OPTION_FACTORS}
    planner, solver, risk_level = (values.get(factor) for factor in OPTION_FACTORS)
    problems = []
    for factor, what in (("planner", planner), ("solver", solver)):
        if what is not None and not isinstance(what, str):
            problems.append(Problem(OPTION_FACTORS[factor], f"must be text, got {shown(what)}"))
    if risk_level is not None and (isinstance(risk_level, bool) or not isinstance(risk_level, int | float)):
        problems.append(Problem("--epsilon", f"must be a number, got {shown(risk_level)}"))
    if problems:
        raise InputError(problems)
    kind = planner_kinds().get(str(planner or content.get("planner", "")))
    kept = {factor: setting.value for factor, setting in chosen.items()}
    if kind is not None and "risk_level" not in kind.parameters.model_fields:
        risk_level = None
        kept.pop("risk_level", None)
    options = RunOptions(
        planner=planner,
        solver=solver or file.solver,
        risk_level=risk_level if risk_level is None else _as_float(risk_level),
        overrides=overrides,
    )
    ready = assemble_scenario(document, options, path)
    return Cell(cell_id_of(ready), kept, ready, document_of(ready))


def _as_float(number: float) -> float:
    """Return a number as a float; a whole number beyond all floats is far out of any range, too."""
    return number if isinstance(number, float) else float(min(max(number, -1e300), 1e300))


def document_of(ready: ReadyRun) -> dict[str, Any]:
    """Return a scenario as it is run, with defaults filled in and the network's path where it is not the package's."""
    text = json.dumps(dict(ready.configuration), allow_nan=False)
    content: dict[str, Any] = json.loads(text)
    world = ready.world
    if not isinstance(world, RecordedSettings) and content.get("road") is None:
        file = world.net_file
        if file.name != f"{content['network']}.net.xml":
            content["network"] = str(file.resolve())
    return content


def _located(problem: Problem, chosen: Mapping[str, Setting], scenario: str) -> Problem:
    """Say where in the study file a scenario's mistake comes from."""
    for setting in chosen.values():
        for path in setting.sets:
            place = setting.place_of(path)
            if OPTION_FACTORS.get(path) == problem.path:
                return Problem(place, problem.message)
            if problem.message.startswith("unknown key") and f"{path}.".startswith(f"{problem.path}."):
                known = [*OPTION_FACTORS, *ScenarioFile.model_fields]
                remedy = problem.message if "." in problem.path else f"unknown key; {nearest(problem.path, known)}"
                return Problem(place if setting.named else f"factors.{path}", f"{remedy} (scenario {scenario})")
            if path == problem.path or re.match(rf"{re.escape(path)}[.\[]", problem.path):
                inside = problem.path[len(path) :] if setting.named else ""
                return Problem(f"{place}{inside}", f"{problem.message} (scenario {scenario})")
    if problem.path == "--solver":
        return Problem("solver", problem.message)
    return Problem(f"scenario {scenario}", str(problem))
