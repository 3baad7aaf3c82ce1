"""Turning what a user wrote into validated data, with every mistake named once by its path."""

import difflib
import math
import reprlib
from collections.abc import Iterable, Iterator, Mapping
from types import UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError

from sumo_hmdp.errors import InputError, Problem

Model = TypeVar("Model", bound=BaseModel)
Location = tuple[str | int, ...]

# Of a value or a key so many characters are shown.
_SHOWN_MAX = 60
# Finding what an unknown key may mean takes time; nobody reads more.
_HINTS_MAX = 100
# A value may be as large as its file; what is beyond the first characters is never written.
_BOUNDED = reprlib.Repr()
_BOUNDED.maxdict, _BOUNDED.maxlist, _BOUNDED.maxtuple = 20, 30, 30
_BOUNDED.maxstring, _BOUNDED.maxlong, _BOUNDED.maxother = 200, 10_000, 200


class FileModel(BaseModel):
    """Base of everything that is read from a file: frozen, strict about keys, NaN refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


def parse(model: type[Model], content: Any, source: str = "") -> Model:  # noqa: ANN401 - anything may stand in a file
    """Validate what was read from a file.

    Args:
        model: what it must be.
        content: what was read.
        source: the file's name, for the messages.

    Raises:
        InputError: with every mistake and its path.
    """
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise InputError(_problems(error, model, content), source) from None


def _problems(error: ValidationError, model: type[BaseModel], content: object) -> Iterator[Problem]:
    mistakes = error.errors(include_url=False)
    missing = {mistake["loc"] for mistake in mistakes if mistake["type"] == "missing"}
    hints: dict[Location, str] = {}
    for mistake in mistakes:
        if mistake["type"] == "extra_forbidden" and len(hints) < _HINTS_MAX:
            *parent, name = mistake["loc"]
            known = _known_keys(model, tuple(parent))
            near = difflib.get_close_matches(str(name), known, n=1)
            if near:
                hints[mistake["loc"]] = near[0]
                # A misspelt key is one mistake, not an unknown key and a missing one.
                missing.discard((*parent, near[0]))
    for mistake in mistakes:
        location, kind = mistake["loc"], mistake["type"]
        path = path_text(_in_file(location, content, missing=kind == "missing"))
        if kind == "extra_forbidden":
            moved = getattr(model, "moved", {}).get(location[-1]) if len(location) == 1 else None
            hint = f"did you mean `{hints[location]}`?" if location in hints else "remove it"
            yield Problem(path, moved or f"unknown key; {hint}")
        elif kind == "missing":
            if location in missing:
                yield Problem(path, "is missing; add it")
        elif kind == "union_tag_not_found":
            yield Problem(f"{path}.{_tag_key(mistake)}", "is missing; add it")
        elif kind == "union_tag_invalid":
            yield Problem(f"{path}.{_tag_key(mistake)}", _tag_message(mistake))
        else:
            yield Problem(path, f"{_requirement(mistake)}, got {shown(mistake['input'])}")


def _in_file(location: Location, content: Any, *, missing: bool) -> Location:  # noqa: ANN401 - anything
    """Drop what pydantic adds to a location besides the file's keys: the tags of unions, and `[key]`."""
    kept: list[str | int] = []
    for part in location[:-1] if missing else location:
        found = part in content if isinstance(content, Mapping) else isinstance(content, list) and isinstance(part, int)
        if found:
            content = content[part]
            kept.append(part)
    return (*kept, location[-1]) if missing else tuple(kept)


def path_text(location: Iterable[str | int]) -> str:
    """Return a path such as `vehicles[0].lane`; of a key, letters that only look like ASCII are told as escapes."""
    text = ""
    for part in location:
        if isinstance(part, int):
            text += f"[{part}]"
            continue
        key = ascii(part[: _SHOWN_MAX + 1])[1:-1]
        key = key if len(key) <= _SHOWN_MAX else f"{key[: _SHOWN_MAX - 3]}..."
        text += f".{key}" if text else key
    return text


def shown(value: object) -> str:
    """Return a value as it would stand in a file, shortened."""
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else ("Infinity" if value > 0 else "-Infinity")
    if value is None or isinstance(value, bool):
        return "nothing" if value is None else str(value).lower()
    try:
        text = " ".join(_BOUNDED.repr(value).split())
    except ValueError:
        return "a number of thousands of digits"
    return text if len(text) <= _SHOWN_MAX else text[: _SHOWN_MAX - 3] + "..."


_WHOLE, _NUMBER, _MAPPING, _LIST = "a whole number", "a number", "a mapping of keys to values", "a list"
_REQUIREMENTS = {
    "model_type": _MAPPING,
    "model_attributes_type": _MAPPING,
    "dict_type": _MAPPING,
    "list_type": _LIST,
    "string_type": "text",
    "float_type": _NUMBER,
    "int_type": _WHOLE,
    "int_from_float": _WHOLE,
    "int_parsing_size": _WHOLE,
    "int_parsing": _WHOLE,
    "float_parsing": _NUMBER,
    "string_too_short": "at least {min_length} character long",
    "string_too_long": "at most {max_length} characters long",
    "string_pattern_mismatch": "text of the pattern {pattern}",
    "too_short": "a list of at least {min_length}",
    "too_long": "a list of at most {max_length}",
    "greater_than": "above {gt:.12g}",
    "greater_than_equal": "at least {ge:.12g}",
    "less_than": "below {lt:.12g}",
    "less_than_equal": "at most {le:.12g}",
}


def _requirement(mistake: Any) -> str:  # noqa: ANN401 - pydantic's ErrorDetails
    """Say what must hold where one mistake was found."""
    template = _REQUIREMENTS.get(mistake["type"])
    if template is not None:
        return f"must be {template.format(**mistake.get('ctx', {}))}"
    message = str(mistake["msg"]).removeprefix("Value error, ").removeprefix("Input should be ")
    return message if message.startswith(("must", "is ")) else f"must be {message[0].lower()}{message[1:]}"


def value_problem(error: ValidationError) -> str:
    """Say what must hold of a single value, such as an option's, and what was given."""
    mistake = error.errors()[0]
    choices = str(mistake["msg"]).partition(" is not one of ")[2].rstrip(".")
    requirement = f"must be one of {choices}" if choices else _requirement(mistake)
    return f"{requirement}, got {shown(mistake['input'])}"


def _tag_key(mistake: Any) -> str:  # noqa: ANN401 - pydantic's ErrorDetails
    return str(mistake["ctx"]["discriminator"]).strip("'")


def _tag_message(mistake: Any) -> str:  # noqa: ANN401 - pydantic's ErrorDetails
    tag = str(mistake["ctx"]["tag"])
    known = [name.strip(" '") for name in str(mistake["ctx"]["expected_tags"]).split(",")]
    return f"must be one of {', '.join(known)}, got {shown(tag)}"


def _known_keys(model: type[BaseModel], location: Location) -> list[str]:
    """List the keys that are known at a place, as far as the types tell."""
    current = [model]
    for part in location:
        if isinstance(part, int):
            continue
        inside = [found for m in current if part in m.model_fields for found in models_in(m.model_fields[part])]
        # What is no key of a model is the tag of one of several models, or the key of a mapping of them.
        tagged = [m for m in current if any(get_args(f.annotation) == (part,) for f in m.model_fields.values())]
        current = inside or tagged or current
    return [name for m in current for name in m.model_fields]


def models_in(annotation: Any) -> list[type[BaseModel]]:  # noqa: ANN401 - annotations have no common type
    """Return the model classes inside a field or an annotation such as list[Model] or Model | None."""
    annotation = getattr(annotation, "annotation", annotation)
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if get_origin(annotation) in {Literal, None}:
        return []
    arguments = get_args(annotation)
    if get_origin(annotation) is Annotated:
        arguments = arguments[:1]
    elif get_origin(annotation) not in {Union, UnionType, list, tuple, dict}:
        return []
    return [found for argument in arguments for found in models_in(argument)]


def nearest(name: str, known: Iterable[str] | Mapping[str, object]) -> str:
    """Return a remedy that names the nearest known name, or all of them."""
    names = sorted(known)
    near = difflib.get_close_matches(name, names, n=1)
    return f"did you mean `{near[0]}`?" if near else f"known are {', '.join(names)}"
