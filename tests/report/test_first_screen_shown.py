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


@pytest.mark.slow
def test_page_one_is_one_screen(browser: Browser, tmp_path: Path) -> None:
    with shown(browser, written(crowded(), tmp_path)) as seen:
        end = seen.page.evaluate("document.getElementById('first').getBoundingClientRect().bottom")
        assert end <= WIDE["height"]
        for words in ("Tested", "Checked", "Date"):
            assert seen.page.locator(".sign span", has_text=words).first.is_visible()
        assert seen.page.locator("#to-decide li").first.is_visible()
        assert seen.page.locator("details.answer").count() == 4


FAULTS = """() => {
  const found = [], wide = document.documentElement.clientWidth;
  if (document.documentElement.scrollWidth > wide) found.push("the page scrolls sideways");
  for (const node of document.querySelectorAll("#first *")) {
    const box = node.getBoundingClientRect();
    if (!box.width || !box.height || node.closest("svg, #said")) continue;
    const words = `${node.tagName}.${node.className}: ${node.textContent.trim().slice(0, 30)}`;
    if (!node.closest(".wide") && box.right > wide + 1) found.push(`beyond the page: ${words}`);
    if (node.matches("td, th, span, b, dd") && node.textContent.trim().length > 12)
      if (box.width < 40) found.push(`a letter a line: ${words}`);
    if (node.matches("td, th") && node.scrollWidth > node.clientWidth + 1)
      found.push(`over its neighbour: ${words}`);
  }
  const table = document.querySelector("details.answer[open] table");
  if (table && table.getBoundingClientRect().width < 0.9 * table.closest("#first").clientWidth)
    found.push("an opened question does not take the width of the page");
  return found;
}"""


@pytest.mark.parametrize(
    "width",
    [
        360,
        800,
        *(pytest.param(w, marks=pytest.mark.slow) for w in (768, 834, 960, 1280, 1920, 2560)),
    ],
)
def test_page_one_at_every_width(browser: Browser, tmp_path: Path, width: int) -> None:
    """Nothing is wider than the page, a letter a line, or over its neighbour, opened or not."""
    viewport = {"width": width, "height": 900}
    with shown(browser, written(crowded(), tmp_path), viewport=viewport) as seen:
        assert seen.page.evaluate(FAULTS) == []
        for details in seen.page.locator("#first details").all():
            details.evaluate("(each) => { each.open = true; }")
        assert seen.page.locator("details.answer table").first.is_visible()
        assert seen.page.evaluate(FAULTS) == []


@pytest.mark.slow
def test_on_paper_figures_are_160_mm_wide(browser: Browser, tmp_path: Path) -> None:
    with shown(browser, written(crowded(), tmp_path)) as seen:
        seen.page.emulate_media(media="print")
        figure = seen.page.locator("figure.curves").first
        box = figure.bounding_box()
        assert box is not None
        assert box["width"] == pytest.approx(160 / 25.4 * 96, abs=1.0)
        assert "report " in seen.page.content()
