"""Brute force, the cost of a plan [8 of docs/formulation.md], written from the rules alone."""

SPEED_TOLERANCE = 1e-9


def speed_excess(planner, speed):
    """Return how far the speed is outside the dead band around the desired one."""
    excess = abs(speed - planner["desired_speed_mps"]) - planner["speed_deadband_mps"]
    return excess if excess > SPEED_TOLERANCE else 0.0


def stage_cost(planner, lateral, mode, lane, speed):
    """Return the cost of one step, lane and speed taken where it ends (12)."""
    row = {1: 0, 0: 1, -1: 2}[mode]
    column = {-1: 0, 0: 1, 1: 2}[lateral]
    cost = planner["maneuver_cost"][row][column]
    cost += planner["speed_weight"] * speed_excess(planner, speed)
    if planner["goal_lane"] is not None:
        cost += planner["lane_weight"] * abs(lane - planner["goal_lane"])
    return cost


def toward(now, target):
    """Return the step of -1, 0 or +1 that leads from one number toward another."""
    return (target > now) - (target < now)


def cost_to_go(planner, lane, speed, mode):
    """Return the cost of the baseline policy from here to the goal mode, without traffic (13)."""
    goal_lane = lane if planner["goal_lane"] is None else planner["goal_lane"]
    speed_step = planner["accel_mps2"] * planner["period_s"]
    cost = 0.0
    for _ in range(10_000):
        in_band = speed_excess(planner, speed) == 0.0
        needed = 0 if in_band else toward(speed, planner["desired_speed_mps"])
        if lane == goal_lane and needed == 0 and mode == 0:
            return cost
        mode = mode + toward(mode, needed)
        lateral = toward(lane, goal_lane)
        lane = lane + lateral
        speed = speed + mode * speed_step
        cost += stage_cost(planner, lateral, mode, lane, speed)
    raise ValueError("the baseline does not reach its goal: the dead band is under half a speed step")


def plan_cost(planner, plan):
    """Return the objective of a plan: its stage costs and the terminal cost."""
    cost = sum(stage_cost(planner, step.lateral, step.mode, step.lane, step.speed) for step in plan)
    if planner["terminal_weight"] > 0.0:
        last = plan[-1]
        cost += planner["terminal_weight"] * cost_to_go(planner, last.lane, last.speed, last.mode)
    return cost
