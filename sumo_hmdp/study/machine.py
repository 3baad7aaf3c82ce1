"""What a run's numbers depend on besides its input, here: software, its sources, and the machine's arithmetic."""

import ctypes
import hashlib
import platform
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path

import numpy as np

from sumo_hmdp.decision.highs import solver_version
from sumo_hmdp.decision.registry import planner_package
from sumo_hmdp.sim.sumo import sumo_version

# What of the package only reads results.
_READERS = ("report", "cli")
# OpenBLAS chooses a kernel at run time; builds differ in what they call the function that names it.
_CORE_NAMES = tuple(
    f"{prefix}openblas_get_corename{suffix}" for prefix in ("scipy_", "") for suffix in ("64_", "", "_64")
)


def versions(planner: str = "") -> dict[str, str]:
    """Return everything that can change a result.

    Args:
        planner: that of the run; one of another package has its package's version and source named too.
    """
    package = planner_package(planner) if planner else None
    return dict(_versions()) | ({} if package is None else {"planner_package": str(package)})


@cache
def _versions() -> dict[str, str]:
    packages = ("pyomo", "numpy", "scipy", "piqp")
    return {
        "sumo_hmdp": version("sumo-hmdp"),
        "sumo_hmdp_source": source_hash(Path(__file__).parents[1]),
        "sumo": sumo_version(),
        "highs": solver_version(),
        **{package: version(package) for package in packages},
        "python": platform.python_version(),
        "libc": " ".join(platform.libc_ver()).strip() or "unknown",
        "cpu": _cpu(),
        "numpy_dispatch": _dispatch(),
        "blas": _blas(),
    }


def source_hash(folder: Path) -> str:
    """Return a hash of a package's own modules that take part in runs, its first 12 digits."""
    digest = hashlib.sha256()
    for file in sorted(folder.rglob("*.py")):
        place = file.relative_to(folder)
        if not place.parts[0].startswith(_READERS):
            digest.update(f"{place.as_posix()}\n".encode())
            digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()[:12]


def _cpu() -> str:
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines():
            name, _, value = line.partition(":")
            if name.strip() == "model name":
                return " ".join(value.split())
    return platform.processor() or platform.machine()


def _dispatch() -> str:
    """Return the instruction sets that numpy was built for and those that it found and uses."""
    config = np.show_config(mode="dicts")
    sets = config.get("SIMD Extensions", {}) if isinstance(config, dict) else {}
    return " ".join([*sets.get("baseline", []), *(f"+{name}" for name in sets.get("found", []))]) or "unknown"


def _blas() -> str:
    config = np.show_config(mode="dicts")
    built = config.get("Build Dependencies", {}).get("blas", {}) if isinstance(config, dict) else {}
    words = [str(built.get("name", "unknown")), str(built.get("version", ""))]
    return " ".join([*filter(None, words), _blas_kernel()]).strip()


def _blas_kernel() -> str:
    """Return the kernel that numpy's OpenBLAS has chosen for this machine, empty where there is none to ask."""
    with suppress(OSError):
        maps = Path("/proc/self/maps").read_text(encoding="utf-8", errors="replace")
        paths = {line.split(maxsplit=5)[5] for line in maps.splitlines() if "openblas" in line}
        # Other packages may bring one of their own along.
        for path in sorted(paths, key=lambda path: ("numpy" not in path, path)):
            library = ctypes.CDLL(path)
            for name in _CORE_NAMES:
                function = getattr(library, name, None)
                if function is not None:
                    function.restype = ctypes.c_char_p
                    return str((function() or b"").decode())
    return ""
