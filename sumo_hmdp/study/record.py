"""The record of one run: every instant as table rows, whatever becomes of the run."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
import pandas as pd

from sumo_hmdp.domain.lanes import lanes_at
from sumo_hmdp.domain.maneuver import Mode
from sumo_hmdp.domain.plan import Decision, Evidence, Foretells, SharesRisk
from sumo_hmdp.domain.scene import EGO_ID, Scene, VehicleState
from sumo_hmdp.metrics.catalogue import METRICS
from sumo_hmdp.sim.contact import Contact, Side
from sumo_hmdp.sim.episode import Moment, TraceHash

STEP_COLUMNS = {
    "run_id": "str", "step": "int64", "time_s": "float64", "vehicle_id": "str", "x_m": "float64", "y_m": "float64",
    "heading_rad": "float64", "speed_mps": "float64", "accel_mps2": "float64", "lane": "int64",
    "intended_lane": "int64", "mode": "str", "length_m": "float64", "width_m": "float64",
}  # fmt: skip
DECISION_COLUMNS = {
    "run_id": "str", "decision_index": "int64", "time_s": "float64", "status": "str", "reason": "str",
    "lateral": "str", "mode": "str", "lane": "int64", "accel_mps2": "float64", "objective": "float64",
    "violation_m": "float64", "stage_cost": "float64", "objective_bound": "float64", "shifted_feasible": "boolean",
    "shifted_reason": "str", "risk_taken": "float64", "risk_least": "float64", "contact_risk": "float64",
    "solver": "str", "solve_time_ms": "float64", "pruned_prob": "float64",
    "branch_count": "int64", "ego_x_m": "float64", "ego_y_m": "float64", "ego_speed_mps": "float64", "plan_json": "str",
    "vehicles_json": "str", "branches_json": "str", "forbidden_json": "str", "bounds_json": "str",
    "notes_json": "str", "prediction_json": "str", "risk_json": "str",
}  # fmt: skip
RUN_COLUMNS = {
    "run_id": "str", "scenario": "str", "planner": "str", "solver": "str", "seed": "int64", "risk_level": "float64",
    "status": "str", "reason": "str", "duration_s": "float64", "distance_m": "float64", "speed_mean_mps": "float64",
    "gap_min_m": "float64", "ttc_min_s": "float64", "lane_change_count": "Int64", "lane_change_first_s": "float64",
    "decision_count": "Int64", "optimal_share": "float64", "incumbent_share": "float64",
    "relaxed_share": "float64", "fallback_share": "float64",
    "violation_max_m": "float64", "solve_time_median_ms": "float64", "solve_time_max_ms": "float64",
    "contact_count": "Int64", "contact_at_fault_count": "Int64", "sumo_contact_count": "Int64",
    "background_contact_count": "Int64", "red_light_count": "Int64", "junction_stop_count": "Int64",
    "goal_reached": "boolean", "tracking_failure_count": "Int64", "deadline_miss_count": "Int64",
    "reproducible": "boolean", "wall_time_s": "float64", "trace_hash": "str",
    "versions_hash": "str",
}  # fmt: skip
# Every metric is a column; those above keep their places.
RUN_COLUMNS |= {
    name: RUN_COLUMNS["decision_count"] if metric.is_count else "float64"
    for name, metric in METRICS.all.items()
    if name not in RUN_COLUMNS
}
# What differs from one execution of the same run to the next.
WALL_CLOCK_COLUMNS = (
    "solve_time_ms",
    "solve_time_median_ms",
    "solve_time_p99_ms",
    "solve_time_max_ms",
    "deadline_miss_count",
    "wall_time_s",
)

_PANDAS_KINDS = ("str", "boolean")
# A property of an enumeration is slow to ask for every vehicle at every instant.
_LABEL = {mode: mode.label for mode in Mode}


def _frame(columns: Mapping[str, Any], kinds: Mapping[str, str]) -> pd.DataFrame:
    """Return a table of columns of given kinds; pandas would look at every value to find them out."""
    return pd.DataFrame(
        {
            name: pd.array(columns[name], dtype=kind) if kind in _PANDAS_KINDS else np.asarray(columns[name], kind)
            for name, kind in kinds.items()
        }
    )


def timeless(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a table without what differs from one execution of the same run to the next."""
    return frame.drop(columns=[name for name in WALL_CLOCK_COLUMNS if name in frame])


def tables_hash(*frames: pd.DataFrame) -> str:
    """Return a hash of tables of one run, row by row, without what differs from one execution to the next."""
    digest = hashlib.sha256()
    for frame in frames:
        digest.update(pd.util.hash_pandas_object(timeless(frame), index=False).to_numpy().tobytes())
        digest.update(f" {len(frame)} rows\n".encode())
    return digest.hexdigest()


class Trace(StrEnum):
    """Which vehicles the `steps` table keeps."""

    NONE = "none"
    EGO = "ego"
    ALL = "all"


class RunStatus(StrEnum):
    """How a run ended."""

    COMPLETED = "completed"
    CONTACT = "contact"
    FAILED = "failed"
    INTERRUPTED = "interrupted"
    TIMED_OUT = "timed_out"
    CRASHED = "crashed"


@dataclass
class Recorder:
    """Collects the instants of one run; a run that breaks off leaves what was collected.

    Attributes:
        run_id: the run's name.
        detailed: whether to write down what decisions rest on: branches, forbidden intervals, problems.
        scenes: everybody at every instant, with the number of its step.
        decisions: rows.
        documents: each decision's problem in its file form, None where the planner has none.
        contacts: of the ego, by time.
        sumo_contacts: how many instants SUMO's own list named the ego.
        sumo_touched: whom SUMO's own list says the ego touched.
        qp_failures: how many tracking QPs did not converge.
        background_contacts: pairs of background vehicles that overlapped.
        red_lights: how often the ego passed a stop line at red.
        junction_stops: instants at which the ego stood inside a junction.
        goal_reached: whether the ego got where the run shall end; None where it ends with time alone.
        trace: the hash of all instants.
    """

    run_id: str
    detailed: bool = True
    scenes: list[tuple[int, Scene]] = field(default_factory=list)
    decisions: list[dict[str, Any]] = field(default_factory=list)
    documents: list[str | None] = field(default_factory=list)
    contacts: list[Contact] = field(default_factory=list)
    sumo_contacts: int = 0
    sumo_touched: set[str] = field(default_factory=set)
    qp_failures: int = 0
    background_contacts: int = 0
    red_lights: int = 0
    junction_stops: int = 0
    goal_reached: bool | None = None
    trace: TraceHash = field(default_factory=TraceHash)

    def observe(self, moment: Moment) -> None:
        """Take one instant in."""
        self.trace.add(moment)
        scene = moment.scene
        self.scenes.append((moment.step, scene))
        if moment.decision is not None:
            self.decisions.append(self._decision_row(moment.decision, scene.ego))
            evidence = moment.decision.evidence
            self.documents.append(evidence.problem_json() if evidence is not None and self.detailed else None)
        self.contacts += moment.contacts
        self.sumo_contacts += bool(moment.sumo_contacts)
        self.sumo_touched.update(name for pair in moment.sumo_contacts for name in pair if name != EGO_ID)
        self.background_contacts = moment.background_contacts
        self.red_lights += moment.breaches.red_light
        self.junction_stops += moment.breaches.junction_stop
        self.goal_reached = moment.goal_reached
        if moment.tracking is not None:
            self.qp_failures += not moment.tracking.solved

    @property
    def contacts_at_fault(self) -> int:
        """How many contacts are the ego's fault."""
        return sum(contact.at_fault for contact in self.contacts)

    @property
    def front_contact(self) -> bool:
        """Whether the ego met anybody with its front."""
        return any(contact.side is Side.FRONT for contact in self.contacts)

    def contact_sentences(self) -> list[str]:
        """Say with whom, when and by whose fault the ego had contacts."""
        return [
            f"contact with {contact.other_id} at {contact.time:.2f} s, "
            f"{'' if contact.at_fault else 'not '}the ego's fault"
            for contact in self.contacts
        ]

    def disagreements(self) -> list[str]:
        """Say which contacts only SUMO's own list has, and which only the bodies; of a world in which SUMO looks."""
        touched = {contact.other_id: contact.time for contact in self.contacts}
        by_sumo = [
            f"SUMO lists a contact with {name}, which the bodies did not have"
            for name in sorted(self.sumo_touched - set(touched))
        ]
        by_bodies = [
            f"SUMO does not list the contact with {name} at {time:.2f} s"
            for name, time in touched.items()
            if name not in self.sumo_touched
        ]
        return by_sumo + by_bodies

    def step_table(self) -> pd.DataFrame:
        """Return the `steps` table with all vehicles."""
        vehicles = [vehicle for _, scene in self.scenes for vehicle in (scene.ego, *scene.others)]
        counts = [1 + len(scene.others) for _, scene in self.scenes]
        y = np.array([vehicle.y for vehicle in vehicles], dtype=float)
        columns: dict[str, Any] = {
            "run_id": [self.run_id] * len(vehicles),
            "step": np.repeat([step for step, _ in self.scenes], counts),
            "time_s": np.repeat([scene.time for _, scene in self.scenes], counts),
            "vehicle_id": [vehicle.id for vehicle in vehicles],
            "x_m": [vehicle.x for vehicle in vehicles],
            "y_m": y,
            "heading_rad": [vehicle.heading for vehicle in vehicles],
            "speed_mps": [vehicle.speed for vehicle in vehicles],
            "accel_mps2": [vehicle.accel for vehicle in vehicles],
            "lane": lanes_at(self.scenes[0][1].road, y) if vehicles else [],
            "intended_lane": [vehicle.lane for vehicle in vehicles],
            "mode": [_LABEL[vehicle.mode] for vehicle in vehicles],
            "length_m": [vehicle.length for vehicle in vehicles],
            "width_m": [vehicle.width for vehicle in vehicles],
        }
        return _frame(columns, STEP_COLUMNS)

    def decision_table(self) -> pd.DataFrame:
        """Return the `decisions` table."""
        return _frame({name: [row[name] for row in self.decisions] for name in DECISION_COLUMNS}, DECISION_COLUMNS)

    def _decision_row(self, decision: Decision, ego: VehicleState) -> dict[str, Any]:
        evidence = decision.evidence if self.detailed else None
        return {
            "run_id": self.run_id,
            "decision_index": len(self.decisions),
            "time_s": decision.time,
            "status": str(decision.status),
            "reason": decision.reason,
            "lateral": decision.lateral.label,
            "mode": decision.mode.label,
            "lane": decision.command.lane,
            "accel_mps2": decision.command.accel,
            "objective": decision.objective,
            "violation_m": decision.violation,
            "stage_cost": decision.stage_cost,
            "objective_bound": decision.objective_bound,
            "shifted_feasible": decision.shifted_feasible,
            "shifted_reason": decision.shifted_reason,
            "risk_taken": decision.risk_taken,
            "risk_least": decision.risk_least,
            "contact_risk": decision.contact_risk,
            "solver": decision.solver,
            "solve_time_ms": 1000 * decision.solve_time,
            "pruned_prob": decision.pruned_prob,
            "branch_count": decision.branch_count,
            "ego_x_m": ego.x,
            "ego_y_m": ego.y,
            "ego_speed_mps": ego.speed,
            "plan_json": json.dumps(
                [
                    {
                        "step": step.step,
                        "lateral": step.lateral.label,
                        "mode": step.mode.label,
                        "lane": step.lane,
                        "x_m": step.x,
                        "speed_mps": step.speed,
                    }
                    for step in decision.plan
                ]
            ),
            "vehicles_json": json.dumps(decision.vehicles),
            "branches_json": json.dumps(
                [
                    {
                        "vehicle_id": branch.vehicle_id,
                        "probability": branch.probability,
                        "lanes": branch.lanes,
                        "modes": [Mode(mode).label for mode in branch.modes],
                        "x_m": branch.x,
                        "y_m": branch.y,
                        "x_std_m": branch.x_std,
                        "y_std_m": branch.y_std,
                    }
                    for branch in (() if evidence is None else evidence.branches())
                ]
            ),
            "forbidden_json": json.dumps(
                [
                    {"step": block.step, "lane": block.lane, "x_from_m": block.x_from, "x_to_m": block.x_to}
                    | ({} if block.leaving_x is None else {"leaving_x_m": block.leaving_x})
                    for block in (() if evidence is None else evidence.forbidden())
                ]
            ),
            "notes_json": json.dumps(dict(decision.notes)),
            "bounds_json": json.dumps(
                [
                    {
                        "step": bound.step,
                        "side": "ahead" if bound.ahead else "behind",
                        "room_m": bound.room,
                        "vehicle_id": bound.vehicle_id,
                        "probability": bound.probability,
                        "x_m": bound.x,
                        "distance_m": bound.distance,
                    }
                    for bound in (() if evidence is None else evidence.bounds())
                ]
            ),
            "prediction_json": _prediction_json(evidence),
            "risk_json": _risk_json(evidence),
        }


def _risk_json(evidence: Evidence | None) -> str:
    """Return what each vehicle adds to the risk of the plan, the most first."""
    if not isinstance(evidence, SharesRisk):
        return "[]"
    return json.dumps(
        [
            {
                "vehicle_id": share.vehicle_id,
                "total": share.total,
                "parts": share.parts,
                "step": share.step,
                "cause": None if share.cause is None else str(share.cause),
                "reason": share.reason,
            }
            for share in evidence.risk_shares()
        ]
    )


def _prediction_json(evidence: Evidence | None) -> str:
    """Return the whole prediction of each vehicle, to six digits: enough to score it, and half as long."""
    if not isinstance(evidence, Foretells):
        return "[]"

    def short(values: Sequence[float]) -> list[float]:
        return [float(f"{value:.6g}") for value in values]

    return json.dumps(
        [
            {
                "vehicle_id": one.vehicle_id,
                "pruned_prob": one.pruned,
                "lane_probs": [short(lanes) for lanes in one.lanes],
                "x_mean_m": short(one.x_mean),
                "x_std_m": short(one.x_std),
                "y_mean_m": short(one.y_mean),
                "y_std_m": short(one.y_std),
                "x_quantiles_m": [short(quantiles) for quantiles in one.x_quantiles],
            }
            for one in evidence.prediction()
        ]
    )
