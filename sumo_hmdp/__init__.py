"""SUMO co-simulation studies of hybrid-MDP, chance-constrained driving decisions."""
# ruff: noqa: PLC0415 - imported where it is used, so that `import sumo_hmdp` stays quick for a plug-in that needs none

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sumo_hmdp.report.study_comparison import StudyComparison
    from sumo_hmdp.study.store import Results


def load(folder: str | Path) -> "Results":
    """Read a results directory into pandas frames: `.runs`, `.decisions`, `.steps`, and `.manifests`.

    Args:
        folder: as given to `sumo-hmdp run --out`.

    Raises:
        errors.InputError: if there are no results.
    """
    from sumo_hmdp.study.store import load as load_results

    return load_results(folder)


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


__all__ = ["compare", "load"]
