"""A report's page in a real browser: offline, at every width, with tables and figures."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pytest

from labpipe.records.group import Campaign
from labpipe.report.lab_report import Letterhead, render_page
from labpipe.report.wording import printable
from tests.builders.bundle_campaigns import bundle_campaign, conduit_cases
from tests.builders.campaigns import build_group, six_samples, troubled_samples
from tests.builders.report_pages import PHONE, WIDE, Shown, campaign_of, launched, page_of, shown

if TYPE_CHECKING:
    from playwright.sync_api import Browser
NAMES = [f"T-{number}" for number in range(1, 13)]
RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    yield from launched()


@pytest.fixture(scope="module")
def twelve(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return page_of(tmp_path_factory.mktemp("twelve"), campaign_of(NAMES))


def test_its_policy_lets_nothing_else_run(browser: Browser, twelve: Path, tmp_path: Path) -> None:
    """A page that somebody wrote into: what they wrote does nothing, the page works on."""
    text = twelve.read_text("utf-8")
    evil = (
        "<script>document.title = 'run'</script><img src=x onerror=\"document.title = 'run'\">"
        "<style>h1 { display: none }</style><p style='display: none' id=shown>x</p>"
    )
    page = tmp_path / "report.html"
    page.write_text(text.replace("</main>", f"{evil}</main>", 1), "utf-8")
    assert page.read_text("utf-8") != text
    with shown(browser, page) as seen:
        assert seen.page.title() == "Synthetic"
        assert seen.page.locator("h1").is_visible()
        assert seen.page.locator("#shown").is_visible()
        assert seen.page.locator("#tests .reject").count() == len(NAMES)
        refused = [
            error_text for error_text in seen.complaints if "Content Security Policy" in error_text
        ]
        assert len(refused) >= 4
        answer = seen.page.evaluate("fetch('http://127.0.0.1:9/').catch(() => 'refused')")
        assert answer == "refused"
        assert any("connect-src 'none'" in error_text for error_text in seen.complaints)
        seen.complaints.clear()


def test_without_its_script_it_is_a_page_all_the_same(browser: Browser, twelve: Path) -> None:
    with shown(browser, twelve, java_script_enabled=False) as seen:
        assert seen.page.locator("#tests tbody tr").count() == len(NAMES)
        assert seen.page.locator("figure.plot path.curve").count() > 5
        assert seen.page.get_by_role("button").count() == 0
        assert seen.page.locator("#tools").is_hidden()


@pytest.mark.slow
@pytest.mark.parametrize("look", ["light", "dark", "phone"])
def test_rules_of_accessibility(browser: Browser, tmp_path: Path, look: str) -> None:
    """Those of axe-core: contrast, names of controls, order of headings, tables, ids."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    looks: dict[str, dict[str, Any]] = {
        "light": {"color_scheme": "light"},
        "dark": {"color_scheme": "dark"},
        "phone": {"viewport": PHONE, "is_mobile": True, "has_touch": True},
    }
    with shown(browser, page_of(tmp_path, campaign_of(NAMES)), **looks[look]) as seen:
        seen.page.locator("#t2").get_by_role("button", name="reject").click()
        seen.page.locator("details").evaluate_all("(all) => all.forEach((d) => { d.open = true; })")
        # With a mouse rows are close by design: page one is one screen. A finger gets its 24 px.
        rules = {"target-size": {"enabled": look == "phone"}}
        options = {"runOnly": {"type": "tag", "values": RULES}, "rules": rules}
        results = axe.Axe().run(seen.page, options=options)
    broken = [
        f"{rule['id']}: {node['html'][:120]} {node.get('failureSummary', '')[:200]}"
        for rule in results.response["violations"]
        for node in rule["nodes"][:3]
    ]
    assert len(results.response["passes"]) > 20
    assert broken == []


if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page
HOSTILE = [
    "<script>document.title='X'</script>",
    "<img src=x onerror=\"document.title='X'\">",
    "' onfocus='alert(1)' autofocus='",
    "</script><script>document.title='X'</script>",
    "javascript:alert(1)",
    "&lt;b&gt;",
    "a\u202eb\u0000\x1b[31m\ud800",
    "x" * 200,
]


def rows(page: Page) -> list[str]:
    """Names of the tests that are shown, in the order of the table."""
    script = """() => [...document.querySelectorAll("#tests tbody tr:not([hidden]) > th")]
        .map((head) => head.firstChild.textContent)"""
    found: list[str] = page.evaluate(script)
    return found


def test_a_table_sorts_by_number_with_those_without_last(browser: Browser, twelve: Path) -> None:
    values = """() => [...document.querySelectorAll("#tests tbody td[data-v], #tests tbody tr")]
        .filter((each) => each.matches("tr"))
        .map((row) => Number(row.querySelector("td[data-v]")?.dataset.v ?? NaN))"""
    with shown(browser, twelve) as seen:
        head = seen.page.locator("#tests thead th[data-sort=number]").first
        head.get_by_role("button").click()
        up = seen.page.evaluate(values)
        head.get_by_role("button").click()
        down = seen.page.evaluate(values)
    known = [each for each in up if each == each]
    assert known == sorted(known)
    assert 0 < len(known) < len(up)  # the failed one has no number
    assert [each for each in down if each == each] == known[::-1]
    assert up[-1] != up[-1]
    assert down[-1] != down[-1]


def test_a_table_is_filtered_by_words_and_states(browser: Browser, twelve: Path) -> None:
    with shown(browser, twelve) as seen:
        finder = seen.page.get_by_role("search").filter(has=seen.page.get_by_role("searchbox"))
        find = seen.page.get_by_role("searchbox").last
        find.fill("t-1")
        assert rows(seen.page) == ["T-1", "T-10", "T-11", "T-12"]
        assert finder.last.locator("output").text_content() == "4 of 12 rows"
        find.fill("LAB t-11")
        assert rows(seen.page) == ["T-11"]
        find.fill("")
        seen.page.get_by_role("button", name="doubtful", exact=True).click()
        assert rows(seen.page) == ["T-1"]
        seen.page.get_by_role("button", name="failed", exact=True).click()
        assert rows(seen.page) == ["T-1", "T-5"]
        seen.page.get_by_role("button", name="doubtful", exact=True).click()
        assert rows(seen.page) == ["T-5"]


@pytest.mark.slow
def test_hostile_names_are_shown_as_text(browser: Browser, tmp_path: Path) -> None:
    page = page_of(tmp_path, campaign_of([*HOSTILE, "T-1"]))
    with shown(browser, page) as seen:
        assert seen.page.title() == "Synthetic"
        assert rows(seen.page)[0] == HOSTILE[0]
        assert rows(seen.page)[3] == HOSTILE[3]
        script = "document.querySelectorAll('img, script:not([type]), [onerror], [onfocus]').length"
        assert seen.page.evaluate(script) == 1  # the page's own script
        seen.page.locator("#t7 .reject").click()
        seen.page.get_by_role("button", name="Save decisions.json").click()
        assert seen.said() == f"{HOSTILE[7]}: a rejection needs its reason."
        wide = seen.page.evaluate("document.documentElement.scrollWidth")
        assert wide <= 1400
        for number in range(len(HOSTILE)):
            seen.page.locator(f"#t{number} .reject").click()
        assert seen.page.title() == "Synthetic"


if TYPE_CHECKING:
    from playwright.sync_api import Browser, FloatRect, Locator
SIX = [f"T-{number}" for number in range(1, 7)]
MM = 1e-3


@pytest.fixture(scope="module")
def six(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return page_of(tmp_path_factory.mktemp("six"), campaign_of(SIX))


class Drawn(NamedTuple):
    """The first figure of curves, and where its axes lie on the screen."""

    seen: Shown
    figure: Locator
    box: FloatRect

    def at(self, across: float, up: float) -> tuple[float, float]:
        """A place of the figure, as shares of its axes, on the screen."""
        return self.box["x"] + across * self.box["width"], self.box["y"] + up * self.box["height"]

    def reads(self) -> tuple[str, float, float]:
        """Who is pointed at, mm and N."""
        words = self.figure.locator(".readout").text_content() or ""
        found = re.fullmatch(r"(.+) · ([-\u2212\d.]+) mm · ([-\u2212\d.]+) N", words)
        assert found, words
        across, up = (float(group.replace("\u2212", "-")) for group in found.groups()[1:])
        return found[1], across, up

    def ticks(self, axis: str) -> list[float]:
        """Numbers at an axis, as they stand there."""
        texts = self.figure.locator(f".{axis}-axis .tick text").all_text_contents()
        return [float(text.replace("\u2212", "-")) for text in texts]

    def view(self) -> list[float]:
        found = self.figure.locator("svg.area").get_attribute("viewBox") or ""
        return [float(part) for part in found.split()]


def drawn(seen: Shown) -> Drawn:
    figure = seen.page.locator("figure.plot[data-kind=curves]").first
    figure.scroll_into_view_if_needed()
    script = "(area) => { const r = area.farthestViewportElement.getBoundingClientRect(),"
    script += " s = r.width / area.farthestViewportElement.viewBox.baseVal.width,"
    script += " v = (name) => Number(area.getAttribute(name)) * s; return {x: r.x + v('x'),"
    script += " y: r.y + v('y'), width: v('width'), height: v('height')}; }"
    return Drawn(seen, figure, figure.locator("svg.area").evaluate(script))


@pytest.mark.slow
def test_a_value_is_that_of_the_curve_pointed_at(browser: Browser, six: Path) -> None:
    """Along the curve of one sample, by keyboard, against the samples it was drawn of."""
    (sample,) = (sample for sample in campaign_of(SIX).groups[0].samples if sample.test == "T-3")
    curve = sample.loading[0]
    with shown(browser, six) as seen:
        plot = drawn(seen)
        plot.figure.locator(".legend").get_by_role("button", name="none", exact=True).click()
        plot.figure.locator(".legend li[data-t='2'] button").click()
        plot.figure.locator("svg.frame").focus()
        read = []
        for _ in range(25):
            seen.press("ArrowRight")
            read.append(plot.reads())
    assert {who for who, _, _ in read} == {"T-3"}
    x, force = (np.array(cell) for cell in zip(*[row[1:] for row in read], strict=True))
    assert (np.diff(x) > 0).all()
    # The curve was drawn to 1/65535 of its axes, and its values are read to four figures.
    gap = np.abs(np.interp(x * MM, curve.displacement, curve.force) - force)
    assert gap.max() < 0.003 * float(np.ptp(curve.force))


if TYPE_CHECKING:
    from playwright.sync_api import Browser


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
        for words in ("Tested", "CheckReport", "Date"):
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
    "width", [360, *(pytest.param(w, marks=pytest.mark.slow) for w in (800, 1920))]
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
