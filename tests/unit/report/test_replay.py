import base64
import json
import math
import re
import zlib
from decimal import Decimal
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest

from sumo_hmdp.errors import InputError
from sumo_hmdp.report.replay import render_replay, write_replay
from sumo_hmdp.report.replay_data import replay_data
from sumo_hmdp.report.replay_summary import summarize

HOSTILE = "</script><script>alert(1)</script><!--"


def step(number, vehicle_id, x, lane, **more):
    return {
        "run_id": "r",
        "step": number,
        "time_s": number * 0.15,
        "vehicle_id": vehicle_id,
        "x_m": x,
        "y_m": (2 - lane) * 4.0,
        "heading_rad": 0.0,
        "speed_mps": 20.0,
        "accel_mps2": 0.0,
        "lane": lane,
        "intended_lane": lane,
        "mode": "cruise",
        "length_m": 4.5,
        "width_m": 1.8,
        **more,
    }


def decision(index, time, **more):
    return {
        "run_id": "r",
        "decision_index": index,
        "time_s": time,
        "status": "optimal",
        "reason": "",
        "lateral": "keep",
        "mode": "cruise",
        "lane": 2,
        "objective": 1.5,
        "violation_m": 0.0,
        "solver": "highs",
        "solve_time_ms": 12.0,
        "pruned_prob": 0.0,
        "branch_count": 0,
        "plan_json": "[]",
        "branches_json": "[]",
        "forbidden_json": "[]",
        **more,
    }


@pytest.fixture
def manifest():
    return {
        "run_id": "r",
        "scenario": "case2",
        "planner": "hmdp",
        "seed": 3,
        "status": "completed",
        "reason": "",
        "period_s": 0.6,
        "lanes": {"count": 3, "width_m": 4.0},
        "versions": {"sumo": "1.28.0"},
    }


@pytest.fixture
def steps():
    """The ego drifts from lane 2 to lane 1; a car of 5 m is ahead in lane 2 and one behind in lane 1."""
    rows = []
    for number, lane in enumerate((2, 2, 1)):
        rows.append(step(number, "ego", 100.0 + 3 * number, lane))
        rows.append(step(number, "ahead", 120.0 + 2 * number, 2, length_m=5.0))
        rows.append(step(number, "behind", 90.0 + 3 * number, 1))
    return pd.DataFrame(rows)


def to_mm(value):
    return float(Decimal(float(value)).quantize(Decimal("0.001")))


NO_DECISIONS = pd.DataFrame()


class Page(HTMLParser):
    """Counts the elements and keeps the text of the data element."""

    def __init__(self, html):
        super().__init__()
        self.elements, self.texts, self.inside = [], {}, None
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        self.elements.append(tag)
        self.inside = dict(attrs).get("id")

    def handle_endtag(self, tag):
        self.inside = None

    def handle_data(self, data):
        self.texts[self.inside] = self.texts.get(self.inside, "") + data

    @property
    def data(self):
        return json.loads(zlib.decompress(base64.b64decode(self.texts["replay-data"])))


def test_page_refers_to_nothing_outside_itself(manifest, steps):
    page = render_replay(manifest, steps, pd.DataFrame([decision(0, 0.0)]))

    assert not re.search(r"https?:|//cdn|@import|url\(", page)
    assert not {"link", "img", "iframe"} & set(Page(page).elements)
    assert not re.search(r"<script[^>]*\bsrc=", page)


def test_positions_round_trip_to_the_millimetre(manifest):
    rng = np.random.default_rng(11)
    xs = rng.uniform(-50, 5000, size=(40, 2))
    rows = [
        step(k, vehicle_id, xs[k, i], 2, y_m=xs[k, i] / 1000)
        for k in range(40)
        for i, vehicle_id in enumerate(("ego", "a"))
    ]
    shuffled = pd.DataFrame(rows).sample(frac=1, random_state=5)

    data = Page(render_replay(manifest, shuffled, NO_DECISIONS)).data

    assert [vehicle["id"] for vehicle in data["vehicles"]] == ["ego", "a"]
    for i, vehicle in enumerate(data["vehicles"]):
        assert vehicle["x_m"] == [to_mm(x) for x in xs[:, i]]
        assert vehicle["y_m"] == [to_mm(x / 1000) for x in xs[:, i]]
    np.testing.assert_allclose(data["times_s"], np.arange(40) * 0.15, rtol=0, atol=1e-6)


def test_a_vehicle_that_comes_late_and_pauses_keeps_its_frames(manifest):
    rows = [step(k, "ego", 3.0 * k, 2) for k in range(6)]
    rows += [step(k, "late", 10.0 * k, 1) for k in (2, 4)]

    late = replay_data(manifest, pd.DataFrame(rows), NO_DECISIONS)["vehicles"][1]

    assert (late["first"], late["x_m"]) == (2, [20, None, 40])


@pytest.mark.parametrize("field", ["vehicle_id", "reason", "scenario", "parameter"])
def test_hostile_text_stays_text(manifest, steps, field):
    decisions = pd.DataFrame([decision(0, 0.0, reason=HOSTILE if field == "reason" else "")])
    calm = Page(render_replay(manifest, steps, pd.DataFrame([decision(0, 0.0)])))
    if field == "vehicle_id":
        steps = steps.replace({"vehicle_id": {"ahead": HOSTILE}})
    if field == "scenario":
        manifest["scenario"] = HOSTILE
    if field == "parameter":
        manifest["versions"] = {"sumo": HOSTILE}

    page = render_replay(manifest, steps, decisions)

    assert "<script>alert" not in page
    assert sorted(Page(page).elements) == sorted(calm.elements)
    if field == "vehicle_id":
        assert HOSTILE in [vehicle["id"] for vehicle in Page(page).data["vehicles"]]


def test_decisions_json_is_opened_rounded_and_unbounded_means_null(manifest, steps):
    branch = {
        "vehicle_id": "ahead",
        "probability": 0.25,
        "lanes": [2],
        "modes": ["cruise"],
        "x_m": [130.12345],
        "y_m": [0.0],
        "x_std_m": [0.5],
        "y_std_m": [0.1],
    }
    plan = {"step": 1, "lateral": "left", "mode": "cruise", "lane": 1, "x_m": 112.00049, "speed_mps": 20.0}
    row = decision(
        4,
        0.15,
        objective=None,
        violation_m=math.nan,
        plan_json=json.dumps([plan]),
        branches_json=json.dumps([branch]),
        forbidden_json='[{"step": 1, "lane": 2, "x_from_m": -Infinity, "x_to_m": 140.5}, '
        '{"step": 1, "lane": 3, "x_from_m": 10, "x_to_m": 1e9}]',
    )

    (record,) = Page(render_replay(manifest, steps, pd.DataFrame([row]))).data["decisions"]

    assert record["decision_index"] == 4
    assert record["objective"] is None
    assert record["violation_m"] is None
    assert record["plan"] == [{**plan, "x_m": 112}]
    assert record["branches"][0]["x_m"] == [130.123]
    assert [(f["x_from_m"], f["x_to_m"]) for f in record["forbidden"]] == [(None, 140.5), (10, None)]


def test_summary_by_hand(manifest, steps):
    decisions = pd.DataFrame(
        [
            decision(0, 0.0, lateral="left", lane=1),
            decision(1, 0.15, status="fallback", solve_time_ms=30.0, lane=1),
            decision(2, 0.3, lateral="right"),
        ]
    )

    summary = summarize(replay_data(manifest, steps, decisions))

    # Lane 2: 120 - 5 - 100 = 15 m, then 122 - 5 - 103 = 14 m. Lane 1: 106 - 4.5 - 96 = 5.5 m behind.
    assert summary.smallest_gap is not None
    assert summary.smallest_gap.gap_m == pytest.approx(5.5)
    assert (summary.smallest_gap.vehicle_id, summary.smallest_gap.ahead) == ("behind", False)
    assert summary.smallest_gap.time_s == pytest.approx(0.3)
    assert summary.distance_m == pytest.approx(6.0)
    # Decisions to change lanes, as `lane_change_count` has them, and not the one line that the ego crosses.
    assert summary.lane_changes == ((0.0, 1, True), (0.3, 2, False))
    assert summary.statuses == {"optimal": 2, "fallback": 1}
    assert (summary.solve_time_median_ms, summary.solve_time_max_ms) == (12, 30)


def test_overlapping_vehicles_have_a_negative_gap(manifest):
    rows = [step(0, "ego", 10.0, 2), step(0, "other", 12.0, 2)]

    gap = summarize(replay_data(manifest, pd.DataFrame(rows), NO_DECISIONS)).smallest_gap

    assert gap is not None
    assert gap.gap_m == pytest.approx(12.0 - 4.5 - 10.0)


# Two bodies of 1.8 m overlap across the road up to 1.8 m apart, whichever lane their fronts are in.
@pytest.mark.parametrize(("lane", "y", "gap"), [(1, 1.79, 15.5), (2, 1.81, None)])
def test_the_smallest_gap_is_to_who_is_in_the_path(manifest, lane, y, gap):
    rows = [step(0, "ego", 10.0, 2, y_m=0.0), step(0, "other", 30.0, lane, y_m=y)]

    found = summarize(replay_data(manifest, pd.DataFrame(rows), NO_DECISIONS)).smallest_gap

    assert (None if found is None else found.gap_m) == gap


def test_a_run_without_rows_still_has_a_page(manifest):
    manifest |= {"status": "failed", "reason": "no network"}

    page = render_replay(manifest, pd.DataFrame(), pd.DataFrame())

    assert "no network" in page
    assert "recorded no steps" in page
    assert "versions.sumo" in page


def test_every_mistake_is_named_at_once(manifest, steps):
    del manifest["lanes"]

    with pytest.raises(InputError) as raised:
        render_replay(manifest, steps.drop(columns=["x_m", "mode"]), NO_DECISIONS)

    assert [problem.path for problem in raised.value.problems] == [
        "steps.x_m",
        "steps.mode",
        "manifest.lanes.count",
        "manifest.lanes.width_m",
    ]


def test_unreadable_json_is_named_with_its_row(manifest, steps):
    decisions = pd.DataFrame([decision(0, 0.0), decision(1, 0.15, plan_json="[{"), decision(2, 0.3, branches_json="3")])

    with pytest.raises(InputError) as raised:
        render_replay(manifest, steps, decisions)

    assert [problem.path for problem in raised.value.problems] == [
        "decisions[1].plan_json",
        "decisions[2].branches_json",
    ]


def test_write_is_all_or_nothing(tmp_path, manifest, steps):
    path = tmp_path / "new" / "run.html"

    assert write_replay(path, manifest, steps, NO_DECISIONS) == path
    written = path.read_text(encoding="utf-8")
    with pytest.raises(InputError):
        write_replay(path, {}, steps, NO_DECISIONS)

    assert written == render_replay(manifest, steps, NO_DECISIONS)
    assert path.read_text(encoding="utf-8") == written
    assert list(path.parent.iterdir()) == [path]


def test_near_misses_and_contacts_by_hand(manifest):
    """The ego at 20 m/s behind a standing car: 25, 17, 9, 1 and -7 m between the bumpers at steps of 0.4 s."""
    rows = []
    for number in range(5):
        rows.append(step(number, "ego", 8.0 * number, 2, time_s=0.4 * number))
        rows.append(step(number, "stands", 29.5, 2, time_s=0.4 * number, speed_mps=0.0))
        rows.append(step(number, "beside", 8.0 * number, 1, time_s=0.4 * number))

    found = replay_data(manifest, pd.DataFrame(rows), NO_DECISIONS)["conflicts"]

    # Below 1 s from 17 m on; the bodies overlap once 32 - 29.5 m are past the bumper.
    assert [(one["kind"], one["vehicle_id"]) for one in found] == [("near_miss", "stands"), ("contact", "stands")]
    assert [one["time_s"] for one in found] == pytest.approx([0.4, 1.6])
    assert [one["until_s"] for one in found] == pytest.approx([1.6, 1.6])


def test_notes_become_a_table_of_lanes_and_words(manifest, steps):
    notes = {
        "lane_2_accel_mps2": -1.23456, "lane_1_accel_mps2": -1e-9, "lane_1_incentive_mps2": 0.5,
        "lane_1_safe": "no: busy",
        "follows": True, "time_to_go_s": 12.0, "why": HOSTILE,
    }  # fmt: skip
    page = Page(render_replay(manifest, steps, pd.DataFrame([decision(0, 0.0, notes_json=json.dumps(notes))])))

    (record,) = page.data["decisions"]

    assert record["notes"] == {
        "columns": ["acceleration (m/s\N{SUPERSCRIPT TWO})", "incentive (m/s\N{SUPERSCRIPT TWO})", "safe"],
        "lanes": [[1, ["0", "0.5", "no: busy"]], [2, ["-1.235", "", ""]]],
        "others": [["follows", "yes"], ["time to go (s)", "12"], ["why", HOSTILE]],
    }


def test_results_of_before_the_notes_have_none(manifest, steps):
    (record,) = Page(render_replay(manifest, steps, pd.DataFrame([decision(0, 0.0)]))).data["decisions"]
    assert record["notes"] == {"columns": [], "lanes": [], "others": []}


def test_broken_notes_are_named(manifest, steps):
    for text in ("[1]", "{"):
        with pytest.raises(InputError, match=r"decisions\[0\]\.notes_json: must hold"):
            render_replay(manifest, steps, pd.DataFrame([decision(0, 0.0, notes_json=text)]))
