"""Brute force over maneuver sequences: the reference answer to a decision problem.

Written from the rules alone and sharing no code with the package, so that the two can be compared. Every
sequence of the ego is tried against every sequence of every surrounding vehicle that pruning leaves (those
are in brute_prediction.py); plain loops, no arrays. Numbers in brackets are the sections, in parentheses the
equations of docs/formulation.md.
"""

import importlib.util
import math
import sys
from pathlib import Path
from typing import NamedTuple


def _beside(name):
    """Load a module of this folder: the tests are no package, so they cannot import one another."""
    spec = importlib.util.spec_from_file_location(f"oracle_{name}", Path(__file__).with_name(f"{name}.py"))
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


prediction = _beside("brute_prediction")
costs = _beside("brute_cost")

MODES = prediction.MODES
DEFAULT_LENGTH, DEFAULT_WIDTH = prediction.DEFAULT_LENGTH, prediction.DEFAULT_WIDTH
setting, lane_centre, lanes_under = prediction.setting, prediction.lane_centre, prediction.lanes_under

# The parts that tests look at one by one.
action_probabilities, retained_sequences = prediction.action_probabilities, prediction.retained_sequences
vehicle_motion, lateral_motion = prediction.vehicle_motion, prediction.lateral_motion
position_sigmas, branch_path = prediction.position_sigmas, prediction.branch_path
branch_risks, water_fill, predict = prediction.branch_risks, prediction.water_fill, prediction.predict
cost_to_go, plan_cost = costs.cost_to_go, costs.plan_cost

DISTANCE_TOLERANCE = 1e-6
SPEED_TOLERANCE = 1e-9

REQUIRED_KEYS = (
    "period_s horizon_steps accel_mps2 speed_min_mps speed_max_mps safe_distance_m risk_level "
    "risk_allocation sequence_threshold maneuver_cost speed_weight desired_speed_mps speed_deadband_mps "
    "lane_weight goal_lane terminal_weight forbidden_lanes "
)
PLANNER_KEYS = {*REQUIRED_KEYS.split(), *prediction.DEFAULTS}


class EgoState(NamedTuple):
    """The ego at the end of a step of a plan, or now."""

    lane: int  # the one it intends
    x: float
    speed: float
    mode: int
    leaving: dict  # lane: at how many more step ends it is still taken up (16)
    lanes: frozenset  # taken up at this instant
    lateral: int = 0  # the action of the step
    violation: float = 0.0  # of the step alone, metres


# ---------------------------------------------------------------------------------------------------------
# The lanes that the ego takes up (16)
# ---------------------------------------------------------------------------------------------------------


def share_at(p):
    """Return the share of a lane change that is done after the share p of its time."""
    return 10.0 * p**3 - 15.0 * p**4 + 6.0 * p**5


def time_share(share):
    """Return p with share_at(p) = share, by bisection."""
    low, high = 0.0, 1.0
    for _ in range(200):
        middle = (low + high) / 2.0
        if share_at(middle) < share:
            low = middle
        else:
            high = middle
    return high


def clearing_share(problem):
    """Return p_c, the share of a lane change's time after which the body has left the old lane."""
    lane_width = problem["lanes"]["width_m"]
    return time_share((lane_width + problem["ego"].get("width_m", DEFAULT_WIDTH)) / (2.0 * lane_width))


def steps_to_leave(problem):
    """Return m, at how many step ends a lane is still taken up that a plan leaves."""
    time = clearing_share(problem) * setting(problem, "lane_change_time_s")
    return max(1, math.ceil(time / problem["planner"]["period_s"]) - 1)


def ego_now(problem):
    """Return the ego's state now, with the lanes of a change under way."""
    ego = problem["ego"]
    leaving, lanes = {}, {ego["lane"]}
    if setting(problem, "occupancy") == "swept":
        target = lane_centre(problem, ego["lane"])
        for lane in lanes_under(problem, ego["y_m"], ego.get("width_m", DEFAULT_WIDTH)) - {ego["lane"]}:
            centre = lane_centre(problem, lane)
            done = min(1.0, abs(ego["y_m"] - centre) / abs(target - centre))
            shares = max(0.0, clearing_share(problem) - time_share(done))
            time = shares * setting(problem, "lane_change_time_s")
            leaving[lane] = max(0, math.ceil(time / problem["planner"]["period_s"]) - 1)
            lanes.add(lane)
    return EgoState(ego["lane"], ego["x_m"], ego["speed_mps"], MODES[ego["mode"]], leaving, frozenset(lanes))


def lanes_after(problem, before, lane):
    """Return (leaving, lanes) of the ego after a step that begins in the state before and intends lane."""
    leaving = {left: count for left, count in before.leaving.items() if count > 0}
    if setting(problem, "occupancy") == "swept" and lane != before.lane:
        leaving[before.lane] = steps_to_leave(problem)
        leaving.pop(lane, None)
    lanes = frozenset(leaving) | {lane}
    return {left: count - 1 for left, count in leaving.items()}, lanes


# ---------------------------------------------------------------------------------------------------------
# Distances and what must hold
# ---------------------------------------------------------------------------------------------------------


def distance(problem, ego_speed, branch, *, ego_is_ahead):
    """Return d between the front bumpers of the ego and a branch (17)."""
    rule, safe = setting(problem, "distance_rule"), problem["planner"]["safe_distance_m"]
    leader_length = problem["ego"].get("length_m", DEFAULT_LENGTH) if ego_is_ahead else branch.length
    if rule == "fixed":
        return safe
    if rule == "time_headway":
        return leader_length + safe + setting(problem, "time_headway_s") * ego_speed
    if rule != "rss":
        raise ValueError(f"the oracle has no distance rule {rule!r}")
    rear, front = (branch.speed, ego_speed) if ego_is_ahead else (ego_speed, branch.speed)
    rho, accel = setting(problem, "rss_response_time_s"), setting(problem, "rss_accel_max_mps2")
    way = rear * rho + accel * rho**2 / 2.0
    way += (rear + rho * accel) ** 2 / (2.0 * setting(problem, "rss_brake_min_mps2"))
    way -= front**2 / (2.0 * setting(problem, "rss_brake_max_mps2"))
    return leader_length + max(0.0, way)


def stopping_place(problem, x, speed, mode):
    """Return where the ego comes to rest that brakes as soon as its mode lets it (23): one level a step."""
    planner = problem["planner"]
    T, accel = planner["period_s"], planner["accel_mps2"]
    while speed > 0.0:
        mode = max(mode - 1, -1)
        if mode == 0:
            x += speed * T
        elif speed < accel * T:
            return x + speed**2 / (2.0 * accel)
        else:
            x += speed * T - accel * T**2 / 2.0
            speed -= accel * T
    return x


def beyond_lines(problem, lane, lanes, place):
    """Return by how many metres a place is beyond the stop lines of an ego that intends a lane and takes up some (23).

    A line has one place for who intends one of its lanes and has not passed that place now, and another for the rest;
    what is behind the ego now counts nothing.
    """
    now, beyond = problem["ego"]["x_m"], 0.0
    for line in problem.get("stop_lines", []):
        if not lanes & set(line["lanes"]):
            continue
        near, far = line["x_m"], line.get("leaving_x_m", line["x_m"])
        for x in [near, far] if lane in line["lanes"] else [far]:
            if now - x <= DISTANCE_TOLERANCE:
                beyond = max(beyond, place - x)
    return beyond if beyond > DISTANCE_TOLERANCE else 0.0


def step_violation(problem, before, lanes, x, speed, branch_steps, beyond_line):
    """Return the metres by which a step of the ego misses the distances it must keep (8, 14); None where it
    touches a branch or passes through one. What it is beyond a stop line counts like a vehicle ahead."""
    ego_length = problem["ego"].get("length_m", DEFAULT_LENGTH)
    short_ahead, short_behind = 0.0, beyond_line
    for branch in branch_steps:
        if branch.lanes.isdisjoint(lanes):
            continue
        ego_is_ahead = x > branch.x
        shared_before = not branch.lanes_before.isdisjoint(before.lanes)
        if shared_before and (before.x > branch.x_before) != ego_is_ahead:
            return None
        need = distance(problem, speed, branch, ego_is_ahead=ego_is_ahead) + branch.z_sigma
        # Where less distance is asked for than the length of the vehicle ahead, touching begins there.
        length = min(need, ego_length if ego_is_ahead else branch.length)
        apart = abs(x - branch.x)
        if apart < length - DISTANCE_TOLERANCE:
            return None
        shortfall = need - apart
        if shortfall <= DISTANCE_TOLERANCE:
            continue
        if ego_is_ahead:
            short_ahead = max(short_ahead, shortfall)
        else:
            short_behind = max(short_behind, shortfall)
    return short_ahead + short_behind


def ego_motion(problem, x, speed, mode, mode_before=0):
    """Return (x, speed) of the ego after a step with the mode AFTER its action, or None outside the limits (11).

    Outside them are also the speeds on the way back: of an ego that brakes, or that has accelerated and cannot brake
    yet; below the least speed likewise (36)."""
    planner = problem["planner"]
    T, accel = planner["period_s"], planner["accel_mps2"]
    stops = setting(problem, "stopping") and planner["speed_min_mps"] == 0.0
    if stops and mode == -1 and speed < accel * T:
        return x + speed**2 / (2.0 * accel), 0.0
    after = speed + mode * accel * T
    too_slow = after < planner["speed_min_mps"] - SPEED_TOLERANCE
    too_fast = after > planner["speed_max_mps"] + SPEED_TOLERANCE
    if too_fast and not (mode == -1 or (mode == 0 and mode_before == 1)):
        return None
    if too_slow and not (mode == 1 or (mode == 0 and mode_before == -1)):
        return None
    return x + speed * T + mode * accel * T**2 / 2.0, after


def drive_on(x, speed, accel, time, top):
    """Return x after a time of accelerating by accel, which ends at rest or at the speed top."""
    until = time
    if accel < 0.0:
        until = min(time, speed / -accel)
        return x + speed * until + accel * until**2 / 2.0
    if accel > 0.0:
        until = min(time, max(0.0, top - speed) / accel)
    after = speed + accel * until
    return x + (speed + after) / 2.0 * until + after * (time - until)


def crosses_a_line(problem, k, lane, lateral):
    """Tell whether the change of step k + 1 may cross a line that must not be crossed [17]."""
    planner, ego = problem["planner"], problem["ego"]
    T, accel, top = planner["period_s"], planner["accel_mps2"], planner["speed_max_mps"]
    end = k * T + setting(problem, "lane_change_time_s")
    rear = drive_on(ego["x_m"], ego["speed_mps"], -accel, k * T, top) - ego.get("length_m", DEFAULT_LENGTH)
    front = drive_on(ego["x_m"], ego["speed_mps"], accel, end, top)
    sides = {"left": -1, "right": 1}
    return any(
        line["lane"] == lane and sides[line["to"]] == lateral and line["x_begin_m"] < front and rear < line["x_end_m"]
        for line in problem.get("no_change", [])
    )


def speed_allowed(problem, k, lane):
    """Return the greatest speed of the ego at the end of step k in a lane by the road's limits [17]."""
    planner, ego = problem["planner"], problem["ego"]
    T, accel = planner["period_s"], planner["accel_mps2"]
    far = drive_on(ego["x_m"], ego["speed_mps"], accel, k * T, planner["speed_max_mps"])
    allowed = math.inf
    for zone in problem.get("speed_zones", []):
        if zone["lane"] == lane and ego["x_m"] < zone["x_end_m"]:
            # v^2 = u^2 + 2 (accel / 2) d
            allowed = min(allowed, math.sqrt(zone["speed_mps"] ** 2 + accel * max(0.0, zone["x_begin_m"] - far)))
    if lane != ego["lane"]:
        return allowed
    speed, mode = ego["speed_mps"], MODES[ego["mode"]]
    for _ in range(k):
        mode = max(-1, mode - 1)
        moved = ego_motion(problem, 0.0, speed, mode)
        speed = speed if moved is None else moved[1]
    return max(allowed, speed)


def ego_step(problem, branch_steps, before, lateral, mode, *, last, k):
    """Return the EgoState after the action of step k, or None where it is not admissible, touches a vehicle or passes
    through one [6, 7]. At the last step the ego must be able to stop before its lines."""
    lane = before.lane + lateral
    if not 1 <= lane <= problem["lanes"]["count"] or lane in problem["planner"]["forbidden_lanes"]:
        return None
    if abs(mode - before.mode) > 1:
        return None
    moved = ego_motion(problem, before.x, before.speed, mode, before.mode)
    if moved is None:
        return None
    x, speed = moved
    if crosses_a_line(problem, k - 1, before.lane, lateral):
        return None
    if speed > speed_allowed(problem, k, lane) + SPEED_TOLERANCE:
        return None
    leaving, lanes = lanes_after(problem, before, lane)
    beyond = beyond_lines(problem, lane, lanes, stopping_place(problem, x, speed, mode) if last else x)
    violation = step_violation(problem, before, lanes, x, speed, branch_steps, beyond)
    if violation is None:
        return None
    return EgoState(lane, x, speed, mode, leaving, lanes, lateral, violation)


# ---------------------------------------------------------------------------------------------------------
# The decision
# ---------------------------------------------------------------------------------------------------------


def total_violation(plan):
    """Return the metres a plan misses over all its steps."""
    return sum(step.violation for step in plan)


def all_plans(problem, steps):
    """Return the plans (lists of EgoState) that neither touch nor pass through a vehicle and whose violation is
    the least of all such plans, within the tolerance. A plan in the making that already exceeds the least
    violation found so far is given up."""
    horizon = problem["planner"]["horizon_steps"]
    found, least = [], math.inf

    def extend(plan, state, violation):
        nonlocal least
        if violation > least + DISTANCE_TOLERANCE:
            return
        if len(plan) == horizon:
            found.append(plan)
            least = min(least, violation)
            return
        for lateral in (0, -1, 1):
            for mode in (0, 1, -1):
                last = len(plan) == horizon - 1
                k = len(plan) + 1
                step = ego_step(problem, steps[k], state, lateral, mode, last=last, k=k)
                if step is not None:
                    extend([*plan, step], step, violation + step.violation)

    extend([], ego_now(problem), 0.0)
    return [plan for plan in found if total_violation(plan) <= least + DISTANCE_TOLERANCE]


def check_keys(problem):
    """Refuse what the oracle has no rule for, instead of answering another problem."""
    unknown = set(problem["planner"]) - PLANNER_KEYS
    if unknown:
        raise ValueError(f"the oracle has no rule for {sorted(unknown)}")


def solve(problem):
    """Solve a decision problem by brute force.

    Returns a dict: status ("optimal", "relaxed", "fallback", or "error" where the risk budget cannot be met),
    objective (None without a plan), violation_m, lateral and longitudinal (the plan's lateral actions and modes,
    or empty), branches and pruned_prob ({vehicle id: number of retained sequences} and {vehicle id:
    probability pruned}).
    """
    check_keys(problem)
    planner = problem["planner"]
    nothing = {"objective": None, "violation_m": 0.0, "lateral": [], "longitudinal": []}
    try:
        steps, branches, pruned = predict(problem)
    except prediction.BudgetError:
        return nothing | {"status": "error", "branches": {}, "pruned_prob": {}}
    answer = nothing | {"branches": branches, "pruned_prob": pruned}
    plans = all_plans(problem, steps)
    if not plans:
        return answer | {"status": "fallback"}
    kept = [plan for plan in plans if total_violation(plan) == 0.0]
    best = min(kept or plans, key=lambda plan: plan_cost(planner, plan))
    return answer | {
        "status": "optimal" if kept else "relaxed",
        "objective": plan_cost(planner, best),
        "violation_m": total_violation(best),
        "lateral": [step.lateral for step in best],
        "longitudinal": [step.mode for step in best],
    }


def follow(problem, lateral, longitudinal):
    """Return the states of a given plan, from now to its last step; None where it is not admissible, touches a
    vehicle or passes through one."""
    check_keys(problem)
    horizon = problem["planner"]["horizon_steps"]
    if len(lateral) != horizon or len(longitudinal) != horizon:
        raise ValueError(f"a plan has {horizon} steps")
    branch_steps = predict(problem)[0][1:]
    states = [ego_now(problem)]
    for k in range(horizon):
        last = k == horizon - 1
        step = ego_step(problem, branch_steps[k], states[-1], lateral[k], longitudinal[k], last=last, k=k + 1)
        if step is None:
            return None
        states.append(step)
    return states


def evaluate(problem, lateral, longitudinal):
    """Judge a given plan, by its lateral actions and modes.

    Returns {"violation_m", "objective"}, or None where the plan is not admissible, touches a vehicle or
    passes through one. The plan is feasible where violation_m is 0.
    """
    states = follow(problem, lateral, longitudinal)
    if states is None:
        return None
    plan = states[1:]
    return {"violation_m": total_violation(plan), "objective": plan_cost(problem["planner"], plan)}
