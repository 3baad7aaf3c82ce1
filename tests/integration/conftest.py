"""The command line as fixtures: in this process, where that is enough, and as the real command."""

import os
import shutil
import signal
import subprocess
import sys
import threading
from dataclasses import dataclass
from pathlib import Path

import pytest
import yaml

from sumo_hmdp import cli

COMMAND = Path(sys.executable).with_name("sumo-hmdp")


@dataclass(frozen=True)
class Finished:
    """What a call of the command line left."""

    code: int
    out: str
    err: str

    @property
    def lines(self):
        return self.err.splitlines()


@pytest.fixture
def call(capsys, monkeypatch):
    """Call the command line in this process; an exception that escapes it fails the test."""

    def call_in_process(*arguments):
        monkeypatch.setattr(sys, "argv", ["sumo-hmdp", *map(str, arguments)])
        code = 0
        try:
            cli.main()
        except SystemExit as end:
            code = end.code or 0
        captured = capsys.readouterr()
        return Finished(code, captured.out, captured.err)

    return call_in_process


@pytest.fixture(scope="session")
def command():
    """The path of the installed command."""
    assert COMMAND.is_file()
    return str(COMMAND)


@pytest.fixture(scope="session")
def shell(command):
    """Run the installed command to its end in a process of its own."""

    def run(*arguments, **options):
        done = subprocess.run(
            [command, *map(str, arguments)], capture_output=True, text=True, check=False, timeout=120, **options
        )
        return Finished(done.returncode, done.stdout, done.stderr)

    return run


@pytest.fixture
def short_case(tmp_path):
    """Write Case 2 with another duration [s]."""

    def write(duration, old="", new=""):
        text = (Path(__file__).parents[2] / "scenarios" / "case2.yaml").read_text(encoding="utf-8")
        assert "duration_s: 45.0" in text
        assert old in text
        file = tmp_path / "short.yaml"
        file.write_text(text.replace("duration_s: 45.0", f"duration_s: {duration}").replace(old, new), encoding="utf-8")
        return file

    return write


@pytest.fixture
def write_study():
    """Write a study of one cell with runs of 0.6 s, with other values in place of some."""
    return _write_study


@pytest.fixture(scope="module")
def write_study_once():
    """The same for fixtures of a whole module."""
    return _write_study


def _write_study(folder, **changes):
    content = {
        "name": "tiny",
        "scenarios": ["case2"],
        "factors": {"planner": ["constant"], "duration_s": [0.6]},
        "seeds": {"count": 4},
    }
    file = folder / "study.yaml"
    file.write_text(yaml.safe_dump(content | changes))
    return file


@pytest.fixture
def faulty(tmp_path):
    """Offer the planner `faulty` as an installed package would; the environment in which it is seen."""
    shutil.copy(Path(__file__).with_name("faulty_planners.py"), tmp_path)
    info = tmp_path / "faulty_planners-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: faulty-planners\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[sumo_hmdp.planners]\nfaulty = faulty_planners:FAULTY\n")
    paths = [str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


# A shell that starts the tests in the background has them, and so the commands that they start, ignore Ctrl-C.
if threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGINT, signal.default_int_handler)
