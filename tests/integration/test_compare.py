"""The command `compare` on real runs, in words and as JSON."""

import json

import pytest


@pytest.fixture
def results(call, write_study, tmp_path):
    factors = {"planner": ["hmdp_mpc", "constant"], "risk_level": [0.05], "duration_s": [0.6]}
    study = write_study(tmp_path, factors=factors, seeds={"count": 9}, solver="search")
    assert call("study", study, "--out", tmp_path / "out", "--workers", 1).code == 0
    return tmp_path / "out"


def test_compare_in_words_and_as_json(call, results):
    finished = call("compare", results)
    assert (finished.code, finished.err) == (0, "")
    lines = [line for line in finished.out.splitlines() if line.startswith("- ")]
    assert len(lines) == 7
    # Nothing is random in Case 2: nine pairs with the same difference.
    assert lines[0].startswith("- constant is ")
    # Clopper and Pearson of 0 in 9.
    assert lines[0].endswith(
        " m/s slower than hmdp_mpc in each of 9 pairs alike, without spread for a test or an interval; up to 34 % of "
        "all seeds may do otherwise"
    )
    assert "too few data: 0 pairs of constant and hmdp_mpc with a share of optimal decisions" in lines[4]
    table = call("compare", results, "--metric", "ttc_min_s", "--metric", "contact_rate").out
    for text in ("hmdp_mpc", "constant", "contact_rate", "0/9 [0, 0.34]"):
        assert text in table

    options = ("--metric", "ttc_min_s", "--metric", "contact_rate", "--by", "planner", "--json")
    content = json.loads(call("compare", results, *options).out)
    assert (content["by"], content["metrics"]) == (["planner"], ["ttc_min_s", "contact_rate"])
    assert [(row["first"], row["second"]) for row in content["differences"]] == [("constant", "hmdp_mpc")] * 2
    assert [(row["hits"], row["trials"]) for row in content["rates"]] == [(0, 9), (0, 9)]


def test_what_cannot_be_compared_is_said(call, results, tmp_path):
    finished = call("compare", results, "--metric", "speed")
    assert (finished.code, finished.out) == (2, "")
    assert len(finished.lines) == 1
    assert finished.err.startswith("--metric: must be a column of numbers, got 'speed'")
    single = tmp_path / "single"
    assert call("run", "case2", "--planner", "sumo", "--out", single).code == 0
    finished = call("compare", single, "--metric", "speed_mean_mps")
    assert finished.code == 0
    assert "nothing to compare: no two cells differ in one factor alone" in finished.out
