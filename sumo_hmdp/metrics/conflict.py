"""Conflicts across the ego's path: bodies that would meet, lane changes that others pay for, distances below RSS."""

from dataclasses import dataclass

import numpy as np

from sumo_hmdp.metrics.registry import Better, Metric, RunData
from sumo_hmdp.metrics.safety import at_most_zero
from sumo_hmdp.metrics.trace import BoolArray, FloatArray, Trace, greatest, least

# How far ahead bodies are moved at present speed and heading [s].
TTC2D_HORIZON = 3.0
NEAR_MISS = 1.0
# How long after a lane change its follower's braking counts [s].
BRAKING_TIME = 5.0


@dataclass(frozen=True)
class RssLimits:
    """The limits of Responsibility-Sensitive Safety.

    Attributes:
        response_time: rho [s].
        accel_max: along the road during the response [m/s2].
        brake_min: along the road after it, a positive magnitude [m/s2].
        brake_max: of the vehicle in front [m/s2].
        side_accel_max: across the road during the response [m/s2].
        side_brake_min: across the road after it [m/s2].
        side_margin: least distance across the road [m].
    """

    response_time: float = 0.5
    accel_max: float = 2.0
    brake_min: float = 4.0
    brake_max: float = 8.0
    side_accel_max: float = 0.2
    side_brake_min: float = 0.8
    side_margin: float = 0.1


RSS = RssLimits()


def ttc2d(trace: Trace) -> FloatArray:
    """Return when each body would meet the ego's at present speeds and headings, shape (T, V) [s].

    Two rectangles overlap while their shadows overlap on all four edge directions. Each shadow is passed in an
    interval of time, so that the first moment common to all four is exact. Inf where there is none up to the horizon.
    """
    result: FloatArray = np.where(np.isnan(trace.others.x), np.nan, np.inf)
    ego, others = trace.ego, trace.others
    reach = ego.length + others.length + ego.width + others.width + TTC2D_HORIZON * (ego.speed + others.speed)
    row, column = np.nonzero(np.hypot(others.x - ego.x, others.y - ego.y) < reach)

    def of_ego(array: FloatArray) -> FloatArray:
        return np.asarray(array[row, 0])

    def of_other(array: FloatArray) -> FloatArray:
        return np.asarray(array[row, column])

    cos_a, sin_a = np.cos(of_ego(ego.heading)), np.sin(of_ego(ego.heading))
    cos_b, sin_b = np.cos(of_other(others.heading)), np.sin(of_other(others.heading))
    half_a, half_b = of_ego(ego.length) / 2, of_other(others.length) / 2
    side_a, side_b = of_ego(ego.width) / 2, of_other(others.width) / 2
    dx = (of_other(others.x) - half_b * cos_b) - (of_ego(ego.x) - half_a * cos_a)
    dy = (of_other(others.y) - half_b * sin_b) - (of_ego(ego.y) - half_a * sin_a)
    vx = of_other(others.speed) * cos_b - of_ego(ego.speed) * cos_a
    vy = of_other(others.speed) * sin_b - of_ego(ego.speed) * sin_a
    start, end = np.zeros(len(row)), np.full(len(row), TTC2D_HORIZON)
    for ux, uy in ((cos_a, sin_a), (-sin_a, cos_a), (cos_b, sin_b), (-sin_b, cos_b)):
        shadow = half_a * np.abs(cos_a * ux + sin_a * uy) + side_a * np.abs(cos_a * uy - sin_a * ux)
        shadow += half_b * np.abs(cos_b * ux + sin_b * uy) + side_b * np.abs(cos_b * uy - sin_b * ux)
        offset, rate = dx * ux + dy * uy, vx * ux + vy * uy
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            first = np.where(rate == 0, -np.inf, (-np.sign(rate) * shadow - offset) / rate)
            last = np.where(rate == 0, np.inf, (np.sign(rate) * shadow - offset) / rate)
        never = (rate == 0) & (np.abs(offset) >= shadow)
        start, end = np.maximum(start, first), np.where(never, -np.inf, np.minimum(end, last))
    result[row, column] = np.where(start < end, start, np.inf)
    return result


def near_misses(run: RunData) -> float:
    """Return how often a vehicle's 2-D time to collision fell below `NEAR_MISS`; a contact is at least one."""
    near = ttc2d(run.trace) < NEAR_MISS
    return max(float(np.sum(near[:1]) + np.sum(near[1:] & ~near[:-1])), float(run.contact))


def rss_unsafe(trace: Trace, limits: RssLimits = RSS) -> BoolArray:
    """Tell where both the distance along and that across the road are below those of RSS, shape (T, V)."""
    rear_speed = np.where(trace.ahead, trace.ego.speed, trace.others.speed)
    front_speed = np.where(trace.ahead, trace.others.speed, trace.ego.speed)
    rho = limits.response_time
    along = rear_speed * rho + limits.accel_max * rho**2 / 2
    along += (rear_speed + rho * limits.accel_max) ** 2 / (2 * limits.brake_min)
    along -= front_speed**2 / (2 * limits.brake_max)
    # Sideways speeds toward each other: both bodies may drift together for rho, then brake sideways.
    toward = np.where(trace.others.y >= trace.ego.y, 1.0, -1.0)
    across = limits.side_margin + np.maximum(
        _drift(toward * trace.ego.speed * np.sin(trace.ego.heading), limits)
        + _drift(-toward * trace.others.speed * np.sin(trace.others.heading), limits),
        0.0,
    )
    return np.asarray((trace.length_gap < np.maximum(along, 0.0)) & (trace.side_gap < across))


def _drift(speed: FloatArray, limits: RssLimits) -> FloatArray:
    """Return how far a body drifts toward the other until it stands sideways [m]."""
    reached = speed + limits.response_time * limits.side_accel_max
    return (speed + reached) / 2 * limits.response_time + reached * np.abs(reached) / (2 * limits.side_brake_min)


def entries(trace: Trace) -> list[tuple[int, int]]:
    """List the ego's lane changes with their new followers.

    Returns:
        (index of the first instant in the new lane, index of the nearest vehicle behind in it), by time; lane changes
        without such a follower are left out.
    """
    lane = trace.ego.lane[:, 0]
    found = []
    for index in (np.flatnonzero(np.diff(lane) != 0) + 1).tolist():
        behind = (trace.others.lane[index] == lane[index]) & ~trace.ahead[index]
        if behind.any():
            found.append((index, int(np.argmax(np.where(behind, trace.others.x[index], -np.inf)))))
    return found


def post_encroachment(run: RunData) -> float:
    """Return the smallest time between the ego's rear leaving a point and its new follower's front reaching it [s]."""
    trace = run.trace
    times = [float("nan")]
    for index, follower in entries(trace):
        point = trace.ego.x[index, 0] - trace.ego.length[index, 0]
        x = trace.others.x[index:, follower]
        there = np.flatnonzero(x >= point)
        if not len(there):
            times.append(float("inf"))
        elif there[0] == 0:
            times.append(0.0)
        else:
            late = index + int(there[0])
            early = late - 1
            x_early, x_late = trace.others.x[early, follower], trace.others.x[late, follower]
            share = (point - x_early) / (x_late - x_early) if np.isfinite(x_early) else 1.0
            times.append(float(trace.time[early] + share * (trace.time[late] - trace.time[early]) - trace.time[index]))
    return least(np.array(times))


def braking_imposed(run: RunData) -> float:
    """Return the strongest deceleration of a new follower after a lane change of the ego [m/s2]."""
    trace = run.trace
    braking = [float("nan")]
    for index, follower in entries(trace):
        during = (trace.time >= trace.time[index]) & (trace.time <= trace.time[index] + BRAKING_TIME)
        braking.append(greatest(np.maximum(-trace.others.accel[during, follower], 0.0)))
    return greatest(np.array(braking))


_FOLLOWER = "the ego's front entered a lane with a vehicle behind it in it"

CONFLICT = (
    Metric(
        "ttc2d_min_s", "smallest 2-D time to collision", "s", Better.HIGHER,
        "smallest time until the oriented bodies of the ego and another vehicle meet at present speed and heading; 0 "
        "in a run with a contact",
        "another vehicle is in the run", f"inf beyond {TTC2D_HORIZON:g} s; the minimum of a longer run is lower", 1.0,
        "", at_most_zero(ttc2d),
    ),
    Metric(
        "near_miss_count", "near misses", "", Better.LOWER,
        f"how often the 2-D time to collision with a vehicle fell below {NEAR_MISS:g} s; contacts count as well",
        threshold=NEAR_MISS, reference="high risk below 1 s: Sayed and Zein, Transp. Plan. Technol. 22 (1999)",
        compute=near_misses,
    ),
    Metric(
        "pet_min_s", "smallest post-encroachment time", "s", Better.HIGHER,
        "over the ego's lane changes, the time from its front entering the lane until the new follower's front reaches "
        "the point where the ego's rear was then; 0 where it is past it",
        _FOLLOWER, "inf where the follower does not get there within the run", None,
        "Allen, Shin and Cooper, Transp. Res. Rec. 667 (1978)", post_encroachment,
    ),
    Metric(
        "braking_imposed_max_mps2", "strongest braking imposed", "m/s2", Better.LOWER,
        f"strongest deceleration of the new follower within {BRAKING_TIME:g} s after the ego's front entered its lane",
        _FOLLOWER, "a run that ends earlier shows less", None, "", braking_imposed,
    ),
    Metric(
        "rss_violation_share", "share of time below RSS", "1", Better.LOWER,
        "share of instants at which the distances to a vehicle along and across the road are both below those of RSS "
        f"(response {RSS.response_time} s; along: {RSS.accel_max}, {RSS.brake_min} and {RSS.brake_max} m/s2; across: "
        f"{RSS.side_accel_max} and {RSS.side_brake_min} m/s2, margin {RSS.side_margin} m)",
        reference="Shalev-Shwartz, Shammah and Shashua, arXiv:1708.06374 (2017)",
        compute=lambda run: float(rss_unsafe(run.trace).any(axis=1).mean()),
    ),
)  # fmt: skip
