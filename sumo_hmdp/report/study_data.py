"""A study as its report reads it: cells with names for people, runs in an order of their own, not that of writing."""

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from sumo_hmdp.documents import read_text, read_yaml
from sumo_hmdp.errors import InputError
from sumo_hmdp.study.asked import Asked, read_asked
from sumo_hmdp.study.ledger import AGAIN, read_ledger
from sumo_hmdp.study.parts import COLUMNS
from sumo_hmdp.study.record import RunStatus
from sumo_hmdp.study.store import Results, json_names, load, read_cell

# These runs were driven to their end; of the others nothing is counted but that they are lost.
ENDED = (RunStatus.COMPLETED, RunStatus.CONTACT)
# Factors that a cell's name begins with, or that tell variants of one planner apart: no part of its surroundings.
_OWN = ("planner", "solver", "risk_level")
# A planner without a risk level that a reader would compare with first.
BASELINE = "idm_mobil"


@dataclass(frozen=True)
class StudyCell:
    """One cell of a study.

    Attributes:
        id: its name in the store.
        label: its name for people, unique in the study.
        planner: who drives.
        risk_level: what is asked for, None where nothing is.
        context: the scenario and the factors of the surroundings; cells are compared within it. Empty if all share it.
        manifest: configuration, versions, factors.
    """

    id: str
    label: str
    planner: str
    risk_level: float | None
    context: str
    manifest: Mapping[str, Any]


@dataclass(frozen=True)
class StudyData:
    """Everything that a report is made from.

    Attributes:
        folder: the store.
        name: of the study.
        description: what it is for.
        file_text: the study file.
        cells: ordered by context, planner and risk level.
        runs: all runs by cell and seed, with `cell_label` and `contact`.
        ended: those that were driven to their end.
        decisions: of these.
        steps: of these.
        ledger: attempts that did not end well.
        notes: what was left out, and whether versions differ.
    """

    folder: Path
    name: str
    description: str
    file_text: str
    cells: tuple[StudyCell, ...]
    runs: pd.DataFrame
    ended: pd.DataFrame
    decisions: pd.DataFrame
    steps: pd.DataFrame
    ledger: tuple[Mapping[str, object], ...]
    notes: tuple[str, ...] = ()

    @property
    def contexts(self) -> tuple[str, ...]:
        """The surroundings, in order."""
        return tuple(dict.fromkeys(cell.context for cell in self.cells))

    def cells_in(self, context: str) -> tuple[StudyCell, ...]:
        """Return the cells of one context."""
        return tuple(cell for cell in self.cells if cell.context == context)


def read_study(folder: Path) -> StudyData:
    """Read the folder that `sumo-hmdp study` has written, finished or not.

    Raises:
        InputError: if it is no study's, or a file is damaged.
    """
    results = load(folder)
    if not (folder / "cells").is_dir() or (len(results.runs) and "cell" not in results.runs):
        raise InputError([f"{folder} must be written by `sumo-hmdp study`, got other results. Give its --out"])
    asked = read_asked(folder)
    cells = named_cells(_descriptions(folder, results, asked))
    runs = results.runs if len(results.runs) else pd.DataFrame(columns=list(COLUMNS["runs"])).astype(COLUMNS["runs"])
    runs = _ordered(runs if "cell" in runs else runs.assign(cell=""), cells)
    ended = runs[runs["status"].isin(ENDED)].reset_index(drop=True)
    file = folder / "study.yaml"
    content = read_yaml(file).content if file.exists() else {}
    content = content if isinstance(content, Mapping) else {}
    known = {cell.id for cell in cells}
    return StudyData(
        folder=folder,
        name=str(content.get("name", folder.name)),
        description=" ".join(str(content.get("description", "")).split()),
        file_text=read_text(file) if file.exists() else "",
        cells=cells,
        runs=runs,
        ended=ended,
        decisions=_of_runs(results.decisions, ended, "decisions"),
        steps=_of_runs(results.steps, ended, "steps"),
        ledger=tuple(
            entry
            for entry in read_ledger(folder)
            if entry["status"] != AGAIN and str(entry["run_id"]).rsplit("-seed", 1)[0] in known
        ),
        notes=results.notes,
    )


def _descriptions(folder: Path, results: Results, asked: Asked | None) -> list[dict[str, Any]]:
    """Return what the cells are that the study asks for, with its labels and the versions of their runs."""
    names = asked.cells if asked is not None else [name.removesuffix(".json") for name in json_names(folder / "cells")]
    versions: dict[str, list[Any]] = {}
    for one in results.manifests.values():
        found = versions.setdefault(one.get("cell", ""), [])
        if one["versions"] not in found:
            found.append(one["versions"])
    described = []
    for name in names:
        content = read_cell(folder, name)
        if asked is not None:
            content["factors"] = dict(asked.cells[name])
        *before, content["versions"] = versions.get(name) or [content["versions"]]
        described.append(content | ({"versions_before": before} if before else {}))
    return described


def _ordered(runs: pd.DataFrame, cells: Sequence[StudyCell]) -> pd.DataFrame:
    place = {cell.id: index for index, cell in enumerate(cells)}
    labels = {cell.id: cell.label for cell in cells}
    unknown = sorted(set(runs["cell"]) - set(place))
    if unknown:
        raise InputError([f"cells/{name}.json must be there to tell what its runs are. Restore it" for name in unknown])
    return (
        runs.assign(
            cell_label=runs["cell"].map(labels).astype("str"),
            contact=(runs["status"] == RunStatus.CONTACT).astype(bool),
            place=runs["cell"].map(place),
        )
        .sort_values(["place", "seed"], kind="stable", ignore_index=True)
        .drop(columns="place")
    )


def _of_runs(table: pd.DataFrame, runs: pd.DataFrame, name: str) -> pd.DataFrame:
    """Return the rows of these runs; an unfinished study may hold more."""
    if not len(table):
        return pd.DataFrame(columns=list(COLUMNS[name])).astype(COLUMNS[name]).assign(cell="", cell_label="")
    labels = dict(zip(runs["run_id"], runs["cell_label"], strict=True))
    kept = table[table["run_id"].isin(list(labels))]
    return kept.assign(cell_label=kept["run_id"].map(labels)).reset_index(drop=True)


def named_cells(manifests: Iterable[Mapping[str, Any]]) -> tuple[StudyCell, ...]:
    """Name cells by what tells them apart, and put them in order.

    Args:
        manifests: what `cells/` holds.
    """
    ordered = sorted(manifests, key=_rank)
    varying = {
        name
        for name in {name for one in ordered for name in one["factors"]} - set(_OWN)
        if len({json.dumps(one["factors"].get(name), sort_keys=True) for one in ordered}) > 1
    }
    several = {key: len({one[key] for one in ordered}) > 1 for key in ("scenario", "solver")}
    contexts = [_context(one, varying, scenarios=several["scenario"]) for one in ordered]
    labels = [_label(one, varying, context, several) for one, context in zip(ordered, contexts, strict=True)]
    counts = Counter(labels)
    return tuple(
        StudyCell(
            id=one["cell"],
            label=label if counts[label] == 1 else f"{label} [{one['cell'].rsplit('-', 1)[-1]}]",
            planner=one["planner"],
            risk_level=one["risk_level"],
            context=context,
            manifest=one,
        )
        for one, label, context in zip(ordered, labels, contexts, strict=True)
    )


def _rank(one: Mapping[str, Any]) -> tuple[str, str, str, str, float, str]:
    surroundings = {name: value for name, value in one["factors"].items() if _is_outside(name)}
    asked = -1.0 if one["risk_level"] is None else float(one["risk_level"])
    texts = json.dumps(surroundings, sort_keys=True), one["planner"], one["solver"]
    return one["scenario"], *texts, asked, one["cell"]


def _is_outside(factor: str) -> bool:
    return factor not in _OWN and not factor.startswith("planners.")


def _context(one: Mapping[str, Any], varying: set[str], *, scenarios: bool) -> str:
    words = [one["scenario"]] if scenarios else []
    words += [
        f"{name}={one['factors'][name]}" for name in sorted(varying) if _is_outside(name) and name in one["factors"]
    ]
    return " ".join(words)


def _label(one: Mapping[str, Any], varying: set[str], context: str, several: Mapping[str, bool]) -> str:
    words = [one["planner"]]
    if several["solver"]:
        words.append(one["solver"])
    if one["risk_level"] is not None:
        words.append(f"ε={one['risk_level']:g}")
    own = [name for name in sorted(varying) if not _is_outside(name) and name in one["factors"]]
    words += [f"{name.rsplit('.', 1)[-1]}={one['factors'][name]}" for name in own]
    return " ".join([*words, *([f"({context})"] if context else [])])


def baseline_of(cells: Sequence[StudyCell]) -> StudyCell | None:
    """Return the cell that the others of its context are compared with, None without others.

    One of the planner `idm_mobil` if there is any, else one without a risk level, else the first.
    """
    ranked = sorted(cells, key=lambda cell: (cell.planner != BASELINE, cell.risk_level is not None))
    return ranked[0] if len(ranked) > 1 else None
