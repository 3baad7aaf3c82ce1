"""The source of a planner that another package offers: what its runs depend on besides their input."""

import ast
import hashlib
import sys
import sysconfig
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path

# Of a package's files, what says how it was installed and not what it does.
_NOT_SOURCE = (".pyc", ".pyo", ".pth")


@dataclass(frozen=True)
class PlannerPackage:
    """The package that offers a planner.

    Attributes:
        name: of the distribution.
        version: of the distribution.
        source: hash of its files, its first 12 digits.
    """

    name: str
    version: str
    source: str

    def __str__(self) -> str:
        return f"{self.name} {self.version} (source {self.source})"


def package_of(entry: EntryPoint) -> PlannerPackage:
    """Return the package of an entry point whose module has been imported."""
    digest = hashlib.sha256()
    for name, file in sorted(_files(entry).items()):
        digest.update(f"{name}\n".encode())
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    known = entry.dist is not None
    name = entry.dist.name if entry.dist is not None else entry.module.split(".")[0]
    return PlannerPackage(name, entry.dist.version if known and entry.dist else "unknown", digest.hexdigest()[:12])


def _files(entry: EntryPoint) -> dict[str, Path]:
    """Return files by their place below where packages stand, which is the same on every machine.

    They are those that the distribution lists, those of the entry point's own package, and the modules beside it that
    these import; of a package that is worked on in place, the distribution lists none.
    """
    found = {
        str(listed): Path(str(listed.locate()))
        for listed in (entry.dist.files if entry.dist is not None else None) or ()
        if ".dist-info" not in str(listed) and not listed.name.startswith("__editable__") and ".." not in listed.parts
    }
    root, own = _own_files(entry.module)
    found |= {file.relative_to(root).as_posix(): file for file in own}
    if root not in _shared_folders():
        waiting = [file for file in own if file.suffix == ".py"]
        while waiting:
            for file in _imported(waiting.pop(), root):
                place = file.relative_to(root).as_posix()
                if place not in found:
                    found[place] = file
                    waiting += [file] if file.suffix == ".py" else []
    return {name: file for name, file in found.items() if file.suffix not in _NOT_SOURCE and file.is_file()}


def _own_files(module: str) -> tuple[Path, list[Path]]:
    """Return the folder in which the outermost package of a module stands, and the package's files."""
    parts = module.split(".")
    for count in range(1, len(parts) + 1):
        # Namespace packages, which several distributions share, have no file.
        file = getattr(sys.modules.get(".".join(parts[:count])), "__file__", None)
        if file is None:
            continue
        path = Path(file)
        if path.name != "__init__.py":
            return path.parent, [path]
        root = path.parents[count]
        return root, [one for one in path.parent.rglob("*") if one.is_file() and "__pycache__" not in one.parts]
    return Path(), []


def _shared_folders() -> set[Path]:
    """Return where packages of all kinds stand side by side."""
    return {Path(sysconfig.get_path(name)) for name in ("purelib", "platlib", "stdlib")}


def _imported(file: Path, root: Path) -> Iterator[Path]:
    """Yield the modules and packages in a folder that a module imports."""
    try:
        tree = ast.parse(file.read_bytes())
    except (SyntaxError, ValueError):
        return
    for node in ast.walk(tree):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names = [node.module]
        for name in {one.split(".")[0] for one in names}:
            if (root / f"{name}.py").is_file():
                yield root / f"{name}.py"
            if (root / name / "__init__.py").is_file():
                yield from (one for one in (root / name).rglob("*") if one.is_file() and "__pycache__" not in one.parts)
