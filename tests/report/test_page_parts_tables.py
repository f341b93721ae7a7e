"""Tables of a report's page in a real browser: they sort, are filtered, and show names as text."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.builders.browsers import launched, shown
from tests.builders.report_pages import campaign_of, page_of

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

NAMES = [f"T-{number}" for number in range(1, 13)]
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


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    yield from launched()


@pytest.fixture(scope="module")
def twelve(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return page_of(tmp_path_factory.mktemp("twelve"), campaign_of(NAMES))


def rows(page: Page) -> list[str]:
    """Names of the tests that are shown, in the order of the table."""
    script = """() => [...document.querySelectorAll("#tests tbody tr:not([hidden]) > th")]
        .map((head) => head.firstChild.textContent)"""
    found: list[str] = page.evaluate(script)
    return found


@pytest.mark.slow
def test_a_table_sorts_by_name_as_people_count(browser: Browser, twelve: Path) -> None:
    with shown(browser, twelve) as seen:
        head = seen.page.locator("#tests thead th").first
        head.get_by_role("button").click()
        assert rows(seen.page) == NAMES  # T-2 before T-10
        assert head.get_attribute("aria-sort") == "ascending"
        head.get_by_role("button").press("Enter")
        assert rows(seen.page) == NAMES[::-1]
        assert head.get_attribute("aria-sort") == "descending"
        assert "sorted by" in seen.said()


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


def test_numbers_with_intervals_sort_where_the_page_says_no_more(
    browser: Browser, twelve: Path
) -> None:
    with shown(browser, twelve) as seen:
        table = seen.page.locator("table.sortable:not(#tests)").first
        heads = table.locator("thead th").all_text_contents()
        at = next(n for n, head in enumerate(heads) if head.startswith("Peak force"))
        table.locator("thead th").nth(at).get_by_role("button").click()
        texts = table.locator(f"tbody td:nth-of-type({at})").all_text_contents()
        numbers = [float(each.split()[0].rstrip("?")) for each in texts if each[0].isdigit()]
        assert len(numbers) > 3
        assert numbers == sorted(numbers)


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


def test_a_link_leads_to_a_row_that_was_filtered_out(browser: Browser, twelve: Path) -> None:
    with shown(browser, twelve) as seen:
        seen.page.get_by_role("searchbox").last.fill("nothing of that kind")
        assert rows(seen.page) == []
        seen.page.evaluate("location.hash = '#t3'")
        seen.page.locator("#t3").wait_for(state="visible")
        assert rows(seen.page) == NAMES


@pytest.mark.slow
def test_a_thousand_tests(browser: Browser, tmp_path: Path) -> None:
    names = [f"tube-{number:04d}" for number in range(1000)]
    page = page_of(tmp_path, campaign_of(names, most=50))
    assert page.stat().st_size < 0.3e6 + 3e3 * len(names)
    with shown(browser, page) as seen:
        seen.page.locator("#t999").scroll_into_view_if_needed()
        assert seen.page.locator("#t999").is_visible()
        seen.page.get_by_role("searchbox").last.fill("tube-077")
        assert rows(seen.page) == names[770:780]
        seen.page.get_by_role("button", name="reject tube-0777", exact=True).last.click()
        assert "tube-0777: rejected" in seen.said()


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
