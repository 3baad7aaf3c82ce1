"""SUMO co-simulation studies of hybrid-MDP, chance-constrained driving decisions."""
# ruff: noqa: PLC0415 - imported where it is used, so that `import sumo_hmdp` stays quick for a plug-in that needs none

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sumo_hmdp.domain.plan import Planner
    from sumo_hmdp.report.study_comparison import StudyComparison
    from sumo_hmdp.scenario.load import ReadyRun
    from sumo_hmdp.study.run import RunRecord
    from sumo_hmdp.study.session import Session
    from sumo_hmdp.study.store import Results


def load(folder: str | Path, *, everything: bool = False) -> "Results":
    """Read a results directory into pandas frames: `.runs`, `.decisions`, `.steps`, and `.manifests`.

    Of a study these are the runs that its study file asks for at present. A warning says in one line what else is
    there, and whether runs were made with different versions; `.notes` has these lines, too.

    Args:
        folder: as given to `sumo-hmdp run --out`.
        everything: return what a study no longer asks for as well.

    Raises:
        errors.InputError: if there are no results, or a file is damaged; it names the file.
    """
    from sumo_hmdp.study.store import load as load_results

    results = load_results(folder, everything=everything)
    for note in results.notes:
        warnings.warn(note, stacklevel=2)
    return results


def compare(
    folder: str | Path, metrics: Sequence[str] = (), by: Sequence[str] | str = (), level: float = 0.95
) -> "StudyComparison":
    """Compare the cells of a study on common seeds: `.means`, `.rates`, `.differences`, `.verdicts`.

    Args:
        folder: as given to `sumo-hmdp study --out`.
        metrics: columns of `runs`, or `contact_rate`; without any, a choice of them.
        by: the factors whose values are compared; without any, the planner, or else the first factor that varies.
        level: of the intervals.

    Raises:
        errors.InputError: if there are no results, or no such metric or factor.
    """
    from sumo_hmdp.report.study_comparison import compare_study

    return compare_study(folder, metrics, by, level)


def scenario(
    name_or_path: str | Path,
    planner: "str | Planner[Any] | None" = None,
    *,
    seed: int = 0,
    solver: str = "milp",
    risk_level: float | None = None,
    keys: Mapping[str, Any] | None = None,
) -> "ReadyRun":
    """Read and check a scenario; the run that comes out is started by `run` or stepped by `Session`.

    Args:
        name_or_path: of a scenario that comes with the package, or a YAML file.
        planner: a planner's name, or an object with `period` [s], `initial_memory()` and `decide(scene, memory)`;
            None takes the scenario's own.
        seed: of everything random.
        solver: how the planner's decisions are solved.
        risk_level: epsilon of the planner, None takes the scenario's.
        keys: values that take the place of the scenario's, by path, such as `{"ego.speed_mps": 25.0}`.

    Raises:
        errors.InputError: with every mistake and its path.
    """
    from sumo_hmdp.scenario.load import RunOptions, find_scenario, load_scenario, with_planner

    name = planner if planner is None or isinstance(planner, str) else "constant"
    run = load_scenario(find_scenario(str(name_or_path)), RunOptions(name, solver, seed, risk_level, dict(keys or {})))
    return run if planner is None or isinstance(planner, str) else with_planner(run, planner)


def run(ready: "ReadyRun") -> "RunRecord":
    """Run a scenario to its end: `.row` has its measures, `.steps` and `.decisions` are pandas frames.

    Args:
        ready: from `scenario`.

    Raises:
        errors.InputError: if the run cannot even start for a mistake in its input.
    """
    from sumo_hmdp.study.run import execute

    return execute(ready)


def __getattr__(name: str) -> Any:  # noqa: ANN401 - any of the names below
    if name == "Session":
        from sumo_hmdp.study.session import Session

        return Session
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


__all__ = ["Session", "compare", "load", "run", "scenario"]
