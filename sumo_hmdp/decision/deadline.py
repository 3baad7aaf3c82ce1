"""One deadline for a whole decision: every solve in it gets what is left of it."""

import time
from dataclasses import dataclass

import numpy as np

from sumo_hmdp.decision.problem import PlannerSettings

# A solve always gets this much, so that it can find out that it is late [s].
LEAST = 1e-3


@dataclass(frozen=True)
class Deadline:
    """When a decision must be there.

    Attributes:
        end: by `time.perf_counter` [s], infinite where no deadline is enforced.
    """

    end: float = np.inf

    @classmethod
    def of(cls, settings: PlannerSettings, started: float) -> "Deadline":
        """Return the deadline of a decision that began at `started`, by `time.perf_counter` [s]: one period later."""
        return cls(started + settings.period if settings.enforce_deadline else np.inf)

    def left(self) -> float:
        """Return how long a solve may take from now on [s]."""
        return max(self.end - time.perf_counter(), LEAST)
