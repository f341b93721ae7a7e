"""Decisions in a report's page in a real browser: made, kept, saved, and in the next report."""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from labpipe.campaign.decisions import add_decisions, read_decisions
from labpipe.campaign.reporting import report_tests
from labpipe.campaign.saved_decisions import take_in_file
from labpipe.campaign.serving import ReportServer, Site
from labpipe.campaign.test_pages import page_of_test
from tests.builders.pulled_campaigns import decision_on, make_pulls
from tests.builders.report_pages import Shown, campaign_of, key_of, launched, page_of, shown

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator
NAMES = [f"T-{number}" for number in range(1, 13)]
OLD = {
    "test": "T-2", "run": key_of("T-2"), "decision": "reject", "because": "bent <i>before</i>",
    "by": "B. Tester", "when": "2026-03-10T08:00:00+00:00",
}  # fmt: skip


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    yield from launched()


@pytest.fixture(scope="module")
def twelve(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return page_of(tmp_path_factory.mktemp("twelve"), campaign_of(NAMES, decisions=[OLD]))


def row(seen: Shown, name: str) -> Locator:
    return seen.page.locator(f'#tests tr[data-test="{name}"]')


def pressed(seen: Shown, name: str) -> list[str]:
    """What is decided on a test, by the buttons in its row."""
    return row(seen, name).locator("button[aria-pressed=true]").all_text_contents()


def saved(seen: Shown) -> dict[str, Any]:
    """What the page saves."""
    with seen.page.expect_download() as download:
        seen.page.get_by_role("button", name="Save decisions.json").click()
    assert download.value.suggested_filename == "decisions.json"
    found: dict[str, Any] = json.loads(Path(download.value.path()).read_text("utf-8"))
    return found


def bar(seen: Shown) -> str:
    return seen.page.locator("#tools .count").text_content() or ""


@pytest.mark.slow
def test_a_decision_by_mouse_is_saved_behind_those_there_are(
    browser: Browser, twelve: Path
) -> None:
    with shown(browser, twelve) as seen:
        assert pressed(seen, "T-2") == ["reject"]
        assert bar(seen) == "Nothing decided here"
        row(seen, "T-3").get_by_role("button", name="reject").click()
        row(seen, "T-3").locator(".because").fill("slipped <b>twice</b>")
        row(seen, "T-4").get_by_role("button", name="accept").click()
        assert "is-rejected" in (row(seen, "T-3").get_attribute("class") or "")
        assert bar(seen).startswith("2 decisions not saved; the numbers of this report do not know")
        seen.page.get_by_label("Decided by").fill(" A. Tester ")
        said = saved(seen)
        assert bar(seen).startswith("2 decisions saved in a file")
    assert (said["schema"], said["campaign"]) == (1, "c")
    assert said["decisions"][0] == OLD
    rejected, accepted = said["decisions"][1:]
    when = rejected.pop("when")
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00", when)
    assert rejected == {
        "test": "T-3", "run": key_of("T-3"), "decision": "reject",
        "because": "slipped <b>twice</b>", "by": "A. Tester",
    }  # fmt: skip
    assert accepted["because"] == "accepted on the page of the report, without a remark"


@pytest.mark.slow
def test_the_keyboard_alone(browser: Browser, twelve: Path) -> None:
    """From the top of the page to a saved file, without a mouse."""
    with shown(browser, twelve) as seen:
        stops = 0
        while seen.focused() != "accept T-1" or not within_table(seen):
            seen.press("Tab")
            stops += 1
            assert stops < 150
        seen.press("ArrowDown", "ArrowDown", "r")
        assert seen.focused() == "why, T-3"
        seen.page.keyboard.type("slipped")
        seen.press("Enter")
        assert seen.focused() == "reject T-3"
        seen.press("ArrowDown", "a", "ArrowDown", "c")
        assert seen.focused() == "why, T-5"
        seen.press("Escape", "r", "ArrowUp", "a")  # no reason; and T-4 taken back: typed into why
        seen.press("Shift+Tab", "Shift+Tab")
        assert pressed(seen, "T-3") == ["reject"]
        assert pressed(seen, "T-4") == ["accept"]
        assert pressed(seen, "T-5") == ["reject"]
        seen.page.get_by_role("button", name="Save decisions.json").press("Enter")
        assert "T-5: a rejection needs its reason." in seen.said()
        assert seen.focused() == "why, T-5"
        seen.page.keyboard.type("no signal")
        seen.page.get_by_role("button", name="Save decisions.json").press("Enter")
        assert "A name is needed." in seen.said()
        seen.page.keyboard.type("A. Tester")  # the field has the focus
        with seen.page.expect_download() as download:
            seen.press("Tab", "Enter")
        said = json.loads(Path(download.value.path()).read_text("utf-8"))
    assert [(sentence["test"], sentence["decision"]) for sentence in said["decisions"][1:]] == [
        ("T-3", "reject"), ("T-4", "accept"), ("T-5", "reject"),
    ]  # fmt: skip


def within_table(seen: Shown) -> bool:
    return bool(seen.page.evaluate("!!document.activeElement.closest('#tests')"))


@pytest.mark.slow
def test_decisions_outlive_the_page_and_end_when_a_report_knows_them(
    browser: Browser, tmp_path: Path
) -> None:
    first = page_of(tmp_path / "one", campaign_of(NAMES))
    with shown(browser, first) as seen:
        row(seen, "T-3").get_by_role("button", name="reject").click()
        row(seen, "T-3").locator(".because").fill("slipped")
        row(seen, "T-6").get_by_role("button", name="accept").click()
        seen.page.get_by_label("Decided by").fill("A. Tester")
        seen.page.reload()
        assert pressed(seen, "T-3") == ["reject"]
        assert row(seen, "T-3").locator(".because").input_value() == "slipped"
        assert seen.page.get_by_label("Decided by").input_value() == "A. Tester"
        said = saved(seen)["decisions"]
        other = page_of(tmp_path / "two", campaign_of(NAMES[:4], decisions=said))
        seen.page.goto(other.as_uri())  # another report of the campaign, which knows them
        assert pressed(seen, "T-3") == ["reject"]
        assert bar(seen) == "Nothing decided here"
        seen.page.goto(first.as_uri())  # the earlier one again: its own are still there
        assert pressed(seen, "T-6") == ["accept"]
        seen.page.get_by_role("button", name="Forget").click()
        assert pressed(seen, "T-6") == []
        seen.page.reload()
        assert bar(seen) == "Nothing decided here"


@pytest.fixture
def processed(tmp_path: Path) -> Path:
    return make_pulls(tmp_path, ("T-1", "T-2", "T-3"))


@pytest.mark.slow
def test_round_trip_offline(browser: Browser, processed: Path, tmp_path: Path) -> None:
    """Page, decisions.json, next report: the rejected is out of it and named."""
    report = report_tests([processed]).files[0]
    with shown(browser, report) as seen:
        row(seen, "T-2").get_by_role("button", name="reject").click()
        row(seen, "T-2").locator(".because").fill("slipped & <bent>")
        seen.page.get_by_label("Decided by").fill("A. Tester")
        file = tmp_path / "decisions (1).json"
        file.write_text(json.dumps(saved(seen)), "utf-8")
        assert not [each for each in seen.asked if not each.startswith(("file:", "blob:"))]
    taken, faults = take_in_file(processed, "c", file)
    assert (len(taken.added), taken.left, faults) == (1, [], ())
    again = report_tests([processed])
    assert [sample.test for group in again.campaign.groups for sample in group.samples] == [
        "T-1", "T-3",
    ]  # fmt: skip
    with shown(browser, again.files[0]) as seen:
        text = row(seen, "T-2").inner_text()
        assert "slipped & <bent>" in text
        assert "A. Tester" in text
        assert pressed(seen, "T-2") == ["reject"]
        assert "1 rejected" in seen.page.locator("body").inner_text()


@pytest.fixture
def served(processed: Path) -> Iterator[str]:
    report = processed / "report"
    site = Site(processed, processed.name, report, lambda: make_again(processed), page_of_test)
    add_decisions(processed, processed.name, [decision_on(processed, "T-1", "accept")])
    make_again(processed)
    with ReportServer(site, 0) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield server.address
        server.shutdown()
        thread.join()


def make_again(processed: Path) -> None:
    report_tests([processed])


@pytest.mark.slow
def test_a_served_page_saves_without_a_download(
    browser: Browser, processed: Path, served: str
) -> None:
    with shown(browser, served) as seen:
        assert seen.page.url.endswith("/report/report.html")
        row(seen, "T-3").get_by_role("button", name="reject").click()
        row(seen, "T-3").locator(".because").fill("slipped")
        seen.page.get_by_label("Decided by").fill("A. Tester")
        seen.page.get_by_role("button", name="Save decisions", exact=True).click()
        seen.page.get_by_text("1 decision saved.").wait_for()
        assert bar(seen) == "Nothing decided here"
        assert [decision.test for decision in read_decisions(processed).decisions] == ["T-1", "T-3"]
        with seen.page.expect_navigation():
            seen.page.get_by_role("button", name="Make the report again").click()
        assert row(seen, "T-3").get_attribute("data-state") == "rejected"
        assert {each.split("/")[2] for each in seen.asked} == {served.split("/")[2]}
