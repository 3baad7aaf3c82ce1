"""What a film shows: everybody at any time of one run, the decision in force, and what the time line marks."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from sumo_hmdp.domain.plan import Status
from sumo_hmdp.domain.scene import EGO_ID
from sumo_hmdp.errors import InputError
from sumo_hmdp.metrics.trace import BoolArray, FloatArray, Motion, Trace, trace_of
from sumo_hmdp.report.replay_data import decision_records
from sumo_hmdp.report.replay_events import conflicts
from sumo_hmdp.report.replay_summary import lane_changes
from sumo_hmdp.report.video_file import FilmFormat

if TYPE_CHECKING:
    import pandas as pd

# The last frame stays, so that one sees how it ended [s of the film].
HOLD = 1.5
SAME_TIME = 2e-6


@dataclass(frozen=True)
class Instant:
    """Everybody at one time, which may lie between two recorded instants; index 0 is the ego, absent vehicles are out.

    Attributes:
        time: [s].
        ids: names.
        x: front bumpers [m].
        y: [m].
        heading: [rad].
        speed: [m/s].
        length: [m].
        width: [m].
        decision: the one in force, None before the first.
    """

    time: float
    ids: tuple[str, ...]
    x: FloatArray
    y: FloatArray
    heading: FloatArray
    speed: FloatArray
    length: FloatArray
    width: FloatArray
    decision: Mapping[str, Any] | None

    def leader(self) -> tuple[str, float, float | None] | None:
        """Return who is ahead in the ego's path, the gap [m], and the time to collision [s], None while none closes."""
        in_path = np.abs(self.y - self.y[0]) < (self.width + self.width[0]) / 2
        ahead = np.flatnonzero(in_path & (self.x >= self.x[0]) & (np.arange(len(self.x)) > 0))
        if not len(ahead):
            return None
        nearest = int(ahead[np.argmin(self.x[ahead])])
        gap = float(self.x[nearest] - self.length[nearest] - self.x[0])
        closing = float(self.speed[0] - self.speed[nearest])
        return self.ids[nearest], gap, gap / closing if closing > 0 and gap >= 0 else None


@dataclass(frozen=True)
class Film:
    """A run that can be looked at at any time.

    Attributes:
        title: what run it is.
        lane_count: lanes of the road.
        lane_width: [m].
        trace: where everybody was.
        decisions: as the replay page has them.
        marks: (time [s], kind) of what the time line marks.
        made: how the film is made.
    """

    title: str
    lane_count: int
    lane_width: float
    trace: Trace
    decisions: tuple[Mapping[str, Any], ...]
    marks: tuple[tuple[float, str], ...]
    made: FilmFormat

    @property
    def frame_count(self) -> int:
        """Frames with the run's end held."""
        return len(self.frame_times)

    @cached_property
    def frame_times(self) -> tuple[float, ...]:
        """Which time of the run each frame shows [s]."""
        times, fps = self.trace.time, self.made.fps
        count = math.ceil((times[-1] - times[0]) / self.made.speed * fps - 1e-9) + 1
        moving = np.minimum(times[0] + np.arange(count) * self.made.speed / fps, times[-1])
        return (*moving.tolist(), *[float(times[-1])] * round(HOLD * fps))

    def lane_y(self, lane: int) -> float:
        """Return where a lane's centre is [m], equation (1)."""
        return ((self.lane_count + 1) / 2 - lane) * self.lane_width

    def at(self, time: float) -> Instant:
        """Return an instant: as recorded at a recorded time, in between on the straight line from one to the next."""
        times = self.trace.time
        first = max(int(np.searchsorted(times, time + SAME_TIME, side="right")) - 1, 0)
        after = min(first + 1, len(times) - 1)
        rest = time - times[first]
        share = float(rest / (times[after] - times[first])) if rest > SAME_TIME and after > first else 0.0
        ego, others = _between(self.trace.ego, first, after, share), _between(self.trace.others, first, after, share)
        there: BoolArray = ~np.isnan(others[0])
        x, y, heading, speed, length, width = (
            np.concatenate((mine, theirs[there])) for mine, theirs in zip(ego, others, strict=True)
        )
        ids = (EGO_ID, *(name for name, is_there in zip(self.trace.ids, there, strict=True) if is_there))
        taken = [one for one in self.decisions if one["time_s"] <= time + SAME_TIME]
        return Instant(time, ids, x, y, heading, speed, length, width, taken[-1] if taken else None)


def _between(motion: Motion, first: int, after: int, share: float) -> list[FloatArray]:
    """Return x, y, heading, speed, length and width between two instants; NaN where one is missing."""
    moving = (motion.x, motion.y, motion.heading, motion.speed)
    mixed = [rows[first] if share == 0.0 else (1 - share) * rows[first] + share * rows[after] for rows in moving]
    return [*mixed, motion.length[first], motion.width[first]]


def film_of(manifest: Mapping[str, Any], steps: "pd.DataFrame", decisions: "pd.DataFrame", made: FilmFormat) -> Film:
    """Collect what a film shows.

    Args:
        manifest: the run's.
        steps: all vehicles at all instants.
        decisions: the run's, may be empty.
        made: how the film is made.

    Raises:
        InputError: if the run has no instants with the ego.
    """
    if not len(steps) or not (steps["vehicle_id"] == EGO_ID).any():
        raise InputError([f"run {manifest['run_id']} must have instants to film, got none: {manifest.get('reason')}"])
    records = tuple(decision_records(decisions))
    asked = manifest.get("risk_level")
    words = [manifest["scenario"], manifest["planner"], *([] if asked is None else [f"ε = {asked:g}"])]
    trace = trace_of(steps)
    return Film(
        title=" · ".join([*words, f"seed {manifest['seed']}"]),
        lane_count=int(manifest["lanes"]["count"]),
        lane_width=float(manifest["lanes"]["width_m"]),
        trace=trace,
        decisions=records,
        marks=tuple(sorted([*_lane_changes(records), *_statuses(records), *_conflicts(steps)])),
        made=made,
    )


def _lane_changes(records: tuple[Mapping[str, Any], ...]) -> Iterator[tuple[float, str]]:
    return ((time, "left" if left else "right") for time, _, left in lane_changes(records))


def _statuses(records: tuple[Mapping[str, Any], ...]) -> Iterator[tuple[float, str]]:
    before = ""
    for one in records:
        if one["status"] != before and Status(one["status"]).departs:
            yield one["time_s"], one["status"]
        before = one["status"]


def _conflicts(steps: "pd.DataFrame") -> Iterator[tuple[float, str]]:
    return ((one["time_s"], one["kind"]) for one in conflicts(steps))
