"""The replay page in a real browser, opened from a file; `open_page` demands an empty console."""

import json
import time

import pandas as pd
import pytest

from sumo_hmdp.report.replay import write_replay

STATE = "window.replay.state()"


@pytest.fixture(scope="module")
def page_path(tmp_path_factory, manifest, steps, decisions):
    return write_replay(tmp_path_factory.mktemp("replay") / "run.html", manifest, steps, decisions)


@pytest.fixture
def page(open_page, page_path):
    return open_page(page_path)


def seek(page, seconds):
    page.evaluate("seconds => window.replay.seek(seconds)", seconds)
    return page.evaluate(STATE)


def until(page, predicate, arg=None, timeout_s=10.0):
    """Wait until a JavaScript function says true; the page's policy forbids Playwright's own waiting."""
    deadline = time.monotonic() + timeout_s
    while not page.evaluate(predicate, arg):
        assert time.monotonic() < deadline, f"never true: {predicate}"
        page.wait_for_timeout(20)


def has_pixels(page, selector):
    """Tell whether a canvas holds more than one colour."""
    return page.evaluate(
        """selector => {
            const canvas = document.querySelector(selector);
            const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
            return new Set(new Uint32Array(data.buffer)).size > 1;
        }""",
        selector,
    )


@pytest.mark.parametrize("step", [0, 1, 83, 150, 254, 299, 300])
def test_recorded_instants_show_the_recorded_positions(page, steps, step):
    rows = steps[steps["step"] == step]

    state = seek(page, float(rows["time_s"].iloc[0]))

    assert set(state["vehicles"]) == set(rows["vehicle_id"])
    for row in rows.itertuples():
        shown = state["vehicles"][row.vehicle_id]
        # Equal to the recorded number rounded to mm, not merely close to it.
        assert (shown["x_m"], shown["y_m"]) == (round(row.x_m, 3), round(row.y_m, 3) + 0.0)


def test_between_two_instants_positions_are_interpolated(page, steps):
    rows = steps[steps["vehicle_id"] == "ego"].set_index("step")
    before, after = rows.loc[60], rows.loc[61]

    state = seek(page, before["time_s"] + 0.25 * (after["time_s"] - before["time_s"]))

    expected = 0.75 * before["x_m"] + 0.25 * after["x_m"]
    assert state["vehicles"]["ego"]["x_m"] == pytest.approx(expected, abs=0.001)


def test_decision_is_the_last_one_taken(page, decisions):
    for index in (0, 1, 40, 74):
        taken = float(decisions["time_s"].iloc[index])
        assert seek(page, taken)["decision_index"] == index
        assert seek(page, taken + 0.45)["decision_index"] == index
    until(page, "() => document.getElementById('decision-title').textContent === 'Decision 74 at 44.40 s'")


def test_it_waits_for_play_and_then_time_advances(page):
    page.wait_for_timeout(150)
    assert page.evaluate(STATE)["time"] == 0
    page.click("#play")

    until(page, "() => window.replay.state().time > 0.2")
    assert page.evaluate(STATE)["playing"] is True
    page.click("#play")
    stopped = page.evaluate(STATE)
    page.wait_for_timeout(150)

    assert stopped["playing"] is False
    assert page.evaluate(STATE)["time"] == stopped["time"]


def test_playback_stops_at_the_end_and_restarts_from_there(page):
    seek(page, 44.0)
    page.select_option("#rate", "8")
    page.keyboard.press("Escape")
    page.click("#play")

    until(page, "() => !window.replay.state().playing")
    assert page.evaluate(STATE)["time"] == 45
    page.click("#play")
    until(page, "() => window.replay.state().time < 40")


def test_keyboard(page):
    keys = page.keyboard

    def time_after(key):
        keys.press(key)
        return page.evaluate(STATE)["time"]

    assert time_after("ArrowRight") == 0.15
    assert time_after("ArrowRight") == 0.3
    assert time_after("ArrowLeft") == 0.15
    assert time_after("Shift+ArrowRight") == 0.6
    assert time_after("End") == 45
    assert time_after("ArrowRight") == 45
    assert time_after("Home") == 0
    keys.press("Space")
    until(page, "() => window.replay.state().time > 0.1")
    keys.press("Space")
    assert page.evaluate(STATE)["playing"] is False


def test_arrows_step_also_when_the_slider_has_the_focus(page):
    page.focus("#time")
    page.keyboard.press("ArrowRight")

    assert page.evaluate(STATE)["time"] == 0.15
    until(page, "() => document.getElementById('time').getAttribute('aria-valuetext').startsWith('0.15 s')")


def test_clicks_seek(page):
    box = page.locator("#speed-plot").bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + 60)
    assert page.evaluate(STATE)["time"] == pytest.approx(22.5, abs=1.0)

    page.click("#events summary")
    page.locator("#event-list button").first.click()
    assert page.evaluate(STATE)["time"] == 5.4

    page.click("[data-seek]")
    assert page.evaluate(STATE)["time"] == pytest.approx(float(page.get_attribute("[data-seek]", "data-seek")))


def test_decisions_of_a_rule_are_no_events(open_page, tmp_path, manifest, steps, decisions):
    ruled = decisions.assign(status="rule", reason="")
    page = open_page(write_replay(tmp_path / "rule.html", manifest, steps, ruled))

    page.click("#events summary")
    listed = page.locator("#event-list button").all_inner_texts()

    assert [text.partition(" s ")[2] for text in listed] == [
        "lane change to the left, now lane 1",
        "lane change to the right, now lane 2",
    ]


def test_the_notes_of_a_rule_explain_it(open_page, tmp_path, manifest, steps, decisions):
    notes = {"lane_2_accel_mps2": -1.5, "lane_1_accel_mps2": 0.25, "lane_1_safe": "no: 1.2 m of room ahead"}
    notes["lane_change"] = "<b>under way</b>"
    ruled = decisions.assign(status="rule", reason="", notes_json=json.dumps(notes))
    page = open_page(write_replay(tmp_path / "notes.html", manifest, steps, ruled))

    assert page.locator(".notes-table thead th").all_inner_texts()[1:] == [
        "acceleration (m/s\N{SUPERSCRIPT TWO})",
        "safe",
    ]
    assert page.locator(".notes-table tbody tr").all_inner_texts() == [
        "1\t0.25\tno: 1.2 m of room ahead",
        "2\t-1.5\t–",  # noqa: RUF001
    ]
    assert "<b>under way</b>" in page.inner_text(".notes")
    assert "A rule weighs no other first actions." not in page.inner_text("#decision")


def test_a_contact_is_told_and_shading_says_what_it_is(open_page, tmp_path, manifest, steps, decisions):
    last = steps["time_s"].max()
    ego = steps[(steps["vehicle_id"] == "ego") & (steps["time_s"] == last)].iloc[0]
    struck = (steps["time_s"] == last) & (steps["vehicle_id"] == "car_02")
    steps = steps.copy()
    steps.loc[struck, ["x_m", "y_m"]] = [ego["x_m"] + 4.0, ego["y_m"]]
    page = open_page(write_replay(tmp_path / "contact.html", manifest, steps, decisions), f"#t={last:.2f}")

    assert "contact with car_02" in page.inner_text("#instant")
    shaded = page.inner_text("#shading")
    assert shaded.startswith("Shaded: ")
    assert {"contact", "near miss"} <= {text.strip() for text in page.locator("#shading span").all_inner_texts()}


def test_fragment_opens_at_a_time(open_page, page_path):
    assert open_page(page_path, "#t=12.6").evaluate(STATE)["time"] == 12.6


def test_gaps_and_times_to_collision_are_those_of_the_steps(page, steps):
    """Every neighbour is looked up again in the table: the nearest front ahead or behind in each of the three lanes."""
    for step in (0, 60, 150, 240):
        rows = steps[steps["step"] == step].set_index("vehicle_id")
        ego, others = rows.loc["ego"], rows.drop("ego")
        expected = {}
        for lane in (ego["lane"] - 1, ego["lane"], ego["lane"] + 1):
            there = others[others["lane"] == lane]
            for side, part in (
                ("ahead", there[there["x_m"] >= ego["x_m"]]),
                ("behind", there[there["x_m"] < ego["x_m"]]),
            ):
                if part.empty:
                    continue
                front, rear = (part, ego) if side == "ahead" else (ego, part)
                gaps = front["x_m"] - front["length_m"] - rear["x_m"]
                closing = rear["speed_mps"] - front["speed_mps"]
                name = gaps.idxmin()
                ttc = gaps[name] / closing[name] if closing[name] > 0 and gaps[name] >= 0 else None
                expected[int(lane), side] = (name, gaps[name], ttc)

        shown = seek(page, float(ego["time_s"]))["neighbours"]

        found = {(one["lane"], one["side"]): (one["vehicle_id"], one["gap_m"], one["ttc_s"]) for one in shown}
        assert found.keys() == expected.keys()
        for key, (name, gap, ttc) in expected.items():
            assert found[key][0] == name
            assert found[key][1] == pytest.approx(gap, abs=0.002)
            assert found[key][2] == (None if ttc is None else pytest.approx(ttc, rel=1e-2))


def test_the_slider_itself_moves_the_vehicles(page, steps):
    """A real drag of the thumb: it snaps to a recorded instant, whose positions are the recorded ones."""
    box = page.locator("#time").bounding_box()
    page.mouse.click(box["x"] + box["width"] * 0.62, box["y"] + box["height"] / 2)

    state = page.evaluate(STATE)

    rows = steps[(steps["time_s"] - state["time"]).abs() < 1e-6].set_index("vehicle_id")
    assert state["time"] == pytest.approx(0.62 * 45, abs=0.5)
    assert set(rows.index) == set(state["vehicles"])
    for vehicle_id, row in rows.iterrows():
        assert state["vehicles"][vehicle_id]["x_m"] == round(row["x_m"], 3)


def test_what_bounds_the_plan_is_told(open_page, tmp_path, manifest, steps, decisions):
    plan = [{"step": 1, "lateral": "keep", "mode": "cruise", "lane": 2, "x_m": 100.0, "speed_mps": 20.0}]
    behind = {"step": 1, "side": "behind", "room_m": 5.0, "vehicle_id": "car_02", "probability": 0.5}
    line = {"step": 1, "side": "ahead", "room_m": -2.0, "vehicle_id": "stop line", "probability": None}
    bounds = [behind | {"x_m": 60.0, "distance_m": 35.0}, line | {"x_m": 110.0, "distance_m": 12.0}]

    def told(name, bounds):
        texts = {"plan_json": json.dumps(plan), "bounds_json": json.dumps(bounds)}
        one = decisions.head(1).assign(status="optimal", **texts)
        one = one.drop(columns="bounds_json") if bounds is None else one
        page = open_page(write_replay(tmp_path / f"{name}.html", manifest, steps, one))
        return page.inner_text(".bound"), page.locator(".plan-table tbody tr td").all_inner_texts()[-2:]

    assert told("line", bounds) == (
        "Tightest at step 1 (0.60 s), lane 2: 2.0 m are missing to a stop line 10.0 m away, of 12.0 m asked for.",
        ["5.0", "-2.0"],
    )
    words, rooms = told("car", bounds[:1])
    assert words.startswith(
        "Tightest at step 1 (0.60 s), lane 2: 5.0 m are left to car_02 behind, whose branch of 50 %"
    )
    assert words.endswith("is 40.0 m away, of 35.0 m asked for.")
    assert rooms == ["5.0", "free"]
    assert told("none", []) == ("Nobody shares a lane with the plan: its costs alone shape it.", ["free", "free"])
    # A table of before the column was written must not read as if nobody were there.
    words, rooms = told("old", None)
    assert words.startswith("What bounds the plan was not recorded")
    assert rooms == ["–", "–"]  # noqa: RUF001 - the dash of tables


def test_why_no_other_first_action_was_taken_is_told(open_page, tmp_path, manifest, steps, decisions):
    def action(lateral, mode, verdict, reason="", objective=None, *, chosen=False):
        return {
            "lateral": lateral, "mode": mode, "chosen": chosen, "verdict": verdict, "reason": reason,
            "objective": objective, "violation_m": None if objective is None else 0.0,
        }  # fmt: skip

    tried = [
        action("left", "cruise", "short", "car_05 at step 2 is 3.25 m too near", 7.0),
        action("left", "accelerate", "contact", "contact with car_05 at step 3 at the latest"),
        action("keep", "cruise", "feasible", objective=5.0, chosen=True),
        action("keep", "decelerate", "feasible", objective=6.25),
        action("keep", "accelerate", "feasible", objective=5.0),
        action("right", "cruise", "inadmissible", "lane 3 is forbidden"),
        action("right", "accelerate", "inadmissible", "lane 3 is forbidden"),
    ]

    def opened(name, status="optimal", **columns):
        one = decisions.head(1).assign(status=status, **columns)
        return open_page(write_replay(tmp_path / f"{name}.html", manifest, steps, one))

    page = opened("tried", actions_json=json.dumps(tried))
    rows = page.locator(".actions-table tbody tr")
    assert [row.split("\t") for row in rows.all_inner_texts()] == [
        ["left, cruise", "7", "car_05 at step 2 is 3.25 m too near"],
        ["left, accelerate", "–", "contact with car_05 at step 3 at the latest"],  # noqa: RUF001 - the dash of tables
        ["keep lane, cruise", "5", "taken"],
        ["keep lane, decelerate", "6.25", "keeps every distance, costs 1.25 more"],
        ["keep lane, accelerate", "5", "as good"],
    ]
    assert page.locator(".actions-table [aria-current] th").all_inner_texts() == ["keep lane, cruise"]
    assert page.locator(".actions-table caption").count() == 1
    assert page.locator(".actions-table th[scope=row]").count() == 5
    assert page.inner_text(".not-allowed") == (
        "Not allowed: right, cruise; right, accelerate – lane 3 is forbidden."  # noqa: RUF001
    )
    told = opened("untold").inner_text("#decision")
    assert "Why no other first action was taken is not in this page: sumo-hmdp replay DIR RUN_ID works it out." in told
    told = opened("rule", status="rule", actions_json="[]").inner_text("#decision")
    assert "A rule weighs no other first actions." in told


@pytest.mark.parametrize(("width", "scheme"), [(390, "dark"), (1280, "light")])
def test_the_reasons_fit(open_page, tmp_path, manifest, steps, decisions, width, scheme):
    long = {
        "lateral": "keep", "mode": "decelerate", "chosen": True, "verdict": "short", "objective": 1234567.25,
        "reason": f"{'bg-side-street-01-in-003' * 4} at step 1 is 13.41 m too near", "violation_m": 38.6,
    }  # fmt: skip
    file = write_replay(tmp_path / "long.html", manifest, steps, decisions.assign(actions_json=json.dumps([long])))
    page = open_page(file, "#t=9", viewport={"width": width, "height": 844}, color_scheme=scheme)
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    inside = "() => { const t = document.querySelector('.actions-table'); return t.scrollWidth <= t.clientWidth + 1; }"
    assert page.evaluate(inside)


def test_dragging_the_road_looks_elsewhere_until_the_ego_is_followed_again(page):
    before = page.evaluate(STATE)["view"]
    box = page.locator("#road").bounding_box()
    page.mouse.move(box["x"] + 600, box["y"] + 60)
    page.mouse.down()
    page.mouse.move(box["x"] + 400, box["y"] + 60, steps=4)
    page.mouse.up()

    dragged = page.evaluate(STATE)["view"]
    per_px = (before["right_m"] - before["left_m"]) / (box["width"] - 34)
    assert dragged["follow"] is False
    assert dragged["left_m"] == pytest.approx(before["left_m"] + 200 * per_px, abs=0.5)
    assert seek(page, 20.0)["view"]["left_m"] == dragged["left_m"]
    assert page.input_value("#highlight") == ""
    page.keyboard.press("f")
    assert page.evaluate(STATE)["view"]["follow"] is True
    assert page.is_checked("#follow")


def test_marks_are_reached_by_keys(page):
    times = []
    for _ in range(3):
        page.keyboard.press(".")
        times.append(page.evaluate(STATE)["time"])

    assert times == sorted(set(times))
    assert times[0] == 5.4
    page.keyboard.press(",")
    assert page.evaluate(STATE)["time"] == times[1]


def test_the_instant_is_told_in_words_and_read_out_only_while_it_stands(page):
    seek(page, 9.0)
    until(page, "() => document.getElementById('instant').textContent.startsWith('9.00 s: ego in lane ')")
    text = page.inner_text("#instant")

    assert "Decision 15, optimal: keep lane" in text
    assert page.get_attribute("#instant", "aria-live") == "polite"
    page.click("#play")
    until(page, "() => document.getElementById('instant').getAttribute('aria-live') === 'off'")


def test_horizon_step_and_zoom(page):
    page.click("#horizon-more")
    page.keyboard.press("]")
    assert page.inner_text("#horizon").startswith("3 of 8")
    assert page.get_attribute(".plan-table tbody tr:nth-child(3)", "aria-selected") == "true"

    before = page.inner_text("#scale")
    page.click("#zoom-in")
    page.hover("#road")
    page.mouse.wheel(0, -200)
    until(page, "text => document.getElementById('scale').textContent !== text", arg=before)
    page.keyboard.press("0")
    assert page.inner_text("#scale") == before


@pytest.mark.parametrize("width", [390, 768, 1280])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_width_and_scheme_draws_and_fits(open_page, page_path, width, scheme):
    page = open_page(page_path, "#t=9", viewport={"width": width, "height": 844}, color_scheme=scheme)
    page.wait_for_timeout(100)

    assert page.evaluate("document.documentElement.dataset.theme") == scheme
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    assert all(has_pixels(page, selector) for selector in ("#road", "#marks", "#speed-plot", "#lane-plot"))
    page.click("#theme")
    assert page.evaluate("document.documentElement.dataset.theme") != scheme


def test_reduced_motion_shows_recorded_instants_only(open_page, page_path, steps):
    page = open_page(page_path, reduced_motion="reduce")
    page.click("#play")
    until(page, "() => window.replay.state().time > 0.4")

    seen = page.evaluate(STATE)["time"]

    assert any(abs(seen - recorded) < 1e-6 for recorded in steps["time_s"].unique())


def test_controls_have_names(page):
    nameless = page.evaluate(
        """() => [...document.querySelectorAll("button, input, select, canvas")].filter((control) =>
            !(control.getAttribute("aria-label") || control.closest("label") || control.textContent.trim()
              || control.closest("[aria-hidden=true]"))).map((control) => control.outerHTML)"""
    )
    assert nameless == []


@pytest.mark.parametrize("kind", ["no decisions", "no branches", "no ego", "one instant", "no steps"])
def test_sparse_runs_render(open_page, tmp_path, manifest, steps, decisions, kind):
    bare = decisions.head(3).assign(objective=None, plan_json="[]", branches_json="", forbidden_json=None)
    tables = {
        "no decisions": (steps, decisions.iloc[:0]),
        "no branches": (steps, bare),
        "no ego": (steps[steps["vehicle_id"] != "ego"], pd.DataFrame()),
        "one instant": (steps[steps["step"] == 0], decisions.head(1)),
        "no steps": (pd.DataFrame(), pd.DataFrame()),
    }
    page = open_page(write_replay(tmp_path / "sparse.html", manifest, *tables[kind]))

    if kind != "no steps":
        page.keyboard.press("ArrowRight")
        page.keyboard.press("]")
        page.keyboard.press("Shift+ArrowRight")
        assert has_pixels(page, "#road")
        page.click("#play")
    assert page.locator("h1").is_visible()


def test_hostile_vehicle_id_is_only_text(open_page, tmp_path, manifest, steps, decisions):
    hostile = "</script><script>document.title='owned'</script><img src=x onerror=document.title='owned'>"
    renamed = steps.replace({"vehicle_id": {"car_01": hostile}})
    page = open_page(write_replay(tmp_path / "hostile.html", manifest, renamed, decisions), "#t=3")
    page.click("#scene summary")

    until(page, "id => document.getElementById('scene-table').textContent.includes(id)", arg=hostile)

    assert hostile in page.evaluate(STATE)["vehicles"]
    assert page.title() == "overtaking · hmdp · seed 7"
