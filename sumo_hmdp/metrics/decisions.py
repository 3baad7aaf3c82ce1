"""What the decisions of a run were like."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.domain.plan import Status
from sumo_hmdp.metrics.registry import Better, Metric, RunData

NAN = float("nan")


def status_share(status: Status) -> Callable[[RunData], float]:
    """Return a function that computes the share of a status; a rule's decisions are neither optimal nor a departure."""

    def share(run: RunData) -> float:
        planned = int((run.decisions["status"] != Status.RULE).sum())
        return int((run.decisions["status"] == status).sum()) / planned if planned else NAN

    return share


def _changes(run: RunData) -> NDArray[np.bool_]:
    return (run.decisions["lateral"] != "keep").to_numpy(dtype=bool)


def _first_change(run: RunData) -> float:
    times = run.decisions["time_s"].to_numpy(dtype=np.float64)[_changes(run)]
    return float(times[0]) if len(times) else NAN


def _solve_time(quantile: float) -> Callable[[RunData], float]:
    def compute(run: RunData) -> float:
        known = run.decisions["solve_time_ms"].dropna().to_numpy(dtype=np.float64)
        return float(np.quantile(known, quantile)) if len(known) else NAN

    return compute


def _metric(
    name: str, label: str, unit: str, better: Better, definition: str, defined: str, compute: Callable[[RunData], float]
) -> Metric:
    return Metric(name, label, unit, better, definition, defined, compute=compute, of_decisions=True)


_CONTACTS = (
    "vehicles whose body the ego's meets in the last step of the run, through which all bodies move evenly; touching "
    "is none (docs/contact-rules.md)"
)
_DISAGREEMENTS = "vehicles with which the bodies or SUMO's own list have a contact, but not both; not in traffic"
_TIMED = "a decision's time is known"
_PLANNED = "a decision is not a rule's"

_SHARES = {
    Status.OPTIMAL: (
        "share of optimal decisions", "share of decisions with the best plan that keeps every distance",
    ),
    Status.INCUMBENT: (
        "share of incumbents", "share of decisions that the deadline ended with the best plan known by then",
    ),
    Status.RELAXED: ("share of relaxed decisions", "share of decisions with a plan of least violation"),
    Status.FALLBACK: ("share of fallbacks", "share of decisions to brake in the lane"),
}  # fmt: skip

DECISIONS = (
    _metric(
        "lane_change_count", "lane changes", "", Better.NEITHER, "decisions to change the lane, aborts included",
        "always", lambda run: float(_changes(run).sum()),
    ),
    _metric(
        "lane_change_first_s", "time of the first lane change", "s", Better.NEITHER,
        "time of the first decision to change the lane", "there is one", _first_change,
    ),
    _metric(
        "decision_count", "decisions", "", Better.NEITHER, "decisions of the run", "always",
        lambda run: float(len(run.decisions)),
    ),
    *(
        _metric(
            f"{status}_share", label, "1", Better.HIGHER if status is Status.OPTIMAL else Better.LOWER, definition,
            _PLANNED, status_share(status),
        )
        for status, (label, definition) in _SHARES.items()
    ),
    _metric(
        "violation_max_m", "largest violation planned", "m", Better.LOWER,
        "largest total violation of the distances by a plan", "there is a plan",
        lambda run: float(run.decisions["violation_m"].max()) if run.decisions["violation_m"].notna().any() else NAN,
    ),
    _metric(
        "solve_time_median_ms", "median decision time", "ms", Better.LOWER, "median time of predict, carve and solve",
        _TIMED, _solve_time(0.5),
    ),
    _metric(
        "solve_time_p99_ms", "99 % quantile of the decision time", "ms", Better.LOWER,
        "99 % quantile, between order statistics linearly", _TIMED, _solve_time(0.99),
    ),
    _metric(
        "solve_time_max_ms", "longest decision time", "ms", Better.LOWER, "longest time of predict, carve and solve",
        _TIMED, _solve_time(1.0),
    ),
    # Written down while the run is recorded.
    Metric(
        "contact_first_s", "time of the first contact", "s", Better.NEITHER,
        "when the bodies met, within the last step of the run", "there is one",
    ),
    *(
        Metric(name, label, "", Better.LOWER, definition)
        for name, label, definition in (
            ("contact_count", "contacts", _CONTACTS),
            ("contact_at_fault_count", "contacts at fault", "those in which the ego moved into the other"),
            ("sumo_contact_count", "contacts by SUMO", "instants at which its own list names the ego; not in traffic"),
            ("contact_disagreement_count", "contacts on one list only", _DISAGREEMENTS),
            ("tracking_failure_count", "tracking failures", "steps whose tracking problem was not solved"),
            ("deadline_miss_count", "deadline misses", "decisions that took longer than the period"),
        )
    ),
)  # fmt: skip
