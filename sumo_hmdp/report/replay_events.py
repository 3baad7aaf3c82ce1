"""What a replay marks on its time line besides decisions: near misses and contacts, as the metrics count them."""

from typing import TYPE_CHECKING, Any

import numpy as np

from sumo_hmdp.domain.scene import EGO_ID
from sumo_hmdp.metrics.conflict import NEAR_MISS, ttc2d
from sumo_hmdp.metrics.trace import BoolArray, trace_of

if TYPE_CHECKING:
    import pandas as pd


def conflicts(steps: "pd.DataFrame") -> list[dict[str, Any]]:
    """List the ego's near misses and contacts, by time.

    A near miss begins where a vehicle's 2-D time to collision falls below `NEAR_MISS`, a contact where the bodies
    overlap, that is where it is 0.

    Args:
        steps: one row per instant and vehicle, in any order.

    Returns:
        `time_s` and `until_s` (the last such instant), `kind` and `vehicle_id` of each.
    """
    if not len(steps) or not (steps["vehicle_id"] == EGO_ID).any():
        return []
    trace = trace_of(steps)
    times = ttc2d(trace)
    found = [
        {"time_s": float(trace.time[first]), "until_s": float(trace.time[last]), "kind": kind, "vehicle_id": name}
        for kind, hit in (("near_miss", times < NEAR_MISS), ("contact", times == 0.0))
        for name, column in zip(trace.ids, hit.T, strict=True)
        for first, last in _stretches(column)
    ]
    return sorted(found, key=lambda one: (one["time_s"], one["kind"], one["vehicle_id"]))


def _stretches(hit: BoolArray) -> list[tuple[int, int]]:
    """Return the first and the last index of every unbroken stretch of hits."""
    edges = np.diff(np.concatenate(([False], hit, [False])).astype(np.int8))
    return list(zip(np.flatnonzero(edges == 1).tolist(), (np.flatnonzero(edges == -1) - 1).tolist(), strict=True))
