"""The command line as a product: help, one line per mistake, JSON for scripts, colours, completion."""

import json
import os
import pty
import re
import subprocess

import pytest

import sumo_hmdp

COMMANDS = ["run", "watch", "study", "report", "compare", "predict", "repro", "check", "list", "decide", "new-planner"]
PAIRED = ["--metric", "speed_mean_mps", "--by", "planner"]


def test_the_bare_name_and_help_show_every_command(call):
    bare, asked = call(), call("--help")
    assert (bare.code, bare.err) == (0, "")
    assert bare.out == asked.out
    for command in COMMANDS:
        assert re.search(rf"^│ {command} ", bare.out, re.MULTILINE)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_an_example_and_says_which_files_come_out(call, command):
    helped = call(command, "--help")
    assert (helped.code, helped.err) == (0, "")
    assert f"sumo-hmdp {command} " in helped.out.split("Example")[1]
    assert re.search(r"Files,|Files:|No file comes out", helped.out)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["run", "case2", "--epsilon", "abc"], "--epsilon: must be a number, got 'abc'; see `sumo-hmdp run --help`"),
        (["run", "case2", "--seed", "-1"], "--seed: must be at least 0, got '-1'; see `sumo-hmdp run --help`"),
        (["run", "case2", "--seed", "1.5"], "--seed: must be a whole number, got '1.5'; see `sumo-hmdp run --help`"),
        (
            ["run", "case2", "--trace", "egoo"],
            "--trace: must be one of 'none', 'ego', 'all', got 'egoo'; see `sumo-hmdp run --help`",
        ),
        (["run"], "missing argument 'scenario'; see `sumo-hmdp run --help`"),
        (["study", "main"], "missing option '--out'; see `sumo-hmdp study --help`"),
        (["rnu"], "no such command 'rnu'. Did you mean 'run'? or see `sumo-hmdp --help`"),
        (["list", "--jsn"], "no such option: --jsn (Possible options: --json); see `sumo-hmdp list --help`"),
        (["run", "case2", "case3"], "got unexpected extra argument(s) (case3); see `sumo-hmdp run --help`"),
    ],
)
def test_a_mistake_in_the_call_is_one_line(call, arguments, line):
    finished = call(*arguments)
    assert finished.lines == [line]
    assert (finished.code, finished.out) == (2, "")


def test_a_study_is_no_scenario_and_a_scenario_no_study(call, short_case, tmp_path):
    study = tmp_path / "study.yaml"
    study.write_text("name: tiny\nscenarios: [case2]\nseeds: [0]\n")
    for arguments, remedy in [
        (["run", "main"], "it is a study: `sumo-hmdp study main --out DIR`"),
        (["study", "case2", "--out", tmp_path / "out"], "it is a scenario: `sumo-hmdp run case2`"),
        (["study", short_case(1.2), "--out", tmp_path / "out"], "must be a study, got a scenario; run it with"),
    ]:
        finished = call(*arguments)
        assert (finished.code, finished.out, len(finished.lines)) == (2, "", 1)
        assert remedy in finished.err


def test_a_manifest_that_is_broken_is_one_line(call, short_case, tmp_path):
    assert call("run", short_case(1.2), "--out", tmp_path).code == 0
    manifest = next((tmp_path / "manifests").glob("*.json"))
    manifest.write_text('{"a":')
    for command in (["repro", tmp_path, manifest.stem], ["compare", tmp_path]):
        finished = call(*command)
        assert (finished.code, finished.out, len(finished.lines)) == (2, "", 1)
        assert finished.err.startswith(f"{manifest}: must be JSON: ")


def test_json_of_a_run_is_its_row(call, short_case, tmp_path):
    finished = call("run", short_case(1.2), "--out", tmp_path, "--json")
    assert (finished.code, finished.err) == (0, "")
    told = json.loads(finished.out)
    row = sumo_hmdp.load(tmp_path).runs.iloc[0]
    assert told["run"]["trace_hash"] == row["trace_hash"]
    assert told["run"]["speed_mean_mps"] == row["speed_mean_mps"]
    assert told["run"]["goal_reached"] is None
    assert told["page"] == str(tmp_path / f"{row['run_id']}.html")
    again = json.loads(call("repro", tmp_path, row["run_id"], "--json").out)
    assert (again["same"], again["new_hash"]) == (True, row["trace_hash"])


def test_json_of_check_names_every_problem_by_its_path(call, short_case, tmp_path):
    bad = tmp_path / "bad.yaml"
    bad.write_text(short_case(1.2).read_text().replace("duration_s:", "duraton_s:"))
    finished = call("check", "case2", bad, "--json")
    assert finished.code == 2
    assert finished.lines == [f"{bad}: duraton_s: unknown key; did you mean `duration_s`?"]
    problem = {"path": "duraton_s", "message": "unknown key; did you mean `duration_s`?"}
    assert json.loads(finished.out) == {
        "files": [
            {"file": "case2", "ok": True, "problems": [], "notes": []},
            {"file": str(bad), "ok": False, "problems": [problem], "notes": []},
        ]
    }


def test_json_of_list(call):
    listed = json.loads(call("list", "--json").out)
    assert {"hmdp_mpc", "idm_mobil"} <= {planner["planner"] for planner in listed["planners"]}
    assert "main" in {study["study"] for study in listed["studies"]}
    assert listed["solvers"] == ["milp", "search", "both"]
    case2 = next(scenario for scenario in listed["scenarios"] if scenario["scenario"] == "case2")
    assert set(case2) == {"scenario", "planner", "description"}


def test_json_of_a_study_and_of_what_looks_at_it(call, short_case, tmp_path):
    study = tmp_path / "study.yaml"
    scenario = short_case(1.2)
    study.write_text(
        f"name: tiny\nscenarios: ['{scenario}']\nfactors: {{planner: [constant, idm_mobil], risk_level: [0.1, 0.2]}}\n"
        "seeds: [0, 1]\n"
    )
    forecast = call("study", study, "--out", tmp_path / "out", "--dry-run", "--json", "--workers", 1)
    assert json.loads(forecast.out)["run_count_max"] == 4
    assert forecast.lines[0].startswith("note: 2 combinations are the same cell")
    done = call("study", study, "--out", tmp_path / "out", "--json", "--workers", 1)
    told = json.loads(done.out)
    assert (told["runs"], told["complete"]) == ({"completed": 4}, True)
    compared = json.loads(call("compare", tmp_path / "out", *PAIRED, "--json").out)
    assert [row["metric"] for row in compared["differences"]] == ["speed_mean_mps"]


def on_a_terminal(command, *arguments, **environment):
    """Return what a command writes to standard error, if that is a terminal."""
    ours, theirs = pty.openpty()
    clean = {key: value for key, value in os.environ.items() if key not in {"NO_COLOR", "FORCE_COLOR"}}
    subprocess.run(
        [command, *arguments],
        stderr=theirs,
        stdout=subprocess.DEVNULL,
        env=clean | environment,
        check=False,
        timeout=60,
    )
    os.close(theirs)
    shown = os.read(ours, 65536).decode()
    os.close(ours)
    return shown


def test_mistakes_are_red_on_a_terminal_unless_no_colour_is_wanted(command):
    assert "\x1b[31m" in on_a_terminal(command, "rnu")
    plain = on_a_terminal(command, "rnu", NO_COLOR="1")
    assert plain.startswith("no such command 'rnu'")
    assert "\x1b[" not in plain


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["run", "case2_"], ["case2_fitted", "case2_literal", "case2_rule_based"]),
        (["run", "case2", "--planner", "idm"], ["idm_mobil", "idm_mobil_published"]),
        (["study", "mai"], ["main"]),
        (["run", "./my"], ["./my_scenario.yaml"]),
    ],
)
def test_names_and_files_are_completed(command, tmp_path, words, expected):
    (tmp_path / "my_scenario.yaml").write_text("")
    (tmp_path / "my_notes.txt").write_text("")
    environment = {
        **os.environ,
        "_SUMO_HMDP_COMPLETE": "complete_bash",
        "COMP_WORDS": " ".join(["sumo-hmdp", *words]),
        "COMP_CWORD": str(len(words)),
    }
    done = subprocess.run(
        [command], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False, timeout=60
    )
    assert done.stdout.split() == expected


def test_runs_are_completed(call, short_case, tmp_path):
    from sumo_hmdp.cli_common import complete_run  # noqa: PLC0415

    assert call("run", short_case(1.2), "--out", tmp_path).code == 0

    class Context:
        params = {"folder": tmp_path}  # noqa: RUF012

    assert complete_run(Context, "case2-h") == ["case2-hmdp_mpc-eps0.05-seed0"]
    assert complete_run(Context, "z") == []
    Context.params = {"folder": tmp_path / "none"}
    assert complete_run(Context, "") == []
