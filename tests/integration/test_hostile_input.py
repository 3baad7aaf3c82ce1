"""Inputs that mean harm, or nothing: a thousand mutants, and names that a terminal or a table would obey."""

import importlib.util
import os
from pathlib import Path

import pytest
import yaml

from sumo_hmdp.cli_common import MISTAKES_SHOWN, complain, plain_console, say, tell
from sumo_hmdp.errors import InputError, printable
from sumo_hmdp.scenario.load import RunOptions, find_scenario, load_scenario
from sumo_hmdp.study.design import load_design
from sumo_hmdp.study.run import execute
from sumo_hmdp.validation import parse, path_text, shown

ROOT = Path(__file__).parents[2]
CASE2 = yaml.safe_load((ROOT / "scenarios" / "case2.yaml").read_text(encoding="utf-8"))
HIGHWAY = yaml.safe_load((ROOT / "scenarios" / "highway.yaml").read_text(encoding="utf-8"))


def _mutator():
    spec = importlib.util.spec_from_file_location("hostile_input", ROOT / "analysis" / "13_hostile_input.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_thousand_mutants_end_in_lines(tmp_path):
    mutator = _mutator()
    found = [
        mutator.tried(mutant, tmp_path)
        for mutant in mutator.mutants(
            2026,
            range(1000),
            ("decision", "scenario", "decision", "study", "scenario", "decision", "scenario", "decision"),
        )
    ]
    assert [one for one in found if one.bad] == []
    # Both sides of the checks were tried.
    assert {one.outcome for one in found} == {"refused", "accepted"}
    assert {one.kind for one in found if one.outcome == "accepted"} == {"decision", "study", "scenario"}
    assert max(one.seconds for one in found) < mutator.LIMIT_S


def written(tmp_path, content, name="a.yaml"):
    file = tmp_path / name
    file.write_text(yaml.safe_dump(content), encoding="utf-8")
    return file


ABSURD = {
    "name": ("name", "a" * 5000),
    "duration": ("duration_s", 1e12),
    "steps": ("duration_s", 80_000.1),
    "step": ("dt_s", 1e-9),
    "long step": ("dt_s", 100.0),
    "period": ("planners.hmdp_mpc.period_s", 1e-9),
    "horizon": ("planners.hmdp_mpc.horizon_steps", 10**9),
    "lanes": ("lanes.count", 10**6),
    "lanes beyond a word": ("lanes.count", 10**9),
    "width": ("lanes.width_m", 1e-300),
    "threshold": ("planners.hmdp_mpc.sequence_threshold", 1e-300),
    "lane change": ("ego.lane_change_time_s", 1e-200),
    "vehicles": ("vehicles", [1] * 2000),
    "number": ("ego.speed_mps", 10**4200),
    "letters": ("ego.speed_mps", "x" * 1_000_000),
}


@pytest.mark.parametrize("what", ABSURD)
def test_an_absurd_value_is_named_at_once(call, tmp_path, what):
    path, value = ABSURD[what]
    content = yaml.safe_load(yaml.safe_dump(CASE2))
    if what == "threshold":
        content["planners"]["hmdp_mpc"]["horizon_steps"] = 20
        even = {"left": 0.33, "keep": 0.34, "right": 0.33}
        content["vehicles"][0]["policy"][0].update(
            lateral_probs=even, longitudinal_probs={"accelerate": 0.33, "cruise": 0.34, "decelerate": 0.33}
        )
    holder = content
    *way, last = path.split(".")
    for part in way:
        holder = holder[part]
    holder[last] = value
    finished = call("check", written(tmp_path, content))
    assert (finished.code, finished.out) == (2, "")
    assert any(path in line for line in finished.lines)
    assert all(len(line) < 1100 for line in finished.lines)


@pytest.mark.parametrize(
    ("path", "value", "named"),
    [
        ("density_vpkm_per_lane", 1e9, "traffic.density_vpkm_per_lane"),
        ("warm_up_s", 1e6, "traffic.warm_up_s"),
        ("classes", [{"name": "x"}] * 2000, "traffic.classes"),
    ],
)
def test_absurd_traffic_is_not_drawn(call, tmp_path, path, value, named):
    content = {**HIGHWAY, "traffic": {**HIGHWAY["traffic"], path: value}}
    finished = call("check", written(tmp_path, content))
    assert finished.code == 2
    assert all(named in line for line in finished.lines)


def test_more_vehicles_than_a_run_can_hold_are_not_drawn(call, tmp_path):
    finished = call("check", written(tmp_path, {**HIGHWAY, "duration_s": 80_000.0, "dt_s": 0.8}))
    assert finished.code == 2
    assert "duration_s: must let at most 50000 vehicles enter, got up to" in finished.err


@pytest.mark.parametrize("planner", [["hmdp_mpc"], {"hmdp_mpc": 1}, 3, None])
def test_a_planner_that_is_no_name_is_a_mistake(call, tmp_path, planner):
    file = written(tmp_path, {**CASE2, "planner": planner})
    (line,) = call("check", file).lines
    assert line.startswith(f"{file}: planner: must be text, got ")
    study = written(tmp_path, STUDY | {"scenarios": ["a.yaml"], "factors": {}}, "study.yaml")
    finished = call("check", study)
    assert finished.code == 2
    assert "planner: must be text, got " in finished.err


@pytest.mark.parametrize("value", [10**400, -(10**400), 5, True, "x", [0.1], None])
def test_a_risk_level_that_is_none_is_a_mistake(call, tmp_path, value):
    study = written(tmp_path, STUDY | {"factors": {"risk_level": [value], "duration_s": [0.6]}})
    finished = call("check", study)
    assert finished.code == (0 if value is None else 2)
    assert all("factors.risk_level[0]: must be " in line for line in finished.lines)


STUDY = {"name": "s", "scenarios": ["case2"], "factors": {"planner": ["constant"]}, "seeds": {"count": 2}}


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"factors": {"[/foo]": {"a": {"duration_s": 0.6}}}}, "factors.[/foo]: must be text of the pattern"),
        ({"factors": {"x" * 5000: {"a": {"duration_s": 0.6}}}}, "must be at most 100 characters long"),
        ({"factors": {"pace": {"y" * 5000: {"duration_s": 0.6}}}}, "must be at most 100 characters long"),
        ({"factors": {"": [1]}}, "must be text of the pattern"),
        ({"name": "n" * 5000}, "name: must be at most 100 characters long"),
        ({"factors": {f"ego.k{n}": list(range(100)) for n in range(9)}}, "factors: must make at most 2000 cells"),
        ({"factors": {"ego.x_m": [0.0, 1.0]}, "seeds": {"count": 900_000}}, "seeds: must make at most 1000000 runs"),
        ({"scenarios": ["s" * 5000]}, "scenarios[0]: must be a scenario file or name"),
    ],
)
def test_a_study_with_absurd_names_or_sizes_is_refused(call, tmp_path, changes, named):
    finished = call("check", written(tmp_path, STUDY | changes))
    assert (finished.code, finished.out) == (2, "")
    assert named in finished.err
    assert all(len(line) < 1400 for line in finished.lines)


def test_a_study_is_checked_as_a_study(call, tmp_path):
    finished = call("check", written(tmp_path, STUDY), "case2_epsilon")
    assert (finished.code, finished.err) == (0, "")
    assert finished.out.splitlines()[0].endswith("a.yaml: ok")


def test_look_alike_letters_in_a_key_are_told(call, tmp_path):
    content = {**CASE2, "dur\u0430tion_s": 1.0}
    finished = call("check", written(tmp_path, content))
    assert finished.lines == [f"{tmp_path / 'a.yaml'}: dur\\u0430tion_s: unknown key; did you mean `duration_s`?"]


def test_what_is_printed_does_not_steer_the_terminal(capfd):
    evil = "a\x1b[2J\x9b31m\u202eb\udcff\r[/foo][red]"
    say(evil)
    tell(evil)
    complain(InputError([evil], evil))
    told = "".join(capfd.readouterr())
    assert not any(letter in told for letter in "\x1b\x9b\u202e\udcff\r")
    assert told.count(r"a\x1b[2J\x9b31m\u202eb\udcff\r[/foo][red]") == 2
    assert printable("12 km·h - ü\n\tok") == "12 km·h - ü\n\tok"


def test_a_table_shows_names_as_they_are(capsys):
    from rich.table import Table  # noqa: PLC0415 - as in the commands

    table = Table("[/foo]", "b", title="[bold]:smile:[/]")
    table.add_row("[red]x[/blue]", "\x1b[31m")
    plain_console(width=80).print(table)
    out = capsys.readouterr().out
    assert all(text in out for text in ("[/foo]", "[red]x[/blue]", r"\x1b[31m", "[bold]:smile:[/]"))
    assert "\x1b" not in out


def test_a_terminal_shows_what_goes_on_with_any_name(monkeypatch, capfd):
    from sumo_hmdp.cli_common import busy, progress_bar  # noqa: PLC0415

    monkeypatch.setenv("FORCE_COLOR", "1")
    with busy("doing [/foo] again"), progress_bar("[/bar]", at_once=True) as on_progress:
        on_progress(1, 2)
    assert "[/foo]" in capfd.readouterr().err


def test_many_mistakes_are_counted(call, tmp_path):
    finished = call("check", written(tmp_path, {**CASE2, **{f"x{n}": 1 for n in range(400)}}))
    assert len(finished.lines) == MISTAKES_SHOWN + 1
    assert finished.lines[-1].endswith("300 more mistakes; mend these first, or see all with `check --json`")


def test_long_values_are_shown_shortened():
    assert len(shown({"a": ["x" * 10**6] * 1000})) <= 60
    assert shown(10**5000) == "a number of thousands of digits"
    assert path_text(["k" * 10**6, 3]) == f"{'k' * 57}...[3]"
    with pytest.raises(InputError):
        parse(type(load_design(find_study("case2_epsilon")).file), {"name": 10**4000})


def find_study(name):
    return ROOT / "scenarios" / "studies" / f"{name}.yaml"


def test_a_run_that_will_reach_the_end_of_the_road_is_told_before(call, tmp_path):
    content = {**HIGHWAY, "duration_s": 600.0, "planner": "constant"}
    del content["traffic"]
    content["ego"] = {"x_m": 8900.0, "lane": 2, "speed_mps": 30.0}
    file = written(tmp_path, content)
    finished = call("check", file)
    assert finished.code == 0
    assert "note: the ego may reach the road's end at 9000 m" in finished.out
    assert "set ego.goal_x_m" in finished.out
    record = execute(load_scenario(file, RunOptions()))
    assert str(record.status) == "failed"
    assert "the ego must not reach the road's end at 9000 m" in record.reason
    assert "Set ego.goal_x_m below it" in record.reason
    content["ego"]["goal_x_m"] = 8990.0
    ready = load_scenario(written(tmp_path, content))
    assert ready.notes == ()
    assert str(execute(ready).status) == "completed"


@pytest.mark.parametrize("name", ["case1", "case2", "case3", "highway", "highway_ramps", "matched", "urban"])
def test_the_scenarios_of_the_package_stay_on_their_roads(name):
    assert load_scenario(find_scenario(name)).notes == ()


def test_a_scenario_or_study_that_is_a_pipe_is_not_waited_for(call, tmp_path):
    os.mkfifo(tmp_path / "pipe.yaml")
    for command in (["check"], ["run"], ["study", "--out", tmp_path / "out"]):
        finished = call(*command, tmp_path / "pipe.yaml")
        assert (finished.code, len(finished.lines)) == (2, 1)
