"""The risk that a study's plans took against the risk they were asked for; where that cannot be told, why."""

from collections.abc import Iterator
from dataclasses import dataclass

import pandas as pd

from sumo_hmdp.domain.scene import EGO_ID
from sumo_hmdp.errors import InputError
from sumo_hmdp.metrics.planned_distances import audit_settings
from sumo_hmdp.metrics.risk_audit import Verdict, audit_results, violation_rates
from sumo_hmdp.report.study_data import StudyData
from sumo_hmdp.report.study_table import StudyTable, each, interval, listed, number

_COLUMNS = [
    "cell", "risk_allocation", "status", "risk_level", "per", "violation_count", "trial_count", "run_count",
    "violation_rate", "low_rate", "high_rate", "design_effect", "verdict",
]  # fmt: skip


@dataclass(frozen=True)
class StudyAudit:
    """The audit of a study.

    Attributes:
        rates: as of `violation_rates` by `cell_label`, with `risk_allocation`; no rows where nothing could be audited.
        notes: what could not be, and why.
    """

    rates: pd.DataFrame
    notes: tuple[str, ...]

    @property
    def plans(self) -> pd.DataFrame:
        """The rates per plan of plans that claim to keep their risk level."""
        claimed = (self.rates["per"] == "plan") & (self.rates["verdict"] != Verdict.NO_CLAIM)
        return self.rates[claimed].reset_index(drop=True)


def audit_study(data: StudyData) -> StudyAudit:
    """Audit every cell whose planner keeps a fixed safe distance and whose runs kept all vehicles."""
    notes: list[str] = []
    untraced: list[str] = []
    parts = []
    kept = _traced(data)
    for cell in data.cells:
        try:
            claims = audit_settings(cell.manifest) is not None
        except InputError:
            rule = cell.manifest["parameters"]["distance_rule"]
            notes.append(
                f"{cell.label} cannot be audited: its plans keep the distance of the rule {rule}, and only a fixed "
                "distance can be looked up afterwards."
            )
            continue
        ran = data.ended.loc[data.ended["cell"] == cell.id, "run_id"]
        if not claims or ran.empty:
            continue
        traced = [run for run in ran if run in kept]
        if len(traced) < len(ran):
            untraced.append(
                cell.label if not traced else f"{len(ran) - len(traced)} of {len(ran)} runs of {cell.label}"
            )
        if traced:
            decisions = data.decisions[data.decisions["run_id"].isin(traced)]
            steps = data.steps[data.steps["run_id"].isin(traced)]
            parts.append(audit_results(decisions, steps, dict.fromkeys(traced, cell.manifest)))
    if untraced:
        notes.append(
            f"The risk that was taken cannot be audited for {listed(untraced)}: the study kept no traces of the other "
            "vehicles (trace: none or ego). Run it again with trace: all."
        )
    audited = [part for part in parts if len(part)]
    if not audited:
        empty = pd.DataFrame(columns=["cell_label", *_COLUMNS[1:]])
        return StudyAudit(empty, tuple(notes) or ("No planner of this study plans with a risk level.",))
    rates = violation_rates(pd.concat(audited, ignore_index=True), data.ended, ["cell_label"])
    allocation = {cell.label: cell.manifest["parameters"].get("risk_allocation") for cell in data.cells}
    order = {cell.label: place for place, cell in enumerate(data.cells)}
    rates = rates.assign(risk_allocation=rates["cell_label"].map(allocation), place=rates["cell_label"].map(order))
    return StudyAudit(rates.sort_values("place", kind="stable", ignore_index=True), tuple(notes))


def _traced(data: StudyData) -> set[str]:
    """Return the runs that kept all vehicles, or never saw another one."""
    others = set(data.steps.loc[data.steps["vehicle_id"] != EGO_ID, "run_id"])
    alone = set(data.steps["run_id"]) - set(data.decisions.loc[data.decisions["branch_count"] > 0, "run_id"])
    return others | alone


def audit_table(audit: StudyAudit) -> StudyTable:
    """Return the rates per step, plan and run with their verdicts."""
    rows = []
    for row in audit.rates.to_dict("records"):
        asked, rate = row["risk_level"], row["violation_rate"]
        ratio = number(rate / asked, 2) if asked and asked > 0 else number(None)
        counted = f"{row['violation_count']} of {row['trial_count']}", str(row["run_count"])
        measured = number(100 * rate), interval(100 * row["low_rate"], 100 * row["high_rate"]), ratio
        told = row["status"], str(row["per"]), number(100 * asked)
        rows.append((row["cell_label"], str(row["risk_allocation"]), *told, *counted, *measured, str(row["verdict"])))
    headings = (
        "cell", "risk rule", "plans", "per", "asked [%]", "violated", "runs", "rate [%]", "95 % interval",
        "rate over asked", "verdict",
    )  # fmt: skip
    note = (
        "A planned step is violated where, at its instant, a vehicle in the planned lane was nearer than the safe "
        "distance. Intervals: Clopper and Pearson, widened by how alike the plans of one run are. The rule individual "
        "claims less than a rate per plan; plans that are not optimal claim nothing."
    )
    frame = audit.rates.rename(columns={"cell_label": "cell"})[_COLUMNS]
    return StudyTable(
        "risk", "Violations of the safe distance per planned step, plan and run", frame, headings, tuple(rows), note
    )


def audit_sentences(audit: StudyAudit) -> Iterator[str]:
    """Yield what the audit found of plans, then what it could not find."""
    plans = audit.plans
    words = {
        Verdict.VIOLATED: "took more risk than asked",
        Verdict.CONSISTENT: "took about the risk asked",
        Verdict.CONSERVATIVE: "took less than half the risk asked",
        Verdict.TOO_FEW: "planned too few times to tell the risk taken",
    }
    for outcome, told in words.items():
        cells = plans[plans["verdict"] == outcome]
        if len(cells):
            named = [f"{row.cell_label} ({number(100 * row.violation_rate)} % of its plans)" for row in each(cells)]
            yield f"{told[0].upper()}{told[1:]}: {listed(named)}."
    yield from audit.notes
