"""Brute force over maneuver sequences: the reference answer to a decision problem.

Written from the rules alone and sharing no code with the package, so that the two can be compared. Every
sequence of the ego is tried against every sequence of every surrounding vehicle that pruning leaves; plain
loops, no arrays. Numbers in square brackets are the sections of the formulation.

Conventions: lanes are numbered 1..n from the left; a lateral action is -1 (left), 0 (keep) or +1 (right), a
mode +1 (accelerate), 0 (cruise) or -1 (decelerate). x is the position of the front bumper.
"""

import math
from statistics import NormalDist
from typing import NamedTuple

MODES = {"accelerate": 1, "cruise": 0, "decelerate": -1}
LATERALS = {"left": -1, "keep": 0, "right": 1}
MODE_NAMES = {mode: name for name, mode in MODES.items()}
LATERAL_NAMES = {lateral: name for name, lateral in LATERALS.items()}

# The paper's actions a1..a9 as (lateral action, change of mode) [2].
ACTIONS = [(lateral, change) for lateral in (0, -1, 1) for change in (0, 1, -1)]

DISTANCE_TOLERANCE = 1e-6
SPEED_TOLERANCE = 1e-9
THRESHOLD_TOLERANCE = 1e-12
DEFAULT_LENGTH = 4.5

PLANNER_KEYS = {
    "period_s",
    "horizon_steps",
    "accel_mps2",
    "speed_min_mps",
    "speed_max_mps",
    "safe_distance_m",
    "risk_level",
    "risk_allocation",
    "sequence_threshold",
    "maneuver_cost",
    "speed_weight",
    "desired_speed_mps",
    "speed_deadband_mps",
    "lane_weight",
    "goal_lane",
    "terminal_weight",
    "forbidden_lanes",
}


class BranchStep(NamedTuple):
    """One step of one predicted branch, with what the rules need to know of the step before it."""

    lane_before: int
    x_before: float
    lane: int
    x: float
    need: float  # the distance that must be kept: d_safe + z * sigma
    length: float


class EgoStep(NamedTuple):
    """The ego after one step of a plan."""

    lateral: int
    mode: int
    lane: int
    x: float
    speed: float
    violation: float  # of this step alone, metres


# ---------------------------------------------------------------------------------------------------------
# Surrounding vehicles: policy, pruning, prediction
# ---------------------------------------------------------------------------------------------------------


def action_probabilities(problem, vehicle, lane, mode):
    """Return {(lateral action, change of mode): probability} in the state (lane, mode) [3].

    The lateral table times the table over the next mode, masked by admissibility, renormalised. Actions of
    probability zero are left out. The order is the paper's.
    """
    lateral_table = vehicle["lateral_probs"]
    if str(lane) in lateral_table:
        lateral_table = lateral_table[str(lane)]
    products = {}
    for lateral, change in ACTIONS:
        if not 1 <= lane + lateral <= problem["lanes"]["count"]:
            continue
        if mode + change not in MODE_NAMES:
            continue
        lateral_prob = lateral_table[LATERAL_NAMES[lateral]]
        mode_prob = vehicle["longitudinal_probs"][MODE_NAMES[mode + change]]
        if lateral_prob * mode_prob > 0.0:
            products[lateral, change] = lateral_prob * mode_prob
    total = sum(products.values())
    if total <= 0.0:
        raise ValueError(f"{vehicle['id']}: no action has a positive probability in lane {lane}, mode {mode}")
    return {action: product / total for action, product in products.items()}


def retained_sequences(problem, vehicle):
    """Return [(probability, actions)] of the action sequences that pruning leaves [5].

    Kept is what reaches the sequence threshold; where nothing does, the likeliest sequence alone (the first
    of equals in the paper's order of actions).
    """
    horizon = problem["planner"]["horizon_steps"]
    threshold = problem["planner"]["sequence_threshold"] * (1.0 - THRESHOLD_TOLERANCE)
    kept = []
    likeliest = (0.0, None)

    def extend(lane, mode, prob, actions):
        nonlocal likeliest
        # A product only falls as the sequence grows, so a prefix that can be neither kept nor the likeliest
        # is given up.
        if prob < threshold and prob <= likeliest[0] * (1.0 + THRESHOLD_TOLERANCE):
            return
        if len(actions) == horizon:
            if prob >= threshold:
                kept.append((prob, actions))
            if prob > likeliest[0] * (1.0 + THRESHOLD_TOLERANCE):
                likeliest = (prob, actions)
            return
        for (lateral, change), p in action_probabilities(problem, vehicle, lane, mode).items():
            extend(lane + lateral, mode + change, prob * p, [*actions, (lateral, change)])

    extend(vehicle["lane"], MODES[vehicle["mode"]], 1.0, [])
    return kept or [likeliest]


def vehicle_motion(planner, x, speed, mode):
    """Return (x, speed) after a step with the mode BEFORE its action; nobody drives backwards [4]."""
    T, accel = planner["period_s"], planner["accel_mps2"]
    if mode == -1 and speed < accel * T:
        return x + speed**2 / (2.0 * accel), 0.0
    return x + speed * T + mode * accel * T**2 / 2.0, speed + mode * accel * T


def position_sigmas(problem, vehicle):
    """Return the standard deviation of the vehicle's x after steps 1..H [4]."""
    T = problem["planner"]["period_s"]
    q_xx, q_xv, q_vv = vehicle["position_var_m2"], 0.0, vehicle["speed_var_m2ps2"]
    sigmas = []
    for _ in range(problem["planner"]["horizon_steps"]):
        q_xx = q_xx + 2.0 * T * q_xv + T**2 * q_vv + vehicle["process_position_var_m2"]
        q_xv = q_xv + T * q_vv
        q_vv = q_vv + vehicle["process_speed_var_m2ps2"]
        sigmas.append(math.sqrt(q_xx))
    return sigmas


def risk_quantile(problem):
    """Return z = Phi^-1(1 - eps_k) [7]."""
    planner = problem["planner"]
    eps = planner["risk_level"]
    if planner["risk_allocation"] == "uniform":
        eps = eps / (planner["horizon_steps"] * max(1, len(problem["vehicles"])))
    elif planner["risk_allocation"] != "individual":
        raise ValueError(f"the oracle has no risk allocation {planner['risk_allocation']!r}")
    return NormalDist().inv_cdf(1.0 - eps)


def predict(problem):
    """Return (steps, branches, pruned): steps[k] the set of all branches' step k, k = 1..H (steps[0] empty);
    branches and pruned {vehicle id: number of sequences kept, probability of those that are not}.

    Branches that agree over steps k-1 and k are one at step k: no rule looks further back.
    """
    planner = problem["planner"]
    z = risk_quantile(problem)
    steps = [set() for _ in range(planner["horizon_steps"] + 1)]
    branches, pruned = {}, {}
    for vehicle in problem["vehicles"]:
        sequences = retained_sequences(problem, vehicle)
        branches[vehicle["id"]] = len(sequences)
        pruned[vehicle["id"]] = max(0.0, 1.0 - math.fsum(prob for prob, _ in sequences))
        needs = [planner["safe_distance_m"] + z * sigma for sigma in position_sigmas(problem, vehicle)]
        length = vehicle.get("length_m", DEFAULT_LENGTH)
        for _, actions in sequences:
            lane, mode, x, speed = (
                vehicle["lane"],
                MODES[vehicle["mode"]],
                vehicle["x_m"],
                vehicle["speed_mps"],
            )
            for k, (lateral, change) in enumerate(actions, start=1):
                lane_before, x_before = lane, x
                x, speed = vehicle_motion(planner, x, speed, mode)
                lane, mode = lane + lateral, mode + change
                steps[k].add(BranchStep(lane_before, x_before, lane, x, needs[k - 1], length))
    return steps, branches, pruned


# ---------------------------------------------------------------------------------------------------------
# Ego: motion, what must hold, cost
# ---------------------------------------------------------------------------------------------------------


def in_contact(x_ego, ego_length, branch):
    """Tell whether the ego touches a branch in whose lane it is; where less distance is asked for than a
    vehicle's length, that distance is the length."""
    behind = branch.x - min(branch.length, branch.need) + DISTANCE_TOLERANCE
    ahead = branch.x + min(ego_length, branch.need) - DISTANCE_TOLERANCE
    return behind < x_ego < ahead


def step_violation(ego_length, lane_before, x_before, lane, x, branch_steps):
    """Return the metres by which the ego, moving from (lane_before, x_before) to (lane, x), misses the
    distances it must keep [6]; None where it touches a branch or passes through one."""
    short_ahead, short_behind = 0.0, 0.0
    for branch in branch_steps:
        if branch.lane != lane:
            continue
        ego_is_ahead = x > branch.x
        shared_before = branch.lane_before == lane_before
        if shared_before and (x_before > branch.x_before) != ego_is_ahead:
            return None
        if in_contact(x, ego_length, branch):
            return None
        shortfall = branch.need - abs(x - branch.x)
        if shortfall <= DISTANCE_TOLERANCE:
            continue
        if ego_is_ahead:
            short_ahead = max(short_ahead, shortfall)
        else:
            short_behind = max(short_behind, shortfall)
    return short_ahead + short_behind


def ego_step(problem, branch_steps, lane_before, x_before, speed_before, mode_before, action):
    """Return the EgoStep after an action (lateral, next mode), or None where it is not admissible, touches a
    vehicle or passes through one. The ego moves with the mode AFTER the action [4, 8]."""
    planner = problem["planner"]
    T, accel = planner["period_s"], planner["accel_mps2"]
    lateral, mode = action
    lane = lane_before + lateral
    if not 1 <= lane <= problem["lanes"]["count"] or lane in planner["forbidden_lanes"]:
        return None
    if abs(mode - mode_before) > 1:
        return None
    speed = speed_before + mode * accel * T
    if speed < planner["speed_min_mps"] - SPEED_TOLERANCE or speed > planner["speed_max_mps"] + SPEED_TOLERANCE:
        return None
    x = x_before + speed_before * T + mode * accel * T**2 / 2.0
    ego_length = problem["ego"].get("length_m", DEFAULT_LENGTH)
    violation = step_violation(ego_length, lane_before, x_before, lane, x, branch_steps)
    if violation is None:
        return None
    return EgoStep(lateral, mode, lane, x, speed, violation)


def speed_excess(planner, speed):
    """Return how far the speed is outside the dead band around the desired one."""
    excess = abs(speed - planner["desired_speed_mps"]) - planner["speed_deadband_mps"]
    return excess if excess > SPEED_TOLERANCE else 0.0


def stage_cost(planner, lateral, mode, lane, speed):
    """Return the cost of one step, lane and speed taken where it ends [8]."""
    row = {1: 0, 0: 1, -1: 2}[mode]
    column = {-1: 0, 0: 1, 1: 2}[lateral]
    cost = planner["maneuver_cost"][row][column]
    cost += planner["speed_weight"] * speed_excess(planner, speed)
    if planner["goal_lane"] is not None:
        cost += planner["lane_weight"] * abs(lane - planner["goal_lane"])
    return cost


def toward(now, target):
    """Return the step of -1, 0 or +1 that leads from one integer to another."""
    return (target > now) - (target < now)


def cost_to_go(planner, lane, speed, mode):
    """Return the cost of the baseline policy from here to the goal mode, without traffic [8]."""
    goal_lane = lane if planner["goal_lane"] is None else planner["goal_lane"]
    speed_step = planner["accel_mps2"] * planner["period_s"]
    cost = 0.0
    for _ in range(10_000):
        if speed_excess(planner, speed) == 0.0:
            needed = 0
        else:
            needed = 1 if speed < planner["desired_speed_mps"] else -1
        if lane == goal_lane and needed == 0 and mode == 0:
            return cost
        mode = mode + toward(mode, needed)
        lateral = toward(lane, goal_lane)
        lane = lane + lateral
        speed = speed + mode * speed_step
        cost += stage_cost(planner, lateral, mode, lane, speed)
    raise ValueError("the baseline does not reach its goal: the dead band is under half a speed step")


def plan_cost(planner, plan):
    """Return the objective of a plan: its stage costs and the terminal cost [8]."""
    cost = sum(stage_cost(planner, step.lateral, step.mode, step.lane, step.speed) for step in plan)
    if planner["terminal_weight"] > 0.0:
        last = plan[-1]
        cost += planner["terminal_weight"] * cost_to_go(planner, last.lane, last.speed, last.mode)
    return cost


# ---------------------------------------------------------------------------------------------------------
# The decision
# ---------------------------------------------------------------------------------------------------------


def all_plans(problem, steps, *, keep_distances):
    """Yield every plan (a list of EgoStep) that neither touches nor passes through a vehicle; with
    keep_distances only those that keep every distance."""
    horizon = problem["planner"]["horizon_steps"]

    def extend(plan, lane, x, speed, mode):
        if len(plan) == horizon:
            yield plan
            return
        for lateral in (0, -1, 1):
            for next_mode in (0, 1, -1):
                step = ego_step(problem, steps[len(plan) + 1], lane, x, speed, mode, (lateral, next_mode))
                if step is None or (keep_distances and step.violation > 0.0):
                    continue
                yield from extend([*plan, step], step.lane, step.x, step.speed, step.mode)

    ego = problem["ego"]
    yield from extend([], ego["lane"], ego["x_m"], ego["speed_mps"], MODES[ego["mode"]])


def total_violation(plan):
    """Return the metres a plan misses over all its steps."""
    return sum(step.violation for step in plan)


def check_keys(problem):
    """Refuse what the oracle has no rule for, instead of answering another problem."""
    unknown = set(problem["planner"]) - PLANNER_KEYS
    if unknown:
        raise ValueError(f"the oracle has no rule for {sorted(unknown)}")


def solve(problem):
    """Solve a decision problem by brute force.

    Returns a dict: status ("optimal", "relaxed" or "fallback"), objective (None for fallback), violation_m,
    lateral and longitudinal (the plan's lateral actions and modes, empty for fallback), branches and
    pruned_prob ({vehicle id: number of retained sequences} and {vehicle id: probability pruned}).
    """
    check_keys(problem)
    planner = problem["planner"]
    steps, branches, pruned = predict(problem)
    status = "optimal"
    plans = list(all_plans(problem, steps, keep_distances=True))
    if not plans:  # [9]: the least violation first, then the least cost
        status = "relaxed"
        plans = list(all_plans(problem, steps, keep_distances=False))
        least = min(map(total_violation, plans), default=0.0)
        plans = [plan for plan in plans if total_violation(plan) <= least + DISTANCE_TOLERANCE]
    answer = {"branches": branches, "pruned_prob": pruned}
    if not plans:
        return answer | {
            "status": "fallback",
            "objective": None,
            "violation_m": 0.0,
            "lateral": [],
            "longitudinal": [],
        }
    best = min(plans, key=lambda plan: plan_cost(planner, plan))
    return answer | {
        "status": status,
        "objective": plan_cost(planner, best),
        "violation_m": total_violation(best),
        "lateral": [step.lateral for step in best],
        "longitudinal": [step.mode for step in best],
    }


def evaluate(problem, lateral, longitudinal):
    """Judge a given plan, by its lateral actions and modes.

    Returns {"violation_m", "objective"}, or None where the plan is not admissible, touches a vehicle or
    passes through one. The plan is feasible where violation_m is 0.
    """
    check_keys(problem)
    horizon = problem["planner"]["horizon_steps"]
    if len(lateral) != horizon or len(longitudinal) != horizon:
        raise ValueError(f"a plan has {horizon} steps")
    steps, _, _ = predict(problem)
    ego = problem["ego"]
    plan = []
    lane, x, speed, mode = ego["lane"], ego["x_m"], ego["speed_mps"], MODES[ego["mode"]]
    for branch_steps, action in zip(steps[1:], zip(lateral, longitudinal, strict=True), strict=True):
        step = ego_step(problem, branch_steps, lane, x, speed, mode, action)
        if step is None:
            return None
        plan.append(step)
        lane, x, speed, mode = step.lane, step.x, step.speed, step.mode
    return {"violation_m": total_violation(plan), "objective": plan_cost(problem["planner"], plan)}
