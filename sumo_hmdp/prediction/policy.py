"""Policies of surrounding vehicles: a distribution over admissible actions in every maneuver state."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.domain.maneuver import ACTIONS, ManeuverState, Mode, transition

Probabilities = tuple[float, float, float]

# A table sums to 1 up to what decimal fractions lose in binary.
SUM_TOLERANCE = 1e-9


@dataclass(frozen=True)
class Policy:
    """A policy pi(a | s) as one distribution over the lateral action times one over the NEXT mode.

    The product is masked by admissibility and renormalised (docs/formulation.md, eq. 3). The distribution over the
    lateral action may differ from one step of the horizon to the next
    (docs/formulation.md, eq. 45).

    Attributes:
        lateral: for each lane 1..n the probabilities of left, keep, right at the first step; each row sums to 1.
        longitudinal: probabilities that the next mode is decelerate, cruise, accelerate; sums to 1.
        later: tables like `lateral` of the steps after the first; the last one holds for all steps that remain. Empty
            where `lateral` holds over the whole horizon.
    """

    lateral: tuple[Probabilities, ...]
    longitudinal: Probabilities
    later: tuple[tuple[Probabilities, ...], ...] = ()

    def at_step(self, step: int) -> "Policy":
        """Return the policy of one step of the horizon, the same at every step.

        Args:
            step: 0 is the first.
        """
        if not self.later:
            return self
        tables = (self.lateral, *self.later)
        return replace(self, lateral=tables[min(step, len(self.later))], later=())


@dataclass(frozen=True)
class ScheduledPolicy:
    """A policy that changes at given times.

    Attributes:
        entries: (time [s] from which it holds, policy), by rising time; the first holds before its time too.
    """

    entries: tuple[tuple[float, Policy], ...]

    def at(self, time: float) -> Policy:
        """Return the policy that holds at a time [s]; a prediction keeps it over its whole horizon."""
        current = self.entries[0][1]
        for start, policy in self.entries:
            # Decision instants are multiples of the period in floating point.
            if start <= time + 1e-9:
                current = policy
        return current


@lru_cache(maxsize=4096)
def action_probabilities(policy: Policy) -> NDArray[np.float64]:
    """Tabulate pi(a | s) of the first step (docs/formulation.md, eq. 3).

    Args:
        policy: with one lateral row per lane.

    Returns:
        Probabilities, shape (lanes, 3, 9): lane - 1, mode + 1, index into `ACTIONS`. A row sums to 1, or is all
        zero where no admissible action has any probability.
    """
    lane_count = len(policy.lateral)
    table = np.zeros((lane_count, 3, len(ACTIONS)))
    for lane in range(1, lane_count + 1):
        for mode in Mode:
            for index, action in enumerate(ACTIONS):
                successor = transition(ManeuverState(lane, mode), action, lane_count)
                if successor is not None:
                    lateral = policy.lateral[lane - 1][action.lateral + 1]
                    table[lane - 1, mode + 1, index] = lateral * policy.longitudinal[successor.mode + 1]
    totals = table.sum(axis=2, keepdims=True)
    normalised = np.zeros_like(table)
    np.divide(table, totals, out=normalised, where=totals > 0)
    normalised.flags.writeable = False
    return normalised


def dead_end(policy: Policy, start: ManeuverState, steps: int) -> ManeuverState | None:
    """Find a state, reachable within some steps, in which no admissible action has any probability.

    Args:
        policy: the policy.
        start: the state to start from.
        steps: how many actions are taken.

    Returns:
        The first such state, or None where the policy always has something to do.
    """
    lane_count = len(policy.lateral)
    frontier = {start}
    for step in range(steps):
        table = action_probabilities(policy.at_step(step))
        following = set()
        for state in sorted(frontier, key=lambda s: (s.lane, s.mode)):
            row = table[state.lane - 1, state.mode + 1]
            if not row.any():
                return state
            for action in np.flatnonzero(row):
                successor = transition(state, ACTIONS[action], lane_count)
                if successor is not None:
                    following.add(successor)
        frontier = following
    return None


def sums_to_one(probabilities: Sequence[float]) -> bool:
    """Tell whether numbers are a probability distribution."""
    return all(0 <= p <= 1 for p in probabilities) and abs(sum(probabilities) - 1) <= SUM_TOLERANCE
