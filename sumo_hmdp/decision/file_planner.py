"""A planner from a Python file, by a scenario's section alone: no package to install."""

import hashlib
import importlib.util
from pathlib import Path
from typing import Any

from pydantic import computed_field, field_validator

from sumo_hmdp.domain.plan import Planner
from sumo_hmdp.errors import InputError, Problem
from sumo_hmdp.validation import FileModel


class FilePlannerFile(FileModel):
    """`planners: {python: {file: my_agent.py, object: planner}}`.

    The file is looked for from the folder in which the command runs. `object` names a planner in it, or a class or
    function that makes one without arguments. The file's hash is a parameter of the run: a changed file is another cell
    of a study. What the file imports or reads besides is not followed.
    """

    file: str
    object: str = "planner"

    @field_validator("file")
    @classmethod
    def _is_there(cls, value: str) -> str:
        if not Path(value).is_file():
            raise ValueError(f"must be a Python file that exists, got {value!r}; check the path")
        return value

    @computed_field  # type: ignore[prop-decorator]
    @property
    def sha256(self) -> str:
        """Hash of the file's content."""
        return hashlib.sha256(Path(self.file).read_bytes()).hexdigest()


def build_from_file(parameters: FilePlannerFile, context: object) -> Planner[Any]:
    """Return the planner that a file holds or makes.

    Raises:
        InputError: the file cannot be imported, or holds no such planner.
    """
    del context
    where, source = "planners.python", Path(parameters.file)
    spec = importlib.util.spec_from_file_location(f"sumo_hmdp_planner_{parameters.sha256[:12]}", source)
    if spec is None or spec.loader is None:
        raise InputError([Problem(f"{where}.file", f"must be a Python file (.py), got {parameters.file!r}")])
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
        found = getattr(module, parameters.object)
        planner = found if hasattr(found, "decide") and not isinstance(found, type) else found()
    except Exception as error:
        message = f"must hold a planner or a maker of one, got {type(error).__name__}: {error}"
        raise InputError([Problem(f"{where}.object", f"{message} ({parameters.object} of {source})")]) from error
    missing = [name for name in ("period", "initial_memory", "decide") if not hasattr(planner, name)]
    if missing:
        message = f"must have period, initial_memory and decide, got {planner!r} without {', '.join(missing)}"
        raise InputError([Problem(f"{where}.object", message)])
    return planner  # type: ignore[no-any-return]
