"""Page one in a real browser: all of it on one screen, and on paper."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from labpipe.records.group import Campaign
from labpipe.report.lab_report import Letterhead, render_page
from labpipe.report.wording import printable
from tests.builders.browsers import WIDE, launched, shown
from tests.builders.bundle_campaigns import bundle_campaign, conduit_cases
from tests.builders.campaigns import build_group, six_samples, troubled_samples

if TYPE_CHECKING:
    from playwright.sync_api import Browser


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    yield from launched()


def written(campaign: Campaign, folder: Path) -> Path:
    letterhead = Letterhead((("Lab", "Bench 3"), ("Customer", "Somebody"), ("Order", "42")))
    dated = replace(campaign, made_on=date(2026, 3, 9))
    page = folder / "report.html"
    page.write_text(printable(render_page(dated, letterhead=letterhead)), encoding="utf-8")
    return page


def crowded() -> Campaign:
    """Twenty-five groups of two families, four questions, three tests to decide on."""
    bundles = bundle_campaign(conduit_cases())
    more = [build_group(f"tube {n}", six_samples()[:3], scaled=False) for n in range(16)]
    odd = build_group("odd", troubled_samples()[:5])
    return replace(bundles, groups=(*bundles.groups, *more, odd))


def test_page_one_is_one_screen(browser: Browser, tmp_path: Path) -> None:
    with shown(browser, written(crowded(), tmp_path)) as seen:
        end = seen.page.evaluate("document.getElementById('first').getBoundingClientRect().bottom")
        assert end <= WIDE["height"]
        for words in ("Tested", "Checked", "Date"):
            assert seen.page.locator(".sign span", has_text=words).first.is_visible()
        assert seen.page.locator("#to-decide li").first.is_visible()
        assert seen.page.locator("details.answer").count() == 4


def test_no_words_of_page_one_lie_upon_each_other(browser: Browser, tmp_path: Path) -> None:
    widest = """[...document.querySelectorAll('.keys td, .keys th')].filter(
        (each) => each.offsetParent && each.scrollWidth > each.clientWidth + 1).length"""
    with shown(browser, written(crowded(), tmp_path)) as seen:
        assert seen.page.evaluate(widest) == 0


def test_on_paper_figures_are_160_mm_wide(browser: Browser, tmp_path: Path) -> None:
    with shown(browser, written(crowded(), tmp_path)) as seen:
        seen.page.emulate_media(media="print")
        figure = seen.page.locator("figure.curves").first
        box = figure.bounding_box()
        assert box is not None
        assert box["width"] == pytest.approx(160 / 25.4 * 96, abs=1.0)
        assert "report " in seen.page.content()
