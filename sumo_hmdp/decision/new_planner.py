"""A package with a planner that drives, written for somebody who wants to put a planner of their own in its place."""

import importlib.util
import keyword
import re
from importlib.metadata import version
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from sumo_hmdp.decision.names import ENTRY_POINT_GROUP
from sumo_hmdp.decision.registry import planner_kinds
from sumo_hmdp.errors import InputError

NAME_LENGTH_MAX = 40


def write_planner_package(name: str, parent: Path) -> tuple[Path, ...]:
    """Write a package NAME with a planner NAME into a new folder NAME.

    Args:
        name: of folder, package, module and planner.
        parent: the folder in which the new folder is made; made as well where it is missing.

    Returns:
        The files, in the order of their names.

    Raises:
        InputError: if the name cannot be used, or there is something of this name already.
    """
    problem = _name_problem(name)
    if problem:
        raise InputError([f"NAME: {problem}"])
    folder = parent / name
    files = {
        folder / "README.md": "README.md.j2",
        folder / "pyproject.toml": "pyproject.toml.j2",
        folder / "src" / f"{name}.py": "planner.py.j2",
        folder / "tests" / f"test_{name}.py": "planner_test.py.j2",
    }
    environment = Environment(  # noqa: S701 - Python, TOML and Markdown with a name that is checked
        loader=PackageLoader("sumo_hmdp.decision"), undefined=StrictUndefined, keep_trailing_newline=True
    )
    values = {"name": name, "group": ENTRY_POINT_GROUP, "version": version("sumo-hmdp")}
    texts = {path: environment.get_template(template).render(values) for path, template in files.items()}
    try:
        folder.mkdir(parents=True)
        for path, text in texts.items():
            path.parent.mkdir(exist_ok=True)
            path.write_text(text, encoding="utf-8")
    except FileExistsError:
        raise InputError([f"{folder} must not exist yet. Choose another name, or another --out"]) from None
    except OSError as error:
        raise InputError([f"--out: {folder} must be writable: {error.strerror}. Choose another"]) from None
    return tuple(files)


def _name_problem(name: str) -> str:
    """Return why a planner, and its module, cannot have a name; empty where it can."""
    if not re.fullmatch(rf"[a-z][a-z0-9_]{{0,{NAME_LENGTH_MAX - 1}}}", name) or keyword.iskeyword(name):
        form = f"small letters, digits and _, a letter first, at most {NAME_LENGTH_MAX}, and no word of Python"
        return f"must be made of {form}, got {name!r}. Choose another, such as my_planner"
    if name in planner_kinds():
        return f"must be new, got {name!r}, which is a planner already. Choose another"
    if importlib.util.find_spec(name) is not None:
        return f"must be new, got {name!r}, which is an installed Python module. Choose another"
    return ""
