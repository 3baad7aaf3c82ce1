"""Short forms that several texts share."""

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from typing import Any

from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.domain.plan import PlanStep

_LATERAL_SIGN = {Lateral.LEFT: "L", Lateral.KEEP: "K", Lateral.RIGHT: "R"}
_MODE_SIGN = {Mode.ACCELERATE: "+", Mode.CRUISE: "0", Mode.DECELERATE: "-"}
# What is less likely is shown as nothing, since it is rounding or below all that is predicted.
LEAST = 1e-9
ALMOST_SURE = 0.995


def short_sequence(maneuvers: Sequence[tuple[Lateral, Mode]]) -> str:
    """Return a sequence of maneuvers in short, such as `R+ K0*3`: right and accelerate, three times keep and cruise."""
    runs = ((pair, len(list(run))) for pair, run in groupby(maneuvers))
    return " ".join(
        f"{_LATERAL_SIGN[lateral]}{_MODE_SIGN[mode]}{f'*{count}' if count > 1 else ''}"
        for (lateral, mode), count in runs
    )


def short_plan(plan: Sequence[PlanStep]) -> str:
    """Return the maneuvers of a plan in short."""
    return short_sequence([(step.lateral, step.mode) for step in plan])


def percent(probability: float) -> str:
    """Return a probability, or a bound of one, in per cent with two digits that count, such as `0.8 %`."""
    if probability < LEAST:
        return "0 %"
    return "100 %" if probability >= ALMOST_SURE else f"{100 * probability:.2g} %"


def uncovered_text(pruned: float, allocation: str, *, account_pruned: bool) -> str:
    """Return what epsilon does not cover, in words; empty where all is covered.

    Args:
        pruned: the largest pruned probability of any vehicle.
        allocation: the risk rule.
        account_pruned: whether `uniform` takes it off epsilon.
    """
    covered = allocation in {"joint", "mixture"} or (allocation == "uniform" and account_pruned)
    if covered or pruned < LEAST:
        return ""
    return f"{percent(pruned)} of the prediction is not covered by epsilon: pruned and not charged by {allocation}"


def uncovered_of_run(manifest: Mapping[str, Any], pruned: Iterable[float]) -> str:
    """Return what epsilon does not cover at any decision of a run, in words; empty where all is covered.

    Args:
        manifest: of the run or of its cell; its `parameters` name the risk rule.
        pruned: the largest pruned probability of any vehicle, of each decision.
    """
    parameters = manifest.get("parameters") or {}
    most = max((value for value in pruned if math.isfinite(value)), default=0.0)
    rule = parameters.get("risk_allocation")
    if rule is None:
        return ""
    told = uncovered_text(most, str(rule), account_pruned=bool(parameters.get("account_pruned")))
    return f"up to {told}" if told else ""
