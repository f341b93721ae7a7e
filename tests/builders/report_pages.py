"""Reports as a program finds them: workbooks, parts of pages, pages in a browser."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import date
from hashlib import sha256
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from openpyxl import load_workbook
from openpyxl.workbook import Workbook

from labpipe.records.group import Campaign, Difference, Group, Sample
from labpipe.report.lab_report import render_page
from labpipe.report.report_workbook import save_workbook
from labpipe.report.wording import printable
from tests.builders.campaigns import build_difference, build_group, build_sample, troubled_samples

DAY = date(2026, 3, 9)


def key_of(name: str) -> str:
    """Key of the results of a synthetic test."""
    return sha256(name.encode("utf-8", "surrogatepass")).hexdigest()


def named(sample: Sample, name: str) -> Sample:
    """The same sample under another name, with what a processed test has."""
    return replace(
        sample, test=name, label=name, run=key_of(name), date=DAY, operator="virtual lab",
        source=f"processed/c/{name}/result.h5",
    )  # fmt: skip


def campaign_of(
    names: Sequence[str],
    *,
    most: int = 6,
    decisions: Sequence[Mapping[str, str]] = (),
) -> Campaign:
    """Tests of these names, so many in a group; of the first group one is doubtful, one failed."""
    samples = [
        named(
            build_sample(f"s{number % 2}", f"{number}", seed=number, scale=1 + 0.01 * number), name
        )
        for number, name in enumerate(names)
    ]
    if len(names) >= 6:
        samples[:6] = map(named, troubled_samples(), names[:6])
    groups = tuple(
        build_group(f"tube {at // most}", samples[at : at + most], scaled=False)
        for at in range(0, len(samples), most)
    )
    return Campaign(
        "Synthetic",
        groups,
        tuple(_difference(*pair) for pair in pairwise(groups)),
        labpipe_version="0.0",
        name="c",
        decisions=(*decisions,),
    )


def _difference(one: Group, other: Group) -> Difference:
    names = one.name, other.name
    return replace(build_difference(), first=names[0], second=names[1], fields={"type": names})


def page_of(folder: Path, campaign: Campaign) -> Path:
    """Write the page of a campaign; gives the file."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "report.html"
    path.write_text(printable(render_page(campaign)), encoding="utf-8")
    return path


def saved(campaign: Campaign, folder: Path) -> Workbook:
    """The workbook of a campaign, written to a folder and read."""
    save_workbook(campaign, folder / "tables.xlsx")
    return load_workbook(folder / "tables.xlsx")


def table(book: Workbook, name: str) -> list[dict[str, Any]]:
    """Rows of a sheet by its heads."""
    heads, *rows = book[name].iter_rows(values_only=True)
    return [dict(zip(map(str, heads), row, strict=True)) for row in rows]


if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page


PROGRAMS = ("chromium", "chromium-browser", "google-chrome")


def launched() -> Iterator[Browser]:
    """Chromium of this machine. Of a module at the longest: its loop would disturb other tests."""
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
    asked: list[str] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)

    def press(self, *keys: str) -> None:
        for key in keys:
            self.page.keyboard.press(key)

    def focused(self) -> str:
        """What a screen reader would say of what has the focus."""
        script = "() => document.activeElement.ariaLabel || document.activeElement.textContent"
        return str(self.page.evaluate(script))

    def said(self) -> str:
        return self.page.locator("#said").text_content() or ""


@contextmanager
def shown(browser: Browser, address: str | Path, **wanted: Any) -> Iterator[Shown]:
    """Open a page: a file without a network, or an address of this machine."""
    is_file = isinstance(address, Path)
    settings: dict[str, Any] = {"offline": is_file, "viewport": WIDE} | wanted
    context = browser.new_context(**settings)
    context.set_default_timeout(60_000)  # a busy machine is slow, not wrong
    page = context.new_page()
    found = Shown(page)
    page.on("request", lambda request: found.asked.append(request.url))
    page.on("console", lambda said: found.complaints.append(said.text))
    page.on("pageerror", lambda error: found.complaints.append(str(error)))
    page.goto(address.as_uri() if isinstance(address, Path) else address)
    try:
        yield found
    finally:
        context.close()
    assert not found.complaints, "\n".join(found.complaints)


WIDE = {"width": 1400, "height": 900}


PHONE = {"width": 390, "height": 844}
