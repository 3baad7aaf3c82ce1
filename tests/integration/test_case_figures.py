"""The paper's cases on real runs: figures that can be read back, the same bytes each time, and a page that is true."""

import importlib.util
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.text import Text
from PIL import Image
from scipy.stats import norm

from sumo_hmdp.domain.maneuver import Mode
from sumo_hmdp.report.case3_figures import lane_change_by_risk, threshold_snapshots
from sumo_hmdp.report.case_animation import animation_times, write_animation, write_still
from sumo_hmdp.report.case_claims import number, statement, told
from sumo_hmdp.report.case_data import CaseBranch, PlanPoint, case_run
from sumo_hmdp.report.case_fit import distance, fitted_values
from sumo_hmdp.report.case_histories import action_history, ego_trajectories, speed_profiles, trajectories
from sumo_hmdp.report.case_numbers import worst_joint_probability
from sumo_hmdp.report.case_road import write_figure
from sumo_hmdp.report.case_snapshots import branch_snapshots, strip_snapshots
from sumo_hmdp.report.reproduction import PaperRuns, render_reproduction
from sumo_hmdp.scenario.load import RunOptions, find_scenario, load_scenario
from sumo_hmdp.study.run import execute, versions

ROOT = Path(__file__).parents[2]
LEVELS = (0.001, 0.3)
NAMED = (
    "case1", "case1_literal", "case1_fitted", "case2", "case2_literal", "case2_fitted", "case2_rule_based",
)  # fmt: skip


def load_analysis():
    spec = importlib.util.spec_from_file_location("paper_cases", ROOT / "analysis" / "01_paper_cases.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def analysis():
    return load_analysis()


@pytest.fixture(scope="module")
def records():
    one = {
        name: execute(load_scenario(find_scenario(name), RunOptions(solver="search" if "fitted" in name else "milp")))
        for name in NAMED
    }
    slower = RunOptions(solver="search", overrides=load_analysis().SLOWER)
    one["case2_slower"] = execute(load_scenario(find_scenario("case2"), slower))
    case3 = find_scenario("case3")
    return one | {level: execute(load_scenario(case3, RunOptions(risk_level=level))) for level in LEVELS}


@pytest.fixture(scope="module")
def runs(records):
    read = {key: case_run(r.manifest, r.row, r.steps, r.decisions) for key, r in records.items()}
    case3 = [read[level] for level in LEVELS]
    return PaperRuns(
        **{name: read[name] for name in (*NAMED[:-1], "case2_slower")},
        rule_based=read[NAMED[-1]],
        case3=case3,
        case3_more=case3,
    )


@pytest.fixture(scope="module")
def figures(analysis, runs):
    """Functions, so that a figure can be drawn more than once."""
    a = analysis
    return {
        "branches": lambda: branch_snapshots(runs.case1, a.CASE1_SNAPSHOTS, a.CASE1_VIEW),
        "actions": lambda: action_history(runs.case1, a.CASE1_DECISIONS),
        "paths": lambda: trajectories(runs.case1, 10.0),
        "strips": lambda: strip_snapshots(runs.case2, a.CASE2_SNAPSHOTS, a.CASE2_VIEW, "title"),
        "rules": lambda: strip_snapshots(runs.rule_based, a.RULE_TIMES, a.CASE2_VIEW, "title"),
        "speeds": lambda: speed_profiles(runs.case2, runs.rule_based, a.CASE2_SNAPSHOTS, a.RULE_TIMES),
        "ego_paths": lambda: ego_trajectories(runs.case2, runs.rule_based, 1.5),
        "thresholds": lambda: threshold_snapshots(runs.case3, a.CASE3_TIMES),
        "by_risk": lambda: lane_change_by_risk(runs.case3, runs.case3_more),
    }


NAMES = ("branches", "actions", "paths", "strips", "rules", "speeds", "ego_paths", "thresholds", "by_risk")


@pytest.mark.parametrize("name", NAMES)
def test_a_figure_is_one_column_wide_and_has_the_same_bytes_each_time(figures, tmp_path, name):
    first = write_figure(figures[name](), tmp_path / "a", name)
    svg, png = (path.read_bytes() for path in first)
    assert svg.startswith(b"<?xml")
    assert svg.rstrip().endswith(b"</svg>")
    assert b"<dc:date>" not in svg
    with Image.open(first[1]) as image:
        assert image.width == 1050
    (again,) = write_figure(figures[name](), tmp_path / "b", name, (".svg",))
    assert again.read_bytes() == svg
    assert png[:4] == b"\x89PNG"


@pytest.mark.parametrize("name", NAMES)
def test_all_axes_say_what_they_show(figures, name):
    figure = figures[name]()
    assert figure.get_suptitle()
    bottom = figure.axes[-1]
    assert re.search(r"\[(s|m|-)\]$", bottom.get_xlabel())
    for axes in figure.axes:
        labelled = axes.get_ylabel() in {"lane", "y [m]", "x [m]", "t [s]", "speed [m/s]"}
        assert labelled or any(label.get_text() in {"lane 1", "cruise"} for label in axes.get_yticklabels())


def test_the_panels_tell_what_the_tables_hold(figures, analysis, records):
    steps = records["case2"].steps
    titles = [axes.get_title(loc="left") for axes in figures["strips"]().axes]
    for time, title in zip(analysis.CASE2_SNAPSHOTS, titles, strict=True):
        ego = steps[(steps["vehicle_id"] == "ego") & np.isclose(steps["time_s"], time)].iloc[0]
        assert f"{time:.2f} s: x = {ego.x_m:.0f} m, {ego.speed_mps:.1f} m/s" in title


def test_a_strip_is_as_long_as_what_was_predicted_and_as_dark_as_it_is_likely(figures):
    panel = figures["strips"]().axes[0]
    strips = [patch for patch in panel.patches if patch.get_alpha() is not None]
    # Three modes of each SV; 45 m in 1.8 s at 25 m/s, the others less than 6 m from it.
    assert len(strips) == 6
    assert all(abs(patch.get_width() - 45.0) < 6 for patch in strips)
    # Two SVs, each: accelerate, cruise, decelerate. What was pruned of the unlikely ones makes them a little paler.
    opacity = sorted(patch.get_alpha() for patch in strips)
    assert opacity == pytest.approx([0.06 + 0.94 * p for p in (0.05, 0.05, 0.1, 0.1, 0.8, 0.9)], abs=0.02)
    written = [text.get_text() for text in panel.findobj(Text)]
    assert {"0.90", "0.80"} <= set(written)


def test_the_rules_predict_nothing(figures):
    assert not [patch for panel in figures["rules"]().axes for patch in panel.patches if patch.get_alpha() is not None]


def test_a_contact_is_not_hidden(figures, runs):
    assert runs.case3[-1].row["contact_count"]
    legends = [text.get_text() for text in figures["thresholds"]().legends[0].get_texts()]
    assert f"\u03b5 = 0.3, contact at {runs.case3[-1].ego.times[-1]:.2f} s" in legends


@pytest.fixture(scope="module")
def page(runs):
    return render_reproduction(runs, versions())


def row_of(page, claim):
    rows = [line.split("|")[1:-1] for line in page.splitlines() if line.startswith(f"| {claim}")]
    assert rows, claim
    return [[cell.strip() for cell in row] for row in rows]


def of(record, vehicle_id):
    return record.steps[record.steps["vehicle_id"] == vehicle_id].set_index("time_s")


def test_the_page_tells_the_numbers_of_the_runs(page, records):
    planner, rules = records["case2"], records["case2_rule_based"]
    for name, vehicle, papers in (("EV", "ego", (1400, 1250)), ("SV1", "sv1", (1300, 1150))):
        found = row_of(page, f"{name} after 45 s")
        # The claims of Case 2, the table of its places, the claims of the rules.
        rows = [found[0], found[2]]
        assert found[1][1:4] == [found[0][1], found[0][3], found[0][4]]
        for row, record, paper in zip(rows, (planner, rules), papers, strict=True):
            assert row[1] == f"about {paper} m"
            assert row[3] == f"{of(record, vehicle)['x_m'].iloc[-1]:.1f} m"
        assert rows[0][4] == f"{of(planner, vehicle)['x_m'].iloc[-1] - papers[0]:+.1f} m"
    (peak,) = row_of(page, "Peak speed of SV1")
    assert peak[2:5] == ["36.25 m/s", f"{of(rules, 'sv1')['speed_mps'].max():.2f} m/s", "0.00 m/s"]
    first = planner.decisions[planner.decisions["lateral"] == "left"]["time_s"].iloc[0]
    assert row_of(page, "(b) 5.85 s")[0][2] == f"{first:.2f} s"
    assert row_of(page, "(b) 5.85 s")[0][3] == f"+{first - 5.85:.2f} s"
    for level, line in zip(LEVELS, re.findall(r"^\| 0\.(?:001|3) \|.*$", page, re.MULTILINE), strict=True):
        cells = [cell.strip() for cell in line.split("|")[1:-1]]
        change = records[level].decisions[records[level].decisions["lateral"] != "keep"].iloc[0]
        assert cells[1:3] == [f"{change.time_s:.2f}", f"{change.ego_x_m:.1f}"]


def test_the_page_compares_all_instants(page):
    """Also those that do not match; of Case 2 the last two by both readings."""
    times = re.findall(r"^\| \(([a-f])\) (\d+\.\d\d) s \|", page, re.MULTILINE)
    case1 = [*zip("abcdef", ("12.00", "20.80", "23.20", "29.60", "30.40", "40.80"), strict=True)]
    case2 = [*zip("abcdef", ("0.00", "5.85", "12.45", "14.85", "29.25", "36.15"), strict=True)]
    assert times == [*case1, *case2, *case2[-2:]]
    assert "too slow to catch up" not in page
    assert "Not met within one scale by the fitted setting: " in page


@pytest.mark.parametrize("case", [1, 2])
def test_a_fitted_scenario_is_nearer_and_differs_in_open_values_alone(runs, case):
    given = {1: (runs.case1, runs.case1_fitted), 2: (runs.case2, runs.case2_fitted)}[case]
    own, fitted = given
    assert distance(case, fitted) < 0.6 * distance(case, own)
    open_values = (
        r"speed_weight|desired_speed|deadband|risk_level|position_var|lane_change_time|lateral_probs|speed_max_mps"
    )
    paths = [path for path, _, _ in fitted_values(own, fitted)]
    assert paths
    assert [path for path in paths if not re.search(open_values, path)] == []
    assert not any(path.endswith("hmdp_mpc.speed_max_mps") for path in paths)
    text = find_scenario(f"case{case}_fitted").read_text()
    assert text.startswith("# FITTED")


def test_the_page_in_the_repository_is_that_of_these_runs(page):
    """If this fails after a change of a scenario or of the planner: `make paper`, and read what has changed."""
    kept = (ROOT / "docs" / "reproduction.md").read_text(encoding="utf-8")

    def until_case3(text):
        text = text[text.index("## Case 1") : text.index("## Case 3")]
        return [line for line in text.splitlines() if line.startswith("|")]

    assert until_case3(kept) == until_case3(page)
    for name in re.findall(r"\((figures/[^)]*)\)", kept):
        assert (ROOT / "docs" / name).is_file(), name


def test_the_animation_holds_every_frame_and_has_the_same_bytes_each_time(runs, tmp_path):
    times = animation_times(runs.case2, 100)
    assert times == pytest.approx((0.0, 15.0, 30.0, 45.0))
    for name in ("a.gif", "b.gif"):
        write_animation(tmp_path / name, runs.case2, runs.rule_based, times, frame_ms=100, hold_ms=900)
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "b.gif").read_bytes()
    with Image.open(tmp_path / "a.gif") as image:
        assert image.n_frames == 4
        durations = []
        for frame in range(4):
            image.seek(frame)
            durations.append(image.info["duration"])
    assert durations == [100, 100, 100, 1000]
    write_still(tmp_path / "still.png", runs.case2, runs.rule_based, 12.45)
    with Image.open(tmp_path / "still.png") as image:
        assert image.size == (760, 450)


def test_the_joint_probability_is_that_of_a_random_walk(runs):
    """One branch: closed forms for noise that stays, and for a single step; two vehicles are independent."""
    run, first = runs.case1, runs.case1.decisions[0]

    def decided(stds, vehicles=("sv1",)):
        branches = [
            CaseBranch(name, 1.0, (1, 1), (Mode.CRUISE, Mode.CRUISE), (100.0, 100.0), (4.0, 4.0), stds, stds)
            for name in vehicles
        ]
        plan = (PlanPoint(1, 59.0), PlanPoint(1, 59.0))
        return replace(run, decisions=(replace(first, plan=plan, branches=tuple(branches)),))

    # 41 m behind with 40 m asked for: short when the vehicle is more than 1 m farther back than its mean.
    still = norm.sf(1.0 / 0.8)
    assert worst_joint_probability(decided((0.8, 0.8))) == pytest.approx(still, abs=0.01)
    assert worst_joint_probability(decided((0.8, 0.8), ("sv1", "sv2"))) == pytest.approx(1 - (1 - still) ** 2, abs=0.01)
    # Fresh noise in the second step only: more than either step alone, less than both together.
    grown = worst_joint_probability(decided((0.8, 1.0)))
    assert norm.sf(1.0) < grown < norm.sf(1.0) + still


def test_a_row_says_how_far_off_it_is():
    assert number("c", 12.34, "m", paper=10.0) == number("c", 12.34, "m", paper=10.0, digits=1)
    row = number("c", 12.34, "m", paper=10.0, published=13.0)
    assert (row.paper, row.published, row.ours, row.difference) == ("10.0 m", "13.0 m", "12.3 m", "\u22120.7 m")
    assert number("c", None, "s", paper=1.0).ours == "never s"
    assert number("c", None, "s", paper=1.0).difference == ""
    assert statement("c", "o", holds=False).difference == "does not hold"
    assert (told(-0.04), told(-0.06), told(0.04, sign=True)) == ("0.0", "\u22120.1", "0.0")
