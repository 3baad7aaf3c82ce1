"""Doing a stored run again from what is stored of it, and comparing."""

from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from sumo_hmdp.study.again import run_again, stored_run


@dataclass(frozen=True)
class Reproduction:
    """How a run compares with its repetition.

    Attributes:
        stored_hash: of the trace then.
        new_hash: of the trace now.
        difference: the first step at which the stored steps differ, in words; empty if none does or none are stored.
        versions: what of the software has another version now, in words.
    """

    stored_hash: str
    new_hash: str
    difference: str
    versions: tuple[str, ...]

    @property
    def same(self) -> bool:
        """Whether both runs are the same, bit for bit."""
        return self.stored_hash == self.new_hash


def reproduce(folder: Path, run_id: str) -> Reproduction:
    """Do a stored run again and compare the two.

    Args:
        folder: a results directory, of single runs or of a study.
        run_id: the run.

    Raises:
        InputError: if there is no such run, if nothing was recorded of it, or if it cannot be assembled here.
    """
    run = stored_run(folder, run_id)
    record = run_again(run)
    stored = run.table("steps")
    return Reproduction(
        run.row["trace_hash"],
        record.row["trace_hash"],
        first_difference(stored if len(stored) else record.steps.iloc[:0], record.steps),
        run.changed_versions(),
    )


def first_difference(stored: pd.DataFrame, new: pd.DataFrame) -> str:
    """Say where the stored steps first differ from new ones; vehicles that were not stored are not compared.

    Args:
        stored: rows of `steps` of one run.
        new: rows of `steps` with all vehicles.
    """
    keys = ["step", "vehicle_id"]
    new = new[new["vehicle_id"].isin(stored["vehicle_id"].unique())]
    both = stored.merge(new, on=keys, how="outer", suffixes=("", "_new"), indicator=True).sort_values(keys)
    for row in both.to_dict("records"):
        where = f"step {row['step']}, {row['vehicle_id']}"
        if row["_merge"] != "both":
            return f"{where}: only in the {'stored' if row['_merge'] == 'left_only' else 'new'} run"
        for column in stored.columns:
            if column not in keys and row[column] != row[f"{column}_new"]:
                return f"{where} at {row['time_s']:.2f} s: {column} was {row[column]!r}, is {row[f'{column}_new']!r}"
    return ""
