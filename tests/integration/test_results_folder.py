"""Several runs in one results directory, and which vehicles the steps table keeps."""

import pytest

import sumo_hmdp


@pytest.fixture
def short(short_case):
    """A scenario of 3 s."""
    return short_case(3.0)


@pytest.mark.parametrize(("trace", "kept"), [("none", set()), ("ego", {"ego"}), ("all", {"ego", "sv1", "sv2"})])
def test_the_steps_table_keeps_what_was_asked_for(call, short, tmp_path, trace, kept):
    assert call("run", short, "--out", tmp_path / "out", "--trace", trace).code == 0
    results = sumo_hmdp.load(tmp_path / "out")
    vehicles = set(results.steps["vehicle_id"])
    assert vehicles >= kept
    assert trace == "all" or vehicles == kept
    # The numbers of the run are those of all vehicles, whatever is kept.
    assert results.runs["gap_min_m"].notna().all()
    assert len(results.decisions) == 5
    assert not list((tmp_path / "out").glob("decision_files/*"))


def test_other_seeds_planners_and_risk_levels_stay_beside_each_other(call, short, tmp_path):
    runs = [[], ["--seed", 1], ["--epsilon", 0.01], ["--epsilon", 0.0100000001], ["--planner", "idm_mobil"]]
    for options in runs:
        assert call("run", short, "--out", tmp_path / "out", *options).code == 0
    results = sumo_hmdp.load(tmp_path / "out")
    assert results.runs["run_id"].nunique() == len(results.manifests) == len(runs)
    assert len(list((tmp_path / "out").glob("*.html"))) == len(runs)
    assert set(results.steps["run_id"]) == set(results.decisions["run_id"]) == set(results.runs["run_id"])
    assert results.runs.set_index("run_id")["seed"].max() == 1
    # A planner without a risk level must not turn the others' into texts.
    assert results.runs["risk_level"].dtype == "float64"


def test_the_same_run_again_takes_the_place_of_the_first(call, short, tmp_path):
    out = tmp_path / "out"
    assert call("run", short, "--out", out, "--dump-decisions").code == 0
    first = sumo_hmdp.load(out)
    dumped = out / "decision_files" / first.runs["run_id"].item()
    assert len(list(dumped.iterdir())) == 5
    assert call("run", short, "--out", out).code == 0
    again = sumo_hmdp.load(out)
    assert len(again.runs) == 1
    assert len(again.steps) == len(first.steps)
    assert again.runs["trace_hash"].tolist() == first.runs["trace_hash"].tolist()
    # Decisions that this run did not dump would be read as its own.
    assert list(dumped.iterdir()) == []
