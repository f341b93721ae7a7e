"""``labpipe serve``."""

from __future__ import annotations

import re
import webbrowser
from pathlib import Path

import pytest

from labpipe.campaign.serving import ReportServer
from labpipe.cli import BAD_INPUT
from tests.builders.pulled_campaigns import make_pulls
from tests.builders.small_tests import Run


@pytest.fixture(scope="module")
def processed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_pulls(tmp_path_factory.mktemp("done"), ("T-1", "T-2"))


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Addresses that a browser would open; the server is ended at once, as by Ctrl+C."""

    def interrupted(_: ReportServer) -> None:
        raise KeyboardInterrupt

    addresses: list[str] = []
    monkeypatch.setattr(ReportServer, "serve_forever", interrupted)
    monkeypatch.setattr(webbrowser, "open", addresses.append)
    return addresses


def test_it_makes_the_report_and_opens_it(run: Run, processed: Path, opened: list[str]) -> None:
    page = processed / "report" / "report.html"
    ran = run("serve", processed, "--port", "0", "--title", "Tubes")
    assert ran.status == 0
    assert "Tubes" in page.read_text("utf-8")
    (address,) = opened
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/[\w-]{32}/", address)
    assert ran.out.splitlines() == [
        f"Tubes: {address}",
        "Only this machine can open it. Ctrl+C ends it.",
        "",
    ]
    page.write_text("as it was", "utf-8")
    run("serve", processed, "--port", "0", "--no-browser")
    assert page.read_text("utf-8") == "as it was"
    assert len(opened) == 1


def test_bad_input(run: Run, tmp_path: Path, opened: list[str]) -> None:
    ran = run("serve", tmp_path)
    assert ran.status == BAD_INPUT
    assert "expected a result.h5, or a folder with processed tests" in ran.err
    assert "expected a whole number, found 'x'" in run("serve", tmp_path, "--port", "x").err
    assert opened == []
