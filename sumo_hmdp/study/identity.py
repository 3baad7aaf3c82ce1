"""Names of cells and runs that follow from what is run, so that they are the same on every machine."""

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from sumo_hmdp.decision.registry import planner_kind, planner_package
from sumo_hmdp.scenario.load import ReadyRun
from sumo_hmdp.sim.recorded_world import RecordedSettings
from sumo_hmdp.study.store import SCHEMA_VERSION

# What a scenario says besides the run itself: texts for people, and the sections of planners that do not drive.
_NOT_RUN = ("description", "published", "planner", "planners")
# Sections that came later: where there is none, a cell keeps the name that it had before.
_LATER = ("matched_traffic", "road", "tracks")
_LATER_OF_EGO = ("vehicle", "planning_problem")
# What a world with `noise` takes from the section of `hmdp_mpc`.
_MODEL = ("period_s", "accel_mps2")


def content_of(run: ReadyRun) -> dict[str, Any]:
    """Return everything that decides what happens in a run, apart from its seed."""
    scenario = {
        key: value
        for key, value in run.configuration.items()
        if key not in _NOT_RUN and not (key in _LATER and value is None)
    }
    if run.configuration.get("noise"):
        # Whoever drives, the surrounding vehicles are drawn from the model.
        scenario["model"] = {key: run.configuration["planners"]["hmdp_mpc"].get(key) for key in _MODEL}
    ego = run.configuration["ego"]
    scenario["ego"] = {key: value for key, value in ego.items() if not (key in _LATER_OF_EGO and value is None)}
    # Networks and tracks may have the same name in different folders.
    if isinstance(run.world, RecordedSettings):
        tracks = {key: value for key, value in run.configuration["tracks"].items() if key != "recording_meta"}
        scenario["tracks"] = tracks | {"file": run.world.traffic.digest}
    else:
        scenario["network"] = hashlib.sha256(Path(run.world.net_file).read_bytes()).hexdigest()
    version = planner_kind(run.planner_name, "planner").version
    content = {
        "schema_version": SCHEMA_VERSION,
        "scenario": scenario,
        "planner": run.planner_name if version == 1 else f"{run.planner_name} {version}",
        "parameters": dict(run.parameters),
        "solver": run.solver,
    }
    # A changed planner is another planner; this package's own code is among a run's versions instead.
    package = planner_package(run.planner_name)
    return content if package is None else content | {"planner_package": asdict(package)}


def cell_id_of(run: ReadyRun) -> str:
    """Return the name of all runs that differ in their seeds alone: words for people, and a hash of the content."""
    words = [run.scenario, run.planner_name]
    if run.solver != "milp":
        words.append(run.solver)
    risk_level = run.parameters.get("risk_level")
    if risk_level is not None:
        words.append(f"eps{risk_level!r}")
    text = json.dumps(content_of(run), sort_keys=True, allow_nan=False, default=str)
    return "-".join([*words, hashlib.sha256(text.encode()).hexdigest()[:10]])


def study_run_id(cell_id: str, seed: int) -> str:
    """Return the name of one run of a study."""
    return f"{cell_id}-seed{seed}"
