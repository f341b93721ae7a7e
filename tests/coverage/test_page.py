"""The page of the study of tests: what stands on it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.coverage.judgement import Held
from tests.coverage.page import by_fault, by_noise, put, tables

KIND = "foreign/tensile"


def seldom(text: str) -> list[str]:
    """Lines of tables that hold too seldom."""
    return [line for line in text.splitlines() if line.startswith("|") and "**" in line]


def test_nothing_holds_too_seldom(repository: Path) -> None:
    page = repository / "docs" / "explanations" / "coverage.md"
    assert not seldom(page.read_text(encoding="utf-8"))


def row(truth: float, *, noise: str = "white", fault: str = "") -> dict[str, Any]:
    result = {"name": "peak_force.1", "status": "ok", "value": 1.0, "lower": 0.9, "upper": 1.1}
    about = {"noise": noise, "fault": fault}
    return {"kind": KIND, "about": about, "error": "", "rows": [{**result, "truth": truth}]}


def test_what_the_page_says() -> None:
    text = tables([*(row(1.01 if i < 17 else 1.2) for i in range(29)), row(1.5, fault="cut")])
    assert "| tensile | `peak_force.1` | 29 | 0 | 0 | 17 | 59 |" in text
    assert "Of 1 results that were judged 1 hold too seldom and 0 are wide." in text
    assert len(seldom(text)) == 2  # the result, and all results of its kind


def test_by_noise_and_by_fault() -> None:
    made = [row(1.0), row(1.2), row(1.0, noise="hum"), row(1.0, fault="cut")]
    made += [row(1.5, fault="cut"), row(-1.0, fault="counts-down")]
    assert by_noise(made) == {(KIND, "white"): Held(1, 2), (KIND, "hum"): Held(1, 1)}
    assert by_fault(made) == {(KIND, "cut"): (2, 2, 1), (KIND, "counts-down"): (1, 1, 0)}


def test_what_stands_around_the_marks_stays(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- tests: begin -->\nyesterday\n<!-- tests: end -->\nafter\n")
    put("today", "tests", page)
    assert page.read_text() == (
        "before\n<!-- tests: begin -->\n\ntoday\n\n<!-- tests: end -->\nafter\n"
    )
