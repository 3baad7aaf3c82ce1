"""What a mistake of the user looks like: one line each, with file, path, value and remedy, and exit code 2."""

import json
import math
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROBLEM = ROOT / "tests" / "fixtures" / "decisions" / "dodge-right-and-return.json"
CASE2 = (ROOT / "scenarios" / "case2.yaml").read_text(encoding="utf-8")
DELETE = object()
KEEP = {"left": 0, "keep": 1, "right": 0}


def changed(*changes):
    """Return a good problem with values put elsewhere: ((path, value), ...)."""
    problem = json.loads(PROBLEM.read_text(encoding="utf-8"))["problem"]
    for path, value in changes:
        place = problem
        for part in path[:-1]:
            place = place[part]
        if value is DELETE:
            del place[path[-1]]
        else:
            place[path[-1]] = value
    return problem


def at(*path):
    return path


TABLE = at("vehicles", 0, "lateral_probs")
PROBLEM_MISTAKES = {
    "lane": (at("vehicles", 0, "lane"), 5, ["vehicles[0].lane: must be 1..3, got 5"]),
    "lane that is true": (at("ego", "lane"), True, ["ego.lane: must be a whole number, got true"]),
    "lane 2.0": (at("ego", "lane"), 2.0, ["ego.lane: must be a whole number, got 2.0"]),
    "lane below": (at("planner", "goal_lane"), 0, ["planner.goal_lane: must be 1..3, got 0"]),
    "forbidden lane": (at("planner", "forbidden_lanes"), [4], ["planner.forbidden_lanes[0]: must be 1..3, got 4"]),
    "no lane left": (
        at("planner", "forbidden_lanes"),
        [1, 2, 3],
        ["planner.forbidden_lanes: must leave the ego at least one lane; take one out"],
    ),
    "no lanes": (at("lanes", "count"), 0, ["lanes.count: must be at least 1, got 0"]),
    "epsilon 0": (at("planner", "risk_level"), 0, ["planner.risk_level: must be above 0, got 0"]),
    "epsilon 0.7": (at("planner", "risk_level"), 0.7, ["planner.risk_level: must be at most 0.5, got 0.7"]),
    "horizon 0": (at("planner", "horizon_steps"), 0, ["planner.horizon_steps: must be at least 1, got 0"]),
    "NaN": (at("ego", "x_m"), math.nan, ["ego.x_m: must be a finite number, got NaN"]),
    "infinite": (at("ego", "x_m"), -math.inf, ["ego.x_m: must be a finite number, got -Infinity"]),
    "infinite and related": (
        at("planner", "accel_mps2"),
        math.inf,
        ["planner.accel_mps2: must be a finite number, got Infinity"],
    ),
    "more than a float": (
        at("planner", "accel_mps2"),
        10**400,
        [f"planner.accel_mps2: must be a number, got {10**56}..."],
    ),
    "beyond any road": (at("ego", "x_m"), -1e300, ["ego.x_m: must be at least -1000000, got -1e+300"]),
    "beyond any car": (
        at("planner", "desired_speed_mps"),
        1e9,
        ["planner.desired_speed_mps: must be at most 1000, got 1000000000.0"],
    ),
    "too fine a step": (at("planner", "period_s"), 1e-300, ["planner.period_s: must be at least 0.01, got 1e-300"]),
    "text": (at("ego", "x_m"), "35", ["ego.x_m: must be a number, got '35'"]),
    "boolean": (at("ego", "x_m"), True, ["ego.x_m: must be a number, got true"]),
    "nothing": (at("ego", "x_m"), None, ["ego.x_m: must be a number, got nothing"]),
    "mode": (
        at("ego", "mode"),
        "cruse",
        ["ego.mode: must be 'accelerate', 'cruise' or 'decelerate', got 'cruse'"],
    ),
    "unknown key": (at("egoo"), 1, ["egoo: unknown key; did you mean `ego`?"]),
    "unknown key in a list": (
        at("vehicles", 1, "positon_var_m2"),
        1,
        ["vehicles[1].positon_var_m2: unknown key; did you mean `position_var_m2`?"],
    ),
    "unlike any key": (at("planner", "zzz"), 1, ["planner.zzz: unknown key; remove it"]),
    "missing key": (at("planner", "period_s"), DELETE, ["planner.period_s: is missing; add it"]),
    "no mapping": (at("ego"), [], ["ego: must be a mapping of keys to values, got []"]),
    "no list": (at("vehicles"), {}, ["vehicles: must be a list, got {}"]),
    "id of the ego": (at("vehicles", 0, "id"), "ego", ["vehicles[0].id: must be unique and not `ego`, got 'ego'"]),
    "id twice": (at("vehicles", 1, "id"), "sv1", ["vehicles[1].id: must be unique and not `ego`, got 'sv1'"]),
    "empty id": (at("vehicles", 0, "id"), "", ["vehicles[0].id: must be at least 1 character long, got ''"]),
    "dead band": (
        at("planner", "speed_deadband_mps"),
        0.1,
        [
            (
                "planner.speed_deadband_mps: must be at least half a speed step, accel_mps2 * period_s / 2 = 0.6 m/s, "
                "with a terminal weight, got 0.1 m/s; widen it or set terminal_weight to 0"
            )
        ],
    ),
    "speeds": (
        at("planner", "speed_min_mps"),
        50,
        ["planner.speed_min_mps: must be at most speed_max_mps (40.0 m/s), got 50.0 m/s"],
    ),
    "table of a number": (TABLE, 5, ["vehicles[0].lateral_probs: must be a mapping of keys to values, got 5"]),
    "sum": (TABLE, {"left": 0.1, "keep": 0.1, "right": 0}, ["vehicles[0].lateral_probs: must sum to 1, got 0.2"]),
    "text in a table": (
        TABLE,
        {"left": 0, "keep": "1", "right": 0},
        ["vehicles[0].lateral_probs.keep: must be a number, got '1'"],
    ),
    "misspelt in a table": (
        TABLE,
        {"left": 0, "kepp": 1, "right": 0},
        ["vehicles[0].lateral_probs.kepp: unknown key; did you mean `keep`?"],
    ),
    "NaN in a table": (
        TABLE,
        {"left": 0, "keep": math.nan, "right": 0},
        ["vehicles[0].lateral_probs.keep: must be a finite number, got NaN"],
    ),
    "empty table": (TABLE, {}, ["vehicles[0].lateral_probs: must have a table for every lane; add 1, 2, 3"]),
    "tables by lane": (
        TABLE,
        {"1": KEEP, "2": 3, "3": {**KEEP, "keep": 1.5}},
        [
            "vehicles[0].lateral_probs.2: must be a mapping of keys to values, got 3",
            "vehicles[0].lateral_probs.3.keep: must be at most 1, got 1.5",
        ],
    ),
    "table of no lane": (
        TABLE,
        {"1": KEEP, "2": KEEP, "3": KEEP, "4": KEEP},
        ["vehicles[0].lateral_probs.4: must be keyed by a lane 1..3, got '4'"],
    ),
}


@pytest.mark.parametrize("command", ["decide", "check"])
@pytest.mark.parametrize("mistake", PROBLEM_MISTAKES)
def test_a_mistake_in_a_decision_problem_is_one_line_with_its_path(call, tmp_path, mistake, command):
    path, value, expected = PROBLEM_MISTAKES[mistake]
    file = tmp_path / "problem.json"
    file.write_text(json.dumps(changed((path, value))))
    finished = call(command, file)
    assert finished.lines == [f"{file}: {line}" for line in expected]
    assert (finished.code, finished.out) == (2, "")


def test_all_mistakes_of_a_file_are_named_at_once(call, tmp_path):
    file = tmp_path / "problem.json"
    problem = changed(
        (at("vehicles", 0, "lane"), 5),
        (at("planner", "risk_level"), 0),
        (at("ego", "x_m"), math.nan),
        (TABLE, {**KEEP, "left": 1}),
    )
    file.write_text(json.dumps({"problem": problem, "answer": None}))
    finished = call("decide", file)
    paths = {line.removeprefix(f"{file}: ").split(":")[0] for line in finished.lines}
    assert paths == {"vehicles[0].lane", "planner.risk_level", "ego.x_m", "vehicles[0].lateral_probs"}
    assert len(finished.lines) == 4


def test_a_misspelt_key_is_not_missing_as_well(call, tmp_path):
    file = tmp_path / "problem.json"
    file.write_text(json.dumps(changed((at("planner", "period_s"), DELETE), (at("planner", "perod_s"), 0.6))))
    assert call("decide", file).lines == [f"{file}: planner.perod_s: unknown key; did you mean `period_s`?"]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.json", b'{"a": 1,}', "must be JSON: .* at line 1, column 9"),
        ("a.json", b"", "must not be empty"),
        ("a.json", b"[1]", r"must be a mapping of keys to values, got \[1\]"),
        ("a.json", b"null", "must be a mapping of keys to values, got nothing"),
        ("a.json", b'{"problem": null}', "must be a mapping of keys to values, got nothing"),
        ("a.json", b'{"a": "\xff"}', "must be UTF-8 text: .* at byte 7"),
        ("a.json", b"[" * 200_000, "must be JSON of a reasonable size"),
        ("a.yaml", b"ego: [\nvehicles: 1\n", "must be YAML: .* at line 3, column 1"),
        ("a.yaml", b"\tname: x", "must be YAML: .* at line 1, column 1"),
        ("a.yaml", b"a: *b", "must be YAML: found undefined alias 'b' at line 1"),
        ("a.yaml", b"", "must not be empty"),
        ("a.yaml", b"# nothing\n", "must be a mapping of keys to values, got nothing"),
        ("a.yaml", b"- 1\n", r"must be a mapping of keys to values, got \[1\]"),
        ("a.yaml", b"name: \xff", "must be UTF-8 text: .* at byte 6"),
    ],
)
def test_a_file_that_is_none_is_one_line(call, tmp_path, name, content, message):
    file = tmp_path / name
    file.write_bytes(content)
    commands = ["check", "decide"] if name.endswith("json") else ["check", "run"]
    for command in commands:
        finished = call(command, file)
        assert (finished.code, finished.out, len(finished.lines)) == (2, "", 1)
        assert re.match(f"{re.escape(str(file))}: {message}", finished.err)


def test_a_directory_and_a_missing_file_are_one_line(call, tmp_path):
    for command, name, message in [
        ("decide", tmp_path, "cannot be read: Is a directory"),
        ("decide", tmp_path / "none.json", "cannot be read: No such file or directory"),
        ("check", tmp_path / "none.json", "cannot be read: No such file or directory"),
        ("check", tmp_path, "must be a file, got a directory"),
        ("run", tmp_path, "must be a file, got a directory"),
        ("run", tmp_path / "none.yaml", "must be a scenario file or name, got"),
    ]:
        finished = call(command, name)
        assert (finished.code, finished.out, len(finished.lines)) == (2, "", 1)
        assert message in finished.err
        assert str(name) in finished.err


@pytest.mark.parametrize("wrapped", [False, True])
def test_a_key_that_stands_twice_in_json_is_a_mistake(call, tmp_path, wrapped):
    problem = json.dumps(changed()).replace('"horizon_steps": 3', '"horizon_steps": 3, "horizon_steps": 2')
    file = tmp_path / "problem.json"
    file.write_text(f'{{"problem": {problem}, "answer": null}}' if wrapped else problem)
    finished = call("decide", file)
    assert finished.lines == [f"{file}: planner.horizon_steps: must stand once, got it again. Remove one"]
    assert (finished.code, finished.out) == (2, "")


def test_good_files_are_answered_in_order_around_bad_ones(call, tmp_path):
    good = sorted(PROBLEM.parent.glob("*.json"))[:2]
    bad = tmp_path / "bad.json"
    bad.write_text("{")
    finished = call("decide", good[0], bad, tmp_path / "none.json", good[1])
    objectives = [json.loads(file.read_text())["answer"]["objective"] for file in good]
    assert [json.loads(line)["objective"] for line in finished.out.splitlines()] == pytest.approx(objectives, abs=1e-6)
    assert [line.split(": ")[0] for line in finished.lines] == [str(bad), str(tmp_path / "none.json")]
    assert finished.code == 2


def test_a_solver_that_fails_on_one_file_does_not_keep_the_others_from_their_answers(call, monkeypatch):
    from sumo_hmdp.decision import decide  # noqa: PLC0415
    from sumo_hmdp.decision.optimiser import SolverError  # noqa: PLC0415

    answer, calls = decide.answer, []

    def fail_first(*arguments):
        calls.append(arguments)
        if len(calls) == 1:
            raise SolverError("the solver must prove something, got nothing")
        return answer(*arguments)

    monkeypatch.setattr(decide, "answer", fail_first)
    finished = call("decide", PROBLEM, PROBLEM)
    assert finished.lines == [f"{PROBLEM}: the solver must prove something, got nothing"]
    assert (finished.code, len(finished.out.splitlines())) == (1, 1)


HMDP = "planners.hmdp_mpc"
LANE_KEEPING = "&keep_lane {left: 0.0, keep: 1.0, right: 0.0}"
OFF_ROAD = "{}: must be at least -995.5 and below 9000.0 m, got {} m. The whole vehicle must be on the road."
SCENARIO_MISTAKES = {
    "unknown key": ("duration_s: 45.0", "duraton_s: 45.0", ["duraton_s: unknown key; did you mean `duration_s`?"]),
    "lane": ("lane: 2\n  speed", "lane: 5\n  speed", ["ego.lane: must be 1..3, got 5"]),
    "epsilon": ("risk_level: 0.05 ", "risk_level: 0 ", [f"{HMDP}.risk_level: must be above 0, got 0"]),
    "NaN": ("x_m: 35.0 ", "x_m: .nan ", ["ego.x_m: must be a finite number, got NaN"]),
    "infinite": ("x_m: 35.0 ", "x_m: -.inf ", ["ego.x_m: must be a finite number, got -Infinity"]),
    "text": ("x_m: 35.0 ", "x_m: '35' ", ["ego.x_m: must be a number, got '35'"]),
    "boolean": ("x_m: 35.0 ", "x_m: yes ", ["ego.x_m: must be a number, got true"]),
    "horizon": ("horizon_steps: 3", "horizon_steps: 0", [f"{HMDP}.horizon_steps: must be at least 1, got 0"]),
    "misspelt in planner": (
        "horizon_steps: 3",
        "horizn_steps: 3",
        [f"{HMDP}.horizn_steps: unknown key; did you mean `horizon_steps`?"],
    ),
    "twice": ("dt_s: 0.15", "dt_s: 0.15\ndt_s: 0.1", ["dt_s: must stand once, got it again at line 9. Remove one"]),
    "period": (
        "period_s: 0.6 ",
        "period_s: 0.65 ",
        [f"{HMDP}.period_s: must be a multiple of dt_s (0.15 s), got 0.65 s"],
    ),
    "duration": (
        "duration_s: 45.0",
        "duration_s: 45.1",
        ["duration_s: must be a multiple of dt_s (0.15 s), got 45.1 s"],
    ),
    "overlap": (
        "x_m: 150.0",
        "x_m: 33.0",
        ["vehicles: ego and sv2 must not start in each other, got an overlap of 1.80 m. Move one of them."],
    ),
    "ego off the road": (
        "x_m: 35.0",
        "x_m: 9500.0",
        [OFF_ROAD.format("ego.x_m", 9500.0)],
    ),
    "off the road": (
        "x_m: 150.0",
        "x_m: -1001.0",
        [OFF_ROAD.format("vehicles[1].x_m", -1001.0)],
    ),
    "lane count": ("count: 3", "count: 4", ["lanes.count: must equal the network's 3, got 4."]),
    "lane width": (
        "width_m: 4.0",
        "width_m: 3.5",
        ["lanes.width_m: must equal the network's 4.0 m (lane 3), got 3.5 m."],
    ),
    "driver": (
        "kind: mode_schedule",
        "kind: mode_shedule",
        ["vehicles[0].driver.kind: must be one of constant_speed, mode_schedule, idm, got 'mode_shedule'"],
    ),
    "no driver": ("kind: mode_schedule\n      ", "", ["vehicles[0].driver.kind: is missing; add it"]),
    "driver's key": (
        "speed_max_mps: 38.0",
        "speed_mx_mps: 38.0",
        ["vehicles[0].driver.speed_mx_mps: unknown key; did you mean `speed_max_mps`?"],
    ),
    "slower than it starts": (
        "driver: {kind: constant_speed}",
        "driver: {kind: idm, desired_speed_mps: 20}",
        [
            (
                "vehicles[1].driver.desired_speed_mps: must be at least the speed 25.0 m/s at which the vehicle "
                "enters, got 20.0 m/s. Lower the one or raise the other."
            )
        ],
    ),
    "id": ("id: sv2", "id: sv1", ["vehicles[1].id: must be unique and not `ego`, got 'sv1'; rename it"]),
    "id with a space": (
        "id: sv2",
        "id: sv 2",
        ["vehicles[1].id: must be text of the pattern ^[A-Za-z0-9_.-]+$, got 'sv 2'"],
    ),
    "planner": (
        "planner: hmdp_mpc",
        "planner: hmdp_mcp",
        ["planner: must be a known planner, got 'hmdp_mcp'; did you mean `hmdp_mpc`?"],
    ),
    "planner's section": (
        "  hmdp_mpc:\n",
        "  hmdp_mpcc:\n",
        ["planners.hmdp_mpcc: must be a known planner, got 'hmdp_mpcc'; did you mean `hmdp_mpc`?"],
    ),
}


@pytest.mark.parametrize("mistake", SCENARIO_MISTAKES)
def test_a_mistake_in_a_scenario_is_one_line_with_its_path(call, tmp_path, mistake):
    old, new, expected = SCENARIO_MISTAKES[mistake]
    assert old in CASE2
    file = tmp_path / "my case.yaml"
    file.write_text(CASE2.replace(old, new, 1))
    for arguments in (["check", file], ["run", file, "--out", tmp_path / "out"]):
        finished = call(*arguments)
        assert finished.lines == [f"{file}: {line}" for line in expected]
        assert (finished.code, finished.out) == (2, "")
    # Nothing is written for a run that cannot start.
    assert not (tmp_path / "out").exists()


def test_the_tables_of_a_policy_must_sum_to_1_wherever_they_stand(call, tmp_path):
    file = tmp_path / "case.yaml"
    file.write_text(CASE2.replace(LANE_KEEPING, LANE_KEEPING.replace("left: 0.0", "left: 0.5"), 1))
    finished = call("check", file)
    assert f"{file}: vehicles[0].policy[1].lateral_probs: must sum to 1, got 1.5" in finished.lines
    assert len(finished.lines) == 5


def test_an_unknown_network_names_the_known_ones(call, tmp_path):
    file = tmp_path / "case.yaml"
    file.write_text(CASE2.replace("highway_3x4m", "highwy", 1))
    finished = call("check", file)
    assert len(finished.lines) == 1
    assert f"{file}: network: must be a network that exists, got 'highwy'; known are" in finished.err
    assert "highway_3x4m" in finished.err


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (LANE_KEEPING, "&keep_lane {1: &k {left: 0.0, keep: 1.0, right: 0.0}, 2: *k, 3: *k}"),
        ("sequence_threshold: 1.0e-5", "sequence_threshold: 1e-5"),
    ],
    ids=["lanes as numbers", "1e-5 without a point"],
)
def test_yaml_is_read_as_it_is_meant(call, tmp_path, old, new):
    assert old in CASE2
    file = tmp_path / "case.yaml"
    file.write_text(CASE2.replace(old, new, 1))
    finished = call("check", file)
    assert (finished.code, finished.out, finished.err) == (0, f"{file}: ok\n", "")


def test_a_network_is_found_beside_its_scenario(call, tmp_path):
    (tmp_path / "mine.net.xml").write_bytes((ROOT / "networks" / "highway_3x4m.net.xml").read_bytes())
    file = tmp_path / "case.yaml"
    file.write_text(CASE2.replace("network: highway_3x4m", "network: mine.net.xml", 1))
    assert call("check", file).code == 0


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--epsilon", "0"], ["--epsilon: must be above 0, got 0.0"]),
        (["--epsilon", "0.7"], ["--epsilon: must be at most 0.5, got 0.7"]),
        (["--epsilon", "nan"], ["--epsilon: must be a finite number, got NaN"]),
        (["--planner", "hmdp"], ["--planner: must be a known planner, got 'hmdp'; did you mean `hmdp_mpc`?"]),
        (
            ["--solver", "mlip", "--planner", "hmdp_mcp"],
            [
                "--solver: must be a known solver, got 'mlip'; did you mean `milp`?",
                "--planner: must be a known planner, got 'hmdp_mcp'; did you mean `hmdp_mpc`?",
            ],
        ),
    ],
)
def test_a_mistake_in_an_option_names_the_option(call, tmp_path, options, expected):
    finished = call("run", "case2", *options, "--out", tmp_path / "out")
    assert (finished.code, finished.out, finished.lines) == (2, "", expected)


def test_an_unknown_scenario_or_solver_gets_the_nearest_name(call):
    finished = call("run", "cas2")
    expected = "must be a scenario file or name, got 'cas2' (no such file); did you mean `case2`?"
    assert (finished.code, finished.lines) == (2, [expected])
    finished = call("decide", PROBLEM, "--solver", "mlip")
    assert finished.lines == ["--solver: must be a known solver, got 'mlip'; did you mean `milp`?"]
    assert (finished.code, finished.out) == (2, "")


def test_results_that_cannot_be_written_are_refused_before_the_run(call, tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "occupied").mkdir()
    (tmp_path / "occupied" / "steps").write_text("")
    for folder in (tmp_path / "file", tmp_path / "file" / "below", tmp_path / "occupied", Path("/proc/none/below")):
        finished = call("run", "case2", "--out", folder)
        assert (finished.code, finished.out, len(finished.lines)) == (2, "", 1)
        assert finished.err.startswith(f"--out: {folder} must be a writable directory: ")
