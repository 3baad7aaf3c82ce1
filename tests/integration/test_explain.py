"""`sumo-hmdp decide --explain` and `--figure`: what goes where, and what is refused."""

import json
from pathlib import Path

import pytest

DECISIONS = Path(__file__).parents[1] / "fixtures" / "decisions"
INFEASIBLE = DECISIONS / "neighbour-may-merge-infeasible.json"
FREE = DECISIONS / "nothing-to-do-with-forbidden-lane.json"
BEGINNING = {".svg": b"<?xml", ".png": b"\x89PNG", ".pdf": b"%PDF"}


def test_the_explanation_goes_to_standard_error_and_the_answer_stays_one_line(call):
    finished = call("decide", INFEASIBLE, FREE, "--explain", "--solver", "search")
    assert finished.code == 0
    answers = [json.loads(line) for line in finished.out.splitlines()]
    assert [answer["status"] for answer in answers] == ["relaxed", "optimal"]
    assert [line for line in finished.lines if line.endswith(".json")] == [str(INFEASIBLE), str(FREE)]
    assert max(len(line) for line in finished.lines if not line.endswith(".json")) <= 100
    chosen = [line.split() for line in finished.lines if line.startswith("  * ")]
    assert [(row[1], row[2], float(row[3])) for row in chosen] == [
        (answer["action"]["lateral"], answer["action"]["mode"], pytest.approx(answer["objective"], abs=1e-3))
        for answer in answers
    ]
    assert "sv1 at step 1 is 0.38 m too near" in finished.err
    assert "there is no lane left of lane 1" in finished.err


@pytest.mark.parametrize("suffix", [".svg", ".png", ".pdf"])
def test_a_figure_is_written_and_is_the_same_every_time(call, tmp_path, suffix):
    files = [tmp_path / f"{name}{suffix}" for name in ("first", "second")]
    for file in files:
        finished = call("decide", INFEASIBLE, "--figure", file)
        assert (finished.code, finished.err) == (0, "")
        assert len(finished.out.splitlines()) == 1
    first, second = (file.read_bytes() for file in files)
    assert first.startswith(BEGINNING[suffix])
    assert first == second


@pytest.mark.parametrize("name", ["decision.jpg", "decision"])
def test_another_suffix_is_refused_before_anything_is_solved(call, tmp_path, name):
    finished = call("decide", FREE, "--figure", tmp_path / name)
    assert (finished.code, finished.out) == (2, "")
    assert len(finished.lines) == 1
    assert finished.err.startswith("--figure: must end in .svg, .png or .pdf, got ")


def test_a_figure_takes_a_single_file_and_a_folder_that_exists(call, tmp_path):
    several = call("decide", FREE, INFEASIBLE, "--figure", tmp_path / "decision.svg")
    assert (several.code, several.out) == (2, "")
    assert several.lines == ["--figure: must be given with a single file, got 2. Call once for each file"]
    nowhere = call("decide", FREE, "--figure", tmp_path / "missing" / "decision.svg")
    assert (nowhere.code, nowhere.out, len(nowhere.lines)) == (2, "", 1)
    assert "must be in a folder that exists" in nowhere.err
