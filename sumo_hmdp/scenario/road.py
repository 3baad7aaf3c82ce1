"""A straight road without a network file: `road` in a scenario, and the SUMO network that is made of it."""

import hashlib
import os
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from sumo_hmdp.decision.problem_schema import Positive
from sumo_hmdp.errors import Problem
from sumo_hmdp.sim.net_text import straight_net
from sumo_hmdp.validation import FileModel, shown

_LANES_MAX = 6
WIDTH = 3.5  # of a lane, where nothing is said [m]: between the usual 3.25 and 3.75 m of motorways
# Widths that a car fits in and that no two cars do; a road that is longer than any run needs is a mistake of units.
_WIDTH_MIN, _WIDTH_MAX = 2.0, 5.0
_LENGTH_MIN, _LENGTH_MAX = 100.0, 100_000.0
_SPEED_MAX = 100.0


class RoadFile(FileModel):
    """`road`: a straight road from x = 0 to `length_m`, instead of `network` and `lanes`."""

    lanes: Annotated[int, Field(ge=1, le=_LANES_MAX)]
    width_m: Annotated[Positive, Field(ge=_WIDTH_MIN, le=_WIDTH_MAX)] = WIDTH
    length_m: Annotated[Positive, Field(ge=_LENGTH_MIN, le=_LENGTH_MAX)]
    speed_limit_mps: Annotated[Positive, Field(le=_SPEED_MAX)] = 60.0
    ramps: list[Any] = Field(default_factory=list)


def road_problems(raw: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield what of a scenario says the road twice, or asks for what is not made here."""
    road = raw.get("road")
    if road is None:
        return
    if raw.get("network") not in (None, ""):
        message = f"must be left out where there is `road`, got {shown(raw['network'])}; keep one of them"
        yield Problem("network", message)
    if raw.get("lanes") is not None and raw["lanes"] != _lanes(road):
        yield Problem("lanes", f"must be left out where there is `road`, got {shown(raw['lanes'])}; take it out")
    if isinstance(road, Mapping) and road.get("ramps"):
        message = "must be empty, since only straight roads without ramps are made here, got ramps"
        yield Problem("road.ramps", f"{message}. Use network: highway_ramps, or build a network with netconvert")


def with_road(raw: Mapping[str, Any]) -> dict[str, Any]:
    """Return a scenario's document in which `road` also stands as `lanes`, which all else reads.

    The `configuration` of a run has `road`, `lanes` and an empty `network`, and can be read again.
    """
    road = raw.get("road")
    return dict(raw) if road is None else {**raw, "network": "", "lanes": _lanes(road)}


def _lanes(road: Any) -> dict[str, Any]:  # noqa: ANN401 - any YAML
    return {"count": road.get("lanes"), "width_m": road.get("width_m", WIDTH)} if isinstance(road, Mapping) else {}


def road_file(road: RoadFile) -> Path:
    """Write the SUMO network of a road among this user's temporary files, and return its path.

    The name follows from the content, so all runs and processes share one file, and it is written in one step.

    Raises:
        OSError: the file cannot be written.
    """
    text = straight_net(road.lanes, road.width_m, road.length_m, road.speed_limit_mps)
    name = hashlib.sha256(text.encode()).hexdigest()[:16]
    folder = Path(tempfile.gettempdir()) / f"sumo_hmdp_roads_{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    path = folder / f"{name}.net.xml"
    if not path.is_file() or path.read_bytes() != text.encode():
        with tempfile.NamedTemporaryFile("w", encoding="utf-8", dir=folder, delete=False) as file:
            file.write(text)
        Path(file.name).replace(path)
    return path
