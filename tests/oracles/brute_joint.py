"""Brute force for the rule `joint`: the risk of a whole plan, and the cheapest plan whose risk is within the level.

Written from the formulas alone and sharing no code with the package; plain loops, no arrays. Every plan of the ego
is tried. A vehicle may do whatever its policy allows: nothing is pruned, so the thresholds of a problem count
nothing here. Its policy factorises into lateral actions and modes, which are therefore enumerated apart.

For vehicle i, step k, the lanes f that the ego takes up there and those, f', of the step before:

    L_ik(f)     = P(i takes up a lane of f at k)
    J_ik(f', f) = P(i takes up a lane of f' at k-1, and one of f at k)
    Pa, Pb, N   = the probabilities that the ego keeps its distance ahead of i, behind i, or neither
    risk        = sum over i, k of max(0, L E[N_k] + J E[Pa_k-1 Pb_k + Pb_k-1 Pa_k - N_k-1 N_k])

with expectations over the sequences of modes. A plan here is a tuple of (lateral action, mode) for each step.
"""

import importlib.util
import math
import sys
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple


def _beside(name):
    """Load a module of this folder: the tests are no package, so they cannot import one another."""
    spec = importlib.util.spec_from_file_location(f"oracle_joint_{name}", Path(__file__).with_name(f"{name}.py"))
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


brute_force = _beside("brute_force")
vehicles = _beside("brute_joint_prediction")
prediction, costs = brute_force.prediction, brute_force.costs
setting = brute_force.setting

# The parts that the sampler and tests look at one by one.
lateral_law, lateral_sequences = vehicles.lateral_law, vehicles.lateral_sequences
measured_variance = vehicles.measured_variance
mode_sequences, mean_path, mode_moves = vehicles.mode_sequences, vehicles.mean_path, vehicles.mode_moves

DISTANCE_SLACK = 1e-6  # metres by which a distance may be missed
RISK_SLACK = 1e-9  # by which the risk level may be exceeded, and within which risks are equal
COST_SLACK = 1e-6  # within which costs are equal
KEY_DECIMALS = vehicles.KEY_DECIMALS

LATERAL_ORDER = (0, -1, 1)  # keep, left, right
MODE_ORDER = (0, 1, -1)  # cruise, accelerate, decelerate


def normal_cdf(z):
    """Return Phi(z)."""
    return math.erfc(-z / math.sqrt(2.0)) / 2.0


# ---------------------------------------------------------------------------------------------------------
# Lanes and distances
# ---------------------------------------------------------------------------------------------------------


def lane_intervals(problem, footprint, width):
    """Return the intervals in which the middle of a body is over a lane of the footprint: one where its lanes are
    side by side."""
    reach = (problem["lanes"]["width_m"] + width) / 2.0
    intervals = []
    for centre in sorted(brute_force.lane_centre(problem, lane) for lane in footprint):
        if intervals and centre - reach < intervals[-1][1]:
            intervals[-1][1] = centre + reach
        else:
            intervals.append([centre - reach, centre + reach])
    return intervals


def taken(problem, vehicle, footprint, lane, y, var):
    """Return the probability that a vehicle that intends a lane takes up one of the footprint."""
    if lane in footprint:
        return 1.0
    if setting(problem, "occupancy") == "target":
        return 0.0
    width = vehicle.get("width_m", brute_force.DEFAULT_WIDTH)
    if var == 0.0:
        return 0.0 if brute_force.lanes_under(problem, y, width).isdisjoint(footprint) else 1.0
    sigma = math.sqrt(var)
    intervals = lane_intervals(problem, footprint, width)
    return math.fsum(normal_cdf((high - y) / sigma) - normal_cdf((low - y) / sigma) for low, high in intervals)


class Other(NamedTuple):
    """What a distance depends on."""

    speed: float
    length: float


def distances(problem, ego_speed, vehicle, speed):
    """Return (d_a, d_b), what must be kept ahead of and behind a vehicle, less the slack."""
    other = Other(speed, vehicle.get("length_m", brute_force.DEFAULT_LENGTH))
    pair = [brute_force.distance(problem, ego_speed, other, ego_is_ahead=ahead) for ahead in (True, False)]
    if min(pair) < DISTANCE_SLACK:
        raise ValueError("the oracle has no rule for a distance of 0: the ego would be ahead and behind at once")
    return pair[0] - DISTANCE_SLACK, pair[1] - DISTANCE_SLACK


def sides(problem, ego, vehicle, place, sigma):
    """Return (Pa, Pb, N) of an ego with x and speed against a vehicle's mean x and speed."""
    mean, speed = place
    d_ahead, d_behind = distances(problem, ego.speed, vehicle, speed)
    low, high = ego.x - d_ahead - mean, ego.x + d_behind - mean
    if sigma == 0.0:
        ahead, behind = float(low >= 0.0), float(high <= 0.0)
    else:
        ahead, behind = normal_cdf(low / sigma), normal_cdf(-high / sigma)
    return ahead, behind, 1.0 - ahead - behind


class Ego(NamedTuple):
    """The ego's motion at the end of a step, or now."""

    mode: int
    x: float
    speed: float


class Crowd:
    """The vehicles of a problem: what each adds to the risk of a step of the ego. Nothing is computed twice."""

    def __init__(self, problem):
        self.problem, self.vehicles = problem, problem["vehicles"]
        self.across = [lateral_sequences(problem, vehicle) for vehicle in self.vehicles]
        self.moves = [mode_moves(problem, vehicle) for vehicle in self.vehicles]
        self.sigmas = [[0.0, *prediction.position_sigmas(problem, vehicle)] for vehicle in self.vehicles]
        self.known = {}

    def _once(self, work, *key):
        key = (work.__name__, *key)
        if key not in self.known:
            self.known[key] = work(*key[1:])
        return self.known[key]

    def _taken(self, i, k, footprint):
        """The taken of each lateral sequence at k. The present body is known exactly."""
        return [
            taken(self.problem, self.vehicles[i], footprint, step.lane, step.y, step.var if k > 0 else 0.0)
            for step in self.across[i][k]
        ]

    def _shares(self, i, k, before, after):
        """L and J."""
        now, earlier = self._once(self._taken, i, k, after), self._once(self._taken, i, k - 1, before)
        steps = self.across[i][k]
        alone = math.fsum(step.prob * here for step, here in zip(steps, now, strict=True))
        both = math.fsum(step.prob * earlier[step.parent] * here for step, here in zip(steps, now, strict=True))
        return alone, both

    def _sides(self, i, k, ego, place):
        if k == 0:
            ahead = float(ego.x > place[0])
            return ahead, 1.0 - ahead, 0.0
        return sides(self.problem, ego, self.vehicles[i], place, self.sigmas[i][k])

    def _expectations(self, i, k, before, after):
        """E[N_k] and E[Pa_k-1 Pb_k + Pb_k-1 Pa_k - N_k-1 N_k]."""
        short, pair = 0.0, 0.0
        for prob, place_before, place in self.moves[i][k]:
            ahead0, behind0, short0 = self._once(self._sides, i, k - 1, before, place_before)
            ahead1, behind1, short1 = self._once(self._sides, i, k, after, place)
            short += prob * short1
            pair += prob * (ahead0 * behind1 + behind0 * ahead1 - short0 * short1)
        return short, pair

    def contribution(self, i, k, lanes_before, lanes, ego_before, ego):
        """Return what vehicle i adds to the risk in step k."""
        alone, both = self._once(self._shares, i, k, lanes_before, lanes)
        if alone == 0.0:
            return 0.0
        short, pair = self._once(self._expectations, i, k, ego_before, ego)
        return max(0.0, alone * short + both * pair)

    def _step(self, *step):
        return math.fsum(self.contribution(i, *step) for i in range(len(self.vehicles)))

    def step_risk(self, k, lanes_before, lanes, ego_before, ego):
        """Return what all vehicles add to the risk in step k."""
        return self._once(self._step, k, lanes_before, lanes, ego_before, ego)


# ---------------------------------------------------------------------------------------------------------
# The ego's plans
# ---------------------------------------------------------------------------------------------------------


class Road(NamedTuple):
    """The lanes of the ego at the end of a step, or now: the one it intends, those it is leaving, all it takes up."""

    lane: int
    leaving: tuple
    lanes: frozenset


class Plans:
    """The admissible plans of a problem's ego, step by step."""

    def __init__(self, problem):
        brute_force.check_keys(problem)
        self.problem, self.known = problem, {}
        now = brute_force.ego_now(problem)
        self.road = Road(now.lane, tuple(now.leaving.items()), now.lanes)
        self.ego = Ego(now.mode, now.x, now.speed)

    def turn(self, road, lateral):
        """Return the lanes after an action, or None where there is no such lane or it is forbidden."""
        key = (road, lateral)
        if key not in self.known:
            lane = road.lane + lateral
            before = brute_force.EgoState(road.lane, 0.0, 0.0, 0, dict(road.leaving), road.lanes)
            after = None
            if 1 <= lane <= self.problem["lanes"]["count"] and lane not in self.problem["planner"]["forbidden_lanes"]:
                leaving, lanes = brute_force.lanes_after(self.problem, before, lane)
                after = Road(lane, tuple(leaving.items()), lanes)
            self.known[key] = after
        return self.known[key]

    def drive(self, ego, mode):
        """Return the motion after a step in a mode, or None where the mode or the speed is not admissible."""
        key = (ego, mode)
        if key not in self.known:
            moved = None if abs(mode - ego.mode) > 1 else brute_force.ego_motion(self.problem, ego.x, ego.speed, mode)
            after = None if moved is None else Ego(mode, *moved)
            if after is not None:
                after = self.known.setdefault(tuple(round(number, KEY_DECIMALS) for number in after), after)
            self.known[key] = after
        return self.known[key]

    def keeps_lines(self, road, ego, *, last):
        """Tell whether the ego is before its stop lines; at the last step, whether it can stop before them."""
        if not self.problem.get("stop_lines"):
            return True
        key = (road, ego, last)
        if key not in self.known:
            place = brute_force.stopping_place(self.problem, ego.x, ego.speed, ego.mode) if last else ego.x
            self.known[key] = brute_force.beyond_lines(self.problem, road.lane, road.lanes, place) == 0.0
        return self.known[key]

    def step(self, road, ego, lateral, mode, *, last):
        """Return (road, ego) after a step, or None where it is not admissible."""
        road, ego = self.turn(road, lateral), self.drive(ego, mode)
        if road is None or ego is None or not self.keeps_lines(road, ego, last=last):
            return None
        return road, ego

    def follow(self, plan):
        """Return [(road, ego)] of a plan at k = 0..H, or None where it is not admissible."""
        if len(plan) != self.problem["planner"]["horizon_steps"]:
            raise ValueError(f"a plan has {self.problem['planner']['horizon_steps']} steps")
        states = [(self.road, self.ego)]
        for k, (lateral, mode) in enumerate(plan, start=1):
            after = self.step(*states[-1], lateral, mode, last=k == len(plan))
            if after is None:
                return None
            states.append(after)
        return states


def all_plans(problem):
    """Return [(cost, risk, plan)] of every admissible plan, in the order that decides between equals."""
    planner, plans, crowd = problem["planner"], Plans(problem), Crowd(problem)
    horizon, found, known = planner["horizon_steps"], [], {}

    def remember(work, *arguments):
        if arguments not in known:
            known[arguments] = work(planner, *arguments)
        return known[arguments]

    def extend(plan, road, ego, cost, risk):
        k = len(plan) + 1
        for lateral in LATERAL_ORDER:
            if plans.turn(road, lateral) is None:
                continue
            for mode in MODE_ORDER:
                after = plans.step(road, ego, lateral, mode, last=k == horizon)
                if after is None:
                    continue
                new_road, new_ego = after
                new_cost = cost + remember(costs.stage_cost, lateral, mode, new_road.lane, new_ego.speed)
                new_risk = risk + crowd.step_risk(k, road.lanes, new_road.lanes, ego, new_ego)
                longer = (*plan, (lateral, mode))
                if k < horizon:
                    extend(longer, new_road, new_ego, new_cost, new_risk)
                    continue
                if planner["terminal_weight"] > 0.0:
                    to_go = remember(costs.cost_to_go, new_road.lane, new_ego.speed, mode)
                    new_cost += planner["terminal_weight"] * to_go
                found.append((new_cost, new_risk, longer))

    extend((), plans.road, plans.ego, 0.0, 0.0)
    return found


def choose(plans, risk_level):
    """Return the (cost, risk, plan) that the rule takes, None where none is within the risk level."""
    within = [entry for entry in plans if entry[1] <= risk_level + RISK_SLACK]
    if not within:
        return None
    least_cost = min(cost for cost, _, _ in within)
    cheapest = [entry for entry in within if entry[0] <= least_cost + COST_SLACK]
    least_risk = min(risk for _, risk, _ in cheapest)
    # The order in which plans are enumerated is the one that decides between equals.
    return next(entry for entry in cheapest if entry[1] <= least_risk + RISK_SLACK)


def plan_risk(problem, plan):
    """Return {"risk", "by_vehicle": {id: its part}, "by_step": [the part of steps 1..H]} of a plan, or None where
    the plan is not admissible."""
    states = Plans(problem).follow(plan)
    if states is None:
        return None
    crowd, count = Crowd(problem), len(problem["vehicles"])
    parts = []  # a row for each step, a column for each vehicle
    for k, ((road0, ego0), (road, ego)) in enumerate(pairwise(states), start=1):
        parts.append([crowd.contribution(i, k, road0.lanes, road.lanes, ego0, ego) for i in range(count)])
    return {
        "risk": math.fsum(part for row in parts for part in row),
        "by_vehicle": {v["id"]: math.fsum(row[i] for row in parts) for i, v in enumerate(problem["vehicles"])},
        "by_step": [math.fsum(row) for row in parts],
    }


def solve(problem, *, everything=False):
    """Solve a decision problem under the rule `joint` by brute force.

    Returns a dict: status ("optimal"; "relaxed" where the least risk of all plans exceeds the risk level; "none"
    where lanes, limits and lines leave no plan at all), objective, risk_taken, sequence (the plan), by_vehicle
    ({id: its part of the risk}), which are None unless optimal, risk_least (None without a plan), and with
    `everything` plans, [(cost, risk, plan)].
    """
    plans = all_plans(problem)
    answer = {"status": "none", "objective": None, "risk_taken": None, "sequence": None, "by_vehicle": None}
    answer["risk_least"] = min((risk for _, risk, _ in plans), default=None)
    if plans:
        answer["status"] = "relaxed"
        chosen = choose(plans, problem["planner"]["risk_level"])
        if chosen is not None:
            answer["status"] = "optimal"
            answer["objective"], answer["risk_taken"], answer["sequence"] = chosen
            answer["by_vehicle"] = plan_risk(problem, answer["sequence"])["by_vehicle"]
    return answer | ({"plans": plans} if everything else {})
