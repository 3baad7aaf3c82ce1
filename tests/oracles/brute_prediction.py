"""Brute force, the surrounding vehicles: what they may do, where that leads, what distance it asks for.

Written from the rules alone (docs/formulation.md; its section and equation numbers stand in brackets) and
sharing no code with the package. Plain loops, no arrays.

Conventions: lanes are numbered 1..n from the left; a lateral action is -1 (left), 0 (keep) or +1 (right), a
mode +1 (accelerate), 0 (cruise) or -1 (decelerate). x and y are those of the front bumper.
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

THRESHOLD_TOLERANCE = 1e-12
DEFAULT_LENGTH = 4.5
DEFAULT_WIDTH = 1.8

# The planner's optional keys, and what leaving them out means.
DEFAULTS = {
    "action_threshold": 0.0,
    "lateral_model": None,
    "lateral_gain_k1_ps2": None,
    "lateral_gain_k2_ps": None,
    "account_pruned": False,
    "occupancy": "target",
    "lane_change_time_s": 4.0,
    "distance_rule": "fixed",
    "time_headway_s": 1.5,
    "rss_response_time_s": 0.5,
    "rss_accel_max_mps2": 2.0,
    "rss_brake_min_mps2": 4.0,
    "rss_brake_max_mps2": 8.0,
    "stopping": False,
}


class BudgetError(Exception):
    """What pruning dropped leaves nothing of the risk level [6]."""


class BranchStep(NamedTuple):
    """One step of one predicted branch, with what the rules need to know of the step before it."""

    lanes_before: frozenset  # the lanes that the vehicle takes up
    x_before: float
    lanes: frozenset
    x: float
    speed: float
    length: float
    z_sigma: float  # what the uncertainty adds to the distance (8)


def setting(problem, key):
    """Return a planner setting that the problem may leave out."""
    return problem["planner"].get(key, DEFAULTS[key])


def lane_centre(problem, lane):
    """Return y_ref (1)."""
    return ((problem["lanes"]["count"] + 1) / 2.0 - lane) * problem["lanes"]["width_m"]


def lanes_under(problem, y, width):
    """Return the lanes that a body of this width, centred at y, is over (16)."""
    reach = (problem["lanes"]["width_m"] + width) / 2.0
    lanes = range(1, problem["lanes"]["count"] + 1)
    return frozenset(lane for lane in lanes if abs(y - lane_centre(problem, lane)) < reach)


def lateral_table(vehicle, k):
    """Return the lateral table of step k = 0..H-1: that of now, or of the later ones, of which the last one stays."""
    tables = [vehicle["lateral_probs"], *vehicle.get("lateral_probs_later", [])]
    return tables[min(k, len(tables) - 1)]


def action_probabilities(problem, vehicle, lane, mode, k=0):
    """Return {(lateral action, change of mode): probability} in the state (lane, mode) at step k = 0..H-1 (3).

    The lateral table times the table over the next mode, masked by admissibility, renormalised. Actions of
    probability zero are left out. The order is the paper's.
    """
    table = lateral_table(vehicle, k)
    table = table.get(str(lane), table)
    products = {}
    for lateral, change in ACTIONS:
        if not 1 <= lane + lateral <= problem["lanes"]["count"]:
            continue
        if mode + change not in MODE_NAMES:
            continue
        lateral_prob = table[LATERAL_NAMES[lateral]]
        mode_prob = vehicle["longitudinal_probs"][MODE_NAMES[mode + change]]
        if lateral_prob * mode_prob > 0.0:
            products[lateral, change] = lateral_prob * mode_prob
    total = sum(products.values())
    if total <= 0.0:
        raise ValueError(f"{vehicle['id']}: no action has a positive probability in lane {lane}, mode {mode}")
    return {action: product / total for action, product in products.items()}


def retained_sequences(problem, vehicle):
    """Return [(probability, actions)] of the action sequences that pruning leaves [5].

    Kept is what reaches the sequence threshold and has no single action below the action threshold. Where there
    is no such sequence, the likeliest of all is kept (the first of equals in the paper's order of actions).
    """
    horizon = problem["planner"]["horizon_steps"]
    threshold = problem["planner"]["sequence_threshold"] * (1.0 - THRESHOLD_TOLERANCE)
    action_threshold = setting(problem, "action_threshold") * (1.0 - THRESHOLD_TOLERANCE)
    kept = []
    likeliest = (0.0, None)

    def extend(lane, mode, prob, actions, least):
        nonlocal likeliest
        # A product only falls as the sequence grows, so a prefix that can be neither kept nor the likeliest
        # is given up.
        can_be_kept = prob >= threshold and least >= action_threshold
        if not can_be_kept and prob <= likeliest[0] * (1.0 + THRESHOLD_TOLERANCE):
            return
        if len(actions) == horizon:
            if can_be_kept:
                kept.append((prob, actions))
            if prob > likeliest[0] * (1.0 + THRESHOLD_TOLERANCE):
                likeliest = (prob, actions)
            return
        for (lateral, change), p in action_probabilities(problem, vehicle, lane, mode, len(actions)).items():
            extend(lane + lateral, mode + change, prob * p, [*actions, (lateral, change)], min(least, p))

    extend(vehicle["lane"], MODES[vehicle["mode"]], 1.0, [], 1.0)
    return kept or [likeliest]


def vehicle_motion(planner, x, speed, mode):
    """Return (x, speed) after a step with the mode BEFORE its action; nobody drives backwards (4)."""
    T, accel = planner["period_s"], planner["accel_mps2"]
    if mode == -1 and speed < accel * T:
        return x + speed**2 / (2.0 * accel), 0.0
    return x + speed * T + mode * accel * T**2 / 2.0, speed + mode * accel * T


def gains(problem):
    """Return (K1, K2) where the paper's law holds across the road, else None [4]."""
    K1, K2 = setting(problem, "lateral_gain_k1_ps2"), setting(problem, "lateral_gain_k2_ps")
    if setting(problem, "lateral_model") != "pd" and K1 is None and K2 is None:
        return None
    return 3.0 if K1 is None else K1, 1.0 if K2 is None else K2


def lateral_motion(problem, y, lateral_speed, lateral, lane):
    """Return (y, lateral speed) after a step by the paper's law; lane is the one intended after its action (4)."""
    T = problem["planner"]["period_s"]
    K1, K2 = gains(problem)
    if lateral == 0:
        return y, 0.0
    after = (1.0 - K1 * T**2 / 2.0) * y + T**2 / 2.0 * (K1 * lane_centre(problem, lane) - K2 * lateral_speed)
    return after, (after - y) / T


def lateral_places(problem, vehicle, laterals):
    """Return the mean y at k = 0..H of a vehicle that takes these lateral actions (4) or (32)."""
    T, lane = problem["planner"]["period_s"], vehicle["lane"]
    y, speed = vehicle["y_m"], vehicle.get("lateral_speed_mps", 0.0)
    places = [y]
    if gains(problem) is not None:
        for lateral in laterals:
            lane += lateral
            y, speed = lateral_motion(problem, y, speed, lateral, lane)
            places.append(y)
        return places
    width = problem["lanes"]["width_m"]
    change_speed = width / vehicle.get("lane_change_time_s", 4.0)
    missing = lane_centre(problem, lane) - y
    approach = speed if missing > 0.0 else -speed
    over_the_line = abs(missing) + vehicle.get("width_m", DEFAULT_WIDTH) / 2.0 > width / 2.0
    changing = over_the_line or (missing != 0.0 and approach > change_speed / 2.0)
    followed, off = (y, 0.0) if changing else (y + missing, -missing)
    for k, lateral in enumerate(laterals, start=1):
        lane += lateral
        there = lane_centre(problem, lane)
        if abs(there - followed) <= change_speed * T:
            followed = there
        elif there > followed:
            followed += change_speed * T
        else:
            followed -= change_speed * T
        places.append(followed + off * math.exp(-k * T / vehicle.get("lane_keeping_time_s", 2.0)))
    return places


def lateral_sigmas(problem, vehicle):
    """Return the standard deviation of y at k = 0..H by (33); no margin follows from the paper's law [6]."""
    H, T = problem["planner"]["horizon_steps"], problem["planner"]["period_s"]
    if gains(problem) is not None:
        return [0.0] * (H + 1)
    measured = vehicle.get("lateral_var_m2")
    measured = vehicle.get("position_var_m2", 0.0) if measured is None else measured
    left = math.exp(-2.0 * T / vehicle.get("lane_keeping_time_s", 2.0))
    added = vehicle.get("process_lateral_var_m2", 0.0)
    # What has come in j steps ago has decayed j times.
    return [math.sqrt(left**k * measured + added * math.fsum(left**j for j in range(k))) for k in range(H + 1)]


def position_sigmas(problem, vehicle):
    """Return the standard deviation of the vehicle's x after steps 1..H (5, 6)."""
    T = problem["planner"]["period_s"]
    q_xx = vehicle.get("position_var_m2", 0.0)
    q_xv, q_vv = 0.0, vehicle.get("speed_var_m2ps2", 0.0)
    sigmas = []
    for _ in range(problem["planner"]["horizon_steps"]):
        q_xx = q_xx + 2.0 * T * q_xv + T**2 * q_vv + vehicle.get("process_position_var_m2", 0.0)
        q_xv = q_xv + T * q_vv
        q_vv = q_vv + vehicle.get("process_speed_var_m2ps2", 0.0)
        sigmas.append(math.sqrt(q_xx))
    return sigmas


def water_fill(probs, budget):
    """Return the shares min(1/2, c / p) for the largest c whose sum of p * share keeps the budget (9c).

    Branch p costs min(p / 2, c). Settled from the least likely on: it is full at 1/2 where that costs no more
    than an even part of what is left, and from the first that is not, all that remain pay the same.
    """
    left = budget
    ordered = sorted(probs)
    for done, p in enumerate(ordered):
        even = left / (len(ordered) - done)
        if p / 2.0 > even:
            return [min(0.5, even / q) for q in probs]
        left -= p / 2.0
    return [0.5] * len(probs)


def branch_risks(problem, sequences):
    """Return eps_b of each retained sequence of one vehicle (9)."""
    planner = problem["planner"]
    rule, eps = planner["risk_allocation"], planner["risk_level"]
    steps, count = planner["horizon_steps"], len(problem["vehicles"])
    accounted = eps / count - pruned_probability(sequences)
    if rule == "individual":
        return [eps] * len(sequences)
    if rule == "uniform" and not setting(problem, "account_pruned"):
        return [eps / (steps * count)] * len(sequences)
    if rule not in {"uniform", "mixture"}:
        raise ValueError(f"the oracle has no risk allocation {rule!r}")
    if accounted <= 0.0:
        raise BudgetError
    if rule == "uniform":
        return [accounted / steps] * len(sequences)
    return water_fill([prob for prob, _ in sequences], accounted / steps)


def pruned_probability(sequences):
    """Return the probability of what is not kept [5]."""
    return max(0.0, 1.0 - math.fsum(prob for prob, _ in sequences))


def branch_path(problem, vehicle, actions, z=0.0, z_now=0.0):
    """Return [(lanes taken up, x, speed)] of one sequence at k = 0..H.

    z widens the body by z sigma_y on either side after now (34), z_now likewise now.
    """
    swept = setting(problem, "occupancy") == "swept"
    lane, mode = vehicle["lane"], MODES[vehicle["mode"]]
    x, speed = vehicle["x_m"], vehicle["speed_mps"]
    places = lateral_places(problem, vehicle, [lateral for lateral, _ in actions])
    sigmas = lateral_sigmas(problem, vehicle)

    def lanes(k, quantile):
        width = vehicle.get("width_m", DEFAULT_WIDTH) + 2.0 * quantile * sigmas[k]
        return (lanes_under(problem, places[k], width) if swept else frozenset()) | {lane}

    path = [(lanes(0, z_now), x, speed)]
    for k, (lateral, change) in enumerate(actions, start=1):
        x, speed = vehicle_motion(problem["planner"], x, speed, mode)
        lane, mode = lane + lateral, mode + change
        path.append((lanes(k, z), x, speed))
    return path


def predict(problem):
    """Return (steps, branches, pruned): steps[k] the list of all branches' step k, k = 1..H (steps[0] empty);
    branches and pruned {vehicle id: number of sequences kept, probability of those that are not}.

    Branches that agree over steps k-1 and k are one at step k: no rule looks further back, and the larger
    distance of the two decides in every rule.
    """
    horizon = problem["planner"]["horizon_steps"]
    steps = [{} for _ in range(horizon + 1)]
    branches, pruned = {}, {}
    for vehicle in problem["vehicles"]:
        sequences = retained_sequences(problem, vehicle)
        branches[vehicle["id"]] = len(sequences)
        pruned[vehicle["id"]] = pruned_probability(sequences)
        sigmas = position_sigmas(problem, vehicle)
        length = vehicle.get("length_m", DEFAULT_LENGTH)
        quantiles = [-NormalDist().inv_cdf(eps) for eps in branch_risks(problem, sequences)]  # Phi^-1(1 - eps)
        for (_, actions), z in zip(sequences, quantiles, strict=True):
            path = branch_path(problem, vehicle, actions, z, max(quantiles))
            for k in range(1, horizon + 1):
                lanes_before, x_before, _ = path[k - 1]
                motion = (lanes_before, x_before, *path[k], length)
                steps[k][motion] = max(steps[k].get(motion, 0.0), z * sigmas[k - 1])
    return [[BranchStep(*motion, z) for motion, z in step.items()] for step in steps], branches, pruned
