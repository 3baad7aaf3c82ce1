"""Stop lines: the ego may not pass one, and must be able to stop before it (docs/formulation.md, eq. 23).

A line acts on the planned positions like a vehicle ahead that never moves, and once more at the end of the horizon,
on the place where the ego would come to rest.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from sumo_hmdp.decision.lattice import EgoLattice
from sumo_hmdp.decision.occupancy import start_state, sweep_steps
from sumo_hmdp.decision.problem import DISTANCE_TOLERANCE, DecisionProblem, PlannerSettings
from sumo_hmdp.domain.occupancy import LaneState
from sumo_hmdp.domain.plan import ForbiddenInterval, PlanStep
from sumo_hmdp.domain.scene import StopLine, VehicleState
from sumo_hmdp.prediction.branches import IntArray
from sumo_hmdp.prediction.dynamics import FloatArray


def place_of(ego: VehicleState, line: StopLine, lane: int) -> float:
    """Return where a line stops an ego that takes up one of its lanes [m].

    Args:
        ego: now.
        line: the line.
        lane: that the ego intends.
    """
    if line.leaving_x is None or (lane in line.lanes and ego.x <= line.x + DISTANCE_TOLERANCE):
        return line.x
    return line.leaving_x


def nearest_line(ego: VehicleState, lines: Iterable[StopLine], state: LaneState) -> StopLine | None:
    """Return the first line that stops an ego in a lane state, its x where it does; None where there is none.

    A line behind the front bumper has no effect: the ego cannot go back, and once it is beyond, standing there helps
    nobody.
    """
    acting = ((place_of(ego, line, state.lane), line) for line in lines if not line.lanes.isdisjoint(state.occupied))
    ahead = (pair for pair in acting if ego.x <= pair[0] + DISTANCE_TOLERANCE)
    place, line = min(ahead, key=lambda pair: pair[0], default=(0.0, None))
    return line if line is None or place == line.x else replace(line, x=place)


def closed_from(problem: DecisionProblem, state: LaneState) -> float:
    """Return the x beyond which the ego may not be in a lane state [m], perhaps infinity."""
    line = nearest_line(problem.ego, problem.stop_lines, state)
    return np.inf if line is None else line.x


def stopping_distance(settings: PlannerSettings, speed: FloatArray | float, mode: IntArray | int) -> FloatArray:
    """Return how far the ego goes until it rests, braking as soon as its mode allows (docs/formulation.md, eq. 23) [m].

    Args:
        settings: of the planner.
        speed: at the end of the last step [m/s].
        mode: in that step; one that accelerates must cruise for a step before it brakes.
    """
    return np.asarray(speed**2 / (2 * settings.accel) + settings.period * speed * (mode > 0))


def farthest_stop(lattice: EgoLattice) -> float:
    """Return where an ego that always accelerates would come to rest, in lattice units ahead of cruising to step H."""
    steps_of_speed = lattice.speed / lattice.speed_step + lattice.steps
    return lattice.steps**2 + steps_of_speed**2 + 2 * steps_of_speed


def line_shortfalls(problem: DecisionProblem, plan: Sequence[PlanStep]) -> Iterator[tuple[StopLine | None, float]]:
    """Yield per step of a plan the line that counts and by how many metres it is passed, not above 0 where it is kept.

    At the last step the place counts where the ego would come to rest.
    """
    sweep = sweep_steps(problem)
    state = start_state(problem)
    for step in plan:
        state = state.after(step.lateral, sweep)
        line = nearest_line(problem.ego, problem.stop_lines, state)
        beyond = step.x
        if step.step == problem.settings.horizon_steps:
            beyond += float(stopping_distance(problem.settings, step.speed, step.mode))
        yield line, 0.0 if line is None else beyond - line.x


def closed_stretches(problem: DecisionProblem, lattice: EgoLattice) -> Iterator[ForbiddenInterval]:
    """Yield what the lines close to who intends a lane, step by step, as far as the ego could come to rest; to show."""
    end = lattice.position_at(lattice.steps, farthest_stop(lattice))
    for k in range(1, lattice.steps + 1):
        for lane in range(1, problem.road.lane_count + 1):
            line = nearest_line(problem.ego, problem.stop_lines, LaneState(lane))
            if line is not None and line.x < end:
                # Where the first place counts no more, the second has taken its place.
                room = line.leaving_x if line.leaving_x is not None and line.leaving_x > line.x else None
                yield ForbiddenInterval(k, lane, line.x, end, room)
