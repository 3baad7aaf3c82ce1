"""Values that take the place of others in a scenario's document before it is checked."""

import re
from collections.abc import Iterable, Mapping
from typing import Any

from sumo_hmdp.documents import parse_yaml
from sumo_hmdp.errors import InputError, Problem
from sumo_hmdp.validation import shown

_PART = re.compile(r"([A-Za-z0-9_-]+)((?:\[[0-9]{1,6}\])*)")


def with_overrides(content: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Return a scenario's document with other values at some paths; sections on the way are made where missing.

    What the values mean is checked afterwards with the rest of the document, so that an unknown key is reported as in
    a file.

    Args:
        content: the document, left as it is.
        overrides: by path, such as `ego.speed_mps` or `vehicles[0].x_m`.

    Raises:
        InputError: with every path that is malformed or leads through something else than a mapping or list.
    """
    changed: Any = dict(content)
    problems = []
    for path, value in overrides.items():
        try:
            changed = _replaced(changed, split_path(path), value)
        except ValueError as error:
            problems.append(Problem(path, str(error)))
    if problems:
        raise InputError(problems)
    result: dict[str, Any] = changed
    return result


def read_settings(settings: Iterable[str]) -> dict[str, Any]:
    """Return overrides by path from texts such as `ego.speed_mps=25`; a value is read as in a YAML file.

    Raises:
        InputError: with every text that has no `=`, no path, a value that is no YAML, or a path that came before.
    """
    found: dict[str, Any] = {}
    problems = []
    for text in settings:
        path, sign, value = text.partition("=")
        path = path.strip()
        if not sign or not path:
            problems.append(Problem("--set", f"must be PATH=VALUE such as ego.speed_mps=25, got {shown(text)}"))
            continue
        if path in found:
            problems.append(Problem(f"--set {path}", "must be given once; take one out"))
        try:
            split_path(path)
            document = parse_yaml(value)
        except ValueError as error:
            problems.append(Problem(f"--set {path}", str(error)))
        except InputError as error:
            problems.extend(Problem(f"--set {path}", problem.message) for problem in error.problems)
        else:
            problems.extend(Problem(f"--set {path}", problem.message) for problem in document.problems)
            found[path] = document.content
    if problems:
        raise InputError(problems)
    return found


def split_path(path: str) -> tuple[str | int, ...]:
    """Return the keys and indices of a path such as `vehicles[0].x_m`.

    Raises:
        ValueError: if it is none.
    """
    parts: list[str | int] = []
    for text in path.split("."):
        match = _PART.fullmatch(text)
        if match is None:
            raise ValueError("must be a path such as `ego.speed_mps` or `vehicles[0].x_m`; correct it")
        parts += [match[1], *(int(index) for index in re.findall(r"\d+", match[2]))]
    return tuple(parts)


def _replaced(holder: Any, parts: tuple[str | int, ...], value: Any) -> Any:  # noqa: ANN401 - any YAML
    """Return a copy of what holds the value; aliases of YAML share mappings, so nothing is changed in place."""
    if not parts:
        return value
    first, rest = parts[0], parts[1:]
    if isinstance(first, int):
        if not isinstance(holder, list) or first >= len(holder):
            found = f"a list of {len(holder)}" if isinstance(holder, list) else shown(holder)
            raise ValueError(f"must lead to an entry of a list, got [{first}] of {found}; correct the index")
        return [*holder[:first], _replaced(holder[first], rest, value), *holder[first + 1 :]]
    if holder is not None and not isinstance(holder, Mapping):
        raise ValueError(f"must lead through sections, got `{first}` inside {shown(holder)}; correct the path")
    inside = holder or {}
    return {**inside, first: _replaced(inside.get(first), rest, value)}
