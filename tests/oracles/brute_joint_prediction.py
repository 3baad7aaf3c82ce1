"""Brute force for the rule `joint`, the surrounding vehicles: all that they may do, and where that leads.

Nothing is pruned. The policy factorises, so that lateral actions and modes are enumerated apart. The conventions are
those of brute_prediction.py.
"""

import importlib.util
import math
import sys
from pathlib import Path
from typing import NamedTuple

_SPEC = importlib.util.spec_from_file_location("oracle_joint_base", Path(__file__).with_name("brute_prediction.py"))
prediction = importlib.util.module_from_spec(_SPEC)
sys.modules[_SPEC.name] = prediction
_SPEC.loader.exec_module(prediction)

setting = prediction.setting

KEY_DECIMALS = 7  # places and speeds that agree so far are one; the first of them stands for all


def renormalised(table):
    """Return the positive entries of {outcome: weight}, made to sum to 1."""
    total = math.fsum(table.values())
    if total <= 0.0:
        raise ValueError("no action has a positive probability")
    return {outcome: weight / total for outcome, weight in table.items() if weight > 0.0}


def lateral_choices(problem, vehicle, lane, k=0):
    """Return {lateral action: probability} in a lane at step k = 0..H-1: the lane's row, without what leads off the
    road (45)."""
    table = prediction.lateral_table(vehicle, k)
    row = table.get(str(lane), table)
    lanes = problem["lanes"]["count"]
    inside = {lateral: row[name] for name, lateral in prediction.LATERALS.items() if 1 <= lane + lateral <= lanes}
    return renormalised(inside)


def mode_choices(vehicle, mode):
    """Return {next mode: probability} in a mode: at most one level from it."""
    table = vehicle["longitudinal_probs"]
    return renormalised({m: table[name] for name, m in prediction.MODES.items() if abs(m - mode) <= 1})


def lateral_law(problem, vehicle, lateral):
    """Return (gain, noise) of a step: a deviation from the mean y is multiplied by the gain, and noise of this
    variance is added to it: var+ = gain^2 var + noise (33)."""
    T, paper = problem["planner"]["period_s"], prediction.gains(problem)
    if paper is None:
        return math.exp(-T / vehicle.get("lane_keeping_time_s", 2.0)), vehicle.get("process_lateral_var_m2", 0.0)
    gain = 1.0 if lateral == 0 else 1.0 - paper[0] * T**2 / 2.0
    return gain, vehicle.get("process_position_var_m2", 0.0)


def measured_variance(vehicle):
    """Return the variance of the measured y."""
    own = vehicle.get("lateral_var_m2")
    return vehicle.get("position_var_m2", 0.0) if own is None else own


class Across(NamedTuple):
    """A sequence of lateral actions up to some step, and where it leads."""

    actions: tuple
    prob: float
    lane: int  # the one it intends
    y: float
    var: float  # of y
    gain: float  # of the last step
    noise: float
    parent: int  # which sequence of the step before it goes on from


def lateral_sequences(problem, vehicle):
    """Return the sequences of lateral actions, a list of them for each k = 0..H."""
    start = Across(
        actions=(),
        prob=1.0,
        lane=vehicle["lane"],
        y=vehicle["y_m"],
        var=measured_variance(vehicle),
        gain=1.0,
        noise=0.0,
        parent=0,
    )
    steps = [[start]]
    for k in range(problem["planner"]["horizon_steps"]):
        longer = []
        for parent, before in enumerate(steps[-1]):
            for lateral, prob in lateral_choices(problem, vehicle, before.lane, k).items():
                lane = before.lane + lateral
                gain, noise = lateral_law(problem, vehicle, lateral)
                var = gain**2 * before.var + noise
                actions = (*before.actions, lateral)
                y = prediction.lateral_places(problem, vehicle, actions)[-1]
                longer.append(Across(actions, before.prob * prob, lane, y, var, gain, noise, parent))
        steps.append(longer)
    return steps


def mode_sequences(problem, vehicle):
    """Return [(probability, modes)]: the modes at steps 0..H-1, each of which drives the step that follows it."""
    sequences = [(1.0, (prediction.MODES[vehicle["mode"]],))]
    for _ in range(problem["planner"]["horizon_steps"] - 1):
        sequences = [
            (prob * p, (*modes, following))
            for prob, modes in sequences
            for following, p in mode_choices(vehicle, modes[-1]).items()
        ]
    return sequences


def mean_path(problem, vehicle, modes):
    """Return [(mean x, mean speed)] of a sequence of modes at k = 0..H."""
    path = [(vehicle["x_m"], vehicle["speed_mps"])]
    for mode in modes:
        path.append(prediction.vehicle_motion(problem["planner"], *path[-1], mode))
    # What is added to every sequence (46); nobody drives backwards.
    for k, step in enumerate(vehicle.get("drift", ()), start=1):
        x, speed = path[k]
        path[k] = x + step["x_m"], max(0.0, speed + step["speed_mps"])
    return path


def mode_moves(problem, vehicle):
    """Return, for each k = 0..H, [(probability, (x, speed) at k-1, (x, speed) at k)], equal ones merged."""
    horizon = problem["planner"]["horizon_steps"]
    merged = [{} for _ in range(horizon + 1)]
    for prob, modes in mode_sequences(problem, vehicle):
        path = mean_path(problem, vehicle, modes)
        for k in range(1, horizon + 1):
            key = tuple(round(number, KEY_DECIMALS) for place in path[k - 1 : k + 1] for number in place)
            merged[k].setdefault(key, [0.0, path[k - 1], path[k]])[0] += prob
    return [list(step.values()) for step in merged]
