"""A report's page as a whole in a real browser: offline, on a phone, in the dark, for everybody."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.builders.browsers import PHONE, Shown, launched, shown
from tests.builders.report_pages import campaign_of, page_of

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


@pytest.mark.slow
def test_it_needs_no_network_and_no_other_file(browser: Browser, twelve: Path) -> None:
    with shown(browser, twelve) as seen:
        assert seen.asked == [twelve.as_uri()]
        assert "js" in (seen.page.locator("html").get_attribute("class") or "")


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
        refused = [each for each in seen.complaints if "Content Security Policy" in each]
        assert len(refused) >= 4
        answer = seen.page.evaluate("fetch('http://127.0.0.1:9/').catch(() => 'refused')")
        assert answer == "refused"
        assert any("connect-src 'none'" in each for each in seen.complaints)
        seen.complaints.clear()


def test_without_its_script_it_is_a_page_all_the_same(browser: Browser, twelve: Path) -> None:
    with shown(browser, twelve, java_script_enabled=False) as seen:
        assert seen.page.locator("#tests tbody tr").count() == len(NAMES)
        assert seen.page.locator("figure.plot path.curve").count() > 5
        assert seen.page.get_by_role("button").count() == 0
        assert seen.page.locator("#tools").is_hidden()


@pytest.mark.slow
@pytest.mark.parametrize("viewport", [PHONE, {"width": 320, "height": 700}], ids=["390", "320"])
def test_a_phone_scrolls_down_alone(
    browser: Browser, twelve: Path, viewport: dict[str, int]
) -> None:
    with shown(browser, twelve, viewport=viewport, has_touch=True, is_mobile=True) as seen:
        width = "document.documentElement.scrollWidth"
        assert seen.page.evaluate(width) == viewport["width"]
        for details in seen.page.locator("details:visible").all():
            details.evaluate("(each) => { each.open = true; }")
        row = seen.page.locator("#t2")
        row.get_by_role("button", name="reject").tap()
        row.locator(".because").fill("x" * 200)
        box = row.locator(".because").bounding_box()
        assert box is not None
        assert box["x"] + box["width"] <= viewport["width"]
        assert seen.page.evaluate(width) == viewport["width"]
        frame = seen.page.locator("figure.plot svg.frame").first
        frame.scroll_into_view_if_needed()
        frame.tap()
        assert seen.page.evaluate(width) == viewport["width"]


def colours(seen: Shown) -> tuple[float, float]:
    """Luminance, 0 to 255, of the paper and of the words on it."""
    found = []
    for name in ("backgroundColor", "color"):
        said = seen.page.evaluate(f"getComputedStyle(document.body).{name}")
        found.append(sum(float(each) for each in re.findall(r"[\d.]+", said)[:3]) / 3)
    return found[0], found[1]


def test_in_the_dark(browser: Browser, twelve: Path) -> None:
    with shown(browser, twelve, color_scheme="dark") as seen:
        paper, words = colours(seen)
        assert paper < 60 < 200 < words
        seen.page.emulate_media(media="print", color_scheme="dark")
        paper, words = colours(seen)
        assert words < 60 < 200 < paper  # paper stays white


def test_on_paper_there_are_no_buttons(browser: Browser, twelve: Path) -> None:
    with shown(browser, twelve) as seen:
        seen.page.emulate_media(media="print")
        for kind in (".finder", ".controls", ".plot-tools", ".legend-all", "#tools"):
            assert seen.page.locator(f"{kind}:visible").count() == 0, kind
        seen.page.emulate_media(media="screen")
        seen.page.locator("#t2").get_by_role("button", name="accept").click()
        seen.page.emulate_media(media="print")
        told = seen.page.locator("#tools:visible").inner_text()
        assert "the numbers of this report do not know" in told  # who signs must see it


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
