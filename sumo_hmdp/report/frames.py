"""Tidy frames for statistics: columns that must be there, cells with one run a seed, numbers as floats."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from sumo_hmdp.errors import InputError
from sumo_hmdp.validation import nearest

FloatArray = NDArray[np.float64]
Cell = tuple[object, ...]


def require_columns(frame: pd.DataFrame, names: Sequence[str]) -> None:
    """Make sure that a frame has these columns.

    Raises:
        InputError: naming every column that it lacks, with the nearest one that it has.
    """
    known = [str(name) for name in frame.columns]
    problems = [f"column {name} must be in the table. {nearest(name, known)}" for name in names if name not in known]
    if problems:
        raise InputError(problems)


def numbers(column: pd.Series) -> FloatArray:
    """Return a column as floats; what is missing is NaN, true is 1."""
    return np.asarray(column.astype("Float64").to_numpy(dtype=np.float64, na_value=np.nan), dtype=np.float64)


def is_binary(column: pd.Series) -> bool:
    """Tell whether a column holds truth values."""
    return pd.api.types.is_bool_dtype(column.dtype)


def cell_label(cell: Cell) -> str:
    """Return a cell in words: its values, parted by commas."""
    return ", ".join(str(value) for value in cell)


def cells_of(frame: pd.DataFrame, columns: Sequence[str]) -> dict[Cell, pd.DataFrame]:
    """Split a table into cells, in the order in which they first come.

    Raises:
        InputError: if a column is missing.
    """
    require_columns(frame, columns)
    return {
        key if isinstance(key, tuple) else (key,): part
        for key, part in frame.groupby(list(columns), sort=False, dropna=False)
    }


def by_seed(cell: pd.DataFrame, metric: str, seed: str, label: str) -> pd.Series:
    """Return one metric of one cell by seed.

    Raises:
        InputError: if a seed comes twice, since pairs would then be arbitrary.
    """
    twice = sorted(cell[seed][cell[seed].duplicated()].unique().tolist())
    if twice:
        raise InputError(
            [f"cell {label} must have one run a seed, got several of {seed} {twice}. Name more cell columns"]
        )
    return pd.Series(numbers(cell[metric]), index=cell[seed].to_numpy(), dtype="float64")
