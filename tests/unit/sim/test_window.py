"""SUMO's own window: how it is found, and what it is started with."""

from types import SimpleNamespace

from typer.testing import CliRunner

from sumo_hmdp.cli import app
from sumo_hmdp.errors import InputError
from sumo_hmdp.sim import window


def test_the_window_starts_by_itself_and_goes_when_the_run_ends(monkeypatch):
    monkeypatch.setenv(window.DELAY, "30")
    monkeypatch.setattr(window, "program", lambda: "/opt/sumo-gui")
    words = window.command(["sumo", "--seed", "3"])
    assert words == ["/opt/sumo-gui", "--seed", "3", "--start", "--quit-on-end", "--delay", "30"]


def test_a_program_beside_python_comes_before_one_on_the_path(monkeypatch, tmp_path):
    monkeypatch.setattr(window.sys, "executable", str(tmp_path / "python"))
    monkeypatch.setenv("PATH", str(tmp_path / "elsewhere"))
    assert window.program() is None
    (tmp_path / "sumo-gui").touch()
    assert window.program() == str(tmp_path / "sumo-gui")


def test_the_view_goes_with_the_ego():
    calls = []
    sumo = SimpleNamespace(
        vehicle=SimpleNamespace(setColor=lambda *a: calls.append(("color", *a))),
        gui=SimpleNamespace(
            setZoom=lambda *a: calls.append(("zoom", *a)), trackVehicle=lambda *a: calls.append(("track", *a))
        ),
    )
    window.follow_ego(sumo)
    assert [(name, args[0]) for name, *args in calls] == [("color", "ego"), ("zoom", "View #0"), ("track", "View #0")]


def test_without_the_window_the_remedy_is_told(monkeypatch):
    monkeypatch.setattr(window, "program", lambda: None)
    result = CliRunner().invoke(app, ["watch", "case2"])
    assert isinstance(result.exception, InputError)
    assert "pip install 'sumo-hmdp[gui]'" in str(result.exception)


def test_a_watched_run_is_the_command_run_in_a_process_that_uses_the_window(monkeypatch):
    seen = {}

    def run(words, env, check):
        seen.update(words=words[3:], delay=env[window.DELAY], check=check)
        return SimpleNamespace(returncode=0)

    monkeypatch.setattr(window, "program", lambda: "sumo-gui")
    monkeypatch.setattr("sumo_hmdp.cli_watch.subprocess.run", run)
    result = CliRunner().invoke(
        app, ["watch", "case2", "--planner", "sumo", "--seed", "4", "--delay-ms", "7", "--out", "o"]
    )
    assert result.exit_code == 0
    expected = ["run", "case2", "--solver", "search", "--seed", "4", "--out", "o", "--planner", "sumo"]
    assert seen == {"words": expected, "delay": "7", "check": False}
