"""`sumo-hmdp predict` on a real study: predictors scored on the same recorded traffic."""

import json

import pytest
import yaml

STUDY = {
    "name": "short",
    "description": "Two seeds of highway traffic.",
    "scenarios": ["highway"],
    "factors": {"planner": ["hmdp_mpc"], "duration_s": [7.2], "planners.hmdp_mpc.predictor": ["idm_rollout"]},
    "seeds": {"first": 1, "count": 2},
    "solver": "search",
    "trace": "all",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory, shell):
    root = tmp_path_factory.mktemp("predict")
    (root / "study.yaml").write_text(yaml.safe_dump(STUDY), encoding="utf-8")
    finished = shell("study", str(root / "study.yaml"), "--out", str(root / "out"), "--workers", "1")
    assert finished.code == 0, finished.err
    return root / "out"


def test_predictors_are_scored_on_the_same_vehicles(folder, call):
    finished = call("predict", folder, "--predictor", "belief", "--predictor", "constant_velocity", "--json")
    scores = {(r["predictor"], r["score"]): r for r in json.loads(finished.out)["scores"]}
    assert {row["seed_count"] for row in scores.values()} == {2}
    assert len({row["trial_count"] for row in scores.values()}) == 1
    for name in ("belief", "constant_velocity"):
        shares = [scores[name, f"coverage_{level}_share"]["mean"] for level in (50, 90, 95)]
        assert 0.0 < shares[0] <= shares[1] <= shares[2] <= 1.0
        assert scores[name, "ade_m"]["mean"] < scores[name, "fde_m"]["mean"]
    # Who is sure that nobody changes lanes pays for each change.
    assert scores["belief", "lane_log_loss"]["mean"] != scores["constant_velocity", "lane_log_loss"]["mean"]


def test_an_unknown_predictor_is_one_message(folder, call):
    finished = call("predict", folder, "--predictor", "idm_rolout")
    assert finished.code == 2
    assert "idm_rollout" in finished.err
