"""The report of a study in a real browser, opened from a file; `open_page` demands an empty console."""

import pandas as pd
import pytest

from sumo_hmdp.report.study_report import write_study_report


@pytest.fixture(scope="module")
def page_path(study_by_hand, tmp_path_factory):
    folder = study_by_hand(tmp_path_factory.mktemp("report") / "study", failed=(11,))
    return write_study_report(folder)[1]


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 768, 1280])
def test_it_fits_and_its_colours_follow_the_scheme(open_page, page_path, width, scheme):
    page = open_page(page_path, viewport={"width": width, "height": 844}, color_scheme=scheme)

    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    page.evaluate("document.querySelectorAll('details').forEach(one => { one.open = true; })")
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    ink = page.evaluate("getComputedStyle(document.querySelector('.drawing text, .drawing path')).color")
    assert ink == {"light": "rgb(22, 25, 29)", "dark": "rgb(233, 236, 238)"}[scheme]
    assert page.evaluate("[...document.querySelectorAll('.drawing svg')].every(one => one.clientHeight > 100)")


def test_figures_and_tables_have_names_for_screen_readers(open_page, page_path):
    page = open_page(page_path)

    assert page.get_by_role("img").count() == 7
    assert page.get_by_role("table", name="Each cell against the baseline, on common seeds").count() == 1
    assert page.get_by_role("columnheader", name="p after Holm").count() == 1
    assert page.get_by_role("rowheader", name="idm_mobil").first.is_visible()
    assert page.evaluate(
        """[...document.querySelectorAll("[id]")].map(one => one.id).length
            === new Set([...document.querySelectorAll("[id]")].map(one => one.id)).size"""
    )


def test_links_lead_to_sections_and_tracebacks(open_page, page_path):
    page = open_page(page_path)

    anchors = page.evaluate("[...document.querySelectorAll('nav a')].map(one => one.getAttribute('href').slice(1))")
    assert all(page.locator(f"section#{anchor}").count() == 1 for anchor in anchors)
    targets = page.evaluate("[...document.querySelectorAll('#ledger a')].map(one => one.getAttribute('href'))")
    assert len(targets) == 3
    assert all((page_path.parent / target).is_file() for target in targets)


def test_folded_tables_are_printed(open_page, page_path):
    page = open_page(page_path)
    caption = page.locator("#parameters td").first

    assert not caption.is_visible()
    page.emulate_media(media="print")
    assert caption.is_visible()
    assert not page.locator("nav").is_visible()


def replay_in(page):
    """Wait for the frame that the replay is in, and for the replay in it."""
    for _ in range(500):
        # Asked from outside: the frame's own context goes when its page comes.
        if page.evaluate("!!document.getElementById('replay-frame').contentWindow?.replay"):
            return next(frame for frame in page.frames if frame != page.main_frame)
        page.wait_for_timeout(20)
    raise AssertionError("no replay came")


@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (390, "dark")])
def test_the_link_of_a_run_opens_its_replay(open_page, page_path, width, scheme):
    page = open_page(page_path, viewport={"width": width, "height": 844}, color_scheme=scheme)
    worst = pd.read_csv(page_path.parent / "tables" / "worst_runs.csv")
    links = page.locator("#worst tbody a[href^='#replay-']")
    assert [one.inner_text() for one in links.all()] == worst["run_id"].tolist()[:5]
    steps = pd.concat(pd.read_parquet(file) for file in (page_path.parents[1] / "steps").glob("*/*.parquet"))
    rows = steps[(steps["run_id"] == worst["run_id"][1]) & (steps["step"] == 1)].set_index("vehicle_id")

    links.nth(1).click()
    replay = replay_in(page)
    page.keyboard.press("ArrowRight")

    state = replay.evaluate("window.replay.state()")
    assert state["time"] == pytest.approx(rows["time_s"].iloc[0])
    assert {name: one["x_m"] for name, one in state["vehicles"].items()} == rows["x_m"].to_dict()
    assert page.inner_text("#replay-title") == f"Replay of {worst['run_id'][1]}"
    assert replay.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    assert replay.evaluate("document.documentElement.dataset.theme") == scheme
    page.keyboard.press("Escape")
    page.wait_for_timeout(200)
    assert not page.locator("#replay").is_visible()
    assert page.evaluate("location.hash") == "#worst"


def test_a_replay_can_be_linked_from_outside(open_page, page_path):
    run_id = pd.read_csv(page_path.parent / "tables" / "worst_runs.csv")["run_id"][0]

    page = open_page(page_path, f"#replay-{run_id}")

    assert replay_in(page).evaluate("window.replay.state().time") == 0
    page.click("#replay-close")
    assert not page.locator("#replay").is_visible()
