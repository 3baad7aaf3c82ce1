"""What a study will take on the disk, against what it has taken."""

from pathlib import Path

import pytest
import yaml

from sumo_hmdp.study.design import load_design
from sumo_hmdp.study.forecast import forecast, size_of
from sumo_hmdp.study.parts import RunTables, Writer
from sumo_hmdp.study.runner import job_of
from sumo_hmdp.study.store import TABLES
from sumo_hmdp.study.worker import run_job


def size_on_disk(folder):
    return sum(file.stat().st_size for table in TABLES for file in Path(folder, table).rglob("*.parquet"))


@pytest.mark.parametrize(("trace", "most_kilobyte"), [("none", 6), ("all", 50)])
def test_the_forecast_is_what_the_trace_level_writes(tmp_path, trace, most_kilobyte):
    content = {
        "name": "s", "scenarios": ["matched"], "factors": {"planner": ["hmdp_mpc"], "duration_s": [4.8]},
        "seeds": {"count": 12}, "solver": "search", "trace": trace,
    }  # fmt: skip
    (tmp_path / "study.yaml").write_text(yaml.safe_dump(content))
    design = load_design(tmp_path / "study.yaml")
    found = forecast(design)
    writer = Writer(tmp_path / "out", design.cells)
    for seed in design.seeds:
        outcome = run_job(job_of(design, design.cells[0], seed))
        writer.add(RunTables(design.cells[0].id, outcome.row, outcome.steps, outcome.decisions))
    writer.flush()
    assert found[0].size < 1000 * most_kilobyte
    assert 0.9 < size_of(design, found) / size_on_disk(tmp_path / "out") < 2.0
