"""The decision as a mixed-integer linear program, written in Pyomo: one relation, one function.

Columns: one-hot maneuvers u[k, mode, lateral], one-hot openings z[k, i], speed excess p[k]; where distances depend on
speed, the window w[k, i, n, p] of the opening at speed level n; where asked, the terminal cost and the slack of a
relaxed plan. The ego's position is no column but its lattice point
s_k = sum over j <= k of (2 (k - j) + 1) mode_j, and a window holds it by two rows over the one-hot z (their
convex hull, no big M).

The numbers of one decision enter as *data*: fixed Pyomo variables. A row such as `sum(low * z) <= s` is then
bilinear on paper and linear once the data are fixed, and `decision/highs.py` can read off which coefficient is
which datum, so that the model is compiled once and re-solved for every decision.
"""

import pyomo.environ as pyo

from sumo_hmdp.decision.milp_data import Shape, declare_columns, declare_data
from sumo_hmdp.decision.milp_terms import (
    LATERALS,
    MODES,
    has_stopped,
    lattice_point,
    levels,
    mode_is,
    of_window,
    speed_gain,
    speed_gained,
    speed_level,
    total_violation,
)


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
    if shape.limits:
        model.speed_within_limit = pyo.Constraint(model.K, rule=speed_within_limit)
    model.excess_of_high_speed = pyo.Constraint(model.K, rule=excess_of_high_speed)
    model.excess_of_low_speed = pyo.Constraint(model.K, rule=excess_of_low_speed)
    if shape.stopping:
        model.rest_needs_braking = pyo.Constraint(model.K, rule=rest_needs_braking)
        model.rest_is_lowest = pyo.Constraint(model.K, rule=rest_is_lowest)
        model.one_stop = pyo.Constraint(rule=one_stop)
        model.stand_after_stop = pyo.Constraint(model.K, rule=stand_after_stop)
    if shape.levelled:
        model.opening_has_level = pyo.Constraint(model.K, model.I, rule=opening_has_level)
        model.level_has_opening = pyo.Constraint(model.speeds, rule=level_has_opening)
        model.level_is_reached = pyo.Constraint(model.K, rule=level_is_reached)
        model.phase_is_reached = pyo.Constraint(model.K, rule=phase_is_reached)
        model.level_follows = pyo.Constraint(model.speeds, rule=level_follows)
    if shape.lines:
        model.stops_before_line = pyo.Constraint(model.N, rule=stops_before_line)
    if shape.terminal:
        model.end_lane = pyo.Constraint(model.L, rule=end_lane)
        model.end_mode = pyo.Constraint(MODES, rule=end_mode)
        model.end_level = pyo.Constraint(model.N, model.P, rule=end_level)
        model.end_level_is_reached = pyo.Constraint(rule=end_level_is_reached)
        model.end_phase_is_reached = pyo.Constraint(model.P, rule=end_phase_is_reached)
    if shape.relaxed:
        model.soft_behind = pyo.Constraint(model.K, rule=soft_behind)
        model.soft_ahead = pyo.Constraint(model.K, rule=soft_ahead)
        model.violation_cap = pyo.Constraint(rule=violation_cap)
    model.cost = pyo.Objective(rule=total_cost)
    return model


def rest_needs_braking(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Row: stop_k + stand_k <= dec_k."""
    return model.stop[k] + model.stand[k] <= mode_is(model, k, -1)


def rest_is_lowest(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Row: n_k - n_min <= 2 H (1 - stop_k - stand_k); only a step that would end below zero ends at rest."""
    room = 2 * model.K.last()
    return speed_level(model, k) - model.data.level_min[k] <= room * (1 - model.stop[k] - model.stand[k])


def one_stop(model: pyo.ConcreteModel) -> pyo.Expression:
    """Row: sum of stops <= 1, and 0 where the lattice has the speed zero anyway; then the ego always stands."""
    return has_stopped(model, model.K.last()) <= model.data.may_stop


def stand_after_stop(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Row: stand_k <= stops before step k, or the lattice has the speed zero."""
    before = has_stopped(model, k - 1) if k > 1 else 0
    return model.stand[k] <= before + model.data.stands_at_start


def opening_has_level(model: pyo.ConcreteModel, k: int, i: int) -> pyo.Expression:
    """Row: sum over n, p of open[k, i, n, p] w[k, i, n, p] = z[k, i]; it is used at one speed level."""
    return sum(model.data.open[k, i, n, p] * model.w[k, i, n, p] for n, p in levels(k, model.P)) == model.z[k, i]


def level_has_opening(model: pyo.ConcreteModel, k: int, n: int, p: int) -> pyo.Expression:
    """Row: sum over i of open[k, i, n, p] w[k, i, n, p] = at[k, n, p]."""
    return sum(model.data.open[k, i, n, p] * model.w[k, i, n, p] for i in model.I) == model.at[k, n, p]


def level_is_reached(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Row: sum over n, p of n at[k, n, p] = n_k."""
    return sum(n * model.at[k, n, p] for n, p in levels(k, model.P)) == speed_level(model, k)


def phase_is_reached(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Row: sum over n of at[k, n, 1] tells whether the ego has stopped."""
    if model.P.last() == 0:
        return pyo.Constraint.Skip
    return sum(model.at[k, n, 1] for n in range(-k, k + 1)) == has_stopped(model, k)


def level_follows(model: pyo.ConcreteModel, k: int, n: int, p: int) -> pyo.Expression:
    """Row: at[k, n, p] <= sum of at[k-1, m, q] with |m - n| <= 1, q <= p; implied for whole u, it tightens."""
    if k == 1:
        return pyo.Constraint.Skip
    before = [(m, q) for m, q in levels(k - 1, model.P) if abs(m - n) <= 1 and q <= p]
    return model.at[k, n, p] <= sum(model.at[k - 1, m, q] for m, q in before)


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
    return of_window(model, model.data.low, k) <= lattice_point(model, k)


def not_ahead_of_window(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Row: s_k <= sum over i of high[k, i] z[k, i]."""
    return lattice_point(model, k) <= of_window(model, model.data.high, k)


def speed_not_below(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Row: n_min_k <= n_k (docs/formulation.md, eq. 36)."""
    return model.data.level_min[k] <= speed_level(model, k)


def speed_not_above(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Row: (v_k - v_0) / (accel T) <= n_max_k (docs/formulation.md, eq. 36)."""
    return speed_gain(model, k) <= model.data.level_max[k]


def speed_within_limit(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Row: (v_k - v_0) / (accel T) <= sum over i of top[k, i] z[k, i], what the lane of the opening allows."""
    return speed_gain(model, k) <= sum(model.data.top[k, i] * model.z[k, i] for i in model.I)


def excess_of_high_speed(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Row: p_k >= v_k - v_des - deadband."""
    return model.p[k] >= model.data.speed_error + speed_gained(model, k) - model.data.deadband


def excess_of_low_speed(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Row: p_k >= v_des - v_k - deadband."""
    return model.p[k] >= -model.data.speed_error - speed_gained(model, k) - model.data.deadband


def end_lane(model: pyo.ConcreteModel, lane: int) -> pyo.Expression:
    """Row: the end state's lane is the lane of the last window."""
    ends = sum(model.end[lane, level, phase, mode] for level in model.N for phase in model.P for mode in MODES)
    return ends == sum(model.data.in_lane[lane, i] * model.z[model.K.last(), i] for i in model.I)


def end_mode(model: pyo.ConcreteModel, mode: int) -> pyo.Expression:
    """Row: the end state's mode is the last step's."""
    ends = sum(model.end[lane, level, phase, mode] for lane in model.L for level in model.N for phase in model.P)
    return ends == mode_is(model, model.K.last(), mode)


def end_level(model: pyo.ConcreteModel, level: int, phase: int) -> pyo.Expression:
    """Row: the end state's speed level and phase are the one-hot ones."""
    return sum(model.end[lane, level, phase, mode] for lane in model.L for mode in MODES) == model.level[level, phase]


def end_level_is_reached(model: pyo.ConcreteModel) -> pyo.Expression:
    """Row: sum over n of n level[n] = n_H."""
    reached = sum(level * model.level[level, phase] for level in model.N for phase in model.P)
    return reached == speed_level(model, model.K.last())


def end_phase_is_reached(model: pyo.ConcreteModel, phase: int) -> pyo.Expression:
    """Row: sum over n of level[n, 1] tells whether the ego has stopped, and level[n, 0] the rest."""
    stopped = has_stopped(model, model.K.last()) if hasattr(model, "stop") else 0
    return sum(model.level[level, phase] for level in model.N) == (stopped if phase else 1 - stopped)


def soft_behind(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Row: sum over i of soft_low[k, i] z[k, i] - short_behind_k <= s_k."""
    return of_window(model, model.data.soft_low, k) - model.short_behind[k] <= lattice_point(model, k)


def soft_ahead(model: pyo.ConcreteModel, k: int) -> pyo.Expression:
    """Row: s_k <= sum over i of soft_high[k, i] z[k, i] + short_ahead_k."""
    return lattice_point(model, k) <= of_window(model, model.data.soft_high, k) + model.short_ahead[k]


def violation_cap(model: pyo.ConcreteModel) -> pyo.Expression:
    """Row: the violation is at most what was found to be the least."""
    return total_violation(model) <= model.data.violation_cap


def stops_before_line(model: pyo.ConcreteModel, m: int) -> pyo.Expression:
    """Row: s_H + r_m^2 + (2 r_m + 1) (n_H - m) + 2 r_m acc_H - lost_m stopped <= sum over i of stop_high[i] z[H, i].

    The stopping distance, (v_H / (accel T))^2 lattice units and twice the root of it where the ego accelerates, is
    convex in the speed level: its largest chord is its value (docs/formulation.md, eq. 23). Chord m passes through the
    levels m and m + 1 of phase 0, at r_m = v / (accel T), or m - 1 and m where the ego accelerates. Once it has stopped
    within a step, its speed is lower by the share rho of a speed step, and the distance by at most
    lost_m = 2 rho (r_m + 1) - rho^2 below the chord; by so much at level m + 1, or m where it accelerates. A relaxed
    plan may come to rest beyond the line, at the price of `short_ahead`.
    """
    H, data = model.K.last(), model.data
    slope = data.braked_slope[m]
    rest = lattice_point(model, H) + data.braked[m] + slope * (speed_level(model, H) - m)
    rest += (slope - 1) * mode_is(model, H, 1)
    if hasattr(model, "stop"):
        rest -= data.braked_less[m] * has_stopped(model, H)
    if hasattr(model, "short_ahead"):
        rest -= model.short_ahead[H]
    return rest <= sum(data.stop_high[i] * model.z[H, i] for i in model.I)


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
