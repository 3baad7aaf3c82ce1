"""The command line as fixtures: in this process, where that is enough, and as the real command."""

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

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
