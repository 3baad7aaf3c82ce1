"""What a study's seeds cannot show, told before any run is done."""

from collections.abc import Iterator, Sequence

from sumo_hmdp.report.sample_size import FEWEST_PAIRS, pairs_for_rates, runs_for_no_violation
from sumo_hmdp.report.study_data import baseline_of, named_cells
from sumo_hmdp.report.study_verdict import COMPARED
from sumo_hmdp.study.design import Design


def shortfalls(design: Design) -> tuple[str, ...]:
    """Return what the report of a study could not show, however its runs end; empty where nothing is known.

    Args:
        design: a study that was checked.
    """
    cells = named_cells(
        {
            "cell": cell.id,
            "factors": cell.factors,
            "scenario": cell.ready.scenario,
            "planner": cell.ready.planner_name,
            "solver": cell.ready.solver,
            "risk_level": cell.ready.parameters.get("risk_level"),
        }
        for cell in design.cells
    )
    contexts = [[cell for cell in cells if cell.context == context] for context in {cell.context for cell in cells}]
    comparisons = len(COMPARED) * sum(len(inside) - 1 for inside in contexts if baseline_of(inside) is not None)
    asked = sorted({cell.risk_level for cell in cells if cell.risk_level})
    audited = asked if design.file.trace == "all" else []
    return (*_of_differences(len(design.seeds), comparisons), *_of_risk(len(design.seeds), audited))


def _of_differences(seeds: int, comparisons: int) -> Iterator[str]:
    if not comparisons:
        return
    if seeds < FEWEST_PAIRS:
        yield f"no difference between cells can be shown with {seeds} seeds; it takes {FEWEST_PAIRS} at least"
        return
    needed = pairs_for_rates(comparisons)
    if seeds < needed:
        yield (
            f"no difference in the rate of contacts can be shown with {seeds} seeds after Holm's correction for the "
            f"{comparisons} comparisons of the report; it takes {needed} at least"
        )


def _of_risk(seeds: int, risk_levels: Sequence[float]) -> Iterator[str]:
    for asked in risk_levels:
        needed, careful = runs_for_no_violation(asked), runs_for_no_violation(asked / 2)
        if seeds < needed:
            yield (
                f"a risk level of {asked:g} cannot be shown to be kept with {seeds} seeds, even without any violation; "
                f"it takes {needed} at least, and {careful} to be called conservative, unless violations show that "
                "the plans of a run differ"
            )
