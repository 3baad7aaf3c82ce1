"""What the solvers read off the corridor graph by opening says the same as its windows do one by one."""

from collections import Counter
from dataclasses import replace

import numpy as np

from sumo_hmdp.decision.corridors import carve, clearances
from sumo_hmdp.decision.highs import compile_model
from sumo_hmdp.decision.lattice import ego_lattice
from sumo_hmdp.decision.openings import openings_of
from sumo_hmdp.decision.optimiser import fill, shape_of, start_values
from sumo_hmdp.decision.problem_file import parse_problem
from sumo_hmdp.decision.risk import RiskBudgetError, margins
from sumo_hmdp.decision.search import search_best
from sumo_hmdp.prediction.branches import predict


def carved(general_problems, seed, count):
    """Yield a number of random problems with their lattice and corridor graph."""
    for number in range(count):
        document = general_problems.random_general_problem(np.random.default_rng([seed, number]))
        problem = parse_problem(document)
        lattice = ego_lattice(problem)
        branches = predict(problem.vehicles, problem.settings.prediction())
        try:
            margin = margins(branches, problem.settings)
        except RiskBudgetError:
            continue
        yield problem, lattice, carve(problem, lattice, branches, clearances(problem, branches, margin, relaxed=False))


def test_moves_between_openings_and_speed_levels_are_the_moves_between_windows(general_problems):
    seen = Counter()
    for _, lattice, corridors in carved(general_problems, 41, 120):
        if not corridors.levelled:
            continue
        steps = openings_of(corridors, stopping=lattice.stopping)
        for k in range(1, lattice.steps):
            before, stage = corridors.stages[k - 1], corridors.stages[k]
            follows = np.abs(stage.level - before.level[:, None]) <= 1
            follows &= before.phase[:, None] <= stage.phase
            by_opening = steps[k].moves[before.opening[:, None], stage.opening]
            assert np.array_equal(stage.moves, by_opening & follows)
            seen.update(barred=int((follows & ~by_opening).sum()), shared=len(stage.lane) - stage.opening_count)
    assert seen["barred"] > 100  # some openings do not follow each other,
    assert seen["shared"] > 100  # and some have windows at several speed levels


def test_a_start_meets_every_row_of_the_model(general_problems):
    seen = Counter()
    for problem, lattice, corridors in carved(general_problems, 42, 60):
        best = search_best(problem, lattice, corridors) if corridors.passable else None
        if best is None or lattice.stopping:
            continue
        started = replace(problem, start=best)
        compiled = compile_model(shape_of(started, lattice, corridors, relaxed=False))
        start = start_values(compiled, started, lattice, corridors)
        assert start is not None
        data = fill(compiled, started, lattice, corridors)
        coefficients, low, high, _ = compiled.filled(data)
        rows = np.bincount(compiled.rows, weights=coefficients * start[compiled.cols], minlength=compiled.row_count)
        assert (rows >= low - 1e-9).all()
        assert (rows <= high + 1e-9).all()
        seen[corridors.levelled] += 1
    assert min(seen[True], seen[False]) >= 5
