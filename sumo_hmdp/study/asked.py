"""What the present study file asks for: cells with their labels, and seeds. What else a store holds is left out.

Labels, which the study file gives to cells, are kept here and in no table: they are joined with a run when it is read.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from sumo_hmdp.study.files import DamagedFileError, read_sealed, write_sealed

NAMED = 3


@dataclass(frozen=True)
class Asked:
    """What a study is at present.

    Attributes:
        name: of the study.
        description: what it is for.
        trace: which vehicles the table `steps` is to have.
        cells: by name, the values of the factors as the study file gives them.
        seeds: those that are known to be needed.
    """

    name: str
    description: str
    trace: str
    cells: Mapping[str, Mapping[str, Any]]
    seeds: frozenset[int]

    def holds(self, runs: pd.DataFrame) -> "np.ndarray[Any, np.dtype[np.bool_]]":
        """Tell which rows of `runs`, with their `cell`, the study asks for."""
        return np.asarray(runs["cell"].isin(list(self.cells)) & runs["seed"].isin(list(self.seeds)), dtype=bool)

    def left_out(self, runs: pd.DataFrame) -> tuple[str, ...]:
        """Return one line on the runs that the study does not ask for; nothing where there are none."""
        other = runs[~self.holds(runs)]
        if other.empty:
            return ()
        known = other["cell"].isin(list(self.cells))
        parts = []
        if not known.all():
            cells = sorted(set(other["cell"][~known]))
            parts.append(f"{_count(int((~known).sum()), 'run')} of {_count(len(cells), 'cell')} ({_some(cells)})")
        if known.any():
            seeds = sorted({int(seed) for seed in other["seed"][known]})
            named = f"{_count(len(seeds), 'seed')} ({_some(seeds)})"
            parts.append(f"{_count(int(known.sum()), 'run')} of {named}")
        return (f"left out, for the study does not ask for them at present: {' and '.join(parts)}",)


def asked_path(folder: Path) -> Path:
    """Return where a store says what the study asks for."""
    return folder / "study.json"


def write_asked(folder: Path, asked: Asked) -> None:
    """Write down what the study asks for, as one file, so that labels of all cells change at one instant."""
    content = {
        "name": asked.name,
        "description": asked.description,
        "trace": asked.trace,
        "seeds": sorted(asked.seeds),
        "cells": [{"cell": cell, "factors": dict(factors)} for cell, factors in asked.cells.items()],
    }
    write_sealed(asked_path(folder), content)


def read_asked(folder: Path) -> Asked | None:
    """Return what a store's study asks for, None where no study has said so.

    Raises:
        DamagedFileError: if the file is not what was written.
        InputError: if the system does not give it out.
    """
    path = asked_path(folder)
    if not path.exists():
        return None
    content = read_sealed(path, {"name": str, "trace": str, "seeds": list, "cells": list})
    try:
        cells = {str(one["cell"]): dict(one["factors"]) for one in content["cells"]}
        seeds = frozenset(int(seed) for seed in content["seeds"])
    except (TypeError, KeyError, ValueError):
        raise DamagedFileError(path, "must list cells with their factors, and seeds") from None
    return Asked(content["name"], str(content.get("description", "")), content["trace"], cells, seeds)


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _some(values: Sequence[object]) -> str:
    shown = ", ".join(map(str, values[:NAMED]))
    return shown if len(values) <= NAMED else f"{shown}, ..."


def cells_of(names: Collection[str]) -> str:
    """Return cells in words, the first few by name."""
    return f"{_count(len(names), 'cell')} ({_some(sorted(names))})"
