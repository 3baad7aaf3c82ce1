"""A study made by hand: who is compared with whom, numbers from tables, and the mistakes of a caller."""

import json
import math

import pandas as pd
import pytest
from scipy.stats import norm

import sumo_hmdp
from sumo_hmdp.cli_compare import compare
from sumo_hmdp.errors import InputError
from sumo_hmdp.report.study_comparison import DEFAULT_METRICS, wording

DENSITY = "traffic.density_vpkm_per_lane"
SPEEDS = ["speed_mean_mps"]


def write_cell(folder, name, factors, **columns):
    """Write the runs of one cell as a study does, one for each value; what is not said is the same in all."""
    count = max(len(values) for values in columns.values())
    frame = pd.DataFrame(
        {
            "run_id": [f"{name}-seed{seed}" for seed in range(count)],
            "scenario": "highway",
            "planner": factors["planner"],
            "solver": "search",
            "seed": range(count),
            "risk_level": factors.get("risk_level", math.nan),
            "status": "completed",
            "reason": "",
            "trace_hash": "",
            "contact_count": pd.array([0] * count, dtype="Int64"),
            "factors_json": json.dumps(factors),
            **dict.fromkeys(set(DEFAULT_METRICS) - {"contact_rate"}, 1.0),
        }
    ).assign(**columns)
    path = folder / "runs" / f"cell={name}" / "part.parquet"
    path.parent.mkdir(parents=True)
    frame.to_parquet(path, index=False)


@pytest.fixture
def study(tmp_path):
    """Two planners at two densities, eight seeds: `fast` is faster by 1..8 m/s at 10, and by nothing at 20."""
    eight = [20.0 + seed for seed in range(8)]
    faster = [speed + 1 + seed for seed, speed in enumerate(eight)]
    some = pd.array([1, 0, 1, 0, 0, 0, 2, 0], dtype="Int64")
    for density in (10.0, 20.0):
        write_cell(tmp_path, f"slow{density:g}", {"planner": "slow", DENSITY: density}, speed_mean_mps=eight)
        speeds, contacts = (faster, some) if density == 10.0 else (eight, [0] * 8)
        values = {"planner": "fast", DENSITY: density}
        write_cell(tmp_path, f"fast{density:g}", values, speed_mean_mps=speeds, contact_count=contacts)
    return tmp_path


def test_cells_are_compared_where_everything_else_is_alike(study):
    found = sumo_hmdp.compare(study, [*SPEEDS, "contact_rate"])
    assert found.by == ("planner",)
    rows = found.differences.set_index(["where", "metric"])
    assert set(zip(rows["first"], rows["second"], strict=True)) == {("fast", "slow")}
    assert set(rows.index) == {
        (f"{DENSITY}={density}", metric) for density in (10.0, 20.0) for metric in (*SPEEDS, "contact_rate")
    }
    # Differences 1 to 8: t is 5.196 and p 0.00126. Three contacts of eight runs against none: z is the root of 3.
    here = rows.loc[f"{DENSITY}=10.0"]
    assert here["difference"].to_dict() == {"speed_mean_mps": 4.5, "contact_rate": 0.375}
    speed = here.loc["speed_mean_mps", "p_value"]
    assert 0.00126 < speed < 0.005
    assert here.loc["contact_rate", "p_value"] == pytest.approx(2 * norm.sf(math.sqrt(3)))
    # Holm over all four, two of which have p = 1: times 4, times 3. One is shown, so intervals are at 1 - 0.05 / 4.
    assert here["p_adjusted"].tolist() == pytest.approx([4 * speed, 6 * norm.sf(math.sqrt(3))])
    assert set(found.differences["level"]) == {1 - (1 - 0.95) / 4}
    there = rows.loc[f"{DENSITY}=20.0"]
    assert (there["difference"].tolist(), there["p_adjusted"].tolist()) == ([0.0, 0.0], [1.0, 1.0])
    assert found.verdicts[0].startswith(f"{DENSITY}=10.0: fast is 4.5 m/s faster than slow (98.75 % interval ")
    assert found.verdicts[0].endswith(f"8 pairs, p = {4 * speed:.2g} after Holm)")
    assert "no difference in rate of runs with contact shown between fast and slow: 38 %" in found.verdicts[1]


def test_means_and_rates_of_cells(study):
    found = sumo_hmdp.compare(study, [*SPEEDS, "contact_rate"])
    means = found.means.set_index("cell")
    slow = means.loc[f"slow, {DENSITY}=10.0"]
    # 20..27: mean 23.5, variance 6, t(0.975, 7) = 2.3646.
    assert (slow["count"], slow["mean"], slow["std"]) == (8, 23.5, pytest.approx(math.sqrt(6)))
    assert slow["high"] - slow["mean"] < 1.1 * 2.3646 * math.sqrt(6 / 8)
    assert slow["high"] - slow["mean"] >= 2.3645 * math.sqrt(6 / 8)
    # Clopper and Pearson's limits of 3 in 8 and 0 in 8, as tabled.
    rates = found.rates.set_index("cell")[["hits", "trials", "low", "high"]]
    assert rates.loc[f"fast, {DENSITY}=10.0"].tolist() == pytest.approx([3, 8, 0.0852, 0.7551], abs=1e-4)
    assert rates.loc[f"fast, {DENSITY}=20.0"].tolist() == pytest.approx([0, 8, 0.0, 0.3694], abs=1e-4)


def test_another_factor_or_several(study):
    found = sumo_hmdp.compare(study, SPEEDS, by=DENSITY)
    names = found.differences[["where", "first", "second", "difference"]].to_numpy().tolist()
    assert names == [
        ["fast", f"{DENSITY}=10.0", f"{DENSITY}=20.0", 4.5],
        ["slow", f"{DENSITY}=10.0", f"{DENSITY}=20.0", 0],
    ]
    assert len(sumo_hmdp.compare(study, SPEEDS, by=[DENSITY, "planner"]).differences) == 6


def test_a_factor_that_a_planner_does_not_have_keeps_it_from_no_pair(tmp_path):
    for level in (0.01, 0.1):
        values = {"planner": "hmdp_mpc", "risk_level": level}
        write_cell(tmp_path, f"hmdp{level}", values, speed_mean_mps=[25.0, 26.0])
    write_cell(tmp_path, "rule", {"planner": "rule"}, speed_mean_mps=[20.0, 22.0])
    found = sumo_hmdp.compare(tmp_path, SPEEDS).differences
    assert found[["where", "first", "second", "difference"]].to_numpy().tolist() == [
        ["", "hmdp_mpc, risk_level=0.01", "rule", 4.5],
        ["", "hmdp_mpc, risk_level=0.1", "rule", 4.5],
    ]
    found = sumo_hmdp.compare(tmp_path, SPEEDS, by="risk_level").differences
    assert found[["where", "first", "second"]].to_numpy().tolist() == [
        ["hmdp_mpc", "risk_level=0.01", "risk_level=0.1"]
    ]


def test_cells_stand_in_the_order_of_their_values(tmp_path):
    for name, count in (("a", 10), ("b", 9), ("c", 100)):
        values = {"planner": "p", "planners.p.horizon_steps": count}
        write_cell(tmp_path, name, values, speed_mean_mps=[1.0])
    found = sumo_hmdp.compare(tmp_path, SPEEDS)
    assert found.means["cell"].tolist() == [f"planners.p.horizon_steps={count}" for count in (9, 10, 100)]


def test_lost_runs_are_left_out_and_told(tmp_path):
    write_cell(
        tmp_path, "a", {"planner": "a"}, speed_mean_mps=[1.0, 2.0, 9.0], status=["completed", "contact", "failed"]
    )
    write_cell(tmp_path, "b", {"planner": "b"}, speed_mean_mps=[0.0, 1.0, 5.0])
    found = sumo_hmdp.compare(tmp_path, SPEEDS)
    assert found.notes == ("left out: 1 runs that are failed",)
    (row,) = found.differences.to_dict("records")
    assert (row["pair_count"], row["unpaired_count"], row["difference"]) == (2, 1, 1.0)
    assert found.verdicts[0].startswith("too few data: 2 pairs of a and b with a mean speed")


def test_without_metrics_the_usual_ones(study):
    found = sumo_hmdp.compare(study)
    assert found.metrics == DEFAULT_METRICS
    assert set(found.differences["metric"]) == set(DEFAULT_METRICS)


def test_infinite_and_missing_values_as_they_are_shown(tmp_path, capsys):
    inf, nan = math.inf, math.nan
    write_cell(tmp_path, "a", {"planner": "a"}, ttc_min_s=[2.0, 4.0, inf], optimal_share=[nan] * 3)
    write_cell(tmp_path, "b", {"planner": "b"}, ttc_min_s=[inf, inf, 3.0], optimal_share=[0.5, 1.0, nan])
    compare(tmp_path, ["ttc_min_s", "optimal_share"])
    lines = [[text.strip() for text in line.split("│")[1:-1]] for line in capsys.readouterr().out.splitlines()]
    # t(0.975, 1) = 12.706 times the standard error 0.25.
    assert lines[3:5] == [["a", "median 4, 1 inf", "-"], ["b", "median inf, 2 inf", "0.75 [-2.427, 3.927]"]]
    compare(tmp_path, ["ttc_min_s"], as_json=True)
    content = json.loads(capsys.readouterr().out)
    assert [(row["mean"], row["median"]) for row in content["means"]] == [(None, 4.0), (None, "inf")]
    assert content["differences"][0]["infinite_count"] == 3


def test_one_cell_alone(tmp_path):
    write_cell(tmp_path, "a", {"planner": "a"}, speed_mean_mps=[1.0, 2.0])
    found = sumo_hmdp.compare(tmp_path, SPEEDS)
    assert (found.by, found.verdicts, found.means["cell"].tolist()) == ((), (), ["all runs"])
    with pytest.raises(InputError, match="got 'planner'; all runs are of one cell"):
        sumo_hmdp.compare(tmp_path, by="planner")


def test_runs_of_a_factor_with_a_measured_columns_name_and_of_lists(tmp_path):
    for index, lanes in enumerate(([1], [1, 3])):
        values = {"planner": "a", "duration_s": 20.0 + index, "forbidden_lanes": lanes}
        write_cell(tmp_path, f"c{index}", values, speed_mean_mps=[1.0], duration_s=[9.0])
    found = sumo_hmdp.compare(tmp_path, SPEEDS, by=["factors.duration_s", "forbidden_lanes"])
    assert found.means["cell"].tolist() == [
        "factors.duration_s=20.0, forbidden_lanes=[1]",
        "factors.duration_s=21.0, forbidden_lanes=[1, 3]",
    ]
    assert len(found.differences) == 1


def test_mistakes_are_named(study, tmp_path_factory):
    with pytest.raises(InputError) as caught:
        sumo_hmdp.compare(study, ["speed_mean_mp", "status", "seed"])
    lines = caught.value.lines()
    assert lines[0] == "--metric: must be a column of numbers, got 'speed_mean_mp'; did you mean `speed_mean_mps`?"
    assert [line.split(";")[0].split(", ")[1] for line in lines[1:]] == ["got 'status'", "got 'seed'"]
    with pytest.raises(InputError, match=f"--by: .* got 'solver'; the factors are planner, {DENSITY}"):
        sumo_hmdp.compare(study, by="solver")
    with pytest.raises(InputError, match="must be a results directory"):
        sumo_hmdp.compare(study / "nowhere")
    empty = tmp_path_factory.mktemp("empty")
    (empty / "runs").mkdir()
    with pytest.raises(InputError, match="must hold runs, got none"):
        sumo_hmdp.compare(empty)


@pytest.mark.parametrize(
    ("metric", "text"),
    [
        ("lane_change_count", "number of lane changes"),
        ("gap_min_m", "smallest gap"),
        ("red_light_count", "red_light_count"),
    ],
)
def test_metrics_in_words(metric, text):
    assert wording(metric).quantity == text


def test_a_difference_that_is_not_shown_says_how_many_pairs_it_would_take(tmp_path):
    # Half a standard deviation: 34 pairs for a power of 80 % (Cohen's tables, G*Power).
    spread = [step / math.sqrt(24) for step in (-7, -5, -3, -1, 1, 3, 5, 7)]
    for name, speeds in (("a", [20.0] * 8), ("b", [19.5 - step for step in spread])):
        write_cell(tmp_path, name, {"planner": name}, speed_mean_mps=speeds)
    (sentence,) = sumo_hmdp.compare(tmp_path, SPEEDS).verdicts
    assert sentence.startswith("no difference in mean speed shown between a and b: 0.5 m/s")
    assert sentence.endswith("; if it is real, about 34 pairs would show it in a test of its own")


def test_runs_that_end_early_are_told_where_sums_over_time_are_compared(tmp_path):
    status = ["completed"] * 7 + ["contact"]
    write_cell(tmp_path, "a", {"planner": "a"}, status=status, lane_change_count=[3.0] * 8)
    write_cell(tmp_path, "b", {"planner": "b"}, lane_change_count=[4.0] * 8)
    notes = sumo_hmdp.compare(tmp_path, ["lane_change_count", "tet_s", "speed_mean_mps"]).notes
    assert notes == ("1 runs ended early, with contact: their lane_change_count, tet_s are of a shorter time",)
    assert sumo_hmdp.compare(tmp_path, SPEEDS).notes == ()
