"""A report's page in Chromium: offline, at every width; decisions are made, kept and saved."""

from __future__ import annotations

import json
import re
import shutil
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import date
from hashlib import sha256
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from labpipe.campaign.decisions import read_decisions
from labpipe.campaign.reporting import report_tests
from labpipe.campaign.serving import ReportServer, Site
from labpipe.records.group import Campaign
from labpipe.report.lab_report import render_page
from labpipe.report.wording import replace_unprintable
from tests.builders.campaigns import (
    build_difference,
    build_group,
    build_sample,
    troubled_samples,
)
from tests.builders.pulled_campaigns import make_pulls

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator, Page
pytestmark = pytest.mark.slow
PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
WIDE = {"width": 1400, "height": 900}
NAMES = [f"T-{number}" for number in range(1, 13)]


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Chromium of this machine, of a module at the longest: its loop would disturb other tests."""
    api = pytest.importorskip("playwright.sync_api", reason="no playwright: pip install playwright")
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        pytest.skip("no Chromium on this machine (apt-get install chromium)")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield browser
        browser.close()


@dataclass
class Shown:
    """A page in a browser, what it asked of the network, and what the browser complained of."""

    page: Page
    requests: list[str] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)

    def status(self) -> str:
        return self.page.locator("#message").text_content() or ""

    def bar(self) -> str:
        return self.page.locator("#tools .count").text_content() or ""

    def button(self, name: str) -> Locator:
        return self.page.get_by_role("button", name=name, exact=True)

    def row(self, name: str) -> Locator:
        return self.page.locator(f'#tests tr[data-test="{name}"]')

    def decided(self, name: str) -> list[str]:
        """What is decided on a test, by the buttons in its row."""
        return self.row(name).locator("button[aria-pressed=true]").all_text_contents()

    def reject(self, name: str, because: str) -> None:
        self.row(name).get_by_role("button", name="reject").click()
        self.row(name).locator(".because").fill(because)

    def sign(self) -> None:
        self.page.get_by_label("Decided by").fill("A. Tester")

    def saved(self) -> dict[str, Any]:
        """What the page saves."""
        with self.page.expect_download() as download:
            self.button("Save decisions.json").click()
        assert download.value.suggested_filename == "decisions.json"
        content: dict[str, Any] = json.loads(Path(download.value.path()).read_text("utf-8"))
        return content


@contextmanager
def shown(browser: Browser, address: str | Path, **options: Any) -> Iterator[Shown]:
    """Open a page: a file without a network, or an address of this machine."""
    settings: dict[str, Any] = {"offline": isinstance(address, Path), "viewport": WIDE} | options
    context = browser.new_context(**settings)
    context.set_default_timeout(60_000)  # a busy machine is slow, not wrong
    view = Shown(context.new_page())
    view.page.on("request", lambda request: view.requests.append(request.url))
    view.page.on("console", lambda message: view.complaints.append(message.text))
    view.page.on("pageerror", lambda error: view.complaints.append(str(error)))
    view.page.goto(address.as_uri() if isinstance(address, Path) else address)
    try:
        yield view
    finally:
        context.close()
    assert not view.complaints, "\n".join(view.complaints)


def key_of(name: str) -> str:
    """Key of the results of a synthetic test."""
    return sha256(name.encode("utf-8", "surrogatepass")).hexdigest()


def campaign_of(names: Sequence[str], *decisions: Mapping[str, str]) -> Campaign:
    """Tests of these names, six in a group; of the first group one is doubtful, one failed."""
    samples = [
        build_sample(f"s{number // 6}", f"{number}", seed=number, scale=1 + 0.01 * number)
        for number in range(len(names))
    ]
    if len(names) >= 6:
        samples[:6] = troubled_samples()
    samples = [
        replace(
            sample, test=name, label=name, run=key_of(name), date=date(2026, 3, 9),
            operator="virtual lab", source=f"processed/c/{name}/result.h5",
        )
        for sample, name in zip(samples, names, strict=True)
    ]  # fmt: skip
    starts = range(0, len(samples), 6)
    groups = [build_group(f"tube {n // 6}", samples[n : n + 6], scaled=False) for n in starts]
    pairs = [(first.name, second.name) for first, second in pairwise(groups)]
    differences = [
        replace(build_difference(), first=pair[0], second=pair[1], fields={"type": pair})
        for pair in pairs
    ]
    return Campaign(
        "Synthetic", tuple(groups), tuple(differences), labpipe_version="0.0", name="c",
        decisions=decisions,
    )  # fmt: skip


def page_of(folder: Path, campaign: Campaign, **how: Any) -> Path:
    """Write the page of a campaign; gives the file."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "report.html"
    path.write_text(replace_unprintable(render_page(campaign, **how)), encoding="utf-8")
    return path


OLD = {
    "test": "T-2", "run": key_of("T-2"), "decision": "reject", "because": "bent <i>before</i>",
    "by": "B. Tester", "when": "2026-03-10T08:00:00+00:00",
}  # fmt: skip


@pytest.fixture(scope="module")
def twelve(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return page_of(tmp_path_factory.mktemp("twelve"), campaign_of(NAMES, OLD))


def test_its_policy_lets_nothing_else_run(browser: Browser, twelve: Path, tmp_path: Path) -> None:
    """A page that somebody wrote into: what they wrote does nothing, the page works on."""
    text = twelve.read_text("utf-8")
    evil = (
        "<script>document.title = 'run'</script><img src=x onerror=\"document.title = 'run'\">"
        "<style>h1 { display: none }</style><p style='display: none' id=shown>x</p>"
    )
    page = tmp_path / "report.html"
    page.write_text(text.replace("</main>", f"{evil}</main>", 1), "utf-8")
    with shown(browser, page) as view:
        assert view.page.title() == "Synthetic"
        assert view.page.locator("h1").is_visible()
        assert view.page.locator("#shown").is_visible()
        assert view.page.locator("#tests .reject").count() == len(NAMES)
        answer = view.page.evaluate("fetch('http://127.0.0.1:9/').catch(() => 'refused')")
        assert answer == "refused"
        refused = [text for text in view.complaints if "Content Security Policy" in text]
        assert len(refused) >= 5
        view.complaints.clear()


def test_a_value_is_that_of_the_curve_pointed_at(browser: Browser, tmp_path: Path) -> None:
    """Along the curve of one sample, by keyboard, against the samples it was drawn of."""
    campaign, points = campaign_of(NAMES[:6]), []
    curve = campaign.groups[0].samples[2].loading[0]
    with shown(browser, page_of(tmp_path, campaign)) as view:
        figure = view.page.locator("figure.plot[data-kind=curves]").first
        figure.locator(".legend").get_by_role("button", name="none", exact=True).click()
        figure.locator(".legend li[data-t='2'] button").click()
        figure.locator("svg.frame").focus()
        for _ in range(25):
            view.page.keyboard.press("ArrowRight")
            readout = figure.locator(".readout").text_content() or ""
            value = re.fullmatch(r"T-3 · ([-\u2212\d.]+) mm · ([-\u2212\d.]+) N", readout)
            assert value, readout
            points.append([float(number.replace("\u2212", "-")) for number in value.groups()])
    x, force = np.transpose(points)
    assert (np.diff(x) > 0).all()
    # The curve was drawn to 1/65535 of its axes, and its values are read to four figures.
    gap = np.abs(np.interp(1e-3 * x, curve.displacement, curve.force) - force)
    assert gap.max() < 0.003 * float(np.ptp(curve.force))


def test_a_decision_by_mouse_is_saved_behind_those_there_are(
    browser: Browser, twelve: Path
) -> None:
    with shown(browser, twelve) as view:
        assert view.decided("T-2") == ["reject"]
        assert view.bar() == "Nothing decided here"
        view.reject("T-3", "slipped <b>twice</b>")
        view.row("T-4").get_by_role("button", name="accept").click()
        assert "is-rejected" in (view.row("T-3").get_attribute("class") or "")
        assert view.bar().startswith("2 decisions not saved; the numbers of this report do not in")
        view.page.get_by_label("Decided by").fill(" A. Tester ")
        content = view.saved()
        assert view.bar().startswith("2 decisions saved in a file")
    assert (content["schema"], content["campaign"]) == (1, "c")
    old, rejected, accepted = content["decisions"]
    assert old == OLD
    when = rejected.pop("when")
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00", when)
    assert rejected == {
        "test": "T-3", "run": key_of("T-3"), "decision": "reject",
        "because": "slipped <b>twice</b>", "by": "A. Tester",
    }  # fmt: skip
    assert accepted["because"] == "accepted on the page of the report, without a remark"


def test_decisions_outlive_the_page_and_end_when_a_report_knows_them(
    browser: Browser, tmp_path: Path
) -> None:
    first_page = page_of(tmp_path / "one", campaign_of(NAMES))
    with shown(browser, first_page) as view:
        view.reject("T-3", "slipped")
        view.row("T-6").get_by_role("button", name="accept").click()
        view.sign()
        view.page.reload()
        assert view.decided("T-3") == ["reject"]
        assert view.row("T-3").locator(".because").input_value() == "slipped"
        assert view.page.get_by_label("Decided by").input_value() == "A. Tester"
        second_page = page_of(tmp_path / "two", campaign_of(NAMES[:4], *view.saved()["decisions"]))
        view.page.goto(second_page.as_uri())  # another report of the campaign, which knows them
        assert view.decided("T-3") == ["reject"]
        assert view.bar() == "Nothing decided here"
        view.page.goto(first_page.as_uri())  # the earlier one again: its own are still there
        assert view.decided("T-6") == ["accept"]
        view.page.get_by_role("button", name="Discard").click()
        view.page.reload()
        assert view.decided("T-6") == []
        assert view.bar() == "Nothing decided here"


def test_a_served_page_saves_without_a_download(browser: Browser, tmp_path: Path) -> None:
    processed = make_pulls(tmp_path, NAMES[:3])

    def make_again() -> None:
        report_tests([processed])

    make_again()
    site = Site(processed, processed.name, processed / "report", make_again)
    with ReportServer(site, 0) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            with shown(browser, server.report_url) as view:
                assert view.page.url.endswith("/report/report.html")
                view.reject("T-3", "slipped")
                view.sign()
                view.button("Save decisions").click()
                view.page.get_by_text("1 decision saved.").wait_for()
                assert view.bar() == "Nothing decided here"
                decisions = read_decisions(processed).decisions
                assert [decision.test for decision in decisions] == ["T-3"]
                with view.page.expect_navigation():
                    view.button("Make the report again").click()
                assert view.row("T-3").get_attribute("data-state") == "rejected"
                hosts = {url.split("/")[2] for url in view.requests}
                assert hosts == {server.report_url.split("/")[2]}
        finally:
            server.shutdown()
            thread.join()
