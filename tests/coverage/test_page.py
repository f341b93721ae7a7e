"""The page of the study: what stands on it, and whether it still holds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.coverage.page import (
    by_fault,
    by_noise,
    publish,
    published_digest,
    published_failures,
    tables,
)
from tests.coverage.study import Kind, rests_on

PAGE = "docs/explanations/coverage.md"
KIND = Kind("foreign", "tensile")


@pytest.mark.slow
def test_the_page_holds(repository: Path) -> None:
    """If not: ``make coverage`` until nothing is left, and ``make coverage-page``."""
    assert published_digest((repository / PAGE).read_text(encoding="utf-8")) == rests_on()


def test_nothing_holds_too_seldom(repository: Path) -> None:
    assert not published_failures((repository / PAGE).read_text(encoding="utf-8"))


def line(truth: float, *, noise: str = "white", fault: str = "") -> dict[str, Any]:
    row = {"name": "peak_force.1", "status": "ok", "value": 1.0, "lower": 0.9, "upper": 1.1}
    about = {"simulator": KIND.simulator, "kind": KIND.name, "noise": noise, "fault": fault}
    more = {"seed": 26000, "commit": "abc1234", "error": "", "rows": [{**row, "truth": truth}]}
    return {**about, **more}


def lines(held: int, tests: int) -> list[dict[str, Any]]:
    return [line(1.01 if i < held else 1.2) for i in range(tests)]


@pytest.mark.slow
def test_what_the_page_says() -> None:
    text = tables([*lines(17, 29), line(1.5, fault="cut")])
    assert "30 tests, 30 of 200 seeds of each kind, measured at `abc1234`" in text
    assert "| tensile | `peak_force.1` | 29 | 0 | 0 | 17 | 59 |" in text
    assert "Of 1 results that were judged 1 hold too seldom and 0 are wide." in text
    assert published_digest(text) == rests_on()
    assert len(published_failures(text)) == 2  # the result, and all results of its kind


def test_by_noise_and_by_fault() -> None:
    made = [line(1.0), line(1.2), line(1.0, noise="hum"), line(1.0, fault="cut")]
    made += [line(1.5, fault="cut"), line(-1.0, fault="counts-down")]
    assert by_noise(made) == {(KIND, "white"): (1, 2), (KIND, "hum"): (1, 1)}
    assert by_fault(made) == {
        ("tensile", "cut"): (2, 2, 1),
        ("tensile", "counts-down"): (1, 1, 0),
    }


def test_publishing_keeps_what_stands_around(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- counted: begin -->\nyesterday\n<!-- counted: end -->\nafter\n")
    publish(lines(10, 30), page)
    text = page.read_text()
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "yesterday" not in text
    assert published_failures(text)
