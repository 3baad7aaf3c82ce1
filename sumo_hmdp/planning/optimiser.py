"""From a corridor graph to the best sequence of maneuvers, by the MILP."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.planning.corridors import Corridors
from sumo_hmdp.planning.cost import lane_cost, terminal_table
from sumo_hmdp.planning.highs import CompiledModel, MilpResult, compile_model, solve
from sumo_hmdp.planning.lattice import EgoLattice
from sumo_hmdp.planning.milp import LATERALS, MODES, Shape
from sumo_hmdp.planning.problem import DISTANCE_TOLERANCE, DecisionProblem, ManeuverSequence

FloatArray = NDArray[np.float64]

# Window counts are rounded up to these, so that few shapes are ever compiled.
WINDOW_COUNTS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256)


class SolverError(RuntimeError):
    """The solver stopped without proving an optimum or infeasibility."""


def best_sequence(problem: DecisionProblem, lattice: EgoLattice, corridors: Corridors) -> ManeuverSequence | None:
    """Return the cheapest sequence of maneuvers inside the corridors, None where there is none.

    Raises:
        SolverError: if HiGHS proves neither.
    """
    if not corridors.passable:
        return None
    compiled = compile_model(_shape(problem, corridors, relaxed=False))
    return _sequence(compiled, solve(compiled, fill(compiled, problem, lattice, corridors)))


def least_violation(problem: DecisionProblem, lattice: EgoLattice, corridors: Corridors) -> ManeuverSequence | None:
    """Return the sequence with the least total violation and, among those, the least cost.

    Args:
        problem: the decision problem.
        lattice: of its ego.
        corridors: carved with contact distances; the safe distances are their soft ends.

    Returns:
        None where even contact cannot be avoided.

    Raises:
        SolverError: if HiGHS proves neither.
    """
    if not corridors.passable:
        return None
    compiled = compile_model(_shape(problem, corridors, relaxed=True))
    data = fill(compiled, problem, lattice, corridors)
    cap = compiled.slots["violation_cap", None]
    violation_only = data.copy()
    for (name, _), slot in compiled.slots.items():
        if name in {"maneuver_cost", "lane_cost", "speed_weight", "terminal"}:
            violation_only[slot] = 0.0
    violation_only[compiled.slots["violation_factor", None]] = 1.0
    violation_only[cap] = np.inf
    first = solve(compiled, violation_only)
    if _sequence(compiled, first) is None or first.values is None:
        return None
    data[cap] = sum(
        value
        for (name, _), value in zip(compiled.columns, first.values, strict=True)
        if name in {"short_behind", "short_ahead"}
    )
    data[cap] += DISTANCE_TOLERANCE / lattice.unit
    return _sequence(compiled, solve(compiled, data))


def _shape(problem: DecisionProblem, corridors: Corridors, *, relaxed: bool) -> Shape:
    """Return the least shape that holds the corridors."""
    needed = max(len(stage.lane) for stage in corridors.stages)
    windows = next((count for count in WINDOW_COUNTS if count >= needed), needed)
    return Shape(
        steps=problem.settings.horizon_steps,
        windows=windows,
        lanes=problem.road.lane_count,
        terminal=problem.settings.preferences.terminal_weight > 0,
        relaxed=relaxed,
    )


def fill(compiled: CompiledModel, problem: DecisionProblem, lattice: EgoLattice, corridors: Corridors) -> FloatArray:
    """Return the data of one decision, one number a slot of the compiled model."""
    shape, preferences = compiled.shape, problem.settings.preferences
    values: dict[tuple[str, Any], float] = {
        ("may_accelerate", None): float(problem.ego.mode >= 0),
        ("may_decelerate", None): float(problem.ego.mode <= 0),
        ("start_lane", None): problem.ego.lane,
        ("level_min", None): max(lattice.level_min, -2 * lattice.steps),
        ("level_max", None): min(lattice.level_max, 2 * lattice.steps),
        ("speed_step", None): lattice.accel * lattice.period,
        ("speed_error", None): lattice.speed - preferences.desired_speed,
        ("deadband", None): preferences.speed_deadband,
        ("speed_weight", None): preferences.speed_weight,
    }
    values |= {("maneuver_cost", (m, a)): preferences.maneuver(m, a) for m in MODES for a in LATERALS}
    for k, stage in enumerate(corridors.stages, start=1):
        for i, lane in enumerate(stage.lane.tolist()):
            values["lane", (k, i)] = lane
            values["lane_cost", (k, i)] = lane_cost(preferences, lane)
            values["low", (k, i)] = stage.low[i]
            values["high", (k, i)] = stage.high[i]
            if shape.relaxed:
                values["soft_low", (k, i)] = stage.soft_low[i]
                values["soft_high", (k, i)] = stage.soft_high[i]
            if shape.terminal and k == shape.steps:
                values["in_lane", (lane, i)] = 1.0
        for i, j in np.argwhere(stage.moves).tolist():
            values[("start_move", j) if k == 1 else ("move", (k, i, j))] = 1.0
    if shape.terminal:
        table = terminal_table(preferences, lattice, shape.lanes)
        for lane, level, mode in np.ndindex(table.shape):
            values["terminal", (lane + 1, level - lattice.steps, mode - 1)] = table[lane, level, mode]
    data = np.zeros(len(compiled.slots))
    for key, value in values.items():
        data[compiled.slots[key]] = value
    return data


def _sequence(compiled: CompiledModel, result: MilpResult) -> ManeuverSequence | None:
    """Read the maneuvers off an optimal solution; None where infeasibility was proven."""
    if result.status == "Infeasible":
        return None
    if not result.optimal or result.values is None:
        raise SolverError(f"HiGHS must prove an optimum or infeasibility, got {result.status!r}")
    values = result.values
    laterals, modes = [], []
    for k in range(1, compiled.shape.steps + 1):
        mode, lateral = max(
            ((m, a) for m in MODES for a in LATERALS),
            key=lambda index: values[compiled.columns["u", (k, *index)]],
        )
        laterals.append(Lateral(lateral))
        modes.append(Mode(mode))
    return ManeuverSequence(tuple(laterals), tuple(modes))
