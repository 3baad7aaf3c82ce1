"""The risk that a study's plans took against the risk they were asked for; where that cannot be told, why."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import pandas as pd

from sumo_hmdp.metrics.risk_audit import Verdict, violation_rates
from sumo_hmdp.report.short import uncovered_of_run
from sumo_hmdp.report.study_data import StudyData
from sumo_hmdp.report.study_table import StudyTable, each, interval, listed, number
from sumo_hmdp.report.study_traces import TracedCell

_COLUMNS = [
    "cell", "risk_allocation", "status", "risk_level", "per", "violation_count", "event_count", "trial_count",
    "run_count", "violation_rate", "low_rate", "high_rate", "effective_count", "df_count", "verdict",
]  # fmt: skip
_STEP_COLUMNS = [name for name in _COLUMNS if name not in {"per", "verdict"}]
_STEP_COLUMNS.insert(3, "horizon_step")


@dataclass(frozen=True)
class StudyAudit:
    """The audit of a study.

    Attributes:
        rates: as of `violation_rates` by `cell_label`, with `risk_allocation`; no rows where nothing could be audited.
        steps: the same of each horizon step alone.
        notes: what could not be audited, and why.
    """

    rates: pd.DataFrame
    steps: pd.DataFrame
    notes: tuple[str, ...]

    @property
    def plans(self) -> pd.DataFrame:
        """The rates per plan of plans that claim to keep their risk level."""
        claimed = (self.rates["per"] == "plan") & (self.rates["verdict"] != Verdict.NO_CLAIM)
        return self.rates[claimed].reset_index(drop=True)


def audit_study(data: StudyData, traced: Sequence[TracedCell], notes: tuple[str, ...]) -> StudyAudit:
    """Audit every cell that can be.

    Args:
        data: the study.
        traced: its cells with traces.
        notes: what of it cannot be audited.
    """
    audited = [part for cell in traced for part in cell.planned if len(part)]
    if not audited:
        rates, steps = (pd.DataFrame(columns=["cell_label", *columns[1:]]) for columns in (_COLUMNS, _STEP_COLUMNS))
        return StudyAudit(rates, steps, notes or ("No planner of this study plans with a risk level.",))
    rows = pd.concat(audited, ignore_index=True)
    tables = (violation_rates(rows, data.ended, by) for by in (["cell_label"], ["cell_label", "horizon_step"]))
    allocation = {cell.label: cell.rule for cell in traced}
    order = {cell.label: place for place, cell in enumerate(data.cells)}
    rates, steps = (
        table.assign(risk_allocation=table["cell_label"].map(allocation), place=table["cell_label"].map(order))
        .sort_values("place", kind="stable", ignore_index=True)
        .drop(columns="place")
        for table in tables
    )
    return StudyAudit(rates, steps, notes)


def audit_table(audit: StudyAudit) -> StudyTable:
    """Return the rates per step, plan and run with their verdicts."""
    rows = []
    for row in audit.rates.to_dict("records"):
        asked, rate = row["risk_level"], row["violation_rate"]
        ratio = number(rate / asked, 2) if asked and asked > 0 else number(None)
        runs = str(row["run_count"]), number(row["effective_count"])
        counted = f"{row['violation_count']} of {row['trial_count']}", str(row["event_count"]), *runs
        measured = number(100 * rate), interval(100 * row["low_rate"], 100 * row["high_rate"]), ratio
        told = row["status"], str(row["per"]), number(100 * asked)
        rows.append((row["cell_label"], str(row["risk_allocation"]), *told, *counted, *measured, str(row["verdict"])))
    headings = (
        "cell", "risk rule", "plans", "per", "asked [%]", "violated", "events", "runs", "effective", "rate [%]",
        "95 % interval", "rate over asked", "verdict",
    )  # fmt: skip
    note = (
        "A planned step is violated where, at its instant, a vehicle that the plan kept a distance to and that took up "
        "a lane of the plan was nearer than the planner's own safe distance. Consecutive plans that the same vehicle "
        "violated are one event. Intervals: the runs are the "
        "sampling unit (Korn and Graubard); effective is the number of independent plans that would tell as much, and "
        "without a violation that is the number of runs. The claims hold where vehicles move as predicted, which "
        "those that SUMO drives do not promise. The rule individual claims less than a rate per plan; plans that are "
        "not optimal claim nothing."
    )
    frame = audit.rates.rename(columns={"cell_label": "cell"})[_COLUMNS]
    return StudyTable(
        "risk", "Violations of the safe distance per planned step, plan and run", frame, headings, tuple(rows), note
    )


def audit_step_table(audit: StudyAudit) -> StudyTable:
    """Return the rates of each horizon step."""
    rows = [
        (
            row["cell_label"],
            row["status"],
            str(row["horizon_step"]),
            number(100 * row["risk_level"]),
            f"{row['violation_count']} of {row['trial_count']}",
            str(row["run_count"]),
            number(100 * row["violation_rate"]),
            interval(100 * row["low_rate"], 100 * row["high_rate"]),
        )
        for row in audit.steps.to_dict("records")
    ]
    headings = ("cell", "plans", "horizon step", "asked [%]", "violated", "runs", "rate [%]", "95 % interval")
    frame = audit.steps.rename(columns={"cell_label": "cell"})[_STEP_COLUMNS]
    return StudyTable("risk_steps", "Violations of the safe distance by horizon step", frame, headings, tuple(rows))


def audit_sentences(audit: StudyAudit) -> Iterator[str]:
    """Yield what the audit found of plans, then what it could not find."""
    plans = audit.plans
    words = {
        Verdict.VIOLATED: "took more risk than asked",
        Verdict.CONSISTENT: "took about the risk asked",
        Verdict.CONSERVATIVE: "took less than half the risk asked",
        Verdict.TOO_FEW: "ran too few times to tell the risk taken",
    }
    for outcome, told in words.items():
        cells = plans[plans["verdict"] == outcome]
        if len(cells):
            named = [
                f"{row.cell_label} ({number(100 * row.violation_rate)} % of its plans, {row.run_count} runs)"
                for row in each(cells)
            ]
            yield f"{told[0].upper()}{told[1:]}: {listed(named)}."
    yield from audit.notes


def uncovered_sentences(data: StudyData) -> tuple[str, ...]:
    """Say of each cell what of the prediction its risk level does not cover; nothing where all is covered."""
    pruned = data.decisions.groupby("run_id")["pruned_prob"].max() if len(data.decisions) else pd.Series(dtype=float)
    found = []
    for cell in data.cells:
        runs = data.ended.loc[data.ended["cell_label"] == cell.label, "run_id"]
        told = uncovered_of_run(cell.manifest, pruned.reindex(runs).dropna())
        if told:
            found.append(f"{cell.label}: {told}.")
    return tuple(found)
