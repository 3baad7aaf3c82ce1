"""How far a run of the paper's Case 1 or 2 is from all of its published numbers at once."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from sumo_hmdp.report.case_data import CaseRun
from sumo_hmdp.report.case_instants import case1_instants, case2_instants, case2_places
from sumo_hmdp.report.case_numbers import hardest_decel

# The most that one number, and what each demand that fails, adds.
WORST = 20.0
# The scale of a place: half of what the text's "about 1400 m" and "about 1150 m" are rounded to [m].
PLACE_SCALE = 25.0


@dataclass(frozen=True)
class Published:
    """One published number beside ours.

    Attributes:
        what: it is, with its unit.
        ours: None where what happens in the paper does not happen at all.
        paper: the paper's.
        scale: a difference that counts as 1; of an instant one decision period.
    """

    what: str
    ours: float | None
    paper: float
    scale: float

    @property
    def off(self) -> float:
        """The difference in scales, at most `WORST`."""
        return WORST if self.ours is None else min(abs(self.ours - self.paper) / self.scale, WORST)


def published_numbers(case: int, run: CaseRun) -> tuple[Published, ...]:
    """Return every published number of Case 1 or 2; of Case 1 the paper gives instants only."""
    instants, places = (case1_instants(run), ()) if case == 1 else (case2_instants(run), case2_places(run))
    return (
        *(Published(f"({one.label}) {one.what} [s]", one.ours, one.paper, run.period) for one in instants),
        *(Published(f"{name} after 45 s [m]", ours, paper, PLACE_SCALE) for name, ours, paper in places),
    )


def demands(case: int, run: CaseRun) -> Iterator[tuple[str, bool]]:
    """Yield what has to hold besides."""
    yield "all decisions optimal", all(decision.status == "optimal" for decision in run.decisions)
    yield "no contact", not run.row["contact_count"]
    if case == 2:
        yield "SV1 never brakes", hardest_decel(run.motions["sv1"]) < 1e-6


def distance(case: int, run: CaseRun) -> float:
    """Return the mean over the numbers of |ours - paper| / scale, plus `WORST` for each demand that fails."""
    terms = [number.off for number in published_numbers(case, run)]
    return sum(terms) / len(terms) + WORST * sum(not holds for _, holds in demands(case, run))


def fitted_values(run: CaseRun, fitted: CaseRun) -> tuple[tuple[str, Any, Any], ...]:
    """Return (path, value, fitted value) of all that the two scenarios differ in, in what was run."""
    ours, theirs = _flat(run.configuration), _flat(fitted.configuration)
    shown = [path for path in ours if path.split(".")[0] not in {"name", "description", "published"}]
    other = tuple(f"planners.{name}." for name in run.configuration["planners"] if name != run.planner)
    return tuple(
        (path, ours[path], theirs.get(path))
        for path in shown
        if ours[path] != theirs.get(path) and not path.startswith(other)
    )


def _flat(value: object, path: str = "") -> dict[str, Any]:
    if isinstance(value, Mapping):
        items = [(f"{path}.{key}" if path else str(key), inner) for key, inner in value.items()]
    elif isinstance(value, list):
        # Vehicles by their names.
        names = [one.get("id", i) if isinstance(one, Mapping) else i for i, one in enumerate(value)]
        items = [(f"{path}[{name}]", inner) for name, inner in zip(names, value, strict=True)]
    else:
        return {path: value}
    return {name: leaf for key, inner in items for name, leaf in _flat(inner, key).items()}
