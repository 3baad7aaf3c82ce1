"""What a reader must know, and what is to be done again, before a study goes on in a store that holds runs already."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from sumo_hmdp.study.asked import Asked
from sumo_hmdp.study.files import read_bytes, write_text
from sumo_hmdp.study.ledger import Ledger
from sumo_hmdp.study.machine import versions
from sumo_hmdp.study.parts import disk, drop_runs
from sumo_hmdp.study.record import Trace
from sumo_hmdp.study.recovery import Finished
from sumo_hmdp.study.runner import ENDED_WELL
from sumo_hmdp.study.store import cell_path, read_cell
from sumo_hmdp.study.versions import differences, read_versions

_DETAIL = {str(trace): rank for rank, trace in enumerate(Trace)}


def take_back(
    folder: Path, finished: Finished, asked: Asked, *, retry_failed: bool
) -> tuple[Finished, tuple[str, ...]]:
    """Take runs out of the store that are to be done again; return what is left, and lines that say so.

    Args:
        folder: the store, opened.
        finished: what it holds.
        asked: what the study asks for, all seeds that may be needed.
        retry_failed: whether runs that did not end well are asked for anew.
    """
    rows = finished.rows[asked.holds(finished.rows)]
    told: list[str] = []
    again: dict[str, str] = {}
    lost = rows[~rows["status"].isin(ENDED_WELL)]
    if retry_failed:
        again |= dict.fromkeys(lost["run_id"], "--retry-failed")
        told.append(f"{_runs(len(lost))} that did not end well {_are(len(lost))} done again")
    elif len(lost):
        told.append(f"{_runs(len(lost))} did not end well and {_are(len(lost))} not done again; --retry-failed does")
    if "trace" in rows:
        for trace, some in rows[rows["trace"].isin(list(_DETAIL))].groupby("trace"):
            if _DETAIL[str(trace)] < _DETAIL[asked.trace]:
                again |= dict.fromkeys(some["run_id"], f"trace: {asked.trace}")
                are = _are(len(some))
                told.append(f"{_runs(len(some))} with `trace: {trace}` {are} done again with `trace: {asked.trace}`")
            elif _DETAIL[str(trace)] > _DETAIL[asked.trace]:
                told.append(
                    f"{_runs(len(some))} keep what `trace: {trace}` stored, more than `trace: {asked.trace}` asks for; "
                    "so the study hash is not that of a study from nothing"
                )
    if again:
        for reason in dict.fromkeys(again.values()):
            Ledger(folder).ask_again([name for name, why in again.items() if why == reason], reason)
        drop_runs(folder, again.keys())
        kept = finished.rows[~finished.rows["run_id"].isin(list(again))].reset_index(drop=True)
        finished = Finished(kept, finished.damaged)
    return finished, tuple(told)


def changes(folder: Path, finished: Finished, asked: Asked) -> Iterator[str]:
    """Yield one line for each thing that a reader must know before old and new runs stand in one table."""
    rows = finished.rows
    yield from asked.left_out(rows)
    yield from _changed_planners(folder, rows, asked)
    yield from _other_versions(folder, rows[asked.holds(rows)])


def _other_versions(folder: Path, rows: pd.DataFrame) -> Iterator[str]:
    if "versions_hash" not in rows:
        return
    for (name, planner), some in rows.groupby(["versions_hash", "planner"]):
        found = differences(read_versions(folder, name), versions(str(planner)))
        if found:
            yield f"{_runs(len(some))} of {planner} had other versions than those to come: {'; '.join(found)}"


def _changed_planners(folder: Path, rows: pd.DataFrame, asked: Asked) -> Iterator[str]:
    """Say which planners of other packages have changed: their cells are others, though all else is the same."""
    now: dict[str, str] = {}
    then: dict[str, set[str]] = {}
    for cell in dict.fromkeys([*asked.cells, *rows["cell"]]):
        if not cell_path(folder, cell).exists():
            continue
        content: Mapping[str, Any] = read_cell(folder, cell)
        package = content["versions"].get("planner_package")
        if package is not None and cell in asked.cells:
            now[content["planner"]] = package
        elif package is not None:
            then.setdefault(content["planner"], set()).add(package)
    for planner, packages in then.items():
        for package in sorted(packages - {now.get(planner, "")} if planner in now else ()):
            yield f"the planner {planner} has changed: {package}, now {now[planner]}; its old runs are not mixed in"


def keep_file(source: Path, copy: Path, solver: str | None) -> None:
    """Keep the study file beside its results, so that it can be run from there.

    Args:
        source: the study file.
        copy: where it is kept.
        solver: that was given in place of the file's.
    """
    text = kept_text(source, solver)
    if not copy.exists() or read_bytes(copy) != text.encode():
        with disk():
            write_text(copy, text)


def kept_text(source: Path, solver: str | None) -> str:
    """Return a study file as it is run: as it was written, but for the paths of its scenarios, and the solver."""
    text = source.read_text(encoding="utf-8-sig")
    content = yaml.safe_load(text)
    names = content["scenarios"]
    found = [next((one for one in (source.parent / name, Path(name)) if one.is_file()), None) for name in names]
    wanted = content | {
        "scenarios": [name if path is None else str(path.resolve()) for name, path in zip(names, found, strict=True)]
    }
    if solver is not None:
        wanted["solver"] = solver
    if wanted == content:
        return text
    changed = _replaced(text, {"scenarios": wanted["scenarios"], "solver": solver})
    # With anchors, say, the places in the text are not those of the values.
    return changed if _parsed(changed) == wanted else yaml.safe_dump(wanted, sort_keys=False, allow_unicode=True)


def _parsed(text: str) -> object:
    try:
        return yaml.safe_load(text)
    except yaml.YAMLError:
        return None


def _replaced(text: str, values: Mapping[str, Any]) -> str:
    """Put texts in place of those that a YAML file has, and leave everything else as it is."""
    places: list[tuple[int, int, str]] = []
    lines = ""
    node = yaml.compose(text, Loader=yaml.SafeLoader)
    entries = {key.value: value for key, value in node.value} if isinstance(node, yaml.MappingNode) else {}
    for key, value in values.items():
        if value is None:
            continue
        if key not in entries:
            lines += f"\n{key}: {value}\n"
            continue
        items = entries[key].value if isinstance(value, list) else [entries[key]]
        for item, new in zip(items, value if isinstance(value, list) else [value], strict=True):
            if item.value != new:
                places.append((item.start_mark.index, item.end_mark.index, yaml.dump(new).splitlines()[0]))
    for start, end, new in sorted(places, reverse=True):
        text = f"{text[:start]}{new}{text[end:]}"
    return text.rstrip("\n") + "\n" + lines.lstrip("\n") if lines else text


def _runs(number: int) -> str:
    return f"{number} run{'' if number == 1 else 's'}"


def _are(number: int) -> str:
    return "is" if number == 1 else "are"
