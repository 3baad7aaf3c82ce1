"""SUMO co-simulation studies of hybrid-MDP, chance-constrained driving decisions."""
# ruff: noqa: PLC0415 - imported where it is used, so that `import sumo_hmdp` stays quick for a plug-in that needs none

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sumo_hmdp.report.study_comparison import StudyComparison
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


__all__ = ["compare", "load"]
