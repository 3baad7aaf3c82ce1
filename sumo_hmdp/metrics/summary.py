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
    audit: AuditSettings | None = None,
    *,
    contact: bool = False,
    front_contact: bool = False,
    ended_in_contact: bool = False,
) -> dict[str, float | int | None]:
    """Summarise one run; a number that is not defined is None.

    Args:
        steps: the `steps` table of one run with all vehicles.
        decisions: its `decisions` table.
        desired_speed: of the ego, None where its planner has none [m/s].
        audit: what its plans were asked for, None for a planner without a safe distance.
        contact: whether the ego met another body in the last step.
        front_contact: whether it did so with its front.
        ended_in_contact: whether a contact ended it.
    """
    kept = None if audit is None or decisions.empty else kept_distance(audit, decisions)
    trace = trace_of(steps if audit is None else with_intents(steps, audit.road, audit.told))
    return METRICS.evaluate(
        RunData(
            trace=trace,
            decisions=decisions,
            desired_speed=desired_speed,
            contact=contact,
            front_contact=front_contact,
            kept=kept,
            steps=steps,
            audit=audit,
            ended_in_contact=ended_in_contact,
        )
    )
