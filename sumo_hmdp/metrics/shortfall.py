"""By how much the safe distance was missed at any instant, whatever the plans said of the ends of their steps."""

import json
from dataclasses import dataclass

import numpy as np
import pandas as pd

from sumo_hmdp.domain.occupancy import Occupancy, bodies_over
from sumo_hmdp.metrics.planned_distances import DISTANCE_SLACK, AuditSettings
from sumo_hmdp.metrics.trace import BoolArray, FloatArray, Motion, Trace


@dataclass(frozen=True)
class KeptDistance:
    """What a planner kept from whom.

    Attributes:
        settings: its rules of distance and lanes.
        decided: (D,) times of the decisions [s].
        vehicles: for each decision the vehicles it kept a distance to, None for all.
    """

    settings: AuditSettings
    decided: FloatArray
    vehicles: tuple[frozenset[str] | None, ...]


def kept_distance(settings: AuditSettings, decisions: pd.DataFrame) -> KeptDistance:
    """Return what the decisions of a run kept from whom.

    Args:
        settings: of the run.
        decisions: its `decisions` table.
    """
    names = [json.loads(text) for text in decisions["vehicles_json"].tolist()]
    vehicles = tuple(None if found is None else frozenset(found) for found in names)
    return KeptDistance(settings, decisions["time_s"].to_numpy(np.float64), vehicles)


def worst_shortfall(trace: Trace, kept: KeptDistance) -> float:
    """Return the most that was missing to the safe distance at any instant [m], 0 where nothing was.

    Vehicles count that the decision in force kept a distance to, while both take up a common lane: what they intend,
    and under `swept` what their bodies are over. A decision is in force from its own instant to that of the next, both
    included, with the lane that it intends. Between two instants everybody moves evenly, so that the worst is at one
    of them, unless one passes through another: then nothing is left of the distance.

    Args:
        trace: of the run, with the lanes that everybody intends.
        kept: what the planner kept from whom.
    """
    if len(trace.time) < 2 or not trace.ids:
        return 0.0
    heeded = _heeded(trace, kept)
    lanes = np.arange(1, kept.settings.road.lane_count + 1)
    # The ego intends the lane at the end of a step: the record at its beginning is from before the decision there.
    intends = trace.ego.intended_lane[1:, :, None] == lanes
    own = _over(trace.ego, kept.settings)
    theirs = (trace.others.intended_lane[:, :, None] == lanes) | _over(trace.others, kept.settings)
    missing, required = _missing(trace, kept)
    worst, shared = [np.zeros(1)], []
    for ends in (slice(None, -1), slice(1, None)):
        together = ((intends | own[ends]) & theirs[ends]).any(axis=2)
        shared.append(heeded & together & np.isfinite(missing[ends]))
        worst.append(missing[ends][shared[-1]])
    passed = shared[0] & shared[1] & (trace.ahead[1:] != trace.ahead[:-1])
    worst.append(np.maximum(required[1:], required[:-1])[passed])
    found = float(np.concatenate(worst).max())
    return found if found > DISTANCE_SLACK else 0.0


def _heeded(trace: Trace, kept: KeptDistance) -> BoolArray:
    """Tell for each step but the last instant's whom the decision in force kept a distance to, shape (T - 1, V)."""
    # Times are multiples of the step that differ in rounding only.
    in_force = np.searchsorted(kept.decided, trace.time[:-1] + 1e-6, side="right") - 1
    by_decision = np.array(
        [[vehicles is None or name in vehicles for name in trace.ids] for vehicles in kept.vehicles], dtype=bool
    ).reshape(len(kept.vehicles), len(trace.ids))
    nobody = np.zeros((1, len(trace.ids)), dtype=bool)
    return np.asarray(np.concatenate([nobody, by_decision])[in_force + 1])


def _over(motion: Motion, settings: AuditSettings) -> BoolArray:
    """Tell which lanes bodies are over, none under `target`, shape (T, V, lanes)."""
    if settings.occupancy is Occupancy.TARGET:
        return np.zeros((*motion.y.shape, settings.road.lane_count), dtype=bool)
    y = motion.y.ravel()
    width = np.broadcast_to(motion.width, motion.y.shape).ravel()
    return bodies_over(settings.road, y, width).reshape(*motion.y.shape, settings.road.lane_count)


def _missing(trace: Trace, kept: KeptDistance) -> tuple[FloatArray, FloatArray]:
    """Return what is missing to the safe distance, and that distance, shapes (T, V) [m]."""
    ego, others, distance = trace.ego, trace.others, kept.settings.distance
    required = np.where(
        trace.ahead,
        distance.behind(others.length, ego.speed, others.speed),
        distance.ahead(ego.length, ego.speed, others.speed),
    )
    return required - np.abs(others.x - ego.x), required
