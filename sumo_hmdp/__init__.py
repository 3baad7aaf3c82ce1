"""SUMO co-simulation studies of hybrid-MDP, chance-constrained driving decisions."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sumo_hmdp.study.store import Results


def load(folder: str | Path) -> "Results":
    """Read a results directory into pandas frames: `.runs`, `.decisions`, `.steps`, and `.manifests`.

    Args:
        folder: as given to `sumo-hmdp run --out`.

    Raises:
        errors.InputError: if there are no results.
    """
    # Imported here, so that `import sumo_hmdp` stays quick for a plug-in that needs none of it.
    from sumo_hmdp.study.store import load as load_results  # noqa: PLC0415

    return load_results(folder)


__all__ = ["load"]
