"""How often a plan fails in sampled worlds of the model: what the risk of the rule `joint` is a bound of.

A world is one sequence of lateral actions and one of modes of every vehicle, drawn from its whole policy, and one path
of its noise along x and one across. The noise is that of the model, correlated from step to step, which the bound does
not count on: there, steps are independent given the actions.
"""

import importlib.util
import sys
from pathlib import Path

import numpy as np

_SPEC = importlib.util.spec_from_file_location("oracle_sampled_joint", Path(__file__).with_name("brute_joint.py"))
joint = importlib.util.module_from_spec(_SPEC)
sys.modules[_SPEC.name] = joint
_SPEC.loader.exec_module(joint)

brute_force = joint.brute_force


def sampled_risk(problem, plan, rng, samples):
    """Estimate the probability that a plan fails: that at some step a vehicle takes up a lane of the ego and is nearer
    than it may be, or that it shares lanes at two steps in a row and is on the other side at the second.

    Arguments: plan ((lateral action, mode) for each step), rng (a numpy Generator), samples (how many worlds).
    Returns {"any": (estimate, standard error), "by_vehicle": {id: (estimate, standard error)}}.
    """
    states = joint.Plans(problem).follow(plan)
    if states is None:
        raise ValueError("the plan is not admissible")
    failed = {vehicle["id"]: _failures(problem, vehicle, states, rng, samples) for vehicle in problem["vehicles"]}
    any_failed = np.any([np.zeros(samples, dtype=bool), *failed.values()], axis=0)
    return {"any": _estimate(any_failed), "by_vehicle": {name: _estimate(each) for name, each in failed.items()}}


def _estimate(failed):
    share = float(failed.mean())
    return share, float(np.sqrt(share * (1.0 - share) / len(failed)))


def _normal(rng, var, samples):
    return rng.normal(0.0, np.sqrt(var), samples)


def _failures(problem, vehicle, states, rng, samples):
    """Return in which of the worlds a vehicle makes the plan fail, shape (samples,)."""
    shares = _sharing(problem, vehicle, states, rng, samples)
    ahead, behind = _keeping(problem, vehicle, states, rng, samples)
    failed = np.zeros(samples, dtype=bool)
    for k in range(1, len(states)):
        failed |= shares[k] & ~ahead[k] & ~behind[k]
        passes = (ahead[k - 1] & behind[k]) | (behind[k - 1] & ahead[k])
        failed |= shares[k - 1] & shares[k] & passes
    return failed


def _sharing(problem, vehicle, states, rng, samples):
    """Return [whether the vehicle takes up a lane of the ego] at k = 0..H, each of shape (samples,)."""
    steps = joint.lateral_sequences(problem, vehicle)
    probs = np.array([sequence.prob for sequence in steps[-1]])
    drawn = rng.choice(len(probs), size=samples, p=probs / probs.sum())
    ways = [[sequence] for sequence in steps[-1]]  # of each sequence, its steps from the last to the first
    for step in steps[-2::-1]:
        for way in ways:
            way.append(step[way[-1].parent])
    swept = brute_force.setting(problem, "occupancy") == "swept"
    reach = (problem["lanes"]["width_m"] + vehicle.get("width_m", brute_force.DEFAULT_WIDTH)) / 2.0
    error = _normal(rng, joint.measured_variance(vehicle), samples)
    shares = []
    for k, (road, _) in enumerate(states):
        now = [way[len(steps) - 1 - k] for way in ways]
        lane = np.array([sequence.lane for sequence in now])[drawn]
        y = np.array([sequence.y for sequence in now])[drawn]
        if k > 0:  # the present body is known exactly
            gain = np.array([sequence.gain for sequence in now])[drawn]
            error = gain * error + _normal(rng, now[0].noise, samples)
            y = y + error
        shared = np.isin(lane, list(road.lanes))
        for other in road.lanes if swept else ():
            shared |= np.abs(y - brute_force.lane_centre(problem, other)) < reach
        shares.append(shared)
    return shares


def _keeping(problem, vehicle, states, rng, samples):
    """Return two lists: whether the ego keeps its distance ahead of, and behind, the vehicle at k = 0..H, each of
    shape (samples,)."""
    T = problem["planner"]["period_s"]
    sequences = joint.mode_sequences(problem, vehicle)
    probs = np.array([prob for prob, _ in sequences])
    drawn = rng.choice(len(probs), size=samples, p=probs / probs.sum())
    paths = [joint.mean_path(problem, vehicle, modes) for _, modes in sequences]
    x_error = _normal(rng, vehicle.get("position_var_m2", 0.0), samples)
    v_error = _normal(rng, vehicle.get("speed_var_m2ps2", 0.0), samples)
    side = np.full(samples, states[0][1].x > vehicle["x_m"])  # at present, by the measured position
    ahead, behind = [side], [~side]
    for k, (_, ego) in enumerate(states[1:], start=1):
        x_error = x_error + T * v_error + _normal(rng, vehicle.get("process_position_var_m2", 0.0), samples)
        v_error = v_error + _normal(rng, vehicle.get("process_speed_var_m2ps2", 0.0), samples)
        apart = np.array([joint.distances(problem, ego.speed, vehicle, path[k][1]) for path in paths])[drawn]
        x = np.array([path[k][0] for path in paths])[drawn] + x_error
        ahead.append(x <= ego.x - apart[:, 0])
        behind.append(x >= ego.x + apart[:, 1])
    return ahead, behind
