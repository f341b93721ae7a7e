"""Every number that the documentation prints is one that a run printed."""

from __future__ import annotations

import pytest

from tests.listings import (
    MAKERS,
    ROOT,
    Command,
    check_page,
    fill_in,
    find_commands,
    find_missing_lines,
    is_run,
)

QUICK = ("README.md",)
PRINTED = "peak: 12 ok\n  peak_force   1.25 N   95 %: 1.20 to 1.30\n  energy   3.0 J\nend\n"


@pytest.mark.parametrize(
    "page", [pytest.param(page, marks=() if page in QUICK else pytest.mark.slow) for page in MAKERS]
)
def test_listings_are_fresh(page: str) -> None:
    assert check_page(page) == []


def listing(*lines: str) -> Command:
    return Command("labpipe x", 0, len(lines), lines)


@pytest.mark.parametrize(
    ("lines", "stale"),
    [
        (("peak: 12 ok", "...", "end"), 0),
        (("peak: 12 ok", "  peak_force 1.25 N 95 %: 1.20 to 1.30"), 0),
        (("peak: 12 ok", "  peak_force 1.24 N 95 %: 1.20 to 1.30", "..."), 1),
        (("end", "peak: 12 ok"), 1),  # in another order
        (("peak: 12 ...",), 0),
    ],
)
def test_what_differs(lines: tuple[str, ...], stale: int) -> None:
    assert len(find_missing_lines(listing(*lines), PRINTED)) == stale


def test_what_is_filled_in() -> None:
    old = listing("peak: 11 ok", "...", "  energy   3.1 J", "end")
    assert fill_in(old, PRINTED) == ["peak: 12 ok", "...", "  energy   3.0 J", "end"]
    whole = listing("peak: 11 ok", "end")
    assert fill_in(whole, PRINTED) == PRINTED.splitlines()


def test_every_page_with_a_listing_is_run_or_says_why_not() -> None:
    """What is printed below a command stands on a page that is run, or is named as not run."""
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        shown = [
            command
            for command in find_commands(path.read_text(encoding="utf-8"))
            if command.printed
        ]
        if path.relative_to(ROOT).as_posix() not in MAKERS:
            assert not [command.line for command in shown if is_run(command.line)], path
