"""The numbers of one run, computed from its `steps` and `decisions` tables (docs/metrics.md)."""

import pandas as pd

from sumo_hmdp.metrics.catalogue import METRICS
from sumo_hmdp.metrics.decision_tables import with_intents
from sumo_hmdp.metrics.planned_distances import AuditSettings
from sumo_hmdp.metrics.registry import RunData
from sumo_hmdp.metrics.shortfall import kept_distance
from sumo_hmdp.metrics.trace import trace_of


def run_metrics(
    steps: pd.DataFrame,
    decisions: pd.DataFrame,
    desired_speed: float | None = None,
    asked: AuditSettings | None = None,
    *,
    contact: bool = False,
    front_contact: bool = False,
) -> dict[str, float | int | None]:
    """Summarise one run; a number that is not defined is None.

    Args:
        steps: the `steps` table of one run with all vehicles.
        decisions: its `decisions` table.
        desired_speed: of the ego, None where its planner has none [m/s].
        asked: which distances its plans were asked for, None for a planner without any.
        contact: whether the ego met another body in the last step.
        front_contact: whether it did so with its front.
    """
    kept = None if asked is None or decisions.empty else kept_distance(asked, decisions)
    trace = trace_of(steps if asked is None else with_intents(steps, asked.road, asked.told))
    return METRICS.evaluate(RunData(trace, decisions, desired_speed, contact, front_contact, kept))
