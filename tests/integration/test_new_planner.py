"""A planner of one's own: the template is written, installed as a package, listed, checked, run, and tests itself."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import sumo_hmdp


@pytest.fixture(scope="module")
def written(shell, tmp_path_factory):
    folder = tmp_path_factory.mktemp("work")
    finished = shell("new-planner", "my_planner", "--out", folder)
    assert (finished.code, finished.err) == (0, "")
    assert "sumo-hmdp run highway --planner my_planner" in finished.out
    return folder / "my_planner"


def install(package, where):
    """Install a package without a network into a folder of its own; the environment that sees it."""
    options = ["--quiet", "--disable-pip-version-check", "--no-deps", "--no-build-isolation", "--no-index"]
    done = subprocess.run(
        [sys.executable, "-P", "-m", "pip", "install", *options, "--target", str(where), str(package)],
        capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    paths = [str(where), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


@pytest.fixture(scope="module")
def installed(written, tmp_path_factory):
    return install(written, tmp_path_factory.mktemp("site"))


def test_the_template_runs_in_a_scenario_that_knows_nothing_of_it(shell, installed, tmp_path):
    listed = shell("list", env=installed)
    assert "my_planner" in listed.out
    assert "keeps its lane and its distance" in listed.out
    ran = shell("run", "highway", "--planner", "my_planner", "--out", tmp_path, env=installed)
    assert (ran.code, ran.err) == (0, "")
    results = sumo_hmdp.load(tmp_path)
    row = results.runs.iloc[0]
    assert (row["planner"], row["status"], row["contact_count"]) == ("my_planner", "completed", 0)
    # It wants 33 m/s, and is kept from it by those in front.
    assert 15 < row["speed_mean_mps"] < 33
    assert row["gap_min_m"] > 2
    assert row["time_loss_s"] > 0
    assert (results.decisions["status"] == "rule").all()
    assert (results.decisions["solve_time_ms"] > 0).all()


def test_a_scenario_may_set_its_parameters(shell, installed, tmp_path):
    text = (Path(__file__).parents[2] / "scenarios" / "highway.yaml").read_text(encoding="utf-8")
    good, bad = tmp_path / "good.yaml", tmp_path / "bad.yaml"
    good.write_text(text + "  my_planner: {time_gap_s: 2.5}\n")
    bad.write_text(text + "  my_planner: {time_gap: 2.5, accel_mps2: 0.0}\n")
    finished = shell("check", "highway", good, bad, env=installed)
    assert finished.code == 2
    assert finished.out.splitlines() == ["highway: ok", f"{good}: ok"]
    assert sorted(finished.lines) == [
        f"{bad}: planners.my_planner.accel_mps2: must be above 0, got 0.0",
        f"{bad}: planners.my_planner.time_gap: unknown key; did you mean `time_gap_s`?",
    ]


def test_it_stops_at_red_lights(shell, installed, tmp_path):
    ran = shell("run", "urban", "--planner", "my_planner", "--out", tmp_path, env=installed)
    assert ran.code == 0
    row = sumo_hmdp.load(tmp_path).runs.iloc[0]
    assert (row["contact_count"], row["red_light_count"]) == (0, 0)
    assert row["distance_m"] > 100


def test_its_own_tests_pass(written, installed):
    done = subprocess.run(
        [sys.executable, "-P", "-m", "pytest", "-q", "-p", "no:cacheprovider", "-W", "error", "tests"],
        cwd=written, env=installed, capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    assert "3 passed" in done.stdout


def test_it_is_as_clean_as_this_package(written, installed):
    config = Path(__file__).parents[2] / "pyproject.toml"
    for arguments in (
        ["ruff", "check", "--no-cache", "--config", str(config), "--ignore", "INP001", "src"],
        ["ruff", "format", "--no-cache", "--config", str(config), "--check", "src", "tests"],
    ):
        done = subprocess.run(
            [sys.executable, "-m", *arguments],
            cwd=written, env=installed, capture_output=True, text=True, check=False, timeout=300,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout


def test_a_planner_that_cannot_be_imported_is_named(shell, written, tmp_path):
    broken = tmp_path / "broken"
    shutil.copytree(written, broken)
    source = broken / "src" / "my_planner.py"
    source.write_text(source.read_text().replace("import math\n", "import math\n\nmath.nothing()\n"))
    finished = shell("list", env=install(broken, tmp_path / "site"))
    assert (finished.code, len(finished.lines)) == (2, 1)
    assert finished.err.startswith("planner my_planner: must be importable from my_planner:KIND, got AttributeError: ")
    assert finished.err.rstrip().endswith("my_planner.py, line 5). Correct or uninstall it")
    source.write_text("KIND = 7\n")
    finished = shell("check", "highway", env=install(broken, tmp_path / "other"))
    assert finished.code == 2
    assert "planner my_planner: my_planner:KIND must be a PlannerKind, got 7" in finished.lines[0]


@pytest.mark.parametrize("name", ["", "My", "1st", "with-dash", "class", "a/b", "../up", "x" * 41, "ü"])
def test_names_of_the_wrong_form(call, tmp_path, name):
    finished = call("new-planner", "--out", tmp_path, "--", name)
    assert (finished.code, finished.out, len(finished.lines)) == (2, "", 1)
    assert finished.err.startswith("NAME: must be made of small letters, digits and _, a letter first, ")
    assert f"no word of Python, got {name!r}. Choose another" in finished.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("name", "why"), [("hmdp_mpc", "a planner already"), ("json", "an installed Python module")])
def test_names_that_are_taken(call, tmp_path, name, why):
    finished = call("new-planner", name, "--out", tmp_path)
    assert finished.code == 2
    assert finished.lines == [f"NAME: must be new, got {name!r}, which is {why}. Choose another"]


def test_nothing_is_overwritten(call, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "work.txt").write_text("of months")
    finished = call("new-planner", "mine", "--out", tmp_path)
    assert finished.code == 2
    assert finished.lines == [f"{tmp_path / 'mine'} must not exist yet. Choose another name, or another --out"]
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["work.txt"]
    (tmp_path / "file").write_text("")
    finished = call("new-planner", "mine", "--out", tmp_path / "file")
    assert finished.code == 2
    assert finished.lines == [f"--out: {tmp_path / 'file' / 'mine'} must be writable: Not a directory. Choose another"]
