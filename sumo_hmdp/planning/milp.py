"""The decision as a mixed-integer linear program, written in Pyomo: one relation, one function.

Columns: one-hot maneuvers u[k, mode, lateral], one-hot windows z[k, i], speed excess p[k]; where asked, the
terminal cost and the slack of a relaxed plan. The ego's position is no column but its lattice point
s_k = sum over j <= k of (2 (k - j) + 1) mode_j, and a window holds it by two rows over the one-hot z (their
convex hull, no big M).

The numbers of one decision enter as *data*: fixed Pyomo variables. A row such as `sum(low * z) <= s` is then
bilinear on paper and linear once the data are fixed, and `planning/highs.py` can read off which coefficient is
which datum, so that the model is compiled once and re-solved for every decision.
"""

from dataclasses import dataclass

import pyomo.environ as pyo

MODES = (1, 0, -1)
LATERALS = (-1, 0, 1)


@dataclass(frozen=True)
class Shape:
    """What decides the rows and columns of the model.

    Attributes:
        steps: H.
        windows: windows per step, the same for all; those that a decision lacks are closed.
        lanes: of the road.
        terminal: whether there is a terminal cost.
        relaxed: whether distances may be violated at a price.
    """

    steps: int
    windows: int
    lanes: int
    terminal: bool
    relaxed: bool


def build_model(shape: Shape) -> pyo.ConcreteModel:
    """Write the model of a shape, with all data unset."""
    model = pyo.ConcreteModel(name="decision")
    model.K = pyo.RangeSet(shape.steps)
    model.I = pyo.RangeSet(0, shape.windows - 1)
    model.L = pyo.RangeSet(shape.lanes)
    declare_data(model, shape)
    declare_columns(model, shape)
    model.one_maneuver = pyo.Constraint(model.K, rule=one_maneuver)
    model.no_jump_to_accelerate = pyo.Constraint(model.K, rule=no_jump_to_accelerate)
    model.no_jump_to_decelerate = pyo.Constraint(model.K, rule=no_jump_to_decelerate)
    model.one_window = pyo.Constraint(model.K, rule=one_window)
    model.lane_follows_action = pyo.Constraint(model.K, rule=lane_follows_action)
    model.window_reached = pyo.Constraint(model.K, model.I, rule=window_reached)
    model.window_left = pyo.Constraint(model.K, model.I, rule=window_left)
    model.not_behind_window = pyo.Constraint(model.K, rule=not_behind_window)
    model.not_ahead_of_window = pyo.Constraint(model.K, rule=not_ahead_of_window)
    model.speed_not_below = pyo.Constraint(model.K, rule=speed_not_below)
    model.speed_not_above = pyo.Constraint(model.K, rule=speed_not_above)
    model.excess_of_high_speed = pyo.Constraint(model.K, rule=excess_of_high_speed)
    model.excess_of_low_speed = pyo.Constraint(model.K, rule=excess_of_low_speed)
    if shape.terminal:
        model.end_lane = pyo.Constraint(model.L, rule=end_lane)
        model.end_mode = pyo.Constraint(MODES, rule=end_mode)
        model.end_level = pyo.Constraint(model.N, rule=end_level)
        model.end_level_is_reached = pyo.Constraint(rule=end_level_is_reached)
    if shape.relaxed:
        model.soft_behind = pyo.Constraint(model.K, rule=soft_behind)
        model.soft_ahead = pyo.Constraint(model.K, rule=soft_ahead)
        model.violation_cap = pyo.Constraint(rule=violation_cap)
    model.cost = pyo.Objective(rule=total_cost)
    return model


def declare_data(model: pyo.ConcreteModel, shape: Shape) -> None:
    """Declare the data: variables that are fixed before a solve."""
    K, I = model.K, model.I  # noqa: E741 - the index sets' usual names
    data = model.data = pyo.Block()
    data.maneuver_cost = pyo.Var(MODES, LATERALS)
    data.may_accelerate = pyo.Var()
    data.may_decelerate = pyo.Var()
    data.start_lane = pyo.Var()
    data.lane = pyo.Var(K, I)
    data.lane_cost = pyo.Var(K, I)
    data.low = pyo.Var(K, I)
    data.high = pyo.Var(K, I)
    data.start_move = pyo.Var(I)
    data.move = pyo.Var([k for k in K if k > 1], I, I)
    data.level_min = pyo.Var()
    data.level_max = pyo.Var()
    data.speed_step = pyo.Var()
    data.speed_error = pyo.Var()
    data.deadband = pyo.Var()
    data.speed_weight = pyo.Var()
    if shape.terminal:
        model.N = pyo.RangeSet(-shape.steps, shape.steps)
        data.in_lane = pyo.Var(model.L, I)
        data.terminal = pyo.Var(model.L, model.N, MODES)
    if shape.relaxed:
        data.soft_low = pyo.Var(K, I)
        data.soft_high = pyo.Var(K, I)
        data.violation_factor = pyo.Var()
        data.violation_cap = pyo.Var()


def declare_columns(model: pyo.ConcreteModel, shape: Shape) -> None:
    """Declare the decision variables."""
    model.u = pyo.Var(model.K, MODES, LATERALS, domain=pyo.Binary)
    model.z = pyo.Var(model.K, model.I, domain=pyo.Binary)
    model.p = pyo.Var(model.K, domain=pyo.NonNegativeReals)
    if shape.terminal:
        model.level = pyo.Var(model.N, domain=pyo.Binary)
        model.end = pyo.Var(model.L, model.N, MODES, domain=pyo.NonNegativeReals)
    if shape.relaxed:
        model.short_behind = pyo.Var(model.K, domain=pyo.NonNegativeReals)
        model.short_ahead = pyo.Var(model.K, domain=pyo.NonNegativeReals)


def mode_is(model: pyo.ConcreteModel, k: int, mode: int) -> pyo.Expression:
    """Indicate that step k runs in a mode."""
    return sum(model.u[k, mode, lateral] for lateral in LATERALS)


def mode_value(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Return the mode of step k, s_acc - s_dec."""
    return mode_is(model, k, 1) - mode_is(model, k, -1)


def speed_level(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Return n_k, the sum of the modes of steps 1..k."""
    return sum(mode_value(model, j) for j in range(1, k + 1))


def lattice_point(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Return s_k, the ego's position in lattice units ahead of cruising."""
    return sum((2 * (k - j) + 1) * mode_value(model, j) for j in range(1, k + 1))


def one_maneuver(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Row: sum over m, a of u[k, m, a] = 1."""
    return sum(model.u[k, mode, lateral] for mode in MODES for lateral in LATERALS) == 1


def no_jump_to_accelerate(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Row: acc_k + dec_{k-1} <= 1; the mode moves by at most one level."""
    if k == 1:
        return mode_is(model, 1, 1) <= model.data.may_accelerate
    return mode_is(model, k, 1) + mode_is(model, k - 1, -1) <= 1


def no_jump_to_decelerate(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Row: dec_k + acc_{k-1} <= 1."""
    if k == 1:
        return mode_is(model, 1, -1) <= model.data.may_decelerate
    return mode_is(model, k, -1) + mode_is(model, k - 1, 1) <= 1


def one_window(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Row: sum over i of z[k, i] = 1."""
    return sum(model.z[k, i] for i in model.I) == 1


def lane_follows_action(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Row: lane_k - lane_{k-1} = a_right - a_left."""
    lane = sum(model.data.lane[k, i] * model.z[k, i] for i in model.I)
    before = model.data.start_lane if k == 1 else sum(model.data.lane[k - 1, i] * model.z[k - 1, i] for i in model.I)
    return lane - before == sum(lateral * model.u[k, mode, lateral] for mode in MODES for lateral in LATERALS)


def window_reached(model: pyo.ConcreteModel, k: int, j: int) -> pyo.Expression:
    """Row: z[k, j] <= sum over i of move[k, i, j] z[k-1, i]; a closed window has no move to it."""
    if k == 1:
        return model.z[1, j] <= model.data.start_move[j]
    return model.z[k, j] <= sum(model.data.move[k, i, j] * model.z[k - 1, i] for i in model.I)


def window_left(model: pyo.ConcreteModel, k: int, i: int) -> pyo.Expression:
    """Row: z[k-1, i] <= sum over j of move[k, i, j] z[k, j]; implied for whole z, it tightens the relaxation."""
    if k == 1:
        return pyo.Constraint.Skip
    return model.z[k - 1, i] <= sum(model.data.move[k, i, j] * model.z[k, j] for j in model.I)


def not_behind_window(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Row: sum over i of low[k, i] z[k, i] <= s_k."""
    return sum(model.data.low[k, i] * model.z[k, i] for i in model.I) <= lattice_point(model, k)


def not_ahead_of_window(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Row: s_k <= sum over i of high[k, i] z[k, i]."""
    return lattice_point(model, k) <= sum(model.data.high[k, i] * model.z[k, i] for i in model.I)


def speed_not_below(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Row: n_min <= n_k."""
    return model.data.level_min <= speed_level(model, k)


def speed_not_above(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Row: n_k <= n_max."""
    return speed_level(model, k) <= model.data.level_max


def excess_of_high_speed(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Row: p_k >= v_k - v_des - deadband."""
    return model.p[k] >= model.data.speed_error + model.data.speed_step * speed_level(model, k) - model.data.deadband


def excess_of_low_speed(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Row: p_k >= v_des - v_k - deadband."""
    return model.p[k] >= -model.data.speed_error - model.data.speed_step * speed_level(model, k) - model.data.deadband


def end_lane(model: pyo.ConcreteModel, lane: int) -> pyo.Expression:
    """Row: the end state's lane is the lane of the last window."""
    ends = sum(model.end[lane, level, mode] for level in model.N for mode in MODES)
    return ends == sum(model.data.in_lane[lane, i] * model.z[model.K.last(), i] for i in model.I)


def end_mode(model: pyo.ConcreteModel, mode: int) -> pyo.Expression:
    """Row: the end state's mode is the last step's."""
    ends = sum(model.end[lane, level, mode] for lane in model.L for level in model.N)
    return ends == mode_is(model, model.K.last(), mode)


def end_level(model: pyo.ConcreteModel, level: int) -> pyo.Expression:
    """Row: the end state's speed level is the one-hot level."""
    return sum(model.end[lane, level, mode] for lane in model.L for mode in MODES) == model.level[level]


def end_level_is_reached(model: pyo.ConcreteModel) -> pyo.Expression:
    """Row: sum over n of n level[n] = n_H."""
    return sum(level * model.level[level] for level in model.N) == speed_level(model, model.K.last())


def soft_behind(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Row: sum over i of soft_low[k, i] z[k, i] - short_behind_k <= s_k."""
    return sum(model.data.soft_low[k, i] * model.z[k, i] for i in model.I) - model.short_behind[k] <= lattice_point(
        model, k
    )


def soft_ahead(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Row: s_k <= sum over i of soft_high[k, i] z[k, i] + short_ahead_k."""
    return (
        lattice_point(model, k)
        <= sum(model.data.soft_high[k, i] * model.z[k, i] for i in model.I) + model.short_ahead[k]
    )


def total_violation(model: pyo.ConcreteModel) -> pyo.Expression:
    """Return the violation of all steps in lattice units."""
    return sum(model.short_behind[k] + model.short_ahead[k] for k in model.K)


def violation_cap(model: pyo.ConcreteModel) -> pyo.Expression:
    """Row: the violation is at most what was found to be the least."""
    return total_violation(model) <= model.data.violation_cap


def total_cost(model: pyo.ConcreteModel) -> pyo.Expression:
    """Objective: stage costs and terminal cost; the violation in the first solve of a relaxed plan, with costs of 0."""
    data = model.data
    cost = sum(data.maneuver_cost[m, a] * model.u[k, m, a] for k in model.K for m in MODES for a in LATERALS)
    cost += sum(data.speed_weight * model.p[k] for k in model.K)
    cost += sum(data.lane_cost[k, i] * model.z[k, i] for k in model.K for i in model.I)
    if hasattr(model, "end"):
        cost += sum(data.terminal[index] * model.end[index] for index in model.end)
    if hasattr(model, "short_ahead"):
        cost += data.violation_factor * total_violation(model)
    return cost
