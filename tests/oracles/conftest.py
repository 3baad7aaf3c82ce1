"""The oracle and its problems as fixtures: the tests are no package, so they cannot import one another."""

import importlib.util
import sys
from pathlib import Path

import pytest


def pytest_collection_modifyitems(items):
    """Leave the oracles' tests out of the coverage: it is that of the other tests, and these compute for minutes."""
    folder = Path(__file__).parent
    for item in items:
        if folder in item.path.parents:
            item.add_marker("no_cover")


def _load(name):
    path = Path(__file__).parent / f"{name}.py"
    spec = importlib.util.spec_from_file_location(f"oracle_{name}", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def brute_force():
    """The module brute_force: solve(problem), evaluate(problem, lateral, longitudinal)."""
    return _load("brute_force")


@pytest.fixture(scope="session")
def problems():
    """The module problems: random_problem(rng)."""
    return _load("problems")


@pytest.fixture(scope="session")
def general_problems():
    """The module general_problems: random_general_problem(rng)."""
    return _load("general_problems")


@pytest.fixture(scope="session")
def line_problems():
    """The module line_problems: random_line_problem(rng)."""
    return _load("line_problems")


@pytest.fixture(scope="session")
def rule_problems():
    """The module rule_problems: random_rule_problem(rng)."""
    return _load("rule_problems")


@pytest.fixture(scope="session")
def agreement():
    """The module agreement: disagreements(brute_force, problem, solvers)."""
    return _load("agreement")


@pytest.fixture(scope="session")
def joint_risk():
    """The module joint_risk: measure(...), count_violations(...)."""
    return _load("joint_risk")


@pytest.fixture(scope="session")
def brute_joint():
    """The module brute_joint: solve(problem), plan_risk(problem, plan)."""
    return _load("brute_joint")


@pytest.fixture(scope="session")
def joint_problems():
    """The module joint_problems: random_joint_problem(rng, horizon)."""
    return _load("joint_problems")


@pytest.fixture(scope="session")
def joint_sampler():
    """The module joint_sampler: sampled_risk(problem, plan, rng, samples)."""
    return _load("joint_sampler")


@pytest.fixture(scope="session")
def joint_agreement():
    """The module joint_agreement: disagreements(problem, expected, ways)."""
    return _load("joint_agreement")
