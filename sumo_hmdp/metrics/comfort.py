"""How the ego's motion feels: root mean squares, and the share of time outside bounds taken from human driving."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sumo_hmdp.metrics.registry import Better, Metric, RunData
from sumo_hmdp.metrics.trace import FloatArray, Trace

NUPLAN = "bounds of nuPlan's comfort metric: Caesar et al., arXiv:2106.11810 (2021)"


@dataclass(frozen=True)
class Quantity:
    """A quantity of the ego's motion with its comfortable range.

    Attributes:
        stem: of its columns.
        suffix: unit, as in column names.
        unit: as printed.
        label: in a sentence.
        low: lower bound.
        high: upper bound.
        definition: how it comes from the record.
        of: returns it for each instant, shape (T,); empty where there are too few instants.
    """

    stem: str
    suffix: str
    unit: str
    label: str
    low: float
    high: float
    definition: str
    of: Callable[[Trace], FloatArray]


def rate_of_change(values: FloatArray, time: FloatArray) -> FloatArray:
    """Return the time derivative by central differences, empty with fewer than two instants."""
    return np.asarray(np.gradient(values, time), dtype=np.float64) if len(time) > 1 else np.zeros(0)


def yaw_rate(trace: Trace) -> FloatArray:
    """Return the rate of the ego's heading, shape (T,) [rad/s]."""
    return rate_of_change(np.unwrap(trace.ego.heading[:, 0]), trace.time)


def lateral_accel(trace: Trace) -> FloatArray:
    """Return the acceleration across the ego's heading, shape (T,) [m/s2]: speed times yaw rate."""
    rate = yaw_rate(trace)
    return trace.ego.speed[: len(rate), 0] * rate


def yaw_accel(trace: Trace) -> FloatArray:
    """Return the rate of the yaw rate, shape (T,) [rad/s2]."""
    return rate_of_change(yaw_rate(trace), trace.time)


QUANTITIES = (
    Quantity(
        "accel", "mps2", "m/s2", "acceleration", -4.05, 2.40, "acceleration along the heading, as recorded",
        lambda trace: trace.ego.accel[:, 0],
    ),
    Quantity(
        "lateral_accel", "mps2", "m/s2", "lateral acceleration", -4.89, 4.89, "speed times yaw rate", lateral_accel
    ),
    Quantity(
        "jerk", "mps3", "m/s3", "jerk", -4.13, 4.13, "central differences of the acceleration along the heading",
        lambda trace: rate_of_change(trace.ego.accel[:, 0], trace.time),
    ),
    Quantity(
        "yaw_rate", "radps", "rad/s", "yaw rate", -0.95, 0.95, "central differences of the heading", yaw_rate
    ),
    Quantity(
        "yaw_accel", "radps2", "rad/s2", "yaw acceleration", -1.93, 1.93, "central differences of the yaw rate",
        yaw_accel,
    ),
)  # fmt: skip


def _metrics(quantity: Quantity) -> tuple[Metric, Metric]:
    def rms(run: RunData) -> float:
        values = quantity.of(run.trace)
        return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")

    def outside(run: RunData) -> float:
        values = quantity.of(run.trace)
        return float(np.mean((values < quantity.low) | (values > quantity.high))) if len(values) else float("nan")

    bounds = f"[{quantity.low:g}, {quantity.high:g}] {quantity.unit}"
    defined = "always" if quantity.stem == "accel" else "the run has two instants"
    return (
        Metric(
            f"{quantity.stem}_rms_{quantity.suffix}",
            f"root mean square of the {quantity.label}",
            quantity.unit,
            Better.LOWER,
            f"root mean square over the instants; {quantity.definition}",
            defined,
            compute=rms,
        ),
        Metric(
            f"{quantity.stem}_outside_share",
            f"share of time with uncomfortable {quantity.label}",
            "1",
            Better.LOWER,
            f"share of instants outside {bounds}",
            defined,
            threshold=quantity.high,
            reference=NUPLAN,
            compute=outside,
        ),
    )


COMFORT = tuple(metric for quantity in QUANTITIES for metric in _metrics(quantity))
