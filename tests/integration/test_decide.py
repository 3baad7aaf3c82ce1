"""`sumo-hmdp decide` as the real command: one line of JSON a file, also into a pipe that closes early."""

import json
import subprocess
from pathlib import Path

import pytest

FILES = sorted((Path(__file__).parents[1] / "fixtures" / "decisions").glob("*.json"))
ANSWER = {"status", "objective", "violation_m", "solver", "solve_time_ms", "action", "plan", "prediction"}
STEP = {"step", "lateral", "mode", "lane", "x_m", "speed_mps"}


def refuse_constants(name):
    raise AssertionError(f"{name} is not JSON")


@pytest.mark.parametrize("wrapped", [True, False], ids=["with answer", "bare"])
def test_every_shipped_decision_has_its_known_objective(shell, tmp_path, wrapped):
    pairs = [json.loads(file.read_text(encoding="utf-8")) for file in FILES]
    assert len(pairs) == 10
    files = FILES
    if not wrapped:
        files = [tmp_path / file.name for file in FILES]
        for file, pair in zip(files, pairs, strict=True):
            # With the mark that some editors put in front.
            file.write_text(json.dumps(pair["problem"]), encoding="utf-8-sig")
    finished = shell("decide", *files)
    assert (finished.code, finished.err) == (0, "")
    answers = [json.loads(line, parse_constant=refuse_constants) for line in finished.out.splitlines()]
    assert len(answers) == len(pairs)
    for pair, answer in zip(pairs, answers, strict=True):
        assert set(answer) >= ANSWER
        known = pair["answer"]
        if known is None:
            assert answer["status"] in {"relaxed", "fallback"}
            assert answer["reason"]
            continue
        assert (answer["status"], answer["violation_m"], answer["reason"]) == ("optimal", 0.0, "")
        assert answer["objective"] == pytest.approx(known["objective"], abs=1e-6)
        steps = answer["plan"]
        assert [step["step"] for step in steps] == list(range(1, pair["problem"]["planner"]["horizon_steps"] + 1))
        assert all(set(step) == STEP for step in steps)
        assert answer["action"] == {"lateral": steps[0]["lateral"], "mode": steps[0]["mode"]}
        assert set(answer["prediction"]) == {"branches", "pruned_prob"}


def test_a_reader_that_leaves_early_gets_no_traceback(command):
    # Far more answers than a pipe holds, so that writing fails for certain.
    arguments = [command, "decide", *map(str, FILES * 12)]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        first = process.stdout.readline()
        process.stdout.close()
        complaint = process.stderr.read()
        process.wait(timeout=60)
    assert json.loads(first)["status"] == "optimal"
    assert complaint == ""
