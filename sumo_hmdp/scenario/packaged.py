"""What comes with the package: where its scenarios, studies and networks are."""

from importlib.resources import files
from pathlib import Path


def data_folder(kind: str) -> Path:
    """Return the folder of the scenarios or networks that come with the package."""
    packaged = Path(str(files("sumo_hmdp"))) / "_data" / kind
    return packaged if packaged.is_dir() else Path(str(files("sumo_hmdp"))).parent / kind


def scenario_names() -> dict[str, Path]:
    """Return the scenarios that come with the package, by name."""
    return {path.stem: path for path in sorted(data_folder("scenarios").glob("*.yaml"))}


def study_names() -> dict[str, Path]:
    """Return the studies that come with the package, by name."""
    return {path.stem: path for path in sorted((data_folder("scenarios") / "studies").glob("*.yaml"))}
