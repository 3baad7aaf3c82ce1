"""Going on with a study: what its store holds, with damaged files set aside so that their runs are done again."""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pandas as pd

from sumo_hmdp.study.asked import asked_path
from sumo_hmdp.study.files import DamagedFileError, names_in, read_bytes, read_sealed, set_aside
from sumo_hmdp.study.parts import COLUMNS, disk
from sumo_hmdp.study.store import TABLES, cell_of, json_names, read_cell, run_files
from sumo_hmdp.study.tables import check_table, checked_names, read_table, write_parquet
from sumo_hmdp.study.versions import read_versions

_OTHERS = ("steps", "decisions")


@dataclass(frozen=True)
class Finished:
    """What a store holds already.

    Attributes:
        rows: the rows of `runs` with their cells.
        damaged: what was found broken and put aside, for people.
    """

    rows: pd.DataFrame
    damaged: tuple[str, ...] = ()

    @property
    def run_ids(self) -> frozenset[str]:
        """The names of the finished runs."""
        return frozenset(self.rows["run_id"])


@dataclass(frozen=True)
class _Part:
    """A sound file of `runs`, and whether the files beside it have rows of exactly its runs."""

    file: Path
    rows: pd.DataFrame
    even: bool


def sweep(folder: Path) -> Finished:
    """Read what is finished; set damaged files aside and take away what no row of `runs` vouches for.

    All files are read once, and nothing is touched before all of them have been.

    Raises:
        InputError: if the system does not give a file out: that is no damage.
        SumoHmdpError: if the disk refuses to set aside or to write.
    """
    sound, broken = _parts(folder)
    others = list(_broken_descriptions(folder))
    told = []
    with disk():
        for file, problem in broken:
            told.append(f"{problem}; put aside as .damaged, its runs are run again")
            # What vouches goes first.
            for table in reversed(COLUMNS):
                if os.path.lexists(folder / table / file):
                    set_aside(folder / table / file)
        for error in others:
            told.append(f"{error.problem}; put aside as .damaged")
            set_aside(error.file)
        for part in sound:
            if not part.even:
                _trim(folder, part)
        _take_away(folder, {str(part.file) for part in sound})
    rows = [part.rows.assign(cell=cell_of(part.file)) for part in sound]
    empty = pd.DataFrame(columns=list(COLUMNS["runs"])).astype(COLUMNS["runs"]).assign(cell="")
    return Finished(pd.concat(rows, ignore_index=True) if rows else empty, tuple(told))


def _parts(folder: Path) -> tuple[list[_Part], list[tuple[Path, str]]]:
    """Return the sound files of runs, and the others with what is wrong."""
    sound, broken = [], []
    for file in run_files(folder):
        path = folder / "runs" / file
        try:
            rows = checked_names(read_table(path), path, cell_of(file))
            counts = [check_table(folder / table / file) for table in _OTHERS]
            sound.append(_Part(file, rows, all(count in {None, len(rows)} for count in counts)))
        except DamagedFileError as error:
            broken.append((file, error.problem))
    known: dict[str, Path] = {}
    # Of files with the same runs the one with most stays.
    for part in sorted(sound, key=lambda part: (-len(part.rows), str(part.file))):
        twice = next((name for name in part.rows["run_id"] if name in known), None)
        if twice is not None:
            problem = f"{folder / 'runs' / part.file}: must hold runs of its own, got {twice}, which {known[twice]} has"
            broken.append((part.file, problem))
            sound.remove(part)
        else:
            known |= dict.fromkeys(part.rows["run_id"], part.file)
    return sound, broken


def _broken_descriptions(folder: Path) -> Iterator[DamagedFileError]:
    """Yield what is wrong with the files beside the tables; the study writes them again where it needs them."""
    checks: list[tuple[Path, Callable[[], object]]] = [
        (asked_path(folder), partial(read_sealed, asked_path(folder), {})),
        *((folder / name, partial(read_bytes, folder / name)) for name in ("study.yaml", "ledger.jsonl")),
    ]
    for place, read in (("cells", read_cell), ("versions", read_versions)):
        checks += [
            (folder / place / name, partial(read, folder, name.removesuffix(".json")))
            for name in json_names(folder / place)
        ]
    for table in TABLES:
        for name in names_in(folder / table):
            if name.startswith("cell=") and not (folder / table / name).is_dir():
                yield DamagedFileError(folder / table / name, "must be a directory")
    for path, check in checks:
        if os.path.lexists(path):
            try:
                check()
            except DamagedFileError as error:
                yield error


def _trim(folder: Path, part: _Part) -> None:
    """Take rows away whose runs are not in the file of `runs`: the process was killed before it was replaced."""
    for table in _OTHERS:
        path = folder / table / part.file
        frame = read_table(path)
        write_parquet(path, frame[frame["run_id"].isin(part.rows["run_id"])], len(part.rows))


def _take_away(folder: Path, vouched: set[str]) -> None:
    """Take away what was being written when the process was killed."""
    for table in TABLES:
        for cell in names_in(folder / table):
            for name in names_in(folder / table / cell) if cell.startswith("cell=") else ():
                path = folder / table / cell / name
                unfinished = name.endswith(".parquet") and not name.startswith(".") and f"{cell}/{name}" not in vouched
                if path.is_file() and (unfinished or name.endswith(".partial")):
                    path.unlink()
                elif unfinished:
                    set_aside(path)
    for place in ("", "cells", "versions", "failures"):
        for name in names_in(folder / place):
            if name.startswith(".") and name.endswith(".partial"):
                (folder / place / name).unlink()
