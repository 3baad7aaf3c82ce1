"""How the ego's motion feels: root mean squares, and the share of time outside bounds taken from human driving."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sumo_hmdp.metrics.registry import Better, Metric, RunData
from sumo_hmdp.metrics.trace import FloatArray, Trace

# Rates of change are means over so long a time, and every quantity is looked at so often, whatever the step of a
# scenario [s]. Their bounds are those of nuPlan, which takes them from the slope over 15 samples at 10 Hz.
RATE_WINDOW = 1.0
TIME_BASE = 0.1

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
        of: returns it on the time base, shape (N,); empty where there are too few instants.
    """

    stem: str
    suffix: str
    unit: str
    label: str
    low: float
    high: float
    definition: str
    of: Callable[[Trace], FloatArray]


def on_time_base(values: FloatArray, time: FloatArray) -> FloatArray:
    """Return values every `TIME_BASE` from the first instant on, straight between the instants, shape (N,).

    Args:
        values: (T,) at the instants.
        time: (T,) of the instants [s].
    """
    return np.asarray(np.interp(_every(time[0], time[-1]), time, values), dtype=np.float64)


@dataclass(frozen=True)
class Rate:
    """A mean rate of change on the time base.

    Attributes:
        time: (N,) in the middle of what each mean is over [s].
        value: (N,) of the rate.
    """

    time: FloatArray
    value: FloatArray


def rate_of_change(values: FloatArray, time: FloatArray, window: float) -> Rate:
    """Return the mean rate of change over every window that lies within the times.

    So the rate is that of the motion and not of the step with which it was recorded, as long as steps are well below
    the window.

    Args:
        values: (T,) at the instants, straight between them.
        time: (T,) of the instants, at least two [s].
        window: of a mean [s], at most as long as the times.
    """
    first = _every(time[0], time[-1] - window)
    change = np.interp(first + window, time, values) - np.interp(first, time, values)
    return Rate(first + window / 2, change / window)


def _every(first: float, last: float) -> FloatArray:
    return np.asarray(first + TIME_BASE * np.arange(math.floor((last - first) / TIME_BASE + 1e-6) + 1))


def _window(time: FloatArray) -> float:
    """Return over how long rates are taken [s]: a rate of a rate must find two windows in a run."""
    return min(RATE_WINDOW, float(time[-1] - time[0]) / 2)


def jerk(trace: Trace) -> FloatArray:
    """Return the rate of the ego's acceleration, shape (N,) [m/s3]."""
    return rate_of_change(trace.ego.accel[:, 0], trace.time, _window(trace.time)).value


def _yaw(trace: Trace) -> Rate:
    return rate_of_change(np.unwrap(trace.ego.heading[:, 0]), trace.time, _window(trace.time))


def yaw_rate(trace: Trace) -> FloatArray:
    """Return the rate of the ego's heading, shape (N,) [rad/s]."""
    return _yaw(trace).value


def lateral_accel(trace: Trace) -> FloatArray:
    """Return the acceleration across the ego's heading, shape (N,) [m/s2]: speed times yaw rate."""
    yaw = _yaw(trace)
    return np.asarray(np.interp(yaw.time, trace.time, trace.ego.speed[:, 0]) * yaw.value, dtype=np.float64)


def yaw_accel(trace: Trace) -> FloatArray:
    """Return the rate of the yaw rate, shape (N,) [rad/s2]."""
    yaw = _yaw(trace)
    window = min(_window(trace.time), float(yaw.time[-1] - yaw.time[0]))
    return rate_of_change(yaw.value, yaw.time, window).value if window > 0.0 else np.zeros(0)


def _of_motion(quantity: Callable[[Trace], FloatArray]) -> Callable[[Trace], FloatArray]:
    """Return a quantity that is empty where there are not two instants."""
    return lambda trace: quantity(trace) if len(trace.time) > 1 else np.zeros(0)


QUANTITIES = (
    Quantity(
        "accel", "mps2", "m/s2", "acceleration", -4.05, 2.40, "acceleration along the heading, as recorded",
        lambda trace: on_time_base(trace.ego.accel[:, 0], trace.time),
    ),
    Quantity(
        "lateral_accel", "mps2", "m/s2", "lateral acceleration", -4.89, 4.89, "speed times yaw rate",
        _of_motion(lateral_accel),
    ),
    Quantity(
        "jerk", "mps3", "m/s3", "jerk", -4.13, 4.13, "mean rate of change of the acceleration along the heading",
        _of_motion(jerk),
    ),
    Quantity(
        "yaw_rate", "radps", "rad/s", "yaw rate", -0.95, 0.95, "mean rate of change of the heading",
        _of_motion(yaw_rate),
    ),
    Quantity(
        "yaw_accel", "radps2", "rad/s2", "yaw acceleration", -1.93, 1.93, "mean rate of change of the yaw rate",
        _of_motion(yaw_accel),
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
            f"root mean square over the time base; {quantity.definition}",
            defined,
            compute=rms,
        ),
        Metric(
            f"{quantity.stem}_outside_share",
            f"share of time with uncomfortable {quantity.label}",
            "1",
            Better.LOWER,
            f"share of the time base outside {bounds}",
            defined,
            threshold=quantity.high,
            reference=NUPLAN,
            compute=outside,
        ),
    )


COMFORT = tuple(metric for quantity in QUANTITIES for metric in _metrics(quantity))
