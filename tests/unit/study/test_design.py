"""Study files: which cells and seeds they make, what their names depend on, and every mistake at once."""

import json
import shutil
import subprocess
import sys
from dataclasses import astuple, replace
from pathlib import Path

import pytest
import yaml

from sumo_hmdp.errors import InputError
from sumo_hmdp.scenario.packaged import data_folder
from sumo_hmdp.scenario.traffic import TrafficFile
from sumo_hmdp.study.design import find_study, load_design
from sumo_hmdp.traffic.drivers import HIGHWAY_CLASSES

CASE2 = Path(__file__).parents[3] / "scenarios" / "case2.yaml"


@pytest.fixture
def design(tmp_path):
    """Write a study file and read it."""

    def write(**content):
        file = tmp_path / "study.yaml"
        given = {"name": "small", "scenarios": ["case2"], "seeds": {"count": 2}} | content
        file.write_text(yaml.safe_dump({key: value for key, value in given.items() if value is not None}))
        return load_design(file)

    return write


@pytest.fixture
def complaints(design):
    def complain(**content):
        with pytest.raises(InputError) as caught:
            design(**content)
        assert caught.value.source.endswith("study.yaml")
        return [str(problem) for problem in caught.value.problems]

    return complain


def test_every_combination_is_a_cell_and_a_planner_without_risk_level_has_one(design):
    found = design(
        factors={
            "planner": ["hmdp_mpc", "idm_mobil", "constant"],
            "risk_level": [0.01, 0.05],
            "ego.speed_mps": [29, 30],
            "planners.hmdp_mpc.horizon_steps": [2, 3],
        }
    )
    planners = [cell.ready.planner_name for cell in found.cells]
    assert [planners.count(name) for name in ("hmdp_mpc", "idm_mobil", "constant")] == [8, 2, 2]
    assert len({cell.id for cell in found.cells}) == 12
    assert len(found.notes) == 1
    assert found.notes[0].startswith("12 combinations are the same cell")
    combinations = {
        (c.ready.parameters["risk_level"], c.ready.episode.ego.speed, c.ready.parameters["horizon_steps"])
        for c in found.cells
        if c.ready.planner_name == "hmdp_mpc"
    }
    assert combinations == {(r, v, h) for r in (0.01, 0.05) for v in (29.0, 30.0) for h in (2, 3)}
    assert dict(found.cells[-1].factors) == {"planner": "constant", "ego.speed_mps": 30}
    assert found.cells[0].run_id(7) == f"{found.cells[0].id}-seed7"


LEVELS = {
    "pace": {
        "slow": {"ego.speed_mps": 25.0, "planners.hmdp_mpc.desired_speed_mps": 26.0},
        "usual": {},
    },
    "setup": {"careful": {"planner": "hmdp_mpc", "risk_level": 0.01}, "rules": {"planner": "idm_mobil"}},
}


def test_a_named_level_sets_several_paths_together(design):
    found = design(factors=LEVELS)
    got = {
        tuple(cell.factors.values()): (
            cell.ready.episode.ego.speed, cell.ready.planner_name, cell.ready.parameters.get("risk_level"),
            cell.document["planners"]["hmdp_mpc"].get("desired_speed_mps"),
        )
        for cell in found.cells
    }  # fmt: skip
    usual = design().cells[0].ready.parameters["desired_speed_mps"]
    assert got == {
        ("slow", "careful"): (25.0, "hmdp_mpc", 0.01, 26.0), ("slow", "rules"): (25.0, "idm_mobil", None, 26.0),
        ("usual", "careful"): (30.0, "hmdp_mpc", 0.01, usual), ("usual", "rules"): (30.0, "idm_mobil", None, usual),
    }  # fmt: skip
    assert list(found.cells[0].factors) == ["pace", "setup"]
    # A cell is what is run: however the file says it, it is the same cell.
    plain = design(factors={"planner": ["hmdp_mpc"], "risk_level": [0.01], "ego.speed_mps": [30.0]}).cells[0]
    assert plain.id in {cell.id for cell in found.cells}


FACTOR_NAME = r"^[A-Za-z0-9_-]+(\[[0-9]+\])*(\.[A-Za-z0-9_-]+(\[[0-9]+\])*)*$"


def test_mistakes_in_named_levels_are_named_where_they_stand(complaints):
    assert complaints(
        factors={
            "pace": {"slow": {"ego.sped_mps": 25.0}, "fast": {"ego.speed_mps": -1, "risk_level": "x"}},
            "ego.x_m": {"here": {"duration_s": 1.0}},
            "dur": {"one": {"duration_s": 2.0}, "two": {"duration_s": 2.0}},
            "b d": {"a b": {"lanes": 1}},
        }
    ) == [
        rf"factors.b d: must be text of the pattern {FACTOR_NAME}, got 'b d'",
        "factors.b d.a b: must be text of the pattern ^[A-Za-z0-9_]+$, got 'a b'",
    ]
    found = complaints(
        factors={
            "pace": {"slow": {"ego.sped_mps": 25.0}, "fast": {"ego.speed_mps": 1.0, "risk_level": "x"}},
            "ego.x_m": {"here": {"duration_s": 3.0}},
            "dur": {"one": {"duration_s": 2.0}, "two": {"duration_s": 2.0}},
        }
    )
    name = "must be a list of values, or have a name that is no path where its levels are named"
    assert sorted(found) == [
        "factors.dur.two: must stand once, got the same values again. Remove one",
        f"factors.ego.x_m: {name}. Write [value, ...] or rename it",
        "factors.ego.x_m: must not set duration_s, which the factor `dur` sets. Take it out of one of the two",
        "factors.pace.fast.risk_level: must be a number, got 'x'",
        "factors.pace.slow.ego.sped_mps: unknown key; did you mean `speed_mps`? (scenario case2)",
    ]


def test_seeds_are_a_range_a_list_or_batches(design):
    assert design(seeds={"first": 5, "count": 3}).stages == ((5, 6, 7),)
    assert design(seeds=[9, 2]).stages == ((9, 2),)
    stopping = {"metric": "gap_min_m", "half_width": 1.0, "seeds_min": 2, "seeds_max": 7, "batch_count": 3}
    found = design(seeds={"first": 4}, stopping=stopping)
    assert found.stages == ((4, 5), (6, 7, 8), (9, 10))
    assert found.seeds == (4, 5, 6, 7, 8, 9, 10)
    assert design(seeds=None, stopping=stopping | {"seeds_max": 2}).stages == ((0, 1),)


def test_a_name_depends_on_what_is_run_and_on_nothing_else(design, tmp_path):
    def name(**content):
        return design(**content).cells[0].id

    usual = name()
    assert usual.startswith("case2-hmdp_mpc-eps0.05-")
    assert name(scenarios=[str(CASE2)], name="other", trace="all", seeds=[3]) == usual
    text = CASE2.read_text()
    file = tmp_path / "mine.yaml"
    # Words for people, and planners that do not drive, make no difference.
    other_words = text.replace("Overtaking", "Passing").replace("lane_change_first_s: 5.85", "lane_change_first_s: 6.0")
    file.write_text(other_words.replace("  idm_mobil: ", "  constant: {}\n  idm_mobil: "))
    assert name(scenarios=["mine.yaml"]) == usual
    names = [usual]
    file.write_text(text.replace("x_m: 150.0", "x_m: 150.000001"))
    names.append(name(scenarios=["mine.yaml"]))
    names += [name(factors=f) for f in ({"planner": ["sumo"]}, {"risk_level": [0.01]}, {"solver": ["search"]})]
    names.append(name(factors={"planners.hmdp_mpc.horizon_steps": [2]}))
    # A network of the same name with another content is another road.
    network = tmp_path / "road.net.xml"
    shutil.copy(data_folder("networks") / "highway_3x4m.net.xml", network)
    assert name(factors={"network": [str(network)]}) == usual
    network.write_text(network.read_text() + "<!-- -->\n")
    names.append(name(factors={"network": [str(network)]}))
    assert len(set(names)) == len(names)
    assert design(factors={"network": [str(network)]}).cells[0].document["network"] == str(network)


def test_a_name_is_the_same_in_another_process(design, tmp_path):
    here = [cell.id for cell in design(factors={"planner": ["hmdp_mpc", "idm_mobil"]}).cells]
    program = (
        "import json, pathlib, sys; from sumo_hmdp.study.design import load_design;"
        "print(json.dumps([cell.id for cell in load_design(pathlib.Path(sys.argv[1])).cells]))"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", program, "study.yaml"], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert json.loads(done.stdout) == here


def test_all_mistakes_are_named_at_once(complaints):
    found = complaints(
        scenarios=["case2", "cse1"],
        factors={
            "planer": ["a"],
            "rsk_level": [0.1],
            "planner": ["hmdp_mpc", "idm_mobl", 3],
            "risk_level": [0.01, 0.9, "x"],
            "ego.sped_mps": [29],
            "duration_s": [3.0, -1, 3.0],
        },
        solver="serch",
        wall_limit_s=0,
        colour="red",
    )
    expected = [
        "wall_limit_s: must be above 0, got 0",
        "colour: unknown key; remove it",
        "factors.duration_s[2]: must stand once, got 3.0 again. Remove one",
        "scenarios[1]: must be a scenario file or name, got 'cse1' (no such file); did you mean `case1`?",
        "factors.planer: unknown key; did you mean `planner`? (scenario case2)",
        "factors.rsk_level: unknown key; did you mean `risk_level`? (scenario case2)",
        "factors.planner[1]: must be a known planner, got 'idm_mobl'; did you mean `idm_mobil`?",
        "factors.planner[2]: must be text, got 3",
        "factors.risk_level[1]: must be at most 0.5, got 0.9",
        "factors.risk_level[2]: must be a number, got 'x'",
        "factors.duration_s[1]: must be above 0, got -1 (scenario case2)",
        "solver: must be a known solver, got 'serch'; did you mean `search`?",
    ]
    assert set(expected) <= set(found)
    assert len(found) == len(set(found))


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ({"scenarios": []}, "scenarios: must be a list of at least 1, got []"),
        ({"scenarios": None}, "scenarios: is missing; add it"),
        ({"scenarios": ["case2", "case2"]}, "scenarios: must name every scenario once; remove the others"),
        ({"factors": {"planner": []}}, "factors.planner: must be a list of at least 1, got []"),
        ({"seeds": []}, "seeds: must be a list of at least 1, got []"),
        ({"seeds": {"count": 0}}, "seeds.count: must be at least 1, got 0"),
        ({"seeds": {"first": 2**31 - 2, "count": 3}}, "seeds.first: must leave all seeds at most 2147483647"),
        ({"seeds": None}, "seeds.count: is missing; add it"),
        ({"seeds": [1, 2, 1]}, "seeds: must name every seed once; remove the others"),
        ({"seeds": [1, -2]}, "seeds[1]: must be at least 0, got -2"),
        ({"sceds": {}}, "sceds: unknown key; did you mean `seeds`?"),
        ({"factors": {"planners.hmdp_mpc.horizn_steps": [2]}},
         "factors.planners.hmdp_mpc.horizn_steps: unknown key; did you mean `horizon_steps`? (scenario case2)"),
        ({"factors": {"speedlimit.x": [1]}}, "factors.speedlimit.x: unknown key; known are"),
        ({"factors": {"solver": ["milp"]}, "solver": "search"}, "factors.solver: must not be a factor and given"),
    ],
)  # fmt: skip
def test_single_mistakes(complaints, content, complaint):
    found = complaints(**content)
    assert len(found) == 1
    assert found[0].startswith(complaint)


def test_mistakes_about_stopping(complaints):
    rule = {"metric": "gap_mn_m", "half_width": 1.0, "seeds_min": 4, "seeds_max": 3}
    assert complaints(stopping=rule) == [
        "seeds.count: must be left out, stopping.seeds_max bounds it",
        "stopping.seeds_max: must be at least seeds_min (4), got 3. Raise it",
        "stopping.metric: must be a known metric, got 'gap_mn_m'; did you mean `gap_min_m`?",
    ]
    rule |= {"metric": "solve_time_max_ms", "seeds_max": 9}
    assert complaints(stopping=rule, seeds=[1])[1].startswith("stopping.metric: must not depend on the machine's speed")


def test_a_file_that_is_no_study(tmp_path):
    file = tmp_path / "study.yaml"
    file.write_text("- a\n")
    with pytest.raises(InputError, match="must be a mapping"):
        load_design(file)
    with pytest.raises(InputError, match="cannot be read"):
        load_design(tmp_path / "none.yaml")


def test_the_command_line_solver_is_for_all_runs(tmp_path):
    file = tmp_path / "study.yaml"
    file.write_text("name: a\nscenarios: [case2]\nseeds: [1]\nfactors: {solver: [milp]}\n")
    with pytest.raises(InputError, match="must not be a factor"):
        load_design(file, "search")
    file.write_text("name: a\nscenarios: [case2]\nseeds: [1]\n")
    assert load_design(file, "search").cells[0].ready.solver == "search"


# The rules have no risk level: one cell, last.
@pytest.mark.parametrize(
    ("name", "cells", "rules", "seeds"),
    [("main", 3, 1, 20), ("highway_epsilon", 5, 1, 50), ("highway_risk", 4, 0, 20)],
)
def test_the_studies_on_the_highway(name, cells, rules, seeds):
    design = load_design(find_study(name))
    assert (design.file.name, len(design.seeds)) == (name, seeds)
    sumo = ["sumo"] if name == "main" else []
    assert [cell.ready.planner_name for cell in design.cells] == ["hmdp_mpc"] * cells + ["idm_mobil"] * rules + sumo


def test_the_reliability_study_has_18_settings_that_differ(tmp_path):
    design = load_design(find_study("reliability"))
    assert (len(design.cells), len(design.seeds)) == (18, 450)
    settings = {}
    for cell in design.cells:
        traffic = TrafficFile.model_validate(cell.document["traffic"])
        shares = {kind.name: kind.share for kind in traffic.vehicle_classes()}
        speeds = {kind.name: round(kind.desired_speed.mean, 1) for kind in traffic.vehicle_classes()}
        key = tuple(cell.factors[name] for name in ("traffic.density_vpkm_per_lane", "speed_limit", "drivers"))
        settings[key] = (traffic.density_vpkm_per_lane, shares, speeds, cell.ready.parameters["desired_speed_mps"])
    assert len(settings) == 18
    usual, freight = {"car": 0.85, "truck": 0.15}, {"car": 0.65, "truck": 0.35}
    assert settings[10.0, "free", "usual"] == (10.0, usual, {"car": 33.3, "truck": 23.6}, 33.0)
    assert settings[30.0, "kmh80", "freight"] == (30.0, freight, {"car": 22.2, "truck": 22.2}, 22.2)
    assert settings[20.0, "free", "hurried"][1:3] == (
        {"car": 0.52, "hurried": 0.33, "truck": 0.15}, {"car": 33.3, "hurried": 38.9, "truck": 23.6},
    )  # fmt: skip
    # The classes that the file writes out are those of the package, but for the rounding of km/h.
    written = TrafficFile.model_validate(design.cells[1].document["traffic"]).vehicle_classes()
    for ours, theirs in zip(written, HIGHWAY_CLASSES, strict=True):
        for name in ("desired_speed", "time_gap", "politeness"):
            assert astuple(getattr(ours, name)) == pytest.approx(astuple(getattr(theirs, name)), abs=1e-3)
        same = {name: getattr(theirs, name) for name in ("share", "desired_speed", "time_gap", "politeness")}
        assert replace(ours, **same) == theirs


@pytest.mark.parametrize(
    ("name", "cells", "seeds"),
    [
        ("highway_planners", (3, 3, 3), 100),
        ("highway_ramps_planners", (3, 3, 3), 100),
        ("urban_planners", (3, 3, 3), 100),
        ("matched_planners", (3, 3, 3), 100),
        ("urban_route", (1, 1, 1), 50),
    ],
)
def test_the_studies_of_three_planners(name, cells, seeds):
    design = load_design(find_study(name))
    drivers = [cell.ready.planner_name for cell in design.cells]
    assert (design.file.name, len(design.seeds)) == (name, seeds)
    assert tuple(map(drivers.count, ("hmdp_mpc", "idm_mobil", "sumo"))) == cells
    assert len(drivers) == sum(cells)
    assert {cell.ready.solver for cell in design.cells} == {"search"}
