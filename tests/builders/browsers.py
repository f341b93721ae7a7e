"""A real browser without a window, and pages of reports in it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

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
