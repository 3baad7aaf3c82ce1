"""Random small decision problems, all of them valid, that reach every rule of the problem.

The scenes: `open` (room to spare), `dense` (distances bind), `packed` (many relaxed plans and fallbacks),
`closing` (speed differences that could carry the ego through a vehicle between two steps), `edge` (distances
and sequence probabilities exactly at their limit, which rounding must not turn into a violation).
"""

import math

MODES = ("accelerate", "cruise", "decelerate")
LATERALS = ("left", "keep", "right")
MODE_LEVEL = {"accelerate": 1, "cruise": 0, "decelerate": -1}
LATERAL_STEP = {"left": -1, "keep": 0, "right": 1}
PAPER_COST = [[6, 5, 6], [2, 0, 2], [11, 9, 11]]
SCENES = {"open": 0.25, "dense": 0.35, "packed": 0.2, "closing": 0.1, "edge": 0.1}

# Products of 0.7 and 0.3, not all of which floating-point numbers reach from above.
EDGE_THRESHOLDS = [0.3, 0.7, 0.49, 0.21, 0.09, 0.343, 0.147, 0.063]


def random_problem(rng, *, scene=None, horizon=None, vehicles=None, lanes=None):
    """Draw a problem from a numpy Generator; what is given is not drawn.

    Arguments: scene (a key of SCENES), horizon (steps), vehicles and lanes (how many of them).
    """
    scene = scene or _pick(rng, list(SCENES), list(SCENES.values()))
    horizon = horizon or _pick(rng, [1, 2, 3, 4, 5], [0.15, 0.3, 0.37, 0.15, 0.03])
    most_vehicles = 5 if horizon <= 3 else 3
    if vehicles is None:
        first = {"open": 0, "dense": 2, "packed": 2, "closing": 1, "edge": 1}[scene]
        vehicles = int(rng.integers(first, most_vehicles + 1))
    lanes = lanes or _pick(rng, [1, 2, 3, 4], [0.15, 0.25, 0.45, 0.15])
    width = _pick(rng, [3.5, 4.0])
    planner = _planner(rng, scene, horizon, lanes)
    ego = _ego(rng, planner, lanes, width)
    problem = {
        "lanes": {"count": lanes, "width_m": width},
        "planner": planner,
        "ego": ego,
        "vehicles": [],
    }
    if scene == "edge":
        planner["sequence_threshold"] = _pick(rng, EDGE_THRESHOLDS)
    for number in range(1, vehicles + 1):
        problem["vehicles"].append(_vehicle(rng, problem, scene, f"sv{number}"))
    return problem


def dead_state(problem):
    """Return what is wrong with the first state that a vehicle can reach and cannot leave, or None."""
    count = problem["lanes"]["count"]
    for vehicle in problem["vehicles"]:
        start = (vehicle["lane"], MODE_LEVEL[vehicle["mode"]])
        reached, todo = {start}, [start]
        while todo:
            lane, mode = todo.pop()
            table = vehicle["lateral_probs"]
            table = table.get(str(lane), table)
            successors = {
                (lane + LATERAL_STEP[lateral], MODE_LEVEL[name])
                for lateral in LATERALS
                for name in MODES
                if 1 <= lane + LATERAL_STEP[lateral] <= count
                and abs(MODE_LEVEL[name] - mode) <= 1
                and table[lateral] * vehicle["longitudinal_probs"][name] > 0.0
            }
            if not successors:
                return f"{vehicle['id']}: nothing to do in lane {lane}, mode {mode}"
            todo.extend(successors - reached)
            reached |= successors
    return None


def _pick(rng, options, weights=None):
    return options[int(rng.choice(len(options), p=weights))]


def _uniform(rng, low, high, decimals=2):
    return round(float(rng.uniform(low, high)), decimals)


def _chance(rng, probability):
    return bool(rng.random() < probability)


def _planner(rng, scene, horizon, lanes):
    period = _pick(rng, [0.8, 1.0] if scene == "closing" else [0.4, 0.5, 0.6, 0.8, 1.0])
    accel = _pick(rng, [2.0, 2.0, 1.5, 3.0, 2.5])
    half_speed_step = math.ceil(accel * period / 2.0 * 100.0 - 1e-6) / 100.0
    terminal_weight = _pick(rng, [0.0, 1.0, 1.5])
    deadband = round(half_speed_step * _pick(rng, [1.0, 1.25, 1.6, 2.0]), 2)
    if terminal_weight == 0.0 and _chance(rng, 0.3):
        deadband = _pick(rng, [0.0, 0.1])
    speed_min = _pick(rng, [0.0, 2.0, 10.0], [0.8, 0.1, 0.1])
    speed_max = _pick(rng, [15.0, 25.0, 40.0])
    goal_lane = None if _chance(rng, 0.35) else int(rng.integers(1, lanes + 1))
    forbidden = []
    if lanes > 1 and _chance(rng, 0.25):
        forbidden = [lane for lane in range(1, lanes + 1) if lane != goal_lane and _chance(rng, 0.4)]
        if len(forbidden) == lanes:
            forbidden = forbidden[1:]
    thresholds = [1e-5, 1e-3, 0.02, 0.1, 0.2, 0.3]
    distances = [6.0, 15.0, 40.0, 75.0]
    if scene in {"packed", "closing"}:
        distances = [6.0, 8.5] if scene == "closing" else [6.0, 8.5, 15.0]
    cost = PAPER_COST
    if _chance(rng, 0.3):
        cost = [[_uniform(rng, 0.0, 12.0, 1) for _ in LATERALS] for _ in MODES]
    return {
        "period_s": period,
        "horizon_steps": horizon,
        "accel_mps2": accel,
        "speed_min_mps": speed_min,
        "speed_max_mps": speed_max,
        "safe_distance_m": _pick(rng, distances),
        "risk_level": _pick(rng, [0.001, 0.01, 0.05, 0.2, 0.5]),
        "risk_allocation": _pick(rng, ["individual", "uniform"]),
        # Long horizons with hardly any pruning have too many branches for a brute force.
        "sequence_threshold": _pick(rng, thresholds if horizon <= 3 else thresholds[1:]),
        "maneuver_cost": [list(row) for row in cost],
        "speed_weight": _pick(rng, [0.0, 0.7, 3.1]),
        "desired_speed_mps": _uniform(rng, speed_min, speed_max),
        "speed_deadband_mps": deadband,
        "lane_weight": _pick(rng, [0.0, 0.3, 4.0]),
        "goal_lane": goal_lane,
        "terminal_weight": terminal_weight,
        "forbidden_lanes": forbidden,
    }


def _ego(rng, planner, lanes, width):
    low, high = planner["speed_min_mps"], planner["speed_max_mps"]
    steps = int(rng.integers(0, 4)) * planner["accel_mps2"] * planner["period_s"]
    speed = {
        "slow": _uniform(rng, low, low + 3.0),
        "fast": _uniform(rng, high - 3.0, high),
        "any": _uniform(rng, low, high),
        "limit": round(_pick(rng, [low + steps, high - steps]), 2),
        "desired": min(high, max(low, round(planner["desired_speed_mps"] + _uniform(rng, -3.0, 3.0), 2))),
    }[_pick(rng, ["slow", "fast", "any", "limit", "desired"], [0.15, 0.15, 0.25, 0.15, 0.3])]
    allowed = [lane for lane in range(1, lanes + 1) if lane not in planner["forbidden_lanes"]]
    if _chance(rng, 0.25):  # an ego that must leave a forbidden lane
        allowed = list(range(1, lanes + 1))
    lane = _pick(rng, allowed)
    ego = {
        "x_m": _pick(rng, [0.0, 35.0, _uniform(rng, -500.0, 2000.0)]),
        "y_m": _lane_centre(lanes, width, lane),
        "speed_mps": speed,
        "lane": lane,
        "mode": _pick(rng, MODES, [0.25, 0.5, 0.25]),
    }
    if _chance(rng, 0.15):
        ego["length_m"] = _pick(rng, [3.0, 9.0, 16.5])
    return ego


def _vehicle(rng, problem, scene, name):
    ego = problem["ego"]
    lanes, width = problem["lanes"]["count"], problem["lanes"]["width_m"]
    lane = int(rng.integers(1, lanes + 1))
    if scene in {"dense", "packed", "closing"} and _chance(rng, 0.4):
        lane = ego["lane"]
    spread = 25.0 if scene == "closing" else 6.0
    speed = max(0.0, round(ego["speed_mps"] + _uniform(rng, -spread, spread), 2))
    mode = _pick(rng, MODES, [0.25, 0.5, 0.25])
    if _chance(rng, 0.12):  # standing, or about to stand
        speed, mode = _pick(rng, [0.0, _uniform(rng, 0.0, 2.0)]), _pick(rng, ["cruise", "decelerate"])
    vehicle = {
        "id": name,
        "x_m": _place(rng, problem, scene, lane),
        "y_m": _lane_centre(lanes, width, lane),
        "speed_mps": speed,
        "lane": lane,
        "mode": mode,
        "lateral_probs": {"left": 0.0, "keep": 1.0, "right": 0.0},
        "longitudinal_probs": {"accelerate": 0.0, "cruise": 1.0, "decelerate": 0.0},
        "position_var_m2": _pick(rng, [0.0, 0.1, 0.9, 4.0]),
        "speed_var_m2ps2": _pick(rng, [0.0, 0.04, 0.5]),
        "process_position_var_m2": _pick(rng, [0.0, 0.02, 0.1]),
        "process_speed_var_m2ps2": _pick(rng, [0.0, 0.01, 0.1]),
    }
    if _chance(rng, 0.3):
        vehicle["length_m"] = _pick(rng, [4.0, 9.0, 12.0])
    if scene == "edge":
        return vehicle | _edge(rng, problem)
    alone = {"vehicles": [vehicle], "lanes": problem["lanes"]}
    while True:
        vehicle["lateral_probs"] = _lateral_probs(rng, lanes)
        vehicle["longitudinal_probs"] = _longitudinal_probs(rng)
        if dead_state(alone) is None:
            return vehicle


def _edge(rng, problem):
    """Return a vehicle's entries for a distance, and perhaps for sequences, exactly at their limit."""
    ego, lanes, width = problem["ego"], problem["lanes"]["count"], problem["lanes"]["width_m"]
    side = _pick(rng, [-1.0, 1.0])
    entries = {
        "x_m": round(ego["x_m"] + side * problem["planner"]["safe_distance_m"], 2),
        "speed_mps": ego["speed_mps"],
        "mode": "cruise",
        "position_var_m2": 0.0,
        "speed_var_m2ps2": 0.0,
        "process_position_var_m2": 0.0,
        "process_speed_var_m2ps2": 0.0,
    }
    if _chance(rng, 0.6):
        lane = _pick(rng, [1, lanes])
        toward_middle = "right" if lane == 1 else "left"
        entries |= {"lane": lane, "y_m": _lane_centre(lanes, width, lane)}
        entries["lateral_probs"] = {"left": 0.0, "keep": 0.7, "right": 0.0, toward_middle: 0.3}
    return entries


def _place(rng, problem, scene, lane):
    """Draw a position off those taken in the lane, as far as a few tries go."""
    planner, ego = problem["planner"], problem["ego"]
    safe = planner["safe_distance_m"]
    if scene == "closing" and _chance(rng, 0.05):
        return ego["x_m"]
    reach = {
        "open": 40.0 + 3.0 * safe,
        "dense": 1.6 * safe,
        "packed": 12.0 + safe,
        "closing": 25.0,
        "edge": 1.0,
    }[scene]
    taken = [(ego["lane"], ego["x_m"])]
    taken += [(vehicle["lane"], vehicle["x_m"]) for vehicle in problem["vehicles"]]
    room = {"open": 0.8 * safe, "dense": 0.6 * safe, "packed": 5.0, "closing": safe, "edge": 0.0}[scene]
    for _ in range(20):
        x = round(ego["x_m"] + _uniform(rng, -reach, reach), 2)
        if all(other != lane or abs(x - at) > room for other, at in taken):
            break
    return x


def _lane_centre(lanes, width, lane):
    return ((lanes + 1) / 2.0 - lane) * width


def _three_probs(rng):
    first = _uniform(rng, 0.0, 1.0, 3)
    second = round(_uniform(rng, 0.0, 1.0, 3) * (1.0 - first), 3)
    return first, second, abs(round(1.0 - first - second, 3))


def _lateral_table(rng):
    kind = _pick(rng, ["keep", "even", "any", "never keep"], [0.4, 0.35, 0.2, 0.05])
    left, keep, right = {
        "keep": (0.0, 1.0, 0.0),
        "even": _pick(rng, [(0.025, 0.95, 0.025), (0.1, 0.8, 0.1), (0.25, 0.5, 0.25)]),
        "any": _three_probs(rng),
        "never keep": _pick(rng, [(0.5, 0.0, 0.5), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.3, 0.0, 0.7)]),
    }[kind]
    return {"left": left, "keep": keep, "right": right}


def _lateral_probs(rng, lanes):
    if _chance(rng, 0.5):
        return _lateral_table(rng)
    return {str(lane): _lateral_table(rng) for lane in range(1, lanes + 1)}


def _longitudinal_probs(rng):
    kind = _pick(rng, ["cruise", "even", "any", "never cruise"], [0.35, 0.4, 0.2, 0.05])
    accelerate, cruise, decelerate = {
        "cruise": (0.0, 1.0, 0.0),
        "even": _pick(rng, [(0.05, 0.9, 0.05), (0.15, 0.7, 0.15)]),
        "any": _three_probs(rng),
        "never cruise": _pick(rng, [(1.0, 0.0, 0.0), (0.0, 0.0, 1.0)]),
    }[kind]
    return {"accelerate": accelerate, "cruise": cruise, "decelerate": decelerate}
