"""What the head of a replay page says about the run: a few numbers, each from the recorded steps."""

import statistics
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sumo_hmdp.domain.maneuver import Lateral
from sumo_hmdp.domain.plan import Status


@dataclass(frozen=True)
class SmallestGap:
    """The smallest bumper-to-bumper gap between the ego and a vehicle in its path.

    Attributes:
        gap_m: negative where the two overlap [m].
        time_s: when [s].
        vehicle_id: to whom.
        ahead: whether that vehicle is ahead of the ego.
    """

    gap_m: float
    time_s: float
    vehicle_id: str
    ahead: bool


@dataclass(frozen=True)
class Summary:
    """The run in numbers; None stands for what the run did not record.

    Attributes:
        distance_m: along the road, from the ego's first to its last record [m].
        speed_mean_mps: mean over the ego's records [m/s].
        smallest_gap: over all instants, None where no vehicle was ever in the ego's path.
        lane_changes: (time [s], new lane, whether it lies to the left) of each decision to change the lane.
        statuses: how many decisions had each status.
        solve_time_median_ms: over all decisions [ms].
        solve_time_max_ms: over all decisions [ms].
    """

    distance_m: float | None
    speed_mean_mps: float | None
    smallest_gap: SmallestGap | None
    lane_changes: tuple[tuple[float, int, bool], ...]
    statuses: dict[str, int]
    solve_time_median_ms: float | None
    solve_time_max_ms: float | None


def summarize(data: Mapping[str, Any]) -> Summary:
    """Summarize the data of a replay page.

    Args:
        data: as `replay_data` returns it.

    Returns:
        The summary; a run without an ego has no distance, speed or gap.
    """
    ego = next((vehicle for vehicle in data["vehicles"] if vehicle["id"] == data["ego_id"]), None)
    x = [value for value in ego["x_m"] if value is not None] if ego else []
    speeds = [value for value in ego["speed_mps"] if value is not None] if ego else []
    solve_times = [d["solve_time_ms"] for d in data["decisions"] if d["solve_time_ms"] is not None]
    return Summary(
        distance_m=x[-1] - x[0] if x else None,
        speed_mean_mps=statistics.fmean(speeds) if speeds else None,
        smallest_gap=_smallest_gap(data, ego) if ego else None,
        lane_changes=lane_changes(data["decisions"]),
        statuses=_statuses(data),
        solve_time_median_ms=statistics.median(solve_times) if solve_times else None,
        solve_time_max_ms=max(solve_times, default=None),
    )


def _smallest_gap(data: Mapping[str, Any], ego: Mapping[str, Any]) -> SmallestGap | None:
    gaps = [
        gap
        for other in data["vehicles"]
        if other is not ego
        for frame in range(max(ego["first"], other["first"]), min(_end(ego), _end(other)))
        if (gap := _gap(ego, other, frame, data["times_s"][frame])) is not None
    ]
    return min(gaps, key=lambda gap: (gap.gap_m, gap.time_s, gap.vehicle_id), default=None)


def _gap(ego: Mapping[str, Any], other: Mapping[str, Any], frame: int, time: float) -> SmallestGap | None:
    """Return the gap at one frame as `gap_min_m` defines it; None where the bodies do not overlap across the road."""
    i, j = frame - ego["first"], frame - other["first"]
    ego_x, other_x, ego_y, other_y = ego["x_m"][i], other["x_m"][j], ego["y_m"][i], other["y_m"][j]
    if None in (ego_x, other_x, ego_y, other_y) or abs(other_y - ego_y) >= (ego["width_m"] + other["width_m"]) / 2:
        return None
    if other_x >= ego_x:
        return SmallestGap(other_x - other["length_m"] - ego_x, time, other["id"], ahead=True)
    return SmallestGap(ego_x - ego["length_m"] - other_x, time, other["id"], ahead=False)


def lane_changes(decisions: Sequence[Mapping[str, Any]]) -> tuple[tuple[float, int, bool], ...]:
    """Return (time [s], new lane, whether it lies to the left) of each decision to change the lane.

    These are the changes that `lane_change_count` counts: one that is given up counts, and so does the way back.
    """
    return tuple(
        (one["time_s"], one["lane"], one["lateral"] == Lateral.LEFT.label)
        for one in decisions
        if one["lateral"] in {Lateral.LEFT.label, Lateral.RIGHT.label}
    )


def _statuses(data: Mapping[str, Any]) -> dict[str, int]:
    """Count the decisions of each status, from the best status to the worst, unknown ones last."""
    order = [status.value for status in Status]
    counts = Counter(decision["status"] for decision in data["decisions"])
    known = [status for status in order if status in counts]
    return {status: counts[status] for status in [*known, *sorted(set(counts) - set(known))]}


def _end(vehicle: Mapping[str, Any]) -> int:
    return int(vehicle["first"]) + len(vehicle["x_m"])
