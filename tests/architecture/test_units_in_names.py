"""Whatever leaves Python says its unit: columns, keys of files, options. A new name without one fails here."""

import json
from pathlib import Path
from typing import get_args

import pytest
import typer

from sumo_hmdp.cli import app
from sumo_hmdp.decision.decide import answer
from sumo_hmdp.decision.problem_file import answer_document, read_problem
from sumo_hmdp.decision.problem_schema import ProblemFile
from sumo_hmdp.decision.registry import BUILT_IN
from sumo_hmdp.scenario.load import RunOptions, load_scenario
from sumo_hmdp.scenario.schema import ScenarioFile
from sumo_hmdp.study.record import DECISION_COLUMNS, RUN_COLUMNS, STEP_COLUMNS
from sumo_hmdp.study.run import execute
from sumo_hmdp.study.schema import StudyFile
from sumo_hmdp.validation import models_in

UNITS = ("m", "s", "ms", "mps", "mps2", "mps3", "rad", "radps", "m2", "m2ps2", "ps", "ps2", "radps2")
# Of metrics alone: integrals of seconds over time, and values per kilometre.
UNITS += ("s2", "spkm", "s2pkm")
# Numbers without a dimension, whose last word says so.
WORDS = (
    "share", "rate", "count", "prob", "probs", "level", "weight", "threshold", "cost", "steps", "index", "bound",
    "scale",
)  # fmt: skip
# Numbers without a dimension: lanes are counted from the left, a half-width is in its metric's unit, the rest are
# probabilities, costs and seeds.
DIMENSIONLESS = {
    "accelerate", "branches", "confidence", "count", "cruise", "decelerate", "ending", "ending_lanes", "exponent",
    "first", "forbidden_lanes",
    "contact_risk", "goal_lane", "half_width", "risk_least", "risk_taken", "undecided", "unsafe", "unwanted", "wanted",
    "intended_lane", "keep", "lane", "lanes", "left", "objective", "politeness", "probability", "right",
    "schema_version", "seed", "seeds", "seeds_max", "seeds_min", "step",
    # The numbers of a distribution have the unit of the key that it stands under.
    "max", "mean", "min", "share", "std",
    # Names in a record, which may look like numbers.
    "lanelet", "leave_out", "planning_problem", "vehicle",
    # Vehicles a kilometre, or an hour, and lane.
    "density_vpkm_per_lane", "flow_vph_per_lane", "ramp_flow_vph", "side_flow_vph",
}  # fmt: skip
OPTIONS = {
    "every",
    "predictor",
    "planner",
    "solver",
    "seed",
    "set",
    "epsilon",
    "out",
    "trace",
    "dump-decisions",
    "help",
    "version",
    "explain",
    "delay-ms",
    "figure",
    "frontier",
    "workers",
    "dask",
    "limit",
    "retry-failed",
    "dry-run",
    "metric",
    "by",
    "json",
    "open",
    # Of a film: a factor, frames a second, pixels.
    "speed",
    "fps",
    "width",
}
OPTIONS |= {"install-completion", "show-completion"}


def says_its_unit(name):
    stem, _, last = name.rpartition("_")
    return name in DIMENSIONLESS or (stem != "" and last in (*UNITS, *WORDS))


def offenders(names):
    return sorted({name for name in names if not says_its_unit(name)})


def is_number(annotation):
    """Tell whether an annotation lets a number in, alone or in a list."""
    return annotation in {int, float} or any(is_number(inner) for inner in get_args(annotation))


def numbers_of(model, seen=None):
    """Return the keys of all numbers that a model, and the models inside it, may hold in a file."""
    seen = set() if seen is None else seen
    if model in seen:
        return set()
    seen.add(model)
    keys = {name for name, field in model.model_fields.items() if is_number(field.annotation)}
    for field in model.model_fields.values():
        for inner in models_in(field):
            keys |= numbers_of(inner, seen)
    return keys


def numbers_in(document, key=""):
    """Return the keys of all numbers in a JSON document."""
    if isinstance(document, dict):
        return {found for key, value in document.items() for found in numbers_in(value, key)}
    if isinstance(document, (list, tuple)):
        return {found for item in document for found in numbers_in(item, key)}
    return {key} if isinstance(document, (int, float)) and not isinstance(document, bool) else set()


@pytest.mark.parametrize("name", ["speed", "gap_min", "solve_time", "x", "accel", "gap_min_km", "m"])
def test_a_name_without_its_unit_would_be_found(name):
    assert offenders([name]) == [name]


@pytest.mark.parametrize("columns", [RUN_COLUMNS, DECISION_COLUMNS, STEP_COLUMNS], ids=["runs", "decisions", "steps"])
def test_columns(columns):
    numbers = {name for name, kind in columns.items() if kind in {"int64", "Int64", "float64"}}
    assert len(numbers) > 5
    assert offenders(numbers) == []
    assert set(columns.values()) <= {"int64", "Int64", "float64", "str", "boolean"}


@pytest.mark.parametrize("model", [ScenarioFile, ProblemFile, StudyFile, *(kind.parameters for kind in BUILT_IN)])
def test_keys_of_files_that_are_read(model):
    assert offenders(numbers_of(model)) == []


def test_keys_are_found_at_any_depth():
    found = numbers_of(ScenarioFile)
    assert {"keep", "from_s", "gap_gain_ps2", "desired_speed_mps", "width_m", "lane"} <= found
    assert not found & {"mode", "name", "lateral_probs", "clock"}
    assert {"maneuver_cost", "goal_lane", "forbidden_lanes"} <= numbers_of(ProblemFile)


def test_keys_of_files_that_are_written(tmp_path):
    root = Path(__file__).parents[2]
    for file in sorted((root / "tests" / "fixtures" / "decisions").glob("*.json"))[:2]:
        assert offenders(numbers_in(answer_document(answer(read_problem(file))))) == []
    text = (root / "scenarios" / "case2.yaml").read_text(encoding="utf-8").replace("45.0 ", "0.6 ")
    (tmp_path / "case.yaml").write_text(text, encoding="utf-8")
    record = execute(load_scenario(tmp_path / "case.yaml", RunOptions()))
    manifest = dict(record.manifest)
    assert {"x_m", "risk_level"} <= numbers_in(manifest)
    assert offenders(numbers_in(manifest)) == []
    for column in ("plan_json", "branches_json", "forbidden_json", "bounds_json", "notes_json"):
        assert offenders(numbers_in(json.loads(record.decisions[column].iloc[0]))) == []
    assert set(record.row) == set(RUN_COLUMNS)


def test_options_are_words_without_a_dimension():
    commands = typer.main.get_command(app)
    found = {
        option.removeprefix("--")
        for command in (commands, *commands.commands.values())
        for parameter in command.params
        for option in parameter.opts
        if option.startswith("--")
    }
    assert {"epsilon", "out"} <= found
    assert found - OPTIONS == set()
