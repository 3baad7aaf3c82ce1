"""What a study file may hold: scenarios, factors and seeds, and when to stop. Unknown keys are errors."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag

from sumo_hmdp.decision.problem_schema import ENTRIES_MAX, NAME_MAX
from sumo_hmdp.validation import FileModel

SEED_MAX = 2**31 - 1
SEED_COUNT_MAX = 1_000_000
# All cells are assembled and all runs are listed before any of them starts.
CELL_COUNT_MAX, RUN_COUNT_MAX = 2000, 1_000_000
Seed = Annotated[int, Field(ge=0, le=SEED_MAX)]


class SeedsFile(FileModel):
    """`seeds: {first, count}`: consecutive seeds."""

    first: Seed = 0
    count: Annotated[int, Field(ge=1, le=SEED_COUNT_MAX)] | None = None


def _seeds_form(value: object) -> str:
    return "list" if isinstance(value, list) else "range"


SeedList = Annotated[list[Seed], Field(min_length=1, max_length=SEED_COUNT_MAX)]
Seeds = Annotated[Annotated[SeedsFile, Tag("range")] | Annotated[SeedList, Tag("list")], Discriminator(_seeds_form)]


def _factor_form(value: object) -> str:
    return "levels" if isinstance(value, Mapping) else "values"


LevelName = Annotated[str, Field(max_length=NAME_MAX, pattern=r"^[A-Za-z0-9_]+$")]
# A path in a scenario, such as `vehicles[0].x_m`, or a name of its own; both become columns of tables.
FactorName = Annotated[
    str, Field(max_length=NAME_MAX, pattern=r"^[A-Za-z0-9_-]+(\[[0-9]+\])*(\.[A-Za-z0-9_-]+(\[[0-9]+\])*)*$")
]
Levels = Annotated[dict[LevelName, dict[str, Any]], Field(min_length=1, max_length=ENTRIES_MAX)]
Values = Annotated[list[Any], Field(min_length=1, max_length=ENTRIES_MAX)]
# A list of values of one path, or named levels, each of which sets several paths together.
Factor = Annotated[Annotated[Values, Tag("values")] | Annotated[Levels, Tag("levels")], Discriminator(_factor_form)]


class StoppingFile(FileModel):
    """`stopping`: more seeds, batch by batch, until the metric's confidence interval is narrow enough in every cell.

    `half_width` is in the metric's own unit.
    """

    metric: str
    half_width: Annotated[float, Field(gt=0, le=1e6)]
    confidence: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.95
    seeds_min: Annotated[int, Field(ge=2)] = 10
    seeds_max: Annotated[int, Field(ge=2, le=SEED_COUNT_MAX)]
    batch_count: Annotated[int, Field(ge=1)] = 10


class StudyFile(FileModel):
    """A study: every scenario with every combination of the factors' values, each with every seed."""

    name: Annotated[str, Field(max_length=NAME_MAX, pattern=r"^[a-z0-9_]+$")]
    description: str = ""
    scenarios: Annotated[list[str], Field(min_length=1, max_length=ENTRIES_MAX)]
    factors: dict[FactorName, Factor] = Field(default_factory=dict)
    seeds: Seeds = SeedsFile()
    stopping: StoppingFile | None = None
    solver: str = "milp"
    trace: Literal["none", "ego", "all"] = "none"
    wall_limit_s: Annotated[float, Field(gt=0.0, le=1e6)] = 600.0
