"""Reading JSON and YAML files: everything that can be wrong with a file before its content is looked at.

A file may come from anywhere, so nothing in it may cost more than it holds: sizes, nesting and repetition are bounded.
YAML is read from the parser's events, not by PyYAML's constructors. Those raise any error on a bad tag, take `1:30` for
90 and `017` for 15, and follow aliases without a bound.
"""

import json
import os
import re
import stat
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from sumo_hmdp.errors import InputError, Problem
from sumo_hmdp.validation import path_text, shown

Place = tuple[str | int, ...]

# The largest files of the package and of its own dumps are below 0.2 MB, 9 levels and 5,000 values.
BYTES_MAX, DEPTH_MAX, VALUES_MAX = 4_000_000, 50, 50_000
# Python refuses to turn longer numerals into whole numbers, since the time for it grows with the square.
_DIGITS_MAX = 4300

# Tab, line feed and carriage return are text; the rest of C0 and C1 steers terminals, and NEL is a line break.
_CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x84\x86-\x9f]")
_SURROGATE = re.compile(r"[\ud800-\udfff]")


@dataclass(frozen=True)
class Document:
    """What a file holds.

    Attributes:
        content: mappings, lists, texts and numbers; keys are texts.
        problems: keys that stand twice in one mapping. The parsers take the last one without a word.
    """

    content: Any
    problems: tuple[Problem, ...] = ()


def is_file(path: Path) -> bool:
    """Tell whether a path is a file; a path that no system could have is none."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def exists(path: Path) -> bool:
    """Tell whether there is anything at a path; a path that no system could have leads nowhere."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


def read_text(path: Path) -> str:
    """Read a text file.

    Raises:
        InputError: if it is no file, cannot be read, is too large, is not UTF-8, holds control characters or is empty.
    """
    try:
        found = path.stat()
        if not stat.S_ISREG(found.st_mode):
            # Reading a pipe waits for its writer, and a device may never end.
            kind = "Is a directory" if stat.S_ISDIR(found.st_mode) else "Is a pipe or device"
            raise InputError([f"cannot be read: {kind}. Name a file"], str(path))
        with path.open("rb") as file:
            data = file.read(BYTES_MAX + 1)
    except (OSError, ValueError) as error:
        reason = os.strerror(error.errno) if isinstance(error, OSError) and error.errno else str(error)
        raise InputError([f"cannot be read: {reason}. Check the path and its permissions"], str(path)) from None
    if len(data) > BYTES_MAX:
        size = f"{max(found.st_size, len(data)) / 1e6:.1f} MB"
        raise InputError([f"must be at most {BYTES_MAX // 1_000_000} MB, got {size}. Check the path"], str(path))
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        message = f"must be UTF-8 text: {error.reason} at byte {error.start}. Save it as UTF-8"
        raise InputError([message], str(path)) from None
    control = _CONTROL.search(text)
    if control is not None:
        line = text.count("\n", 0, control.start()) + 1
        message = f"must be text without control characters, got U+{ord(control[0]):04X} at line {line}. Remove it"
        raise InputError([message], str(path))
    if not text.strip():
        raise InputError(["must not be empty. Write it, or check the path"], str(path))
    return text


@dataclass
class _Reading:
    """What is found while a document is read.

    Attributes:
        repeated: keys that stand twice; the rest of the document can be checked nevertheless.
        mistakes: what leaves no value to check.
        size: values so far, those behind aliases counted each time.
    """

    repeated: list[Problem] = field(default_factory=list)
    mistakes: list[Problem] = field(default_factory=list)
    size: int = 0

    def count(self, values: int, place: Place) -> None:
        """Count some values at a place.

        Raises:
            InputError: if they are too many, or too deep.
        """
        self.size += values
        if self.size > VALUES_MAX:
            message = (
                f"must hold at most {VALUES_MAX:,} values, those behind aliases counted each time. Make it smaller"
            )
            raise InputError([message])
        if len(place) > DEPTH_MAX:
            raise InputError([f"must be nested at most {DEPTH_MAX} deep. Check its brackets and indentation"])

    def text(self, text: str, place: Place) -> str:
        """Return a text, and note what cannot be written to a table or a terminal."""
        bad = _CONTROL.search(text) or _SURROGATE.search(text)
        if bad is not None:
            what = "control characters" if _CONTROL.match(bad[0]) else "halves of a surrogate pair"
            self.mistakes.append(
                Problem(path_text(place), f"must be text without {what}, got {shown(text)}. Remove it")
            )
        return text

    def key(self, key: str, known: Mapping[str, Any], place: Place, where: str = "") -> None:
        """Note a key that stands twice."""
        self.text(key, place)
        if key in known:
            self.repeated.append(Problem(path_text(place), f"must stand once, got it again{where}. Remove one"))

    def document(self, content: Any) -> Document:  # noqa: ANN401 - anything may stand in a file
        """Return what was read.

        Raises:
            InputError: if some of it has no value.
        """
        if self.mistakes:
            raise InputError([*self.mistakes, *self.repeated])
        return Document(content, tuple(self.repeated))


def _whole(numeral: str) -> int | float:
    """Return a whole number; one that is too long for that is infinite, as 1e999 is."""
    if len(numeral) <= _DIGITS_MAX:
        return int(numeral)
    return float("-inf" if numeral.startswith("-") else "inf")


def read_json(path: Path) -> Document:
    """Read a JSON file. NaN and infinities pass: the checks of the content name them by their paths.

    Raises:
        InputError: if it cannot be read or is not JSON, with the line.
    """
    text = read_text(path)
    reading = _Reading()
    try:
        content = json.loads(text, object_pairs_hook=_Pairs, parse_int=_whole)
        return reading.document(_plain(content, (), reading))
    except json.JSONDecodeError as error:
        where = f"at line {error.lineno}, column {error.colno}"
        raise InputError([f"must be JSON: {error.msg} {where}. Correct it there"], str(path)) from None
    except RecursionError:
        message = f"must be JSON of a reasonable size: nested at most {DEPTH_MAX} deep. Check its brackets"
        raise InputError([message], str(path)) from None
    except InputError as error:
        raise InputError(error.problems, str(path)) from None


class _Pairs(list[tuple[str, Any]]):
    """A JSON object as its pairs, in which no key has got lost yet."""


def _plain(value: Any, place: Place, reading: _Reading) -> Any:  # noqa: ANN401 - any JSON
    """Turn pairs into mappings and note what is wrong with keys and texts."""
    reading.count(1, place)
    if isinstance(value, _Pairs):
        mapping: dict[str, Any] = {}
        for key, item in value:
            inner = (*place, key)
            reading.key(key, mapping, inner)
            mapping[key] = _plain(item, inner, reading)
        return mapping
    if isinstance(value, list):
        return [_plain(item, (*place, index), reading) for index, item in enumerate(value)]
    return reading.text(value, place) if isinstance(value, str) else value


def read_yaml(path: Path) -> Document:
    """Read a YAML file of one document, with the scalars of JSON.

    `true` (or `yes`, `on`), `null` and decimal numbers mean what they mean in JSON. What versions of YAML read
    differently, such as `017`, `0x1F`, `1:30`, `1_000` or a date, is a mistake unless it is quoted.

    Raises:
        InputError: if it cannot be read or parsed, with the line.
    """
    return parse_yaml(read_text(path), str(path))


def parse_yaml(text: str, source: str = "") -> Document:
    """Return what a YAML text holds, as `read_yaml` does for a file.

    Args:
        text: one document.
        source: where it comes from, for the messages.

    Raises:
        InputError: if it cannot be parsed, with the line.
    """
    reading = _Reading()
    try:
        content = _YamlBuilder(yaml.parse(text, Loader=_PARSER), reading).document()
        return reading.document(content)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" at line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        what = getattr(error, "problem", None) or getattr(error, "reason", None) or "syntax error"
        raise InputError([f"must be YAML: {what}{where}. Correct it there"], source) from None
    except InputError as error:
        raise InputError(error.problems, source) from None


# libyaml is ten times as fast; not every platform has it.
_PARSER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_TAG = "tag:yaml.org,2002:"
_INT = re.compile(r"[-+]?(0|[1-9][0-9]*)")
_FLOAT = re.compile(
    r"[-+]?([0-9]+\.[0-9]*|\.[0-9]+|[0-9]+(?=[eE]))([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"
)
_WORDS = ((True, "true", "yes", "on"), (False, "false", "no", "off"), (None, "null"))
_CONSTANTS = {"~": None, "": None} | {
    form: value for value, *words in _WORDS for word in words for form in (word, word.capitalize(), word.upper())
}
_OCTAL = re.compile(r"[-+]?0o[0-7]+")
_OPEN = object()


def _int(text: str) -> int | float | None:
    return _whole(text) if _INT.fullmatch(text) else None


def _float(text: str) -> float | None:
    if _INT.fullmatch(text) or _FLOAT.fullmatch(text):
        return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
    return None


def _ambiguous(text: str) -> bool:
    """Tell whether some version of YAML takes a plain scalar, which is text here, for something else."""
    rules = yaml.SafeLoader.yaml_implicit_resolvers.get(text[:1], ())
    kinds = {f"{_TAG}{kind}" for kind in ("int", "float", "timestamp")}
    return _OCTAL.fullmatch(text) is not None or any(tag in kinds and rule.match(text) for tag, rule in rules)


def _line(event: Any) -> int:  # noqa: ANN401 - any event
    return int(event.start_mark.line) + 1


class _YamlBuilder:
    """Turns the events of a YAML parser into mappings, lists, texts and numbers."""

    def __init__(self, events: Iterator[Any], reading: _Reading) -> None:
        self._events = events
        self._reading = reading
        # What is behind an anchor, and how many values that is; `_OPEN` until it is complete.
        self._anchors: dict[str, tuple[Any, int]] = {}

    def document(self) -> Any:  # noqa: ANN401 - any YAML
        """Return the only document, None where there is none."""
        content: Any = None
        documents = 0
        for event in self._events:
            if isinstance(event, yaml.DocumentStartEvent):
                documents += 1
                if documents > 1:
                    message = f"must be one document, got another at line {_line(event)}. Remove one"
                    raise InputError([message])
                content = self._value(next(self._events), ())
        return content

    def _value(self, event: Any, place: Place) -> Any:  # noqa: ANN401 - any event, any YAML
        if isinstance(event, yaml.AliasEvent):
            return self._alias(event, place)
        before = self._reading.size
        self._reading.count(1, place)
        if event.anchor is not None:
            self._anchors[event.anchor] = _OPEN, 0
        value: Any
        if isinstance(event, yaml.ScalarEvent):
            value = self._scalar(event, place)
        elif isinstance(event, yaml.SequenceStartEvent):
            self._check_tag(event, place, "seq")
            value = self._items(place)
        else:
            self._check_tag(event, place, "map")
            value = self._mapping(place)
        if event.anchor is not None:
            self._anchors[event.anchor] = value, self._reading.size - before
        return value

    def _alias(self, event: Any, place: Place) -> Any:  # noqa: ANN401
        line = _line(event)
        value, size = self._anchors.get(event.anchor, (None, 0))
        if event.anchor not in self._anchors:
            message = f"must be YAML: found undefined alias {shown(event.anchor)} at line {line}. Correct it there"
            raise InputError([message])
        if value is _OPEN:
            self._mistake(place, f"must not hold itself, got *{event.anchor} at line {line}. Write it out")
            return {}
        self._reading.count(size, place)
        return value

    def _items(self, place: Place) -> list[Any]:
        items: list[Any] = []
        while not isinstance(event := next(self._events), yaml.SequenceEndEvent):
            items.append(self._value(event, (*place, len(items))))
        return items

    def _mapping(self, place: Place) -> dict[str, Any]:
        own: dict[str, Any] = {}
        merged: dict[str, Any] = {}
        while not isinstance(event := next(self._events), yaml.MappingEndEvent):
            line = _line(event)
            if not isinstance(event, yaml.ScalarEvent):
                self._mistake(
                    place, f"must have texts as keys, got a list, mapping or alias at line {line}. Rewrite it"
                )
                self._value(event, (*place, "?"))
                self._value(next(self._events), (*place, "?"))
                continue
            self._check_tag(event, place, "str", "int", "float", "bool", "null", "merge")
            # A key is a text as it is written: the lane `1:` of a table is the key "1".
            key, inner = event.value, (*place, event.value)
            value = self._value(next(self._events), inner)
            if key == "<<" and event.implicit[0]:
                self._merge(value, merged, inner)
                continue
            self._reading.key(key, own, inner, f" at line {line}")
            own[key] = value
        return merged | own if merged else own

    def _merge(self, value: Any, merged: dict[str, Any], place: Place) -> None:  # noqa: ANN401
        """Take the keys of other mappings in; the first one that has a key gives its value."""
        for source in value if isinstance(value, list) else [value]:
            if isinstance(source, Mapping):
                merged.update({key: item for key, item in source.items() if key not in merged})
            else:
                self._mistake(place, f"must merge mappings, got {shown(source)}. Give an alias of a mapping")

    def _scalar(self, event: Any, place: Place) -> Any:  # noqa: ANN401
        text = event.value
        if event.implicit[0]:
            if text in _CONSTANTS:
                return _CONSTANTS[text]
            for read in (_int, _float):
                number = read(text)
                if number is not None:
                    return number
            if _ambiguous(text):
                got = f"{shown(text)} at line {_line(event)}"
                remedy = "Quote a text, write a number in decimals"
                self._mistake(place, f"must mean the same in all versions of YAML, got {got}. {remedy}")
            return self._reading.text(text, place)
        kind = "str" if event.implicit[1] else self._check_tag(event, place, "str", "int", "float", "bool", "null")
        if kind == "str":
            return self._reading.text(text, place)
        value: Any = {"int": _int, "float": _float}.get(kind, _CONSTANTS.get)(text)
        fits = (
            text in _CONSTANTS and (value is None) == (kind == "null")
            if kind in {"bool", "null"}
            else value is not None
        )
        if kind and not fits:
            line = _line(event)
            self._mistake(
                place, f"must be what its tag !!{kind} says, got {shown(text)} at line {line}. Remove the tag"
            )
        return value

    def _check_tag(self, event: Any, place: Place, *known: str) -> str:  # noqa: ANN401
        """Return the short name of a tag that is known, else nothing; a value without one has the first."""
        tag = event.tag
        if tag in {None, "!"}:
            return known[0]
        name = str(tag).removeprefix(_TAG)
        if name in known and name != tag:
            return name
        line, written = _line(event), f"!!{name}" if name != tag else tag
        message = (
            f"must have no tag but {', '.join(f'!!{kind}' for kind in known)}, got {shown(written)} at line {line}"
        )
        self._mistake(place, f"{message}. Remove it")
        return ""

    def _mistake(self, place: Place, message: str) -> None:
        self._reading.mistakes.append(Problem(path_text(place), message))
