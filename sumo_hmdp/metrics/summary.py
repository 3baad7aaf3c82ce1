"""The numbers of one run, computed from its `steps` and `decisions` tables (docs/metrics.md)."""

import pandas as pd

from sumo_hmdp.metrics.catalogue import METRICS
from sumo_hmdp.metrics.planned_distances import AuditSettings
from sumo_hmdp.metrics.registry import RunData
from sumo_hmdp.metrics.trace import trace_of


def run_metrics(
    steps: pd.DataFrame,
    decisions: pd.DataFrame,
    desired_speed: float | None = None,
    audit: AuditSettings | None = None,
    *,
    ended_in_contact: bool = False,
) -> dict[str, float | int | None]:
    """Summarise one run; a number that is not defined is None.

    Args:
        steps: the `steps` table of one run with all vehicles.
        decisions: its `decisions` table.
        desired_speed: of the ego, None where its planner has none [m/s].
        audit: what its plans were asked for, None for a planner without a safe distance.
        ended_in_contact: whether a contact ended it.
    """
    return METRICS.evaluate(RunData(trace_of(steps), decisions, desired_speed, steps, audit, ended_in_contact))
