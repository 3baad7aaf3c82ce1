"""How well the ego gets along."""

import numpy as np

from sumo_hmdp.metrics.registry import Better, Metric, RunData
from sumo_hmdp.metrics.trace import Trace


def time_loss(run: RunData) -> float:
    """Return the time lost by driving slower than desired [s], NaN where no speed is desired."""
    if not run.desired_speed:
        return float("nan")
    missing = np.maximum(1.0 - run.trace.ego.speed[:, 0] / run.desired_speed, 0.0)
    return float(np.sum(run.trace.duration * missing))


def aborts(trace: Trace) -> int:
    """Return how many lane changes were given up: the intention went back before the front was over the line."""
    intended, lane = trace.ego.intended_lane[:, 0], trace.ego.lane[:, 0]
    count, start = 0, None
    for index in (np.flatnonzero(np.diff(intended) != 0) + 1).tolist():
        arrived = start is not None and bool(np.any(lane[start:index] == intended[index - 1]))
        if start is not None and not arrived and intended[index] == intended[start - 1]:
            count, start = count + 1, None
        else:
            start = index
    return count


EFFICIENCY = (
    Metric(
        "duration_s", "duration", "s", Better.NEITHER, "time of the last instant", "the run has an instant",
        "a contact or a failure ends a run early", compute=lambda run: float(run.trace.time[-1]),
    ),
    Metric(
        "distance_m", "distance", "m", Better.HIGHER, "x at the last instant less x at the first",
        "the run has an instant", "shorter where a run ends early",
        compute=lambda run: float(run.trace.ego.x[-1, 0] - run.trace.ego.x[0, 0]),
    ),
    Metric(
        "speed_mean_mps", "mean speed", "m/s", Better.HIGHER, "mean of the ego's speed over the instants",
        "the run has an instant", compute=lambda run: float(np.mean(run.trace.ego.speed)),
    ),
    Metric(
        "time_loss_s", "time loss", "s", Better.LOWER,
        "integral over time of 1 - speed / desired speed, where that is positive",
        "the planner desires a speed above 0", "smaller where a run ends early",
        reference="SUMO's timeLoss", compute=time_loss,
    ),
    Metric(
        "lane_change_abort_count", "lane changes given up", "", Better.LOWER,
        "how often the intended lane went back to the one before, while the ego's front had not been in the other",
        compute=lambda run: float(aborts(run.trace)),
    ),
    Metric(
        "overtaking_lane_share", "share of time in the leftmost lane", "1", Better.NEITHER,
        "share of instants with the ego's front in lane 1", "the run has an instant",
        compute=lambda run: float(np.mean(run.trace.ego.lane == 1)),
    ),
)  # fmt: skip
