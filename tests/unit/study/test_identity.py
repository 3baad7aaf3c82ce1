"""Names of cells: equal for equal runs, and others once a planner of the same name decides otherwise."""

from dataclasses import replace

from sumo_hmdp.decision import registry
from sumo_hmdp.scenario.load import RunOptions, find_scenario, load_scenario
from sumo_hmdp.study.identity import cell_id_of, content_of


def ready(planner):
    return load_scenario(find_scenario("highway"), RunOptions(planner=planner))


def test_runs_of_another_version_of_a_planner_are_of_another_cell(monkeypatch):
    """Even with the very same parameters."""
    run = ready("idm_mobil")
    now = cell_id_of(run)
    kinds = [replace(kind, version=1) if kind.name == "idm_mobil" else kind for kind in registry.BUILT_IN]
    monkeypatch.setattr(registry, "BUILT_IN", tuple(kinds))
    assert cell_id_of(run) != now
    assert cell_id_of(ready("constant")) == cell_id_of(ready("constant"))


def test_what_idm_mobil_was_and_what_it_is_are_two_planners():
    assert content_of(ready("idm_mobil"))["planner"] == "idm_mobil 2"
    # First versions keep the names that their cells had.
    assert content_of(ready("constant"))["planner"] == "constant"
    assert "idm_mobil_published" in cell_id_of(ready("idm_mobil_published"))
