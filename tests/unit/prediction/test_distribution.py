"""The whole prediction of a vehicle against draws of it, and against the branches that are shown."""

import numpy as np
import pytest

from sumo_hmdp.decision.planner import HmdpEvidence
from sumo_hmdp.prediction.branches import covariances, lateral_means, predict
from sumo_hmdp.prediction.distribution import QUANTILES, distributions, mixture_quantiles
from sumo_hmdp.scenario.load import RunOptions, find_scenario, load_scenario
from sumo_hmdp.study.run import execute

# So many sequences of modes that they are not all shown.
MANY_MODES = {"accelerate": 0.04, "cruise": 0.86, "decelerate": 0.1}


@pytest.fixture(scope="module")
def evidence():
    """The first decision in traffic that prunes something and has more branches than are shown."""
    found = []
    options = RunOptions(
        solver="search", seed=1, overrides={"duration_s": 1.0, "traffic.belief.longitudinal_probs": MANY_MODES}
    )
    run = load_scenario(find_scenario("highway"), options)
    execute(run, lambda moment: found.append(moment.decision.evidence) if moment.decision else None)
    assert isinstance(found[0], HmdpEvidence)
    return found[0]


def test_against_draws_of_all_branches(evidence):
    problem, branches = evidence.problem, evidence.answer.branches
    settings = problem.settings.prediction()
    y = lateral_means(branches, problem.road, settings)
    rng = np.random.default_rng(1)
    for index, told in enumerate(distributions(branches, problem.road, settings)[:3]):
        rows = np.flatnonzero(branches.vehicle == index)
        weights = branches.probability[rows] / branches.probability[rows].sum()
        drawn = rng.choice(rows, 40_000, p=weights)
        for k in (0, settings.horizon_steps - 1):
            x = branches.x[drawn, k] + branches.x_std[index, k] * rng.normal(size=len(drawn))
            assert told.x_mean[k] == pytest.approx(x.mean(), abs=0.1)
            assert told.x_std[k] == pytest.approx(x.std(), rel=0.02)
            inside = (x[:, None] <= told.x_quantiles[k]).mean(axis=0)
            assert inside == pytest.approx(np.array(QUANTILES), abs=0.01)
            spread = np.sqrt([covariances(branches, row, settings)[k, 1, 1] for row in rows])
            across = y[drawn, k] + spread[np.searchsorted(rows, drawn)] * rng.normal(size=len(drawn))
            assert told.y_mean[k] == pytest.approx(across.mean(), abs=0.02)
            assert told.y_std[k] == pytest.approx(across.std(), rel=0.03)


def test_lanes_are_of_all_branches_and_what_was_pruned_is_told(evidence):
    branches = evidence.answer.branches
    shown = {}
    for branch in evidence.branches():
        shown[branch.vehicle_id] = shown.get(branch.vehicle_id, 0.0) + branch.probability
    told = evidence.prediction()
    assert {one.vehicle_id for one in told} == set(shown)
    for one in told:
        for lanes in one.lanes:
            assert sum(lanes) == pytest.approx(1 - one.pruned)
    # Twelve branches are not all there is.
    assert any(shown[one.vehicle_id] < 1 - one.pruned - 0.01 for one in told)
    last = branches.vehicle == 0
    expected = [branches.probability[last & (branches.lanes[:, -1] == lane)].sum() for lane in (1, 2, 3)]
    assert told[0].lanes[-1] == pytest.approx(expected)


def test_a_mixture_without_spread_has_atoms_for_quantiles():
    found = mixture_quantiles(np.array([[1.0, 2.0, 3.0]]), np.array([[0.04, 0.9, 0.06]]), np.zeros(1))
    assert found.tolist() == [[1.0, 2.0, 2.0, 2.0, 3.0, 3.0]]
    assert mixture_quantiles(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros(0)).shape == (0, 6)


def test_with_nobody_in_sight_there_is_nothing_to_foretell(evidence):
    settings = evidence.problem.settings.prediction()
    assert distributions(predict((), settings), evidence.problem.road, settings) == ()
