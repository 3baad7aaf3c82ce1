"""Reading JSON and YAML files: everything that can be wrong with a file before its content is looked at."""

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from sumo_hmdp.errors import InputError, Problem
from sumo_hmdp.validation import path_text


@dataclass(frozen=True)
class Document:
    """What a file holds.

    Attributes:
        content: mappings, lists, texts and numbers; keys are texts.
        problems: keys that stand twice in one mapping. The parsers take the last one without a word.
    """

    content: Any
    problems: tuple[Problem, ...] = ()


def read_text(path: Path) -> str:
    """Read a text file.

    Raises:
        InputError: if it cannot be read, is not UTF-8 or is empty.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError([f"cannot be read: {error.strerror}. Check the path and its permissions"], str(path)) from None
    except UnicodeDecodeError as error:
        message = f"must be UTF-8 text: {error.reason} at byte {error.start}. Save it as UTF-8"
        raise InputError([message], str(path)) from None
    if not text.strip():
        raise InputError(["must not be empty. Write it, or check the path"], str(path))
    return text


def read_json(path: Path) -> Document:
    """Read a JSON file. NaN and infinities pass: the checks of the content name them by their paths.

    Raises:
        InputError: if it cannot be read or is not JSON, with the line.
    """
    try:
        content = json.loads(read_text(path), object_pairs_hook=_Pairs)
    except json.JSONDecodeError as error:
        where = f"at line {error.lineno}, column {error.colno}"
        raise InputError([f"must be JSON: {error.msg} {where}. Correct it there"], str(path)) from None
    except (RecursionError, ValueError) as error:
        raise InputError([f"must be JSON of a reasonable size: {error}"], str(path)) from None
    problems: list[Problem] = []
    return Document(_plain(content, (), problems), tuple(problems))


class _Pairs(list[tuple[str, Any]]):
    """A JSON object as its pairs, in which no key has got lost yet."""


def _plain(value: Any, place: tuple[str | int, ...], problems: list[Problem]) -> Any:  # noqa: ANN401 - any JSON
    """Turn pairs into mappings and note the keys that stand twice."""
    if isinstance(value, _Pairs):
        mapping: dict[str, Any] = {}
        for key, item in value:
            if key in mapping:
                problems.append(_twice((*place, key)))
            mapping[key] = _plain(item, (*place, key), problems)
        return mapping
    if isinstance(value, list):
        return [_plain(item, (*place, index), problems) for index, item in enumerate(value)]
    return value


def _twice(place: tuple[str | int, ...], where: str = "") -> Problem:
    return Problem(path_text(place), f"must stand once, got it again{where}. Remove one")


class _Loader(yaml.SafeLoader):
    """YAML in which `1e-5` is the number it is in JSON; PyYAML would take it for a text."""

    yaml_implicit_resolvers = {  # noqa: RUF012 - the base class's own
        letter: list(rules) for letter, rules in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?[0-9][0-9_]*(\.[0-9_]*)?[eE][-+]?[0-9]+$"), list("-+0123456789")
)


def read_yaml(path: Path) -> Document:
    """Read a YAML file.

    Raises:
        InputError: if it cannot be read or parsed, with the line.
    """
    loader = _Loader(read_text(path))
    try:
        node = loader.get_single_node()
        problems = tuple(_check_keys(node, (), set()))
        content = loader.construct_document(node) if node is not None else None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" at line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        what = getattr(error, "problem", None) or "syntax error"
        raise InputError([f"must be YAML: {what}{where}. Correct it there"], str(path)) from None
    except (RecursionError, ValueError) as error:
        raise InputError([f"must be YAML of a reasonable size and with real dates: {error}"], str(path)) from None
    finally:
        loader.dispose()
    return Document(content, problems)


def _check_keys(node: yaml.Node | None, place: tuple[str | int, ...], visited: set[int]) -> Iterator[Problem]:
    """Find the keys that stand twice, and make every key a text: the lane `1:` of a table is the key "1"."""
    # An alias is its anchor's node again.
    if node is None or id(node) in visited:
        return
    visited.add(id(node))
    if isinstance(node, yaml.SequenceNode):
        for index, item in enumerate(node.value):
            yield from _check_keys(item, (*place, index), visited)
    if isinstance(node, yaml.MappingNode):
        seen: set[str] = set()
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode):
                line = key.start_mark.line + 1
                yield Problem(path_text(place), f"must have texts as keys, got a list or mapping at line {line}")
                continue
            inner = (*place, key.value)
            if key.tag != "tag:yaml.org,2002:merge":
                if key.value in seen:
                    yield _twice(inner, f" at line {key.start_mark.line + 1}")
                seen.add(key.value)
                key.tag = "tag:yaml.org,2002:str"
            yield from _check_keys(value, inner, visited)
