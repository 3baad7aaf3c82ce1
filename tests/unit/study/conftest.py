"""A small design, and what its runs leave, computed once."""

import pytest

from sumo_hmdp.study.design import load_design
from sumo_hmdp.study.parts import RunTables
from sumo_hmdp.study.run import execute

STUDY = """
name: tiny
scenarios: [case2]
factors:
  duration_s: [1.2]
  planner: [hmdp_mpc, idm_mobil]
  ego.speed_mps: [29.0, 30.0]
solver: search
seeds: {count: 3}
"""


@pytest.fixture(scope="session")
def tiny(tmp_path_factory):
    """Four cells of runs of 1.2 s."""
    file = tmp_path_factory.mktemp("tiny") / "study.yaml"
    file.write_text(STUDY)
    return load_design(file)


@pytest.fixture(scope="session")
def tables(tiny):
    """What the run of every cell leaves, for any seed: nothing is random in them."""
    records = {cell.id: execute(cell.ready, run_id="any") for cell in tiny.cells}

    def of(cell, seed):
        record, run_id = records[cell.id], cell.run_id(seed)
        return RunTables(
            cell.id,
            record.row | {"run_id": run_id, "seed": seed},
            record.steps.assign(run_id=run_id),
            record.decisions.assign(run_id=run_id),
        )

    return of
