"""Turning what a user wrote into validated data, with every mistake named by its path."""

import difflib
import math
from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from sumo_hmdp.errors import InputError, Problem

Model = TypeVar("Model", bound=BaseModel)


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
        raise InputError(_problems(error, model), source) from None


def _problems(error: ValidationError, model: type[BaseModel]) -> Iterable[Problem]:
    for mistake in error.errors():
        path = path_text(mistake["loc"])
        kind, given = mistake["type"], mistake["input"]
        if kind == "extra_forbidden":
            name = str(mistake["loc"][-1])
            near = difflib.get_close_matches(name, _known_keys(model, mistake["loc"][:-1]), n=1)
            hint = f"; did you mean `{near[0]}`?" if near else "; remove it"
            yield Problem(path, f"unknown key{hint}")
        elif kind == "missing":
            yield Problem(path, "is missing; add it")
        elif kind == "value_error":
            yield Problem(path, str(mistake["ctx"]["error"]))
        else:
            yield Problem(path, f"{_sentence(mistake['msg'])}, got {shown(given)}")


def path_text(location: Iterable[str | int]) -> str:
    """Return a path such as `vehicles[0].lane`."""
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else (f".{part}" if text else str(part))
    return text


def shown(value: object) -> str:
    """Return a value as it would stand in a file, shortened."""
    if isinstance(value, float) and math.isnan(value):
        return "NaN"
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _sentence(message: str) -> str:
    message = message.removeprefix("Value error, ").removeprefix("Input should be ")
    return message if message.startswith(("must", "is ")) else f"must be {message[0].lower()}{message[1:]}"


def _known_keys(model: type[BaseModel], location: tuple[str | int, ...]) -> list[str]:
    """List the keys that are known at a place, as far as the types tell."""
    current: Any = model
    for part in location:
        if not (isinstance(current, type) and issubclass(current, BaseModel)):
            return []
        field = current.model_fields.get(str(part)) if isinstance(part, str) else None
        if field is not None:
            current = _model_inside(field.annotation)
    if isinstance(current, type) and issubclass(current, BaseModel):
        return [field.alias or name for name, field in current.model_fields.items()]
    return []


def _model_inside(annotation: Any) -> Any:  # noqa: ANN401 - annotations have no common type
    """Return the first model class inside an annotation such as tuple[Model, ...] or Model | None."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for argument in getattr(annotation, "__args__", ()):
        found = _model_inside(argument)
        if found is not None:
            return found
    return None


def problem_if(*, wrong: bool, path: str, message: str) -> list[Problem]:
    """Return a list with one problem, or none; for checks that need more than one field."""
    return [Problem(path, message)] if wrong else []


def nearest(name: str, known: Iterable[str] | Mapping[str, object]) -> str:
    """Return a remedy that names the nearest known name, or all of them."""
    names = sorted(known)
    near = difflib.get_close_matches(name, names, n=1)
    return f"did you mean `{near[0]}`?" if near else f"known are {', '.join(names)}"
