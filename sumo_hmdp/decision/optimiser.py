"""From a corridor graph to the best sequence of maneuvers, by the MILP."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.decision.corridors import Corridors
from sumo_hmdp.decision.cost import lane_cost, terminal_table
from sumo_hmdp.decision.deadline import Deadline
from sumo_hmdp.decision.distance import counted
from sumo_hmdp.decision.highs import CompiledModel, MilpResult, compile_model, solve
from sumo_hmdp.decision.lattice import EgoLattice
from sumo_hmdp.decision.milp_data import Shape
from sumo_hmdp.decision.milp_terms import LATERALS, MODES
from sumo_hmdp.decision.openings import Openings, openings_of
from sumo_hmdp.decision.problem import DISTANCE_TOLERANCE, SPEED_TOLERANCE, DecisionProblem, ManeuverSequence
from sumo_hmdp.decision.road_rules import keeps_rules, top_speeds
from sumo_hmdp.decision.stop_lines import farthest_stop, stopping_distance
from sumo_hmdp.decision.windows import UNIT_TOLERANCE
from sumo_hmdp.domain.maneuver import Lateral, Mode
from sumo_hmdp.errors import SumoHmdpError

FloatArray = NDArray[np.float64]

# The windows' bounds by name in the model and in `Openings`, and in which direction the model widens them.
_BOUNDS = {"low": -1.0, "high": 1.0, "soft_low": 0.0, "soft_high": 0.0}

# HiGHS proves wrong optima where coefficients lie about as near to whole numbers as its tolerances are small. So a
# bound keeps away from the points it lets in: halfway to the next where positions are whole, and where the ego may stop
# by a tenth of a micron or less.
WHOLE_SLACK = 0.5
STOPPING_SLACK = 1e-7

# By how much the least violation may be exceeded in the search for the least cost, one after the other [m]. HiGHS
# counts what is missing within the tolerance too, and from rounded ends, which is 4 H tolerances at most.
CAP_SLACKS = (1e-3, 1e-4, 1e-5, DISTANCE_TOLERANCE)

# Window counts are rounded up to these, so that few shapes are ever compiled.
WINDOW_COUNTS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256)


class SolverError(SumoHmdpError):
    """The solver stopped without proving an optimum or infeasibility."""


class DeadlineError(RuntimeError):
    """An enforced deadline came before any plan was found."""


def best_sequence(
    problem: DecisionProblem, lattice: EgoLattice, corridors: Corridors, *, deadline: Deadline | None = None
) -> ManeuverSequence | None:
    """Return the cheapest sequence of maneuvers inside the corridors, None where there is none.

    Args:
        problem: the decision problem.
        lattice: of its ego.
        corridors: carved with safe distances.
        deadline: of the whole decision; None for none.

    Raises:
        SolverError: if HiGHS proves neither.
        DeadlineError: if the deadline is enforced and comes first.
    """
    if not corridors.passable:
        return None
    compiled = compile_model(shape_of(problem, lattice, corridors, relaxed=False))
    data = fill(compiled, problem, lattice, corridors)
    start = start_values(compiled, problem, lattice, corridors)
    return _sequence(compiled, solve(compiled, data, (deadline or Deadline()).left(), start))


def least_violation(
    problem: DecisionProblem, lattice: EgoLattice, corridors: Corridors, *, deadline: Deadline | None = None
) -> ManeuverSequence | None:
    """Return the sequence with the least total violation and, among those, the least cost.

    Args:
        problem: the decision problem.
        lattice: of its ego.
        corridors: carved with contact distances; the safe distances are their soft ends.
        deadline: of the whole decision; None for none.

    Returns:
        None where even contact cannot be avoided.

    Raises:
        SolverError: if HiGHS proves neither.
        DeadlineError: if the deadline is enforced and comes first.
    """
    if not corridors.passable:
        return None
    compiled = compile_model(shape_of(problem, lattice, corridors, relaxed=True))
    data = fill(compiled, problem, lattice, corridors)
    violation_only = data.copy()
    for name in ("maneuver_cost", "lane_cost", "speed_weight", "terminal"):
        if name in compiled.slots:
            violation_only[compiled.slots[name]] = 0.0
    violation_only[compiled.slots["violation_factor"]] = 1.0
    violation_only[compiled.slots["violation_cap"]] = np.inf
    first = solve(compiled, violation_only, (deadline or Deadline()).left())
    sequence = _sequence(compiled, first)
    if sequence is None or first.values is None:
        return None
    least = sum(first.values[compiled.columns[name]].sum() for name in ("short_behind", "short_ahead"))
    # HiGHS is not to be trusted with a cap as near as the rule's tolerance. A looser one lets in more, so the cheapest
    # plan under it is the answer if it meets the rule, which is checked exactly; else the cap is drawn tighter.
    limit = _violation(problem, lattice, corridors, sequence) + DISTANCE_TOLERANCE / lattice.unit
    for slack in CAP_SLACKS:
        data[compiled.slots["violation_cap"]] = least + slack / lattice.unit
        # Under so tight a cap HiGHS' presolve may never end, and without it the answer may be "Infeasible", which is
        # wrong, as the first plan is below every cap.
        second = solve(compiled, data, (deadline or Deadline()).left(), presolve=False)
        if second.status == "Infeasible":
            second = solve(compiled, data, (deadline or Deadline()).left(), presolve=True)
        cheapest = None if second.values is None else _sequence(compiled, second)
        if cheapest is not None and _violation(problem, lattice, corridors, cheapest) <= limit:
            return cheapest
    return replace(sequence, proven=False)


def _violation(
    problem: DecisionProblem, lattice: EgoLattice, corridors: Corridors, sequence: ManeuverSequence
) -> float:
    """Return the total violation of a sequence in lattice units, infinite where it leaves the corridors."""
    windows = _windows_of(problem, lattice, corridors, sequence)
    if windows is None:
        return np.inf
    motions = lattice.walk(tuple(int(mode) for mode in sequence.modes))
    places = list(zip(corridors.stages, motions, windows, strict=True))
    behind = np.array([stage.soft_low[i] - motion.point for stage, motion, i in places])
    ahead = np.array([motion.point - stage.soft_high[i] for stage, motion, i in places])
    ahead[-1] = max(ahead[-1], _beyond_line(problem, lattice, corridors, sequence, windows))
    return float((counted(behind, lattice.unit) + counted(ahead, lattice.unit)).sum())


def _beyond_line(
    problem: DecisionProblem, lattice: EgoLattice, corridors: Corridors, sequence: ManeuverSequence, windows: list[int]
) -> float:
    """Return how far beyond its stop line a sequence comes to rest, in lattice units (docs/formulation.md, eq. 23)."""
    end = lattice.walk(tuple(int(mode) for mode in sequence.modes))[-1]
    braked = stopping_distance(problem.settings, end.speed, sequence.modes[-1])
    return float(end.point + braked / lattice.unit - corridors.stages[-1].stop_high[windows[-1]])


def shape_of(problem: DecisionProblem, lattice: EgoLattice, corridors: Corridors, *, relaxed: bool) -> Shape:
    """Return the least shape that holds the corridors."""
    needed = max(stage.opening_count for stage in corridors.stages)
    windows = next((count for count in WINDOW_COUNTS if count >= needed), needed)
    terminal = problem.settings.preferences.terminal_weight > 0
    return Shape(
        steps=problem.settings.horizon_steps,
        windows=windows,
        # Only the terminal cost has rows for each lane.
        lanes=problem.road.lane_count if terminal else 1,
        terminal=terminal,
        relaxed=relaxed,
        levelled=corridors.levelled,
        stopping=lattice.stopping,
        lines=corridors.lines,
        limits=top_speeds(problem) is not None,
    )


def fill(compiled: CompiledModel, problem: DecisionProblem, lattice: EgoLattice, corridors: Corridors) -> FloatArray:
    """Return the data of one decision, one number a slot of the compiled model."""
    shape, preferences = compiled.shape, problem.settings.preferences
    H, width = shape.steps, shape.windows
    room = 2 * H
    tolerance = SPEED_TOLERANCE / lattice.speed_step
    slack = STOPPING_SLACK if lattice.stopping else WHOLE_SLACK
    lane, move = np.zeros((H, width)), np.zeros((H, width, width))
    bounds = {name: direction for name, direction in _BOUNDS.items() if direction or shape.relaxed}
    windows = {name: np.zeros(compiled.window_shape) for name in ("open", *bounds)}
    steps = openings_of(corridors, stopping=lattice.stopping)
    for k, openings in enumerate(steps):
        before, count = openings.moves.shape
        lane[k, :count] = openings.lane
        move[k, :before, :count] = openings.moves
        windows["open"][k, :count] = is_open = openings.open
        for name, direction in bounds.items():
            bound = np.where(is_open, getattr(openings, name) + direction * slack, 0.0)
            windows[name][k, :count] = bound if direction else _whole_if_near(bound, lattice)
    # Shape (H, 2): by how many levels the speed may be below or above what it is now.
    limits = np.array([lattice.limits(k + 1) for k in range(H)])
    lowest, highest = ((limits - lattice.speed) / lattice.speed_step + np.array([-tolerance, tolerance])).T
    floor = np.full(H, -lattice.levels_to_rest) if lattice.stopping else np.ceil(lowest)
    values: dict[str, Any] = {
        "may_accelerate": problem.ego.mode >= 0,
        "may_decelerate": problem.ego.mode <= 0,
        "start_lane": problem.ego.lane,
        "level_min": floor if lattice.stopping else np.clip(floor, -room, room),
        "level_max": np.clip(highest + slack if lattice.stopping else np.floor(highest), -room, room),
        "speed_step": lattice.speed_step,
        "speed_error": lattice.speed - preferences.desired_speed,
        "deadband": preferences.speed_deadband,
        "speed_weight": preferences.speed_weight,
        "maneuver_cost": np.array(preferences.maneuver_cost),
        "start_move": move[0, 0],
        "move": move[1:],
        "lane": lane,
        "lane_cost": lane_cost(preferences, lane.astype(np.int64)),
        **{name: of_windows[compiled.window_mask] for name, of_windows in windows.items()},
    }
    if shape.stopping:
        values["may_stop"] = lattice.rest_share > 0
        values["stands_at_start"] = lattice.rest_share == 0
        values["lost_share"] = 1 - lattice.rest_share
        values["lost_speed"] = lattice.speed_step * (1 - lattice.rest_share)
        values["lost_share_squared"] = (1 - lattice.rest_share) ** 2
    if shape.lines:
        # Beyond the farthest stop nothing is asked, neither of windows without a line nor of those that are not there.
        stop_high = np.full(width, farthest_stop(lattice) + 1.0)
        last = steps[-1].stop_high + (0.0 if shape.relaxed else STOPPING_SLACK)
        stop_high[: len(last)] = np.minimum(last, stop_high[: len(last)])
        speeds = lattice.speed / lattice.speed_step + np.arange(-H, H + 1)
        values["stop_high"] = stop_high
        values["braked"], values["braked_slope"] = speeds**2, 2 * speeds + 1
        values["braked_less"] = 2 * lattice.rest_share * (speeds + 1) - lattice.rest_share**2
    if shape.limits:
        values["top"] = _top_levels(problem, lattice, steps, width, slack)
    if shape.terminal:
        values["in_lane"] = lane[-1] == np.arange(1, shape.lanes + 1)[:, None]
        table = preferences.terminal_weight * terminal_table(preferences, lattice, shape.lanes)
        # The model has modes in the order accelerate, cruise, decelerate.
        values["terminal"] = table[:, :, :, ::-1]
    data = np.zeros(compiled.slot_count)
    for name, place in compiled.slots.items():
        value = values.get(name, 0.0)
        data[place] = value.ravel() if isinstance(value, np.ndarray) else value
    return data


def _top_levels(
    problem: DecisionProblem, lattice: EgoLattice, steps: Sequence[Openings], width: int, slack: float
) -> FloatArray:
    """Return by how many speed steps the ego may be faster than now in each opening of each step, (H, width)."""
    room = 2.0 * len(steps)
    found = np.full((len(steps), width), room)
    tops = top_speeds(problem)
    assert tops is not None  # noqa: S101 - the shape says so
    for row, openings, top in zip(found, steps, tops, strict=True):
        gain = (top[openings.lane - 1] - lattice.speed + SPEED_TOLERANCE) / lattice.speed_step
        row[: len(gain)] = np.clip(gain + slack if lattice.stopping else np.floor(gain), -room, room)
    return found


def _whole_if_near(soft: FloatArray, lattice: EgoLattice) -> FloatArray:
    """Return soft ends [units], whole where the tolerance lets them be: HiGHS gets no number that is nearly whole."""
    whole = np.round(soft)
    return np.where(np.abs(soft - whole) <= DISTANCE_TOLERANCE / lattice.unit, whole, soft)


def start_values(
    compiled: CompiledModel, problem: DecisionProblem, lattice: EgoLattice, corridors: Corridors
) -> FloatArray | None:
    """Return the columns of the problem's starting sequence, None where there is none or it is not feasible here."""
    sequence, shape = problem.start, compiled.shape
    if sequence is None or lattice.stopping:
        return None
    motions = lattice.walk(tuple(int(mode) for mode in sequence.modes))
    windows = _windows_of(problem, lattice, corridors, sequence)
    if windows is None:
        return None
    if _beyond_line(problem, lattice, corridors, sequence, windows) > UNIT_TOLERANCE:
        return None
    preferences = problem.settings.preferences
    u = np.zeros((shape.steps, len(MODES), len(LATERALS)))
    z = np.zeros((shape.steps, shape.windows))
    for k, (mode, lateral) in enumerate(zip(sequence.modes, sequence.laterals, strict=True)):
        u[k, MODES.index(mode), LATERALS.index(lateral)] = 1.0
        z[k, corridors.stages[k].opening[windows[k]]] = 1.0
    speeds = np.array([motion.speed for motion in motions])
    excess = np.maximum(np.abs(speeds - preferences.desired_speed) - preferences.speed_deadband, 0.0)
    values = {"u": u, "z": z, "p": excess}
    if shape.levelled:
        w = np.zeros(compiled.window_shape)
        for k, (stage, window) in enumerate(zip(corridors.stages, windows, strict=True)):
            w[k, stage.opening[window], stage.level[window] + shape.steps] = 1.0
        values |= {"w": w[compiled.window_mask], "at": w.sum(axis=1)[compiled.window_mask[:, 0]]}
    if shape.terminal:
        level = motions[-1].level + shape.steps
        ends = np.zeros((shape.lanes, 2 * shape.steps + 1, 1, len(MODES)))
        lane = problem.ego.lane + sum(sequence.laterals)
        ends[lane - 1, level, 0, MODES.index(sequence.modes[-1])] = 1.0
        values |= {"end": ends, "level": np.eye(2 * shape.steps + 1)[level]}
    start = np.zeros(compiled.column_count)
    for name, place in compiled.columns.items():
        start[place] = values[name].ravel()
    return start


def _windows_of(
    problem: DecisionProblem, lattice: EgoLattice, corridors: Corridors, sequence: ManeuverSequence
) -> list[int] | None:
    """Return the window that a sequence is in at each step, None where it leaves the corridors or its own limits."""
    windows: list[int] = []
    lane, mode, window = problem.ego.lane, problem.ego.mode, 0
    motions = lattice.walk(tuple(int(m) for m in sequence.modes))
    steps = zip(corridors.stages, sequence.laterals, sequence.modes, motions, strict=True)
    for step, (stage, lateral, following, motion) in enumerate(steps, start=1):
        lane += lateral
        inside = stage.moves[window] & (stage.lane == lane)
        inside &= (stage.low <= motion.point + UNIT_TOLERANCE) & (motion.point - UNIT_TOLERANCE <= stage.high)
        if corridors.levelled:
            inside &= (stage.level == motion.level) & (stage.phase == motion.phase)
        kept = keeps_rules(problem, step, lane - lateral, lateral, motion.speed)
        kept &= lattice.allows(motion.level, motion.phase, step=step)
        if abs(following - mode) > 1 or not kept or not inside.any():
            return None
        mode, window = following, int(inside.argmax())
        windows.append(window)
    return windows


def _sequence(compiled: CompiledModel, result: MilpResult) -> ManeuverSequence | None:
    """Read the maneuvers off an optimal solution; None where infeasibility was proven."""
    if result.status == "Infeasible":
        return None
    if result.timed_out and result.values is None:
        raise DeadlineError
    if not (result.optimal or result.timed_out) or result.values is None:
        raise SolverError(f"HiGHS must prove an optimum or infeasibility, got {result.status!r}")
    chosen = result.values[compiled.columns["u"]].reshape(compiled.shape.steps, len(MODES), len(LATERALS))
    laterals, modes = [], []
    for step in chosen:
        mode, lateral = np.unravel_index(int(step.argmax()), step.shape)
        modes.append(Mode(MODES[mode]))
        laterals.append(Lateral(LATERALS[lateral]))
    return ManeuverSequence(tuple(laterals), tuple(modes), proven=result.optimal)
