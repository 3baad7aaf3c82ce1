"""What is in the wheel: everything that the package needs, and nothing else; and how fast it starts."""

import subprocess
import sys
import zipfile
from importlib.metadata import version
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    arguments = ["-m", "pip", "wheel", "--quiet", "--disable-pip-version-check", "--no-deps", "--no-build-isolation"]
    done = subprocess.run(
        [sys.executable, "-P", *arguments, "--wheel-dir", str(folder), str(ROOT)],
        capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    (built,) = folder.glob("*.whl")
    return zipfile.ZipFile(built)


def test_the_wheel_has_all_that_is_read_at_run_time(wheel):
    names = set(wheel.namelist())
    for folder, inside in (("scenarios", "sumo_hmdp/_data/scenarios"), ("networks", "sumo_hmdp/_data/networks")):
        wanted = [path for path in (ROOT / folder).rglob("*") if path.suffix in {".yaml", ".xml"}]
        assert wanted
        for path in wanted:
            assert f"{inside}/{path.relative_to(ROOT / folder).as_posix()}" in names
    package = [path for path in (ROOT / "sumo_hmdp").rglob("*") if path.is_file() and "__pycache__" not in path.parts]
    assert {path.relative_to(ROOT).as_posix() for path in package} <= names
    assert {"sumo_hmdp/py.typed", "sumo_hmdp/report/templates/replay.html.j2"} <= names
    assert any(name.endswith(".dist-info/licenses/LICENSE") for name in names)


def test_the_wheel_has_nothing_else(wheel):
    for name in wheel.namelist():
        assert name.startswith(("sumo_hmdp/", f"sumo_hmdp-{version('sumo-hmdp')}.dist-info/")), name
        assert not name.endswith(".pyc"), name
        assert "test" not in Path(name).parts[1:-1], name
        assert not Path(name).name.startswith("test_"), name


def test_the_wheel_offers_the_command(wheel):
    (entry_points,) = [name for name in wheel.namelist() if name.endswith("entry_points.txt")]
    assert "sumo-hmdp = sumo_hmdp.cli:main" in wheel.read(entry_points).decode()


HEAVY = ("pyomo", "highspy", "pandas", "pyarrow", "libsumo", "scipy", "piqp", "jinja2", "numpy")


@pytest.mark.parametrize("arguments", [["--help"], ["run", "--help"], ["--version"]], ids=" ".join)
def test_help_loads_nothing_heavy(arguments):
    code = (
        "import sys\nfrom sumo_hmdp import cli\nsys.argv = ['sumo-hmdp', *sys.argv[1:]]\n"
        "try:\n    cli.main()\nexcept SystemExit as end:\n    assert not end.code\n"
        f"print([name for name in {HEAVY!r} if name in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", code, *arguments], capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stderr == "[]\n"
    assert done.stdout


def test_version(shell):
    assert shell("--version").out == f"sumo-hmdp {version('sumo-hmdp')}\n"


def test_every_command_shows_an_example(call):
    for command in ("decide", "run", "check", "list", "study", "repro", "compare", "new-planner", "replay", "video"):
        finished = call(command, "--help")
        assert finished.code == 0
        assert f"sumo-hmdp {command}" in finished.out.split("Example")[1]


def test_list_names_what_can_be_run(call):
    finished = call("list")
    assert finished.code == 0
    for name in ("case2", "hmdp_mpc", "milp", "search"):
        assert name in finished.out
