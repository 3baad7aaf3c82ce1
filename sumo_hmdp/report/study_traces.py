"""The cells of a study whose plans can be looked up in what happened: those that keep a distance and all vehicles."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import pandas as pd

from sumo_hmdp.domain.scene import EGO_ID
from sumo_hmdp.errors import InputError
from sumo_hmdp.metrics.planned_distances import AuditSettings, audit_run, audit_settings
from sumo_hmdp.report.study_data import StudyData
from sumo_hmdp.report.study_table import listed


@dataclass(frozen=True)
class TracedCell:
    """One cell with all that its audit needs.

    Attributes:
        label: of the cell.
        rule: how the risk level is shared, empty where the planner does not say.
        settings: what its plans were asked for.
        decisions: of the runs that kept all vehicles.
        steps: of these.
    """

    label: str
    rule: str
    settings: AuditSettings
    decisions: pd.DataFrame
    steps: pd.DataFrame

    @cached_property
    def traces(self) -> dict[str, pd.DataFrame]:
        """The steps of each run."""
        return {str(run_id): steps for run_id, steps in self.steps.groupby("run_id")}

    @property
    def run_ids(self) -> tuple[str, ...]:
        """The runs with decisions, in the order of `runs`."""
        return tuple(sorted(self.decisions["run_id"].unique()))

    def runs(self) -> Iterator[tuple[str, pd.DataFrame, pd.DataFrame]]:
        """Yield the name of each run with its decisions and steps."""
        for run_id, decisions in self.decisions.groupby("run_id"):
            yield str(run_id), decisions, self.traces.get(str(run_id), self.steps.iloc[:0])

    @cached_property
    def planned(self) -> tuple[pd.DataFrame, ...]:
        """The audit of each run's plans, in the order of `runs`; rates and causes both rest on it."""
        return tuple(audit_run(decisions, steps, self.settings) for _, decisions, steps in self.runs())


def traced_cells(data: StudyData) -> tuple[tuple[TracedCell, ...], tuple[str, ...]]:
    """Return the cells that can be audited, and what cannot be, with the reason."""
    notes: list[str] = []
    untraced: list[str] = []
    found = []
    kept = _traced(data)
    for cell in data.cells:
        try:
            settings = audit_settings(cell.manifest)
        except InputError as error:
            notes.append(f"{cell.label} cannot be audited: {'; '.join(str(problem) for problem in error.problems)}.")
            continue
        ran = data.ended.loc[data.ended["cell"] == cell.id, "run_id"]
        if settings is None or ran.empty:
            continue
        runs = [run for run in ran if run in kept]
        if len(runs) < len(ran):
            untraced.append(cell.label if not runs else f"{len(ran) - len(runs)} of {len(ran)} runs of {cell.label}")
        if runs:
            decisions = data.decisions[data.decisions["run_id"].isin(runs)]
            steps = data.steps[data.steps["run_id"].isin(runs)]
            rule = cell.manifest["parameters"].get("risk_allocation")
            found.append(TracedCell(cell.label, "" if rule is None else str(rule), settings, decisions, steps))
    if untraced:
        notes.append(
            f"The risk that was taken cannot be audited for {listed(untraced)}: the study kept no traces of the other "
            "vehicles (trace: none or ego). Run it again with trace: all."
        )
    return tuple(found), tuple(notes)


def _traced(data: StudyData) -> set[str]:
    """Return the runs that kept all vehicles, or never saw another one."""
    others = set(data.steps.loc[data.steps["vehicle_id"] != EGO_ID, "run_id"])
    alone = set(data.steps["run_id"]) - set(data.decisions.loc[data.decisions["branch_count"] > 0, "run_id"])
    return others | alone
