"""All metrics of a run by name: what each means, and the function that computes it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from types import MappingProxyType

import pandas as pd

from sumo_hmdp.errors import InputError
from sumo_hmdp.metrics.planned_distances import AuditSettings, audit_run
from sumo_hmdp.metrics.shortfall import KeptDistance
from sumo_hmdp.metrics.trace import Trace
from sumo_hmdp.validation import nearest


class Better(StrEnum):
    """Which direction is better."""

    HIGHER = "higher"
    LOWER = "lower"
    NEITHER = "-"


@dataclass(frozen=True)
class RunData:
    """What the metrics of one run are computed from.

    Attributes:
        trace: the run as arrays.
        decisions: its `decisions` table.
        desired_speed: of the ego, None where its planner has none [m/s].
        contact: whether the ego met another body in the last step.
        front_contact: whether it did so with its front.
        kept: the distances that its planner kept, None for a planner without any.
        steps: its `steps` table with all vehicles, None where its plans are not audited.
        audit: what its plans were asked for, None for a planner without a safe distance.
        ended_in_contact: whether a contact ended it.
    """

    trace: Trace
    decisions: pd.DataFrame
    desired_speed: float | None = None
    contact: bool = False
    front_contact: bool = False
    kept: KeptDistance | None = None
    steps: pd.DataFrame | None = None
    audit: AuditSettings | None = None
    ended_in_contact: bool = False

    @cached_property
    def audited(self) -> pd.DataFrame | None:
        """Its planned steps beside what happened, None where nothing can be looked up."""
        if self.audit is None or self.steps is None or self.decisions.empty:
            return None
        return audit_run(self.decisions, self.steps, self.audit)


@dataclass(frozen=True)
class Metric:
    """One metric of a run.

    Attributes:
        name: of its column; ends in its unit.
        label: in a sentence.
        unit: as printed; empty for none.
        better: direction.
        definition: the formula in words.
        defined: when it has a value; missing otherwise.
        censoring: where a value stands for more than was seen.
        threshold: where a conflict or discomfort begins, None without one.
        reference: where definition or threshold come from.
        compute: of a run with at least one instant; None where the recorder counts it.
        of_decisions: it is computed from the decisions alone.
    """

    name: str
    label: str
    unit: str
    better: Better
    definition: str
    defined: str = "always"
    censoring: str = ""
    threshold: float | None = None
    reference: str = ""
    compute: Callable[[RunData], float] | None = None
    of_decisions: bool = False

    @property
    def is_count(self) -> bool:
        """Whether it is a whole number, 0 where nothing happened."""
        return self.name.endswith("_count")


class Registry:
    """Metrics by name; refuses duplicates and unknown names."""

    def __init__(self) -> None:
        self._metrics: dict[str, Metric] = {}

    def add(self, metric: Metric) -> None:
        """Take a metric in.

        Raises:
            InputError: if there is one of this name.
        """
        if metric.name in self._metrics:
            raise InputError([f"metric {metric.name} must be registered once. Choose another name"])
        self._metrics[metric.name] = metric

    def get(self, name: str) -> Metric:
        """Return a metric.

        Raises:
            InputError: if there is none of this name.
        """
        if name not in self._metrics:
            raise InputError([f"metric must be a known one, got {name}: {nearest(name, self._metrics)}"])
        return self._metrics[name]

    @property
    def all(self) -> Mapping[str, Metric]:
        """All metrics by name, in the order in which they were added."""
        return MappingProxyType(self._metrics)

    def evaluate(self, run: RunData) -> dict[str, float | int | None]:
        """Compute every metric of a run that is computed; None where it is not defined."""
        values: dict[str, float | int | None] = {}
        for name, metric in self._metrics.items():
            if metric.compute is None:
                continue
            empty = not (metric.of_decisions or len(run.trace.time))
            value = (0 if metric.is_count else float("nan")) if empty else metric.compute(run)
            # NaN alone differs from itself.
            values[name] = int(value) if metric.is_count else (None if value != value else float(value))  # noqa: PLR0124
        return values
