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
        return self.page.locator("#said").text_content() or ""

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
def shown(browser: Browser, address: str | Path, **wanted: Any) -> Iterator[Shown]:
    """Open a page: a file without a network, or an address of this machine."""
    settings: dict[str, Any] = {"offline": isinstance(address, Path), "viewport": WIDE} | wanted
    context = browser.new_context(**settings)
    context.set_default_timeout(60_000)  # a busy machine is slow, not wrong
    seen = Shown(context.new_page())
    seen.page.on("request", lambda request: seen.requests.append(request.url))
    seen.page.on("console", lambda message: seen.complaints.append(message.text))
    seen.page.on("pageerror", lambda error: seen.complaints.append(str(error)))
    seen.page.goto(address.as_uri() if isinstance(address, Path) else address)
    try:
        yield seen
    finally:
        context.close()
    assert not seen.complaints, "\n".join(seen.complaints)


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
    groups = [build_group(f"tube {at // 6}", samples[at : at + 6], scaled=False) for at in starts]
    pairs = [(one.name, other.name) for one, other in pairwise(groups)]
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
    with shown(browser, page) as seen:
        assert seen.page.title() == "Synthetic"
        assert seen.page.locator("h1").is_visible()
        assert seen.page.locator("#shown").is_visible()
        assert seen.page.locator("#tests .reject").count() == len(NAMES)
        answer = seen.page.evaluate("fetch('http://127.0.0.1:9/').catch(() => 'refused')")
        assert answer == "refused"
        refused = [text for text in seen.complaints if "Content Security Policy" in text]
        assert len(refused) >= 5
        seen.complaints.clear()


def test_a_value_is_that_of_the_curve_pointed_at(browser: Browser, tmp_path: Path) -> None:
    """Along the curve of one sample, by keyboard, against the samples it was drawn of."""
    campaign, read = campaign_of(NAMES[:6]), []
    curve = campaign.groups[0].samples[2].loading[0]
    with shown(browser, page_of(tmp_path, campaign)) as seen:
        figure = seen.page.locator("figure.plot[data-kind=curves]").first
        figure.locator(".legend").get_by_role("button", name="none", exact=True).click()
        figure.locator(".legend li[data-t='2'] button").click()
        figure.locator("svg.frame").focus()
        for _ in range(25):
            seen.page.keyboard.press("ArrowRight")
            readout = figure.locator(".readout").text_content() or ""
            value = re.fullmatch(r"T-3 · ([-\u2212\d.]+) mm · ([-\u2212\d.]+) N", readout)
            assert value, readout
            read.append([float(number.replace("\u2212", "-")) for number in value.groups()])
    x, force = np.transpose(read)
    assert (np.diff(x) > 0).all()
    # The curve was drawn to 1/65535 of its axes, and its values are read to four figures.
    gap = np.abs(np.interp(1e-3 * x, curve.displacement, curve.force) - force)
    assert gap.max() < 0.003 * float(np.ptp(curve.force))


def test_a_decision_by_mouse_is_saved_behind_those_there_are(
    browser: Browser, twelve: Path
) -> None:
    with shown(browser, twelve) as seen:
        assert seen.decided("T-2") == ["reject"]
        assert seen.bar() == "Nothing decided here"
        seen.reject("T-3", "slipped <b>twice</b>")
        seen.row("T-4").get_by_role("button", name="accept").click()
        assert "is-rejected" in (seen.row("T-3").get_attribute("class") or "")
        assert seen.bar().startswith("2 decisions not saved; the numbers of this report do not kn")
        seen.page.get_by_label("Decided by").fill(" A. Tester ")
        content = seen.saved()
        assert seen.bar().startswith("2 decisions saved in a file")
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
    first = page_of(tmp_path / "one", campaign_of(NAMES))
    with shown(browser, first) as seen:
        seen.reject("T-3", "slipped")
        seen.row("T-6").get_by_role("button", name="accept").click()
        seen.sign()
        seen.page.reload()
        assert seen.decided("T-3") == ["reject"]
        assert seen.row("T-3").locator(".because").input_value() == "slipped"
        assert seen.page.get_by_label("Decided by").input_value() == "A. Tester"
        other = page_of(tmp_path / "two", campaign_of(NAMES[:4], *seen.saved()["decisions"]))
        seen.page.goto(other.as_uri())  # another report of the campaign, which knows them
        assert seen.decided("T-3") == ["reject"]
        assert seen.bar() == "Nothing decided here"
        seen.page.goto(first.as_uri())  # the earlier one again: its own are still there
        assert seen.decided("T-6") == ["accept"]
        seen.page.get_by_role("button", name="Forget").click()
        seen.page.reload()
        assert seen.decided("T-6") == []
        assert seen.bar() == "Nothing decided here"


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
            with shown(browser, server.address) as seen:
                assert seen.page.url.endswith("/report/report.html")
                seen.reject("T-3", "slipped")
                seen.sign()
                seen.button("Save decisions").click()
                seen.page.get_by_text("1 decision saved.").wait_for()
                assert seen.bar() == "Nothing decided here"
                decisions = read_decisions(processed).decisions
                assert [decision.test for decision in decisions] == ["T-3"]
                with seen.page.expect_navigation():
                    seen.button("Make the report again").click()
                assert seen.row("T-3").get_attribute("data-state") == "rejected"
                hosts = {url.split("/")[2] for url in seen.requests}
                assert hosts == {server.address.split("/")[2]}
        finally:
            server.shutdown()
            thread.join()
