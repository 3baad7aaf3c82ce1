"""What the decision's MILP is made of: the data that a decision fills in, and the columns that are solved for."""

from dataclasses import dataclass

import pyomo.environ as pyo

from sumo_hmdp.decision.milp_terms import LATERALS, MODES, levels


@dataclass(frozen=True)
class Shape:
    """What decides the rows and columns of the model.

    Attributes:
        steps: H.
        windows: openings per step, the same for all; those that a decision lacks are closed. Where `levelled` is false
            each of them is one window.
        lanes: of the road.
        terminal: whether there is a terminal cost.
        relaxed: whether distances may be violated at a price.
        levelled: whether each opening has a window of its own for every speed level.
        stopping: whether the ego may come to rest within a step.
        lines: whether a stop line may matter.
        limits: whether a speed limit of the road may matter.
    """

    steps: int
    windows: int
    lanes: int
    terminal: bool
    relaxed: bool
    levelled: bool
    stopping: bool
    lines: bool = False
    limits: bool = False


def window_index(shape: Shape) -> list[tuple[int, ...]]:
    """List the windows: one a step k and opening i, or one a step, opening, speed level n and phase p."""
    openings = [(k, i) for k in range(1, shape.steps + 1) for i in range(shape.windows)]
    if not shape.levelled:
        return list(openings)
    return [(k, i, n, p) for k, i in openings for n, p in levels(k, range(int(shape.stopping) + 1))]


def declare_data(model: pyo.ConcreteModel, shape: Shape) -> None:
    """Declare the data: variables that are fixed before a solve."""
    K, I = model.K, model.I  # noqa: E741 - the index sets' usual names
    data = model.data = pyo.Block()
    model.N = pyo.RangeSet(-shape.steps, shape.steps)
    model.P = pyo.RangeSet(0, int(shape.stopping))
    model.windows = pyo.Set(initialize=window_index(shape), ordered=True)
    model.speeds = pyo.Set(initialize=[(k, n, p) for k in K for n, p in levels(k, model.P)], ordered=True)
    data.maneuver_cost = pyo.Var(MODES, LATERALS)
    data.may_accelerate = pyo.Var()
    data.may_decelerate = pyo.Var()
    data.start_lane = pyo.Var()
    data.lane = pyo.Var(K, I)
    data.lane_cost = pyo.Var(K, I)
    data.low = pyo.Var(model.windows)
    data.high = pyo.Var(model.windows)
    data.start_move = pyo.Var(I)
    data.move = pyo.Var([k for k in K if k > 1], I, I)
    data.level_min = pyo.Var(K)
    data.level_max = pyo.Var(K)
    data.speed_step = pyo.Var()
    data.speed_error = pyo.Var()
    data.deadband = pyo.Var()
    data.speed_weight = pyo.Var()
    if shape.levelled:
        data.open = pyo.Var(model.windows)
    if shape.stopping:
        data.may_stop = pyo.Var()
        data.stands_at_start = pyo.Var()
        data.lost_share = pyo.Var()
        data.lost_speed = pyo.Var()
        data.lost_share_squared = pyo.Var()
    if shape.lines:
        data.stop_high = pyo.Var(I)
        data.braked = pyo.Var(model.N)
        data.braked_slope = pyo.Var(model.N)
        data.braked_less = pyo.Var(model.N)
    if shape.limits:
        data.top = pyo.Var(K, I)
    if shape.terminal:
        data.in_lane = pyo.Var(model.L, I)
        data.terminal = pyo.Var(model.L, model.N, model.P, MODES)
    if shape.relaxed:
        data.soft_low = pyo.Var(model.windows)
        data.soft_high = pyo.Var(model.windows)
        data.violation_factor = pyo.Var()
        data.violation_cap = pyo.Var()


def declare_columns(model: pyo.ConcreteModel, shape: Shape) -> None:
    """Declare the decision variables."""
    model.u = pyo.Var(model.K, MODES, LATERALS, domain=pyo.Binary)
    model.z = pyo.Var(model.K, model.I, domain=pyo.Binary)
    model.p = pyo.Var(model.K, domain=pyo.NonNegativeReals)
    if shape.levelled:
        model.w = pyo.Var(model.windows, domain=pyo.NonNegativeReals)
        model.at = pyo.Var(model.speeds, domain=pyo.Binary)
    if shape.terminal:
        model.level = pyo.Var(model.N, model.P, domain=pyo.Binary)
        model.end = pyo.Var(model.L, model.N, model.P, MODES, domain=pyo.NonNegativeReals)
    if shape.stopping:
        model.stop = pyo.Var(model.K, domain=pyo.Binary)
        model.stand = pyo.Var(model.K, domain=pyo.Binary)
    if shape.relaxed:
        model.short_behind = pyo.Var(model.K, domain=pyo.NonNegativeReals)
        model.short_ahead = pyo.Var(model.K, domain=pyo.NonNegativeReals)
