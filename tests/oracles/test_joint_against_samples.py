"""No optimal plan of the rule `joint` fails more often than epsilon in sampled worlds of the model.

The larger run is analysis/15_joint_decisions.py.
"""

import math

import numpy as np

from sumo_hmdp.domain.plan import Status

SAMPLES, PLANS = 20_000, 60


def test_optimal_plans_keep_epsilon(joint_problems, joint_sampler, joint_agreement):
    sampled, happened, near = 0, 0, 0
    for number in range(1000):
        rng = np.random.default_rng([94, number])
        problem = joint_problems.random_joint_problem(rng, 1 + number % 4)
        choice = joint_agreement.chosen(problem, "search")
        # A road without anybody near would prove nothing.
        if choice.status is not Status.OPTIMAL or choice.risk.taken < 1e-4:
            continue
        level = problem["planner"]["risk_level"]
        share, _ = joint_sampler.sampled_risk(problem, joint_agreement.plan_of(choice), rng, SAMPLES)["any"]
        assert share <= level + 4.5 * math.sqrt(level * (1 - level) / SAMPLES), f"problem [94, {number}]"
        bound = choice.risk.taken
        assert share <= bound + 4.5 * math.sqrt(bound / SAMPLES) + 1 / SAMPLES, f"problem [94, {number}]"
        sampled, happened, near = sampled + 1, happened + (share > 0), near + (bound > level / 3)
        if sampled == PLANS:
            break
    assert sampled == PLANS
    assert happened >= 30
    assert near >= 8


def test_contact_is_rarer_than_a_distance_that_falls_short(joint_problems, joint_agreement):
    compared = 0
    for number in range(150):
        problem = joint_problems.random_joint_problem(np.random.default_rng([95, number]), 1 + number % 3)
        choice = joint_agreement.chosen(problem, "search")
        if choice.plan is None:
            continue
        assert 0.0 <= choice.risk.contact <= 1.0
        # Sums of bounds of pairs need not be ordered exactly, those of one step and vehicle are.
        if problem["planner"]["horizon_steps"] == 1:
            assert choice.risk.contact <= choice.risk.taken + 1e-9
            compared += choice.risk.taken > 0
    assert compared >= 10
