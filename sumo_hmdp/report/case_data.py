"""What the figures and numbers of the paper's cases read from a run, as plain arrays."""

import json
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from sumo_hmdp.domain.maneuver import LATERAL_BY_LABEL, MODE_BY_LABEL, Lateral, Mode
from sumo_hmdp.domain.scene import EGO_ID
from sumo_hmdp.errors import InputError

# Instants are multiples of the step, up to rounding [s].
INSTANT_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Motion:
    """One vehicle over the whole run; all arrays have one value an instant.

    Attributes:
        vehicle_id: its id.
        times: instants [s].
        x: front bumper along the road [m].
        y: to the left [m].
        speed: [m/s].
        accel: [m/s2].
        length: [m].
        width: [m].
    """

    vehicle_id: str
    times: NDArray[np.float64]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    speed: NDArray[np.float64]
    accel: NDArray[np.float64]
    length: float
    width: float

    def index(self, time: float) -> int:
        """Return the last instant at or before a time; the first one if there is none."""
        return max(0, int(np.searchsorted(self.times, time + INSTANT_TOLERANCE, side="right")) - 1)


@dataclass(frozen=True)
class CaseBranch:
    """One retained branch; step k stands at index k - 1.

    Attributes:
        vehicle_id: whose.
        probability: of the branch.
        lanes: intended, 1 is the leftmost.
        modes: after the step's action.
        x: mean of the front bumper [m].
        y: mean [m].
        x_std: its standard deviation [m].
        y_std: the same across the road [m].
    """

    vehicle_id: str
    probability: float
    lanes: tuple[int, ...]
    modes: tuple[Mode, ...]
    x: tuple[float, ...]
    y: tuple[float, ...]
    x_std: tuple[float, ...]
    y_std: tuple[float, ...]


@dataclass(frozen=True)
class PlanPoint:
    """The planned ego at the end of a step."""

    lane: int
    x: float


@dataclass(frozen=True)
class CaseDecision:
    """One decision.

    Attributes:
        time: when it was taken [s].
        status: how it ended.
        lateral: the lateral action.
        mode: the ego's mode from now on.
        lane: the lane that the ego intends from now on.
        x: where the ego was [m].
        plan: the plan, empty for a rule.
        branches: what was predicted, empty for a rule.
        pruned_prob: the largest share of a vehicle's future that pruning dropped.
    """

    time: float
    status: str
    lateral: Lateral
    mode: Mode
    lane: int
    x: float
    plan: tuple[PlanPoint, ...]
    branches: tuple[CaseBranch, ...]
    pruned_prob: float

    def mode_shares(self, vehicle_id: str) -> dict[Mode, tuple[float, float]]:
        """Return how likely a vehicle's modes are in the next step, and where its front then is after the horizon.

        Returns:
            Per mode its probability, and the mean of the front bumper at the horizon's end [m] over the branches
            that begin with it. Only branches that were kept and recorded count, so unlikely modes fall a little short.
        """
        sums: dict[Mode, list[float]] = defaultdict(lambda: [0.0, 0.0])
        for branch in self.branches:
            if branch.vehicle_id == vehicle_id:
                share = sums[branch.modes[0]]
                share[0] += branch.probability
                share[1] += branch.probability * branch.x[-1]
        return {mode: (p, total / p) for mode, (p, total) in sums.items() if p > 0}


@dataclass(frozen=True)
class CaseRun:
    """One run.

    Attributes:
        name: the scenario's.
        planner: the planner's.
        risk_level: epsilon, None where the planner has none.
        lane_count: how many lanes.
        lane_width: [m].
        safe_distance: of the planner [m], None where it has none.
        motions: by vehicle id, the ego first.
        decisions: in the order of time.
        row: the run's metrics, as in the `runs` table.
        parameters: of the planner.
        configuration: the scenario as it was run.
    """

    name: str
    planner: str
    risk_level: float | None
    lane_count: int
    lane_width: float
    safe_distance: float | None
    motions: Mapping[str, Motion]
    decisions: tuple[CaseDecision, ...]
    row: Mapping[str, Any]
    parameters: Mapping[str, Any]
    configuration: Mapping[str, Any]

    @property
    def ego(self) -> Motion:
        """The ego's motion."""
        return self.motions[EGO_ID]

    @property
    def period(self) -> float:
        """Time between decisions [s], 0 where there is one only."""
        return self.decisions[1].time - self.decisions[0].time if len(self.decisions) > 1 else 0.0

    def vehicle_file(self, vehicle_id: str) -> Mapping[str, Any]:
        """Return what the scenario holds of a vehicle."""
        vehicles: list[Mapping[str, Any]] = self.configuration["vehicles"]
        return next(vehicle for vehicle in vehicles if vehicle["id"] == vehicle_id)

    def center_y(self, lane: int) -> float:
        """Return where a lane's centre is [m], equation (1)."""
        return ((self.lane_count + 1) / 2 - lane) * self.lane_width

    def decision_at(self, time: float) -> CaseDecision:
        """Return the decision in force at a time [s]: the last one at or before it."""
        before = [decision for decision in self.decisions if decision.time <= time + INSTANT_TOLERANCE]
        return before[-1] if before else self.decisions[0]

    def changes(self) -> tuple[CaseDecision, ...]:
        """Return the decisions that begin a lane change."""
        return tuple(decision for decision in self.decisions if decision.lateral)


def case_run(
    manifest: Mapping[str, Any], row: Mapping[str, Any], steps: pd.DataFrame, decisions: pd.DataFrame
) -> CaseRun:
    """Read the tables of one run.

    Args:
        manifest: the run's manifest.
        row: its row of `runs`.
        steps: its `steps` table with all vehicles.
        decisions: its `decisions` table.

    Raises:
        InputError: if the run left no instants or no decisions.
    """
    if steps.empty or decisions.empty:
        raise InputError([f"run {manifest['run_id']} must have instants and decisions, got none; run it again"])
    motions = {str(vehicle): _motion(str(vehicle), rows) for vehicle, rows in steps.groupby("vehicle_id", sort=False)}
    return CaseRun(
        name=manifest["scenario"],
        planner=manifest["planner"],
        risk_level=manifest["risk_level"],
        lane_count=manifest["lanes"]["count"],
        lane_width=manifest["lanes"]["width_m"],
        safe_distance=manifest["safe_distance_m"],
        motions=motions,
        decisions=tuple(_decision(decision) for decision in decisions.to_dict("records")),
        row=row,
        parameters=manifest["parameters"],
        configuration=manifest["configuration"],
    )


def _motion(vehicle_id: str, rows: pd.DataFrame) -> Motion:
    columns = ("time_s", "x_m", "y_m", "speed_mps", "accel_mps2")
    times, x, y, speed, accel = (rows[column].to_numpy(dtype=np.float64) for column in columns)
    length, width = float(rows["length_m"].iloc[0]), float(rows["width_m"].iloc[0])
    return Motion(vehicle_id, times, x, y, speed, accel, length, width)


def _decision(row: Mapping[Any, Any]) -> CaseDecision:
    branches = tuple(
        CaseBranch(
            vehicle_id=branch["vehicle_id"],
            probability=branch["probability"],
            lanes=tuple(branch["lanes"]),
            modes=tuple(MODE_BY_LABEL[label] for label in branch["modes"]),
            x=tuple(branch["x_m"]),
            y=tuple(branch["y_m"]),
            x_std=tuple(branch["x_std_m"]),
            y_std=tuple(branch["y_std_m"]),
        )
        for branch in json.loads(row["branches_json"])
    )
    return CaseDecision(
        time=row["time_s"],
        status=row["status"],
        lateral=LATERAL_BY_LABEL[row["lateral"]],
        mode=MODE_BY_LABEL[row["mode"]],
        lane=row["lane"],
        x=row["ego_x_m"],
        plan=tuple(PlanPoint(step["lane"], step["x_m"]) for step in json.loads(row["plan_json"])),
        branches=branches,
        pruned_prob=row["pruned_prob"],
    )
