"""The report of a study in a real browser, opened from a file; `open_page` demands an empty console."""

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

    assert page.get_by_role("img").count() == 6
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
