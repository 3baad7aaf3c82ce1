"""The risk that one run took: how often its plans fell short of the safe distance (docs/guarantees.md)."""

from collections.abc import Callable

from sumo_hmdp.metrics.registry import Better, Metric, RunData
from sumo_hmdp.metrics.risk_audit import KEEPING, trials_of


def _rate(unit: str) -> Callable[[RunData], float]:
    def compute(run: RunData) -> float:
        audited = run.audited
        if audited is None or audited.empty:
            return float("nan")
        kept = audited[audited["status"].isin(KEEPING)]
        trials = trials_of(kept.assign(cut_by_contact=run.ended_in_contact), unit)
        return float(trials["violated"].astype(float).mean()) if len(trials) else float("nan")

    return compute


RISK = tuple(
    Metric(
        f"{unit}_violation_rate", f"violation rate per {unit}", "1", Better.LOWER,
        f"share of {what} a vehicle that the plan kept a distance to then came nearer than the safe distance",
        defined="the planner keeps a safe distance, and a plan that claims to (optimal, incumbent) was seen to its end",
        compute=_rate(unit), of_decisions=True,
    )
    for unit, what in (("plan", "plans at any step of which"), ("step", "planned steps at which"))
)  # fmt: skip
