"""Where every plan ends that begins with an action that leads to nothing but contact (docs/formulation.md, eq. 14).

All states that the ego can get to without contact are followed step by step, until there are none.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sumo_hmdp.decision.blocks import BoolArray
from sumo_hmdp.decision.decide import Answer
from sumo_hmdp.decision.distance import Clearance, contact_clearance, safe_clearance
from sumo_hmdp.decision.lattice import Motion
from sumo_hmdp.decision.occupancy import lanes_now, occupied_lanes, start_state, sweep_steps
from sumo_hmdp.decision.problem import DISTANCE_TOLERANCE, DecisionProblem
from sumo_hmdp.decision.road_rules import keeps_rules
from sumo_hmdp.decision.windows import UNIT_TOLERANCE
from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.domain.occupancy import LaneState


@dataclass(frozen=True)
class Contact:
    """What ends every plan that begins with one action.

    Attributes:
        step: by the end of which there is contact whatever the ego does.
        vehicle_ids: whom it meets there, by one plan or another.
    """

    step: int
    vehicle_ids: tuple[str, ...]

    def __str__(self) -> str:
        others = " or ".join(self.vehicle_ids) or "a vehicle"
        return f"contact with {others} at step {self.step} at the latest"


@dataclass(frozen=True)
class _State:
    """The ego at the end of a step: its motion, mode and lanes."""

    motion: Motion
    mode: Mode
    lanes: LaneState


def first_contact(problem: DecisionProblem, answer: Answer, first: tuple[Lateral, Mode]) -> Contact:
    """Return what ends every plan that begins with an admissible action.

    Args:
        problem: the decision problem.
        answer: of that problem.
        first: the action; no plan that begins with it is free of contact.
    """
    meeting = _Meeting(problem, answer)
    alive = {_State(Motion(0, 0, 0.0, answer.lattice.speed), problem.ego.mode, start_state(problem))}
    touched = np.zeros(len(problem.vehicles), dtype=bool)
    for k in range(problem.settings.horizon_steps):
        following: set[_State] = set()
        touched[:] = False
        for before in alive:
            for after in _successors(problem, answer, before, k + 1, first if k == 0 else None):
                met = meeting.met(k, before, after)
                touched[answer.branches.vehicle[met]] = True
                if not met.any():
                    following.add(after)
        if not following:
            break
        alive = following
    ids = (vehicle.state.id for vehicle, yes in zip(problem.vehicles, touched, strict=True) if yes)
    return Contact(k + 1, tuple(ids))


def _successors(
    problem: DecisionProblem, answer: Answer, before: _State, step: int, only: tuple[Lateral, Mode] | None
) -> Iterator[_State]:
    """Yield where the admissible actions of a step lead, or one of them."""
    sweep = sweep_steps(problem)
    for lateral in Lateral:
        lanes = before.lanes.after(lateral, sweep)
        exists = 1 <= lanes.lane <= problem.road.lane_count and lanes.lane not in problem.settings.forbidden_lanes
        for mode in Mode:
            if not exists or abs(mode - before.mode) > 1 or only not in (None, (lateral, mode)):
                continue
            motion = answer.lattice.advance(before.motion, int(mode))
            kept = keeps_rules(problem, step, before.lanes.lane, lateral, motion.speed)
            if kept and answer.lattice.allows(motion.level, motion.phase, step=step):
                yield _State(motion, mode, lanes)


class _Meeting:
    """Tells which branches the ego touches or passes through in a step."""

    def __init__(self, problem: DecisionProblem, answer: Answer) -> None:
        self._problem, self._answer = problem, answer
        branches = answer.branches
        occupied = occupied_lanes(problem, branches)
        now = lanes_now(problem, branches)
        # Shapes (B, 1 + H, lanes) and (B, 1 + H): the present comes first.
        self._occupied = np.concatenate([now[branches.vehicle, None, :], occupied], axis=1)
        x_now = np.array([v.state.x for v in problem.vehicles])[branches.vehicle]
        self._x = np.column_stack([x_now, branches.x])
        self._contact: dict[float, Clearance] = {}
        # The same slack as that of the windows.
        self._tolerance = DISTANCE_TOLERANCE + UNIT_TOLERANCE * answer.lattice.unit

    def met(self, k: int, before: _State, after: _State) -> BoolArray:
        """Tell which branches are met in the step from k to k + 1, shape (B,)."""
        lattice = self._answer.lattice
        x_before = lattice.position_at(k, before.motion.point)
        x_after = lattice.position_at(k + 1, after.motion.point)
        shared = self._shared(k + 1, after)
        ahead = x_after > self._x[:, k + 1]
        contact = self._clearance(after.motion.speed)
        bound = np.where(ahead, contact.ahead[:, k], contact.behind[:, k]) - self._tolerance
        touches = np.abs(x_after - self._x[:, k + 1]) < bound
        passes = self._shared(k, before) & (ahead != (x_before > self._x[:, k]))
        return np.asarray(shared & (touches | passes))

    def _shared(self, step: int, state: _State) -> BoolArray:
        return np.asarray(self._occupied[:, step, [lane - 1 for lane in state.lanes.occupied]].any(axis=1), dtype=bool)

    def _clearance(self, speed: float) -> Clearance:
        if speed not in self._contact:
            answer = self._answer
            safe = safe_clearance(self._problem, answer.branches, answer.margin, speed)
            self._contact[speed] = contact_clearance(self._problem, answer.branches, safe)
        return self._contact[speed]
