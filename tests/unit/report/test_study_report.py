"""The report of a study whose rows are written by hand: its tables show exactly the numbers known of them."""
# ruff: noqa: RUF001 - the page has minus signs and dashes

import base64
import json
import re
import zlib
from html.parser import HTMLParser

import pandas as pd
import pytest
from scipy import stats

from sumo_hmdp import cli
from sumo_hmdp.errors import InputError
from sumo_hmdp.report import study_replays
from sumo_hmdp.report.study_comparison import compare_study
from sumo_hmdp.report.study_data import baseline_of, named_cells
from sumo_hmdp.report.study_report import study_report, write_study_report
from sumo_hmdp.report.study_table import interval, listed, number
from sumo_hmdp.study.files import read_sealed, write_sealed
from sumo_hmdp.study.store import page_path

LOW, HIGH, BASE = "hmdp_mpc ε=0.05", "hmdp_mpc ε=0.2", "idm_mobil"


@pytest.fixture(scope="module")
def folder(study_by_hand, tmp_path_factory):
    folder = study_by_hand(tmp_path_factory.mktemp("whole") / "study")
    write_study_report(folder)
    return folder


def table(folder, name):
    return pd.read_csv(folder / "report" / "tables" / f"{name}.csv")


def page(folder):
    return (folder / "report" / "report.html").read_text(encoding="utf-8")


class Tables(HTMLParser):
    """The cells of all tables of a page, by caption."""

    def __init__(self):
        super().__init__()
        self.found, self.caption, self.row, self.inside = {}, "", None, None

    def handle_starttag(self, tag, attrs):
        if tag == "tr":
            self.row = []
        elif tag in {"th", "td"}:
            self.row.append("")
        self.inside = tag if tag in {"th", "td", "caption"} else self.inside

    def handle_endtag(self, tag):
        if tag == "tr":
            self.found.setdefault(self.caption, []).append(self.row)
        if tag in {"th", "td", "caption"}:
            self.inside = None

    def handle_data(self, data):
        if self.inside == "caption":
            self.caption = data
        elif self.inside:
            self.row[-1] += data


def tables_of(folder):
    parser = Tables()
    parser.feed(page(folder))
    return parser.found


def test_rates_have_the_exact_intervals(folder):
    cells = table(folder, "cells").set_index("cell_label")
    assert cells.loc[HIGH, ["contact_count", "ended_count"]].tolist() == [3, 12]
    # Three of twelve, and none of twelve, as tables of Clopper and Pearson have them.
    assert cells.loc[HIGH, ["contact_low_rate", "contact_high_rate"]].tolist() == pytest.approx(
        [0.0549, 0.5719], abs=1e-4
    )
    assert cells.loc[LOW, "contact_high_rate"] == pytest.approx(1 - 0.025 ** (1 / 12))
    assert cells["speed_mean_mps"].to_dict() == pytest.approx({LOW: 21.605, HIGH: 22.605, BASE: 20.55})


def test_the_page_shows_the_numbers_of_the_csv(folder):
    rows = {row[0]: row for row in tables_of(folder)["Risk and efficiency of every cell"]}
    assert rows[HIGH][1:5] == ["12 of 12", "3", "25", "5.49 to 57.2"]
    assert rows[LOW][5] == "21.61"
    assert rows[BASE][5] == "20.55"


def test_differences_on_common_seeds(folder):
    found = table(folder, "verdict").set_index(["first", "metric"])
    speed = found.loc[(LOW, "speed_mean_mps")]
    assert (speed["second"], speed["outcome"], speed["pair_count"]) == (BASE, "better", 12)
    assert speed["difference"] == pytest.approx(1.0 + 0.01 * 5.5)
    # Twelve differences near 1: as small a p as 9,999 resamples can give. Nobody imposed braking, so 14 of the 16
    # comparisons have a p.
    assert speed["p_value"] == pytest.approx(2 / 10_000)
    assert speed["p_adjusted"] == pytest.approx(14 * 2 / 10_000)
    assert found.loc[(HIGH, "speed_mean_mps"), "difference"] == pytest.approx(2.055)
    # Three contacts against none: McNemar's z is the root of 3.
    contact = found.loc[(HIGH, "contact")]
    assert (contact["p_value"], contact["difference"]) == (
        pytest.approx(2 * stats.norm.sf(3**0.5)),
        pytest.approx(0.25),
    )
    # Two of 14 are shown, in each cell the speed.
    assert found["level"].tolist() == pytest.approx([1 - 0.05 / 13] * 16)
    assert contact["outcome"] == "no difference shown"
    assert found.loc[(LOW, "braking_imposed_max_mps2"), ["outcome", "missing_count"]].tolist() == ["too few data", 12]
    assert found.loc[(LOW, "ttc_min_s"), ["pair_count", "infinite_count"]].tolist() == [11, 1]
    shown = [row for row in tables_of(folder)["Each cell against the baseline, on common seeds"] if row[0] == HIGH]
    assert shown[1][1:4] == [BASE, "mean speed [m/s]", "better"]
    assert (shown[1][4], shown[1][6:]) == ("2.06", ["12", "0.0028"])


def test_the_verdict_comes_first_and_in_sentences(folder):
    first, low, high, *risk = study_report(folder, folder / "r.html").verdict
    assert first == "36 runs in 3 cells with 12 seeds; 3 of the 36 that ended had a contact."
    assert low.startswith(
        f"{LOW} against {BASE}: better in mean speed (+1.1 m/s); no difference shown in contact rate,"
    )
    assert low.endswith("; too few data for strongest braking imposed.")
    assert high.startswith(f"{HIGH} against {BASE}: better in mean speed (+2.1 m/s);")
    assert any(HIGH in sentence for sentence in risk)
    text = page(folder)
    # What was found, then the frontier and the risk taken over the risk asked for, then all else.
    places = [text.index(part) for part in (first, "Figure: frontier violations", "Figure: risk", "<table")]
    assert places == sorted(places)


def test_risk_taken_over_risk_asked(folder):
    rates = table(folder, "risk").set_index(["cell", "status", "per"])
    assert rates.loc[(HIGH, "optimal", "plan"), ["violation_count", "trial_count", "run_count"]].tolist() == [3, 36, 12]
    assert rates.loc[(LOW, "optimal", "plan"), ["violation_count", "trial_count"]].tolist() == [0, 36]
    high = stats.beta.ppf(0.975, 1, 12)
    assert rates.loc[(LOW, "optimal", "plan"), "high_rate"] == pytest.approx(high)
    # No violation in the 36 plans of 12 runs still allows 26 %, more than the 5 % asked for.
    assert rates.loc[(LOW, "optimal", "plan"), "verdict"] == "too few data"
    assert BASE not in rates.index.get_level_values("cell")
    assert (folder / "report" / "figures" / "frontier_violations.svg").is_file()


def test_distributions_count_what_is_infinite(folder):
    found = table(folder, "distributions").set_index(["cell_label", "metric"])
    ttc = found.loc[(BASE, "ttc_min_s")]
    assert ttc[["finite_count", "infinite_count", "missing_count", "min", "median", "max"]].tolist() == [
        11, 1, 0, 4.0, 4.0, float("inf"),
    ]  # fmt: skip
    assert pd.isna(ttc["mean"])
    speed = found.loc[(BASE, "speed_mean_mps")]
    assert speed[["min", "q25", "median", "max"]].tolist() == pytest.approx([20.0, 20.2, 20.55, 21.1])
    assert found.loc[(BASE, "braking_imposed_max_mps2"), "missing_count"] == 12


def test_decision_times_and_statuses(folder):
    found = table(folder, "decisions").set_index("cell_label")
    assert found.loc[LOW, ["decision_count", "optimal_count", "fallback_count"]].tolist() == [48, 36, 12]
    assert found.loc[BASE, "rule_count"] == 48
    assert found.loc[LOW, ["solve_time_median_ms", "solve_time_max_ms"]].tolist() == [25.0, 40.0]
    assert found["deadline_miss_count"].tolist() == [0, 0, 0]


def test_worst_runs_and_what_to_do_with_them(folder, study_by_hand, tmp_path):
    worst = table(folder, "worst_runs")
    assert worst["why"].tolist()[:4] == ["contact"] * 3 + ["small time to collision"]
    assert set(worst["seed"][:3]) == {0, 4, 7}
    assert worst["why"].tolist()[-1] == "large violation planned"
    assert worst["command"][0] == f"sumo-hmdp replay {folder} {worst['run_id'][0]}"
    assert worst["command"][0] in page(folder)
    # Without the others' steps, and without a word of how long the run took, only a page that is there can be linked.
    other = study_by_hand(tmp_path / "study", trace="ego")
    page_path(other, worst["run_id"][0]).write_text("replay")
    report = study_report(other, other / "a" / "r.html")
    table_of = {one.name: one for section in report.sections for one in section.tables}
    assert table_of["worst_runs"].links[:2] == (f"../{worst['run_id'][0]}.html", "")
    assert report.replays == ()
    (texts,) = (section.texts for section in report.sections if section.id == "worst")
    assert texts[0] == f"{worst['run_id'][0]} is not here, since doing it again takes too long for a report."


def test_the_first_runs_are_in_the_page(folder):
    worst = table(folder, "worst_runs")["run_id"]
    report = study_report(folder, folder / "report" / "report.html")

    assert [one.run_id for one in report.replays] == worst[:5].tolist()
    assert not any(one.repeated for one in report.replays)
    for one in report.replays:
        replay = zlib.decompress(base64.b64decode(one.page)).decode()
        assert f'<th scope="row">run_id</th><td>{one.run_id}</td>' in replay
        assert str(one.page) in page(folder)
    for place, run_id in enumerate(worst):
        assert (f'href="#replay-{run_id}"' in page(folder)) == (place < 5)


def test_replays_keep_to_their_budget(folder, monkeypatch):
    worst = table(folder, "worst_runs")["run_id"].tolist()
    sizes = [len(one.page) for one in study_replays.study_replays(folder, worst).pages]
    monkeypatch.setattr(study_replays, "BYTES", sum(sizes[:2]) + 1)

    found = study_replays.study_replays(folder, worst)

    assert [one.run_id for one in found.pages] == worst[:2]
    assert [note.partition(" is not here")[0] for note in found.notes[1:]] == worst[2:5]


def test_parameters_name_the_traffic_s_drivers(folder):
    traffic = table(folder, "traffic").set_index("name")["value"]
    assert traffic["idm.car.accel_mps2"] == "1.4"
    assert traffic["idm.car.time_gap_s"].startswith("mean ")
    assert traffic["mobil.safe_decel_mps2"] == "4.0"
    levels = table(folder, "parameters").set_index(["name", "value"])["cells"]
    assert levels["parameters.risk_level", "0.2"] == HIGH
    assert "sumo" in table(folder, "versions")["name"].tolist()


def test_failed_runs_are_listed_and_count_for_nothing_else(study_by_hand, tmp_path, at_noon):
    folder = study_by_hand(tmp_path / "study", failed=(1, 2))
    report, _ = write_study_report(folder)
    assert "6 runs failed and counted for nothing but the ledger." in report.verdict
    assert table(folder, "cells")["ended_count"].tolist() == [10, 10, 10]
    assert table(folder, "cells")["run_count"].tolist() == [12, 12, 12]
    ledger = table(folder, "ledger")
    assert ledger["became"].tolist() == ["failed"] * 6
    assert set(ledger["at"]) == {"2026-01-01T12:00:00+00:00"}
    assert "ValueError: &lt;b&gt;" in page(folder)
    assert re.search(r'<a href="\.\./failures/[^"]+seed1\.txt">', page(folder))


@pytest.mark.parametrize("trace", ["none", "ego"])
def test_missing_traces_are_said_plainly(study_by_hand, tmp_path, trace):
    folder = study_by_hand(tmp_path / "study", trace=trace)
    report = study_report(folder, folder / "r.html")
    told = f"cannot be audited for {LOW} and {HIGH}: the study kept no traces of the other vehicles"
    risk = next(section for section in report.sections if section.id == "risk")
    assert told in report.verdict[-1]
    assert told in risk.texts[0]
    assert (risk.figures, risk.tables[0].rows) == ((), ())


def test_a_distance_between_bumpers_is_audited_and_an_unknown_one_said(study_by_hand, tmp_path):
    folder = study_by_hand(tmp_path / "study", seeds=(0, 1), rule="time_headway")
    write_study_report(folder)
    rates = table(folder, "risk").set_index(["cell", "status", "per"])
    assert rates.loc[(HIGH, "optimal", "plan"), ["violation_count", "trial_count"]].tolist() == [1, 6]
    for file in (folder / "cells").glob("*.json"):
        content = read_sealed(file, {})
        text = json.dumps(content).replace('"distance_rule": "time_headway"', '"distance_rule": "mine"')
        write_sealed(file, json.loads(text))
    verdict = study_report(folder, folder / "r.html").verdict
    told = f"{LOW} cannot be audited: distance_rule must be one of fixed, time_headway, rss for an audit, got mine"
    assert any(sentence.startswith(told) for sentence in verdict)


def test_causes_and_horizon_steps_of_the_violations(folder):
    blame = table(folder, "blame").set_index(["cell_label", "claim"])
    # The branches were not written down, so nobody can tell what was predicted.
    assert blame.loc[(HIGH, "planned"), ["violation_count", "trial_count", "unknown_count"]].tolist() == [3, 36, 3]
    assert blame.loc[(LOW, "planned"), "violation_count"] == 0
    assert blame.loc[(HIGH, "executed"), "trial_count"] == 36
    steps = table(folder, "risk_steps").set_index(["cell", "status", "horizon_step"])
    assert steps.loc[(HIGH, "optimal", 1), ["violation_count", "trial_count"]].tolist() == [3, 36]
    assert (folder / "report" / "figures" / "blame.svg").is_file()
    assert "There is nothing to compare: no run kept both predictions and all vehicles" in page(folder)


def test_no_runs_and_one_seed(study_by_hand, tmp_path):
    none = study_by_hand(tmp_path / "none", seeds=())
    report, _ = write_study_report(none)
    assert report.verdict[0] == "Too few data: the study has no run yet, of 3 cells."
    assert table(none, "cells")["run_count"].tolist() == [0, 0, 0]
    assert not list((none / "report" / "figures").glob("*.svg"))
    one = study_by_hand(tmp_path / "one", seeds=(4,))
    report, _ = write_study_report(one)
    assert len(report.sections) == 10
    assert f"{LOW} against {BASE}: too few data in everything (1 pairs)." in report.verdict
    assert set(table(one, "verdict")["outcome"]) == {"too few data"}
    assert table(one, "cells")["speed_low_mps"].isna().all()


def test_every_value_infinite(study_by_hand, tmp_path):
    folder = study_by_hand(tmp_path / "study", change=lambda row: row | {"ttc_min_s": float("inf")})
    write_study_report(folder)
    found = table(folder, "distributions").set_index("metric").loc["ttc_min_s"]
    assert found["infinite_count"].tolist() == [12, 12, 12]
    assert set(table(folder, "verdict").set_index("metric").loc["ttc_min_s", "outcome"]) == {"too few data"}


def test_the_same_bytes_twice_and_not_many(folder):
    before = {path: path.read_bytes() for path in (folder / "report").rglob("*") if path.is_file()}
    write_study_report(folder)
    after = {path: path.read_bytes() for path in (folder / "report").rglob("*") if path.is_file()}
    assert before == after
    assert len(page(folder)) < 2_000_000
    assert not re.search(r"""(src|href)=["']?(https?:)?//""", page(folder))


def test_ids_are_unique_and_tables_have_captions_and_scopes(folder):
    text = page(folder)
    ids = re.findall(r'\bid="([^"]+)"', text)
    assert len(ids) == len(set(ids))
    assert text.count("<table>") == text.count("<caption>") > 8
    assert re.findall(r"<th(?! scope=)[ >]", text) == []
    assert all(len(alt) > 40 for alt in re.findall(r'role="img" aria-label="([^"]+)"', text))


def test_markdown_stands_beside_the_csv(folder):
    text = (folder / "report" / "tables" / "cells.md").read_text(encoding="utf-8")
    assert f"| {HIGH} | 12 of 12 | 3 | 25 | 5.49 to 57.2 |" in text
    ledger = (folder / "report" / "tables" / "ledger.md").read_text(encoding="utf-8")
    assert "None." in ledger


def test_an_earlier_report_leaves_nothing(study_by_hand, tmp_path):
    folder = study_by_hand(tmp_path / "study", seeds=())
    stale = folder / "report" / "figures" / "risk.svg"
    stale.parent.mkdir(parents=True)
    stale.write_text("old")
    write_study_report(folder)
    assert not stale.exists()


def run_cli(monkeypatch, *arguments):
    monkeypatch.setattr("sys.argv", ["sumo-hmdp", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    return ended.value.code


def test_the_command(folder, tmp_path, monkeypatch, capsys):
    assert run_cli(monkeypatch, "report", folder, "--out", tmp_path / "r.html") == 0
    assert "36 runs in 3 cells" in capsys.readouterr().out
    assert (tmp_path / "r.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert run_cli(monkeypatch, "report", folder, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    ttc = [row for row in told["tables"]["distributions"] if row["metric"] == "ttc_min_s" and row["cell_label"] == BASE]
    assert (ttc[0]["max"], ttc[0]["mean"]) == ("inf", None)
    assert told["verdict"][0].startswith("36 runs")


def test_mistakes_are_told(tmp_path, monkeypatch, capsys, folder):
    assert run_cli(monkeypatch, "report", tmp_path) == 2
    assert run_cli(monkeypatch, "report", folder, "--out", tmp_path / "r.pdf") == 2
    assert "must end in .html" in capsys.readouterr().err
    (tmp_path / "runs").mkdir()
    with pytest.raises(InputError, match="must be written by `sumo-hmdp study`"):
        write_study_report(tmp_path)


def manifest(cell, planner, risk_level, solver="milp", scenario="s", **factors):
    return {
        "cell": cell, "planner": planner, "risk_level": risk_level, "solver": solver, "scenario": scenario,
        "factors": factors,
    }  # fmt: skip


def test_cells_are_named_by_what_tells_them_apart():
    cells = named_cells(
        [
            manifest("c", "hmdp_mpc", 0.1, **{"ego.speed_mps": 25.0, "planners.hmdp_mpc.horizon_steps": 3}),
            manifest("b", "hmdp_mpc", 0.1, **{"ego.speed_mps": 25.0, "planners.hmdp_mpc.horizon_steps": 5}),
            manifest("a", "idm_mobil", None, **{"ego.speed_mps": 30.0}),
            manifest("x-1", "idm_mobil", None, "search", **{"ego.speed_mps": 25.0}),
        ]
    )
    assert [cell.label for cell in cells] == [
        "hmdp_mpc milp ε=0.1 horizon_steps=5 (ego.speed_mps=25.0)",
        "hmdp_mpc milp ε=0.1 horizon_steps=3 (ego.speed_mps=25.0)",
        "idm_mobil search (ego.speed_mps=25.0)",
        "idm_mobil milp (ego.speed_mps=30.0)",
    ]
    assert baseline_of(cells[:3]).planner == "idm_mobil"
    assert baseline_of(cells[3:]) is None


def test_cells_that_look_alike_keep_their_hash():
    twins = [manifest("s-p-1f", "p", None), manifest("s-p-2e", "p", None)]
    assert [cell.label for cell in named_cells(twins)] == ["p [1f]", "p [2e]"]


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (12.0, "12"), (0.01234, "0.0123"), (-2.5, "−2.5"), (12345.6, "12346"), (float("inf"), "inf"),
     (-float("inf"), "−inf"), (None, "–"), (pd.NA, "–"), (float("nan"), "–")],
)  # fmt: skip
def test_numbers_for_people(value, text):
    assert number(value) == text


def test_words_for_people():
    assert interval(-1.0, 2.5) == "−1 to 2.5"
    assert interval(float("nan"), 1.0) == "–"
    assert listed(["a", "b", "c"], 2) == "a, b and 1 more"
    assert (listed(["a"]), listed([])) == ("a", "none")


def test_the_one_who_waits_is_told_how_far_it_is(study_by_hand, tmp_path):
    folder, told = study_by_hand(tmp_path / "study"), []
    write_study_report(folder, on_progress=lambda done, total: told.append((done, total)))
    figures = len(list((folder / "report" / "figures").glob("*.svg")))
    assert len(told) > figures > 0
    assert [done for done, _ in told] == sorted(done for done, _ in told)
    assert all(done <= total for done, total in told)
    assert told[-1][0] == told[-1][1]
    compared = []
    found = compare_study(folder, on_progress=lambda done, total: compared.append((done, total)))
    assert compared == [(done, len(found.differences)) for done in range(len(found.differences) + 1)]
