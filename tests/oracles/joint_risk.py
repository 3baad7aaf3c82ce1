"""How often a plan's distances are violated in sampled worlds: the joint chance constraint, counted.

A world is one sampled sequence of actions of every vehicle, from its whole policy (nothing pruned), and one sampled
path of its noise, step by step. A world is violated if at any step the ego and a vehicle take up a common lane with
less than d between them, on the side on which the ego is of the vehicle's mean.
"""

import copy

import numpy as np
from scipy.stats import binom

RULES = ("uniform", "mixture", "individual")


def draw_problem(general_problems, rng):
    """Draw a problem with 1 to 6 vehicles whose uncertainty counts; its rule is left to be set."""
    horizon = int(rng.choice([1, 2, 3, 4], p=[0.2, 0.3, 0.3, 0.2]))
    vehicles = int(rng.integers(1, 7 if horizon < 4 else 4))
    problem = general_problems.random_general_problem(
        rng, horizon=horizon, vehicles=vehicles, risk_allocation="mixture"
    )
    problem["planner"]["risk_level"] = float(rng.choice([0.01, 0.05, 0.1, 0.3]))
    for vehicle in problem["vehicles"]:
        vehicle["position_var_m2"] = float(rng.choice([0.0, 0.1, 1.0]))
        vehicle["process_position_var_m2"] = float(rng.choice([0.05, 0.5]))
        vehicle["process_speed_var_m2ps2"] = float(rng.choice([0.0, 0.1]))
    return problem


def with_rule(problem, rule):
    """Return the problem under a risk rule, what pruning drops accounted for."""
    return problem | {"planner": problem["planner"] | {"risk_allocation": rule, "account_pruned": True}}


def slack(brute_force, problem, vehicle, states):
    """Return (the least room beyond (8) to a branch of a vehicle, on which side), None where they share no lane
    or the plan has branches on both sides."""
    prediction, rooms = brute_force.prediction, []
    sequences = prediction.retained_sequences(problem, vehicle)
    sigmas = prediction.position_sigmas(problem, vehicle)
    for (_, actions), eps in zip(sequences, prediction.branch_risks(problem, sequences), strict=True):
        z = -prediction.NormalDist().inv_cdf(eps)
        path = prediction.branch_path(problem, vehicle, actions, z, z)
        for k in range(1, len(path)):
            lanes, x, speed = path[k]
            ego = states[k]
            if lanes.isdisjoint(ego.lanes):
                continue
            length = vehicle.get("length_m", prediction.DEFAULT_LENGTH)
            branch = prediction.BranchStep(lanes, x, lanes, x, speed, length, z * sigmas[k - 1])
            ahead = ego.x > x
            need = brute_force.distance(problem, ego.speed, branch, ego_is_ahead=ahead) + branch.z_sigma
            rooms.append((abs(ego.x - x) - need, ahead))
    if len({ahead for _, ahead in rooms}) != 1:
        return None
    return min(rooms)


def tightened(brute_force, problem, states):
    """Return the problem with every vehicle moved so near that the plan sits on its chance constraint."""
    tight = copy.deepcopy(problem)
    for vehicle in tight["vehicles"]:
        room = slack(brute_force, problem, vehicle, states)
        if room is not None:
            vehicle["x_m"] += room[0] if room[1] else -room[0]
    return tight


def count_violations(brute_force, problem, states, rng, samples):
    """Return in how many of the sampled worlds the plan's distances are violated."""
    violated = np.zeros(samples, dtype=bool)
    for vehicle in problem["vehicles"]:
        violated |= _violated(brute_force, problem, vehicle, states, rng, samples)
    return int(violated.sum())


def _violated(brute_force, problem, vehicle, states, rng, samples):
    planner = problem["planner"]
    T, accel = planner["period_s"], planner["accel_mps2"]
    swept = planner.get("occupancy") == "swept"
    width, lanes_there = problem["lanes"]["width_m"], problem["lanes"]["count"]
    reach = (width + vehicle.get("width_m", 1.8)) / 2
    lane = np.full(samples, vehicle["lane"])
    mode = np.full(samples, {"accelerate": 1, "cruise": 0, "decelerate": -1}[vehicle["mode"]])
    mean, speed = np.full(samples, float(vehicle["x_m"])), np.full(samples, float(vehicle["speed_mps"]))
    across = _Across(brute_force, problem, vehicle, samples, rng)
    x_error = rng.normal(0.0, np.sqrt(vehicle["position_var_m2"]), samples)
    v_error = rng.normal(0.0, np.sqrt(vehicle["speed_var_m2ps2"]), samples)
    violated = np.zeros(samples, dtype=bool)
    for ego in states[1:]:
        lateral, change = _actions(brute_force, problem, vehicle, lane, mode, rng)
        rests = (mode == -1) & (speed < accel * T)
        mean = mean + np.where(rests, speed**2 / (2 * accel), speed * T + mode * accel * T**2 / 2)
        speed = np.where(rests, 0.0, speed + mode * accel * T)
        x_error = x_error + T * v_error + rng.normal(0.0, np.sqrt(vehicle["process_position_var_m2"]), samples)
        v_error = v_error + rng.normal(0.0, np.sqrt(vehicle["process_speed_var_m2ps2"]), samples)
        lane, mode = lane + lateral, mode + change
        y = across.step(lateral, ((lanes_there + 1) / 2 - lane) * width)
        shared = np.isin(lane, list(ego.lanes))
        if swept:
            for other in ego.lanes:
                shared |= np.abs(y - ((lanes_there + 1) / 2 - other) * width) < reach
        ahead = ego.x > mean
        apart = np.where(ahead, 1, -1) * (ego.x - mean - x_error)
        violated |= shared & (apart < _distance(problem, vehicle, ego.speed, speed, ahead))
    return violated


class _Across:
    """Samples of a vehicle's y: a path toward the centre of its lane, and a deviation that decays and is stirred.

    By the paper's law only the mean moves: its constraints know no place across the road.
    """

    def __init__(self, brute_force, problem, vehicle, samples, rng):
        self.gains, self.T = brute_force.prediction.gains(problem), problem["planner"]["period_s"]
        self.rng, self.samples = rng, samples
        start = brute_force.prediction.lateral_places(problem, vehicle, [0])
        self.y = np.full(samples, start[0])
        self.y_speed = np.full(samples, vehicle.get("lateral_speed_mps", 0.0))
        if self.gains is None:
            self.left = np.exp(-self.T / vehicle.get("lane_keeping_time_s", 2.0))
            self.reach = problem["lanes"]["width_m"] / vehicle.get("lane_change_time_s", 4.0) * self.T
            center = brute_force.lane_centre(problem, vehicle["lane"])
            # A deviation decays by its rate; what moves otherwise is a lane change.
            keeps = np.isclose(start[1] - center, self.left * (start[0] - center), rtol=0.0, atol=1e-9)
            self.path = np.full(samples, center if keeps else start[0])
            measured = vehicle.get("lateral_var_m2", vehicle["position_var_m2"])
            self.deviation = self.y - self.path + rng.normal(0.0, np.sqrt(measured), samples)
            self.stirring = np.sqrt(vehicle.get("process_lateral_var_m2", 0.0))

    def step(self, lateral, y_ref):
        if self.gains is not None:
            (K1, K2), half = self.gains, self.T**2 / 2
            pulled = (1 - K1 * half) * self.y + half * (K1 * y_ref - K2 * self.y_speed)
            after = np.where(lateral == 0, self.y, pulled)
            self.y, self.y_speed = after, (after - self.y) / self.T
            return self.y
        to_go = y_ref - self.path
        self.path = np.where(np.abs(to_go) <= self.reach, y_ref, self.path + np.sign(to_go) * self.reach)
        self.deviation = self.left * self.deviation + self.stirring * self.rng.normal(0.0, 1.0, self.samples)
        return self.path + self.deviation


def _actions(brute_force, problem, vehicle, lane, mode, rng):
    """Sample an action for each of many states."""
    lateral, change = np.zeros_like(lane), np.zeros_like(mode)
    for state in np.unique(np.stack([lane, mode], axis=1), axis=0):
        here = np.flatnonzero((lane == state[0]) & (mode == state[1]))
        table = brute_force.action_probabilities(problem, vehicle, int(state[0]), int(state[1]))
        chosen = np.array(list(table))[rng.choice(len(table), size=len(here), p=list(table.values()))]
        lateral[here], change[here] = chosen[:, 0], chosen[:, 1]
    return lateral, change


def _distance(problem, vehicle, ego_speed, speed, ahead):
    planner = problem["planner"]
    rule = planner.get("distance_rule", "fixed")
    if rule == "fixed":
        return planner["safe_distance_m"]
    length = np.where(ahead, problem["ego"].get("length_m", 4.5), vehicle.get("length_m", 4.5))
    if rule == "time_headway":
        return length + planner["safe_distance_m"] + planner["time_headway_s"] * ego_speed
    rear, front = np.where(ahead, speed, ego_speed), np.where(ahead, ego_speed, speed)
    rho, accel = planner["rss_response_time_s"], planner["rss_accel_max_mps2"]
    way = rear * rho + accel * rho**2 / 2 + (rear + rho * accel) ** 2 / (2 * planner["rss_brake_min_mps2"])
    return length + np.maximum(0.0, way - front**2 / (2 * planner["rss_brake_max_mps2"]))


def within_bound(violations, samples, risk_level, doubt):
    """Tell whether so many violations are believable where each world has at most probability risk_level."""
    return violations <= binom.isf(doubt, samples, risk_level)


def planned(brute_force, agreement, problem):
    """Return the states of the plan that the package finds optimal, None where there is none."""
    found = agreement.package_answer(problem, "search")
    if found is None or str(found.status) != "optimal":
        return None
    states = brute_force.follow(problem, [int(s.lateral) for s in found.plan], [int(s.mode) for s in found.plan])
    if states is None or any(state.violation > 0.0 for state in states):
        raise AssertionError("the oracle refuses a plan that the package calls optimal")
    return states


def measure(brute_force, agreement, problem, rng, samples):
    """Return (violations, whether a vehicle is at its limit) of the plan for a problem whose vehicles have been
    moved up to the plan; None where no plan is optimal."""
    states = planned(brute_force, agreement, problem)
    if states is None:
        return None
    tight = tightened(brute_force, problem, states)
    moved_up = planned(brute_force, agreement, tight)
    if moved_up is not None:
        problem, states = tight, moved_up
    rooms = [slack(brute_force, problem, vehicle, states) for vehicle in problem["vehicles"]]
    at_limit = any(room is not None and abs(room[0]) < 1e-5 for room in rooms)
    return count_violations(brute_force, problem, states, rng, samples), at_limit
