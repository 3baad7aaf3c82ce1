"""The verdict of a study: how each cell differs from the baseline on common seeds, in numbers and in sentences."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass

import pandas as pd

from sumo_hmdp.metrics.catalogue import METRICS
from sumo_hmdp.metrics.registry import Better
from sumo_hmdp.report.comparison import (
    Comparison,
    Pairs,
    Wording,
    cell_pairs,
    compare_all,
    pairs_needed,
    verdict,
)
from sumo_hmdp.report.sample_size import FEWEST_PAIRS
from sumo_hmdp.report.study_data import StudyData, baseline_of
from sumo_hmdp.report.study_table import StudyTable, interval, listed, number, p_text, printed

CONTACT = "contact"
# What planners are compared in. None of them is smaller merely because a run ends early, as sums over time are.
COMPARED = (
    CONTACT,
    "speed_mean_mps",
    "gap_min_m",
    "ttc_min_s",
    "near_miss_count",
    "rss_violation_share",
    "braking_imposed_max_mps2",
    "jerk_rms_mps3",
)
LEVEL = 0.95
BETTER, WORSE, NOT_SHOWN, TOO_FEW, ALIKE = (
    "better", "worse", "no difference shown", "too few data", "differs by the same in every pair",
)  # fmt: skip


@dataclass(frozen=True)
class Finding:
    """A comparison with its outcome.

    Attributes:
        comparison: the numbers.
        outcome: of the first cell against the second.
    """

    comparison: Comparison
    outcome: str


def wording(metric: str) -> Wording:
    """Return how a sentence speaks of a metric."""
    if metric == CONTACT:
        return Wording("contact rate", "%")
    known = METRICS.get(metric)
    if metric == "speed_mean_mps":
        return Wording(known.label, printed(known.unit), "faster", "slower")
    return Wording(known.label, "%" if metric.endswith(("_share", "_rate")) else printed(known.unit))


def higher_is_better(metric: str) -> bool:
    """Tell whether more of a metric is better."""
    return metric != CONTACT and METRICS.get(metric).better is Better.HIGHER


def findings_of(data: StudyData) -> tuple[Finding, ...]:
    """Compare every cell with the baseline of its context, with Holm's correction over the whole study."""
    pairs: list[Pairs] = []
    for context in data.contexts:
        cells = data.cells_in(context)
        present = [cell for cell in cells if (data.ended["cell"] == cell.id).any()]
        baseline = baseline_of(present)
        if baseline is not None:
            runs = data.ended[data.ended["cell"].isin([cell.id for cell in present])]
            pairs += cell_pairs(runs, ["cell_label"], COMPARED, (baseline.label,))
    return tuple(Finding(one, outcome_of(one)) for one in compare_all(pairs, LEVEL))


def outcome_of(comparison: Comparison) -> str:
    """Return what a comparison shows of its first cell."""
    if not comparison.enough:
        return TOO_FEW
    if comparison.alike:
        return ALIKE
    if not comparison.shown:
        return NOT_SHOWN
    return BETTER if (comparison.difference > 0) == higher_is_better(comparison.metric) else WORSE


def verdict_table(findings: Sequence[Finding]) -> StudyTable:
    """Return who is better in what, by how much, and how sure that is."""
    rows, records = [], []
    for finding in findings:
        c = finding.comparison
        words = wording(c.metric)
        scale = 100 if words.unit == "%" else 1
        unit = f" [{words.unit}]" if words.unit else ""
        ends = interval(scale * c.low, scale * c.high)
        size = number(scale * c.difference)
        told = f"{finding.outcome} (doubtful)" if c.doubt else finding.outcome
        texts = (f"{words.quantity}{unit}", told, size, ends, str(c.pair_count), p_text(c.p_adjusted))
        rows.append((c.first, c.second, *texts))
        records.append(_record(finding))
    level = f"{100 * findings[0].comparison.level:.4g} % interval" if findings else "interval"
    headings = ("cell", "against", "in", "is", "difference", level, "pairs", "p after Holm")
    note = (
        f"Difference: cell less baseline, mean over common seeds. Its test and its interval are one: Student's t and "
        f"the bootstrap-t together, of contacts Tango's score. Holm's correction is over all {len(findings)} rows; the "
        "intervals are at the level with which it ended, so that one leaves 0 out exactly where a difference is shown. "
        f"Fewer than {FEWEST_PAIRS} pairs show nothing, and pairs that are all alike have no interval. Doubtful: so "
        "skewed, or so few that differ, that the interval may hold less often than it says; the sentence in the CSV "
        "says why."
    )
    return StudyTable(
        "verdict", "Each cell against the baseline, on common seeds", pd.DataFrame(records, columns=_COLUMNS), headings,
        tuple(rows), note,
    )  # fmt: skip


_COLUMNS = [
    "metric", "first", "second", "outcome", "unit", "pair_count", "unpaired_count", "missing_count", "infinite_count",
    "difference", "low", "high", "level", "test", "p_value", "p_adjusted", "cohen_dz",
    "variance_saved", "doubt", "pairs_needed_count", "sentence",
]  # fmt: skip


def _record(finding: Finding) -> dict[str, object]:
    c = finding.comparison
    metric_unit = "1" if c.metric == CONTACT else METRICS.get(c.metric).unit
    return asdict(c) | {
        "outcome": finding.outcome,
        "unit": metric_unit,
        "pairs_needed_count": pairs_needed(c),
        "sentence": verdict(c, wording(c.metric)),
    }


def pairs_table(findings: Sequence[Finding]) -> StudyTable:
    """Return what the comparisons rest on: tests, effect sizes, what was left out, and what common seeds save."""
    rows = []
    for finding in findings:
        c = finding.comparison
        left_out = number(c.unpaired_count), number(c.missing_count), number(c.infinite_count)
        effect = number(c.cohen_dz, 2), number(100 * c.variance_saved, 2)
        told = wording(c.metric).quantity, c.test, p_text(c.p_value)
        rows.append((c.first, *told, str(c.pair_count), *left_out, *effect, number(pairs_needed(c))))
    headings = (
        "cell", "in", "test", "p", "pairs", "without partner", "missing", "infinite", "Cohen's dz",
        "variance saved [%]", "pairs for 80 % power",
    )  # fmt: skip
    note = (
        "Pairs with a missing or an infinite value are left out of the comparison. Variance saved: by common seeds, "
        "against independent ones. The last column: pairs with which a paired t-test finds a true difference as large "
        "as the one seen."
    )
    frame = pd.DataFrame([_record(finding) for finding in findings], columns=_COLUMNS)
    return StudyTable("pairs", "What the comparisons rest on", frame, headings, tuple(rows), note)


def sentences(data: StudyData, findings: Sequence[Finding]) -> tuple[str, ...]:
    """Return the verdict in plain sentences: what there is, then each cell against its baseline."""
    return (*_scope(data), *_against(findings))


def _scope(data: StudyData) -> Iterator[str]:
    total, ended, contacts = len(data.runs), len(data.ended), int(data.ended["contact"].sum())
    if not total:
        yield f"Too few data: the study has no run yet, of {len(data.cells)} cells."
        return
    seeds = data.runs["seed"].nunique()
    runs, cells = _count(total, "run"), _count(len(data.cells), "cell")
    had = "none had a contact" if not contacts else f"{contacts} of the {ended} that ended had a contact"
    yield f"{runs} in {cells} with {_count(seeds, 'seed')}; {had}."
    if total > ended:
        yield f"{_count(total - ended, 'run')} failed and counted for nothing but the ledger."


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _against(findings: Sequence[Finding]) -> Iterator[str]:
    if not findings:
        yield "Nothing can be compared: no two cells with runs share their surroundings."
    for pair in dict.fromkeys((one.comparison.first, one.comparison.second) for one in findings):
        mine = [one for one in findings if (one.comparison.first, one.comparison.second) == pair]
        outcomes = {
            outcome: [_told(one.comparison, outcome) for one in mine if one.outcome == outcome]
            for outcome in (BETTER, WORSE, ALIKE, NOT_SHOWN, TOO_FEW)
        }
        if len(outcomes[TOO_FEW]) == len(mine):
            yield f"{pair[0]} against {pair[1]}: too few data in everything ({mine[0].comparison.pair_count} pairs)."
            continue
        lead = {
            BETTER: "better in",
            WORSE: "worse in",
            NOT_SHOWN: "no difference shown in",
            TOO_FEW: "too few data for",
        }
        lead[ALIKE] = "different by the same in every pair in"
        parts = [f"{lead[outcome]} {listed(names, 9)}" for outcome, names in outcomes.items() if names]
        yield f"{pair[0]} against {pair[1]}: {'; '.join(parts)}."


def _told(c: Comparison, outcome: str) -> str:
    words = wording(c.metric)
    if outcome not in {BETTER, WORSE, ALIKE}:
        return words.quantity
    sign = "+" if c.difference > 0 else "−"  # noqa: RUF001 - a minus
    return f"{words.quantity} ({sign}{words.amount(abs(c.difference))}{words.suffix}{', doubtful' if c.doubt else ''})"
