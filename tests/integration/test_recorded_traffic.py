"""A scenario of recorded traffic, from the files on its page of the documentation to a study."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from sumo_hmdp.documents import Document, read_yaml
from sumo_hmdp.errors import InputError
from sumo_hmdp.scenario.load import RunOptions, assemble_scenario, load_scenario
from sumo_hmdp.study.design import design_of
from sumo_hmdp.study.identity import cell_id_of
from sumo_hmdp.study.run import execute

PAGE = Path(__file__).parents[2] / "docs" / "recorded-traffic.md"
PLANNERS = ["hmdp_mpc", "idm_mobil", "idm_mobil_published", "constant"]


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(), re.DOTALL)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The page's files: the record, the scenario and the study."""
    here = tmp_path_factory.mktemp("recorded")
    (code,) = blocks("python")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(here)
        exec(code, {})  # noqa: S102 - the page's own code
    for name, text in zip(("small.yaml", "small_study.yaml"), blocks("yaml"), strict=True):
        (here / name).write_text(text)
    return here


def ready(folder, planner=None, **overrides):
    options = RunOptions(planner, overrides={key.replace("__", "."): value for key, value in overrides.items()})
    return load_scenario(folder / "small.yaml", options)


def refusal(folder, planner=None, **overrides):
    with pytest.raises(InputError) as error:
        ready(folder, planner, **overrides)
    (line,) = error.value.lines()
    return line


@pytest.mark.parametrize("planner", PLANNERS)
def test_every_planner_drives_among_reacting_vehicles(folder, planner):
    record = execute(ready(folder, planner, duration_s=8.0))
    assert record.status == "completed" or "the ego's fault" in record.reason
    assert record.row["sumo_contact_count"] is None
    assert record.row["background_contact_count"] == 0
    others = set(record.steps["vehicle_id"])
    assert "v4" not in others
    assert {"ego", "v2", "v6"} <= others


def test_a_run_repeats_and_is_done_again_from_its_configuration(folder):
    first = execute(ready(folder, "idm_mobil"))
    stored = Document(first.manifest["configuration"])
    again = assemble_scenario(stored, RunOptions("idm_mobil"), Path("elsewhere.yaml"))
    assert execute(again).row["trace_hash"] == first.row["trace_hash"]
    assert len(first.manifest["tracks_sha256"]) == 64


def test_the_cell_depends_on_what_is_recorded_and_not_on_where_it_is(folder, tmp_path):
    def cell(table):
        (tmp_path / "small.csv").write_bytes(table)
        (tmp_path / "small.yaml").write_text((folder / "small.yaml").read_text())
        return cell_id_of(ready(tmp_path))

    table = (folder / "small.csv").read_bytes()
    assert cell(table) == cell_id_of(ready(folder))
    assert cell(table.replace(b"v11,", b"w11,")) != cell_id_of(ready(folder))
    assert cell_id_of(ready(folder, tracks__reactive="none")) != cell_id_of(ready(folder))


def test_the_pages_study_has_a_cell_for_each_planner_and_place(folder):
    path = folder / "small_study.yaml"
    cells = design_of(read_yaml(path), path).cells
    assert len(cells) == len({cell.id for cell in cells}) == 6
    assert {cell.ready.world.ego_track for cell in cells} == {"v2", "v4", "v5"}


def test_a_first_decision_that_recorded_gaps_relax_is_told(folder):
    small = execute(ready(folder, duration_s=0.8, planners__hmdp_mpc__safe_distance_m=24.0))
    assert small.decisions["status"].iloc[0] in {"relaxed", "fallback"}
    assert "gaps that were recorded" in small.manifest["network_notes"][-1]
    assert execute(ready(folder, duration_s=0.8)).manifest["network_notes"] == []


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ({"duration_s": 40.0}, "duration_s: must end within the record's 30 s"),
        ({"tracks__start_s": 20.0}, "the record is too short"),
        ({"ego__vehicle": "v40"}, "ego.vehicle: must be a vehicle of the record"),
        ({"ego__planning_problem": 3}, "must have one of vehicle and planning_problem"),
        ({"network": "highway_3x4m"}, "network: must be left out"),
        ({"noise": True}, "noise: must be false"),
        ({"tracks__file": "other.csv"}, "tracks.file: must be a file that exists"),
        ({"tracks__leave_out": ["v40"]}, "tracks.leave_out[0]: must be a vehicle of the record"),
        ({"tracks__carriageway": "upper"}, "tracks.carriageway: must be left out"),
        ({"tracks__lane_lines_m": [0.0, -3.5, -4.5]}, "lane 2 must be 2 to 6 m wide"),
        ({"tracks__reactiv": "idm"}, "tracks.reactiv"),
        ({"tracks__format": "ngsim"}, "tracks.units: is missing"),
        ({"ego__x_m": 3.0}, "ego.x_m: must be left out or that of the record"),
        ({"ego__goal_x_m": 1.0}, "ego.goal_x_m: must be ahead"),
    ],
)
def test_check_refuses_in_one_line(folder, overrides, words):
    assert words in refusal(folder, **overrides)


def test_sumo_cannot_drive_here(folder):
    assert "--planner: must be one that drives the ego itself" in refusal(folder, "sumo")


def test_tracks_of_the_ego_need_a_record(folder):
    content = read_yaml(folder / "small.yaml").content
    content = {key: value for key, value in content.items() if key != "tracks"}
    content |= {"network": "highway_3x4m", "lanes": {"count": 3, "width_m": 4.0}}
    content["ego"] = {"x_m": 100.0, "lane": 2, "speed_mps": 10.0, "vehicle": "v1"}
    with pytest.raises(InputError, match=r"ego.vehicle: must go with `tracks`"):
        assemble_scenario(Document(content), RunOptions(), folder / "small.yaml")


def test_an_ego_can_be_put_among_the_recorded_vehicles(folder):
    content = read_yaml(folder / "small.yaml").content
    content["ego"] = {"x_m": 45.0, "lane": 1, "speed_mps": 12.0}
    run = assemble_scenario(Document(content), RunOptions("idm_mobil"), folder / "small.yaml")
    run = replace(run, episode=replace(run.episode, duration=2.0))
    record = execute(run)
    assert "v4" in set(record.steps["vehicle_id"])
