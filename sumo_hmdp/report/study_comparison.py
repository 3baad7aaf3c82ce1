"""The comparison that most studies are made for: their cells side by side, and pair by pair on common seeds."""

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path

import pandas as pd

from sumo_hmdp.errors import InputError
from sumo_hmdp.metrics.catalogue import METRICS
from sumo_hmdp.report.comparison import Comparison, Pairs, Wording, compare_all, pair_up, pairs_needed, verdict
from sumo_hmdp.report.frames import by_seed, is_binary, numbers
from sumo_hmdp.report.statistics import describe, rate_table
from sumo_hmdp.report.work import OnProgress, Work
from sumo_hmdp.study.store import load
from sumo_hmdp.validation import nearest

CONTACT_RATE = "contact_rate"
DEFAULT_METRICS = (
    "speed_mean_mps", "gap_min_m", "ttc_min_s", CONTACT_RATE, "optimal_share", "lane_change_count", "tet_s",
)  # fmt: skip
# What is smaller merely because a run ends early, besides counts.
SUMS_OVER_TIME = frozenset({"duration_s", "distance_m", "time_loss_s", "tet_s", "tit_s2"})
CELL_COLUMNS = ("scenario", "planner", "solver", "risk_level")


@dataclass(frozen=True)
class StudyComparison:
    """What a study says of its cells.

    Attributes:
        metrics: what is compared.
        by: the factors whose values are compared.
        means: one row per cell and metric: `cell`, `metric`, and the fields of `statistics.Description`.
        rates: one row per cell and truth value, with exact intervals (`statistics.rate_table`).
        differences: one row per pair of cells and metric: `where`, the fields of `comparison.Comparison`, `verdict`.
        notes: what was left out.
    """

    metrics: tuple[str, ...]
    by: tuple[str, ...]
    means: pd.DataFrame
    rates: pd.DataFrame
    differences: pd.DataFrame
    notes: tuple[str, ...]

    @property
    def verdicts(self) -> tuple[str, ...]:
        """What each comparison shows, one sentence each."""
        return tuple(self.differences["verdict"])


@dataclass(frozen=True)
class _Cell:
    """One combination of factors: the values that it has, as text, and its runs."""

    factors: dict[str, str]
    runs: pd.DataFrame

    def label(self, names: Sequence[str]) -> str:
        """Return its values of some factors; a planner stands for itself, a number needs its name."""
        shown = [
            value if name in {"planner", "scenario", "solver"} else f"{name}={value}"
            for name, value in self.factors.items()
            if name in names
        ]
        return ", ".join(shown) or "all runs"


def compare_study(
    folder: str | Path,
    metrics: Sequence[str] = (),
    by: Sequence[str] | str = (),
    level: float = 0.95,
    on_progress: OnProgress | None = None,
) -> StudyComparison:
    """Compare the cells of a study pair by pair on common seeds, each pair alike in all that is not compared.

    A factor that means nothing to a planner, such as a risk level to a rule, keeps it from no pair. Runs that failed,
    timed out or crashed count for nothing. All comparisons together share one correction (Holm's).

    Args:
        folder: a results directory, as given to `--out`.
        metrics: columns of `runs` of numbers or truth values, or `contact_rate`; none takes `DEFAULT_METRICS`.
        by: the factors whose values are compared; none takes the first that varies, the planner before all.
        level: of the intervals.
        on_progress: called after each comparison with how many are done and how many there are.

    Raises:
        InputError: if there are no results, or no such metric or factor.
    """
    results = load(folder)
    runs = results.runs
    if "status" not in runs:
        raise InputError([f"{folder} must hold runs, got none. Run the study first"])
    ended = runs["status"].isin(["completed", "contact"])
    notes = list(results.notes)
    notes += [f"left out: {count} runs that are {status}" for status, count in _counts(runs["status"][~ended])]
    runs = runs[ended].assign(**{CONTACT_RATE: runs["contact_count"][ended] > 0})
    metrics = tuple(dict.fromkeys(metrics or DEFAULT_METRICS))
    _require_metrics(runs, metrics)
    notes += _censored(runs, metrics)
    factors = _factors(runs)
    compared = _compared(factors, (by,) if isinstance(by, str) else tuple(by))
    cells = _cells(runs, factors)
    return StudyComparison(
        metrics=metrics,
        by=compared,
        means=_means(cells, factors, [name for name in metrics if not is_binary(runs[name])], level),
        rates=_rates(cells, factors, [name for name in metrics if is_binary(runs[name])], level),
        differences=_differences(cells, compared, metrics, level, Work(on_progress)),
        notes=tuple(notes),
    )


def _counts(statuses: pd.Series) -> list[tuple[str, int]]:
    return [(str(status), int(count)) for status, count in statuses.value_counts(sort=False).sort_index().items()]


def _censored(runs: pd.DataFrame, metrics: Sequence[str]) -> list[str]:
    """Say which metrics are of a shorter time in some runs."""
    early = int((runs["status"] == "contact").sum())
    sums = [name for name in metrics if name in SUMS_OVER_TIME or name.endswith("_count")]
    if not early or not sums:
        return []
    return [f"{early} runs ended early, with contact: their {', '.join(sums)} are of a shorter time"]


def _require_metrics(runs: pd.DataFrame, metrics: Sequence[str]) -> None:
    """Raise if a metric is no column, or one without numbers."""
    known = [
        str(name)
        for name, kind in runs.dtypes.items()
        if (pd.api.types.is_numeric_dtype(kind) or pd.api.types.is_bool_dtype(kind))
        and name not in {*CELL_COLUMNS, "seed"}
    ]
    wrong = [name for name in metrics if name not in known]
    if wrong:
        raise InputError(
            [f"--metric: must be a column of numbers, got {name!r}; {nearest(name, known)}" for name in wrong]
        )


def _factors(runs: pd.DataFrame) -> tuple[str, ...]:
    """Return the columns in which cells may differ and do, the planner first."""
    own = dict.fromkeys(
        name
        for text in (runs["factors_json"].dropna() if "factors_json" in runs else ())
        for name in json.loads(text)
        if name not in CELL_COLUMNS
    )
    columns = [*CELL_COLUMNS, *(f"factors.{name}" if f"factors.{name}" in runs else name for name in own)]
    varying = [name for name in columns if len(set(_texts(runs[name])) - {None}) > 1]
    return tuple(sorted(varying, key=lambda name: name != "planner"))


def _texts(column: pd.Series) -> list[str | None]:
    """Return a factor's values as they would stand in a study file, None for a run whose cell has none."""
    return [_text(value) for value in column.tolist()]


def _text(value: object) -> str | None:
    if value is None or value is pd.NA or (isinstance(value, float) and math.isnan(value)):
        return None
    return value if isinstance(value, str) else json.dumps(value, sort_keys=True)


def _compared(factors: Sequence[str], wanted: Sequence[str]) -> tuple[str, ...]:
    wrong = [name for name in wanted if name not in factors]
    if wrong:
        remedy = f"the factors are {', '.join(factors)}" if factors else "all runs are of one cell"
        raise InputError([f"--by: must be a factor with several values, got {name!r}; {remedy}" for name in wrong])
    return tuple(wanted) or tuple(factors[:1])


def _cells(runs: pd.DataFrame, factors: Sequence[str]) -> list[_Cell]:
    """Return the cells by their factors, numbers in their order."""
    cells: dict[tuple[str | None, ...], list[int]] = {}
    columns = [_texts(runs[name]) for name in factors]
    for position in range(len(runs)):
        cells.setdefault(tuple(column[position] for column in columns), []).append(position)
    return [
        _Cell({name: value for name, value in zip(factors, key, strict=True) if value is not None}, runs.iloc[rows])
        for key, rows in sorted(cells.items(), key=lambda item: [_order(value) for value in item[0]])
    ]


def _order(value: str | None) -> tuple[float, str]:
    try:
        return float(value or "-inf"), ""
    except ValueError:
        return math.inf, str(value)


def _means(cells: Sequence[_Cell], factors: Sequence[str], metrics: Sequence[str], level: float) -> pd.DataFrame:
    return pd.DataFrame(
        [
            {"cell": cell.label(factors), "metric": metric, **asdict(describe(numbers(cell.runs[metric]), level))}
            for cell in cells
            for metric in metrics
        ]
    )


def _rates(cells: Sequence[_Cell], factors: Sequence[str], metrics: Sequence[str], level: float) -> pd.DataFrame:
    labelled = pd.concat([cell.runs.assign(cell=cell.label(factors)) for cell in cells]) if cells else pd.DataFrame()
    return rate_table(labelled, ["cell"], metrics, level) if len(labelled) else labelled


def _pairs(cells: Sequence[_Cell], compared: Sequence[str]) -> Iterator[tuple[_Cell, _Cell]]:
    """Yield every two cells that differ in what is compared and agree in everything else that both have."""
    for first, second in combinations(cells, 2):
        common = first.factors.keys() & second.factors.keys()
        unlike = {name for name in common if first.factors[name] != second.factors[name]}
        if unlike and unlike <= set(compared):
            yield first, second


def _differences(
    cells: Sequence[_Cell], compared: Sequence[str], metrics: Sequence[str], level: float, work: Work
) -> pd.DataFrame:
    found: list[tuple[str, Pairs]] = []
    pairs = list(_pairs(cells, compared))
    work.expect(len(pairs) * len(metrics))
    for first, second in pairs:
        alike = [name for name in first.factors if first.factors[name] == second.factors.get(name)]
        names = tuple(cell.label([name for name in cell.factors if name not in alike]) for cell in (first, second))
        for metric in metrics:
            one, two = (
                by_seed(cell.runs, metric, "seed", name) for cell, name in zip((first, second), names, strict=True)
            )
            binary = is_binary(first.runs[metric])
            where = first.label(alike) if alike else ""
            found.append((where, pair_up(one, two, metric, (names[0], names[1]), binary=binary)))
    places = list(dict.fromkeys(where for where, _ in found))
    found.sort(key=lambda item: places.index(item[0]))
    rows = []
    for (where, _), final in zip(found, compare_all([pair for _, pair in found], level, work.tick), strict=True):
        sentence, needed = verdict(final, wording(final.metric)), pairs_needed(final)
        if final.enough and not final.shown and needed > final.pair_count:
            sentence += f"; if it is real, about {needed:.0f} pairs would show it in a test of its own"
        rows.append({"where": where, **asdict(final), "verdict": f"{where}: {sentence}" if where else sentence})
    columns = ["where", *Comparison.__dataclass_fields__, "verdict"]
    return pd.DataFrame(rows, columns=columns)


def wording(metric: str) -> Wording:
    """Return how a verdict speaks of a column of `runs`."""
    if metric == "speed_mean_mps":
        return Wording("mean speed", "m/s", "faster", "slower")
    if metric == CONTACT_RATE:
        return Wording("rate of runs with contact", "%")
    if metric not in METRICS.all:
        return Wording(metric)
    known = METRICS.get(metric)
    quantity = f"number of {known.label}" if known.is_count else known.label
    return Wording(quantity, "%" if metric.endswith(("_share", "_rate")) else known.unit)
