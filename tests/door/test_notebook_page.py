from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree as ET

from labpipe.door.notebook_page import page_of
from labpipe.records.result import Result, Specimen
from tests.store.builders_result import build_result

RESULT = build_result(half_cycle=0.5)


def texts(page: str) -> list[str]:
    return [text for text in ET.fromstring(page).itertext() if text]


def test_numbers_are_shown_in_display_units_with_their_intervals() -> None:
    said = texts(page_of(RESULT))
    assert said[0] == "A2-085-1"
    assert said[2:5] == ["Peak force, cycle 1", "0.620 N", "estimate 0.600, 0.590 to 0.610"]
    assert "3.100 mm" in said
    assert "doubtful: extrapolated: the force never fell below 5 mN" in said
    assert "failed: not_reached: too short" in said
    assert said[-1] == "95 % intervals, 1 warning in .quality"


def test_hostile_words_are_text() -> None:
    bad = "<script>alert(1)</script>&\x07\"'"
    hostile = replace(
        RESULT,
        test=bad,
        operator=bad,
        specimen=Specimen(bad, bad, bad),
        results=(replace(RESULT.results[0], name=bad), *RESULT.results[1:]),
    )
    page = page_of(hostile)
    assert "<script" not in page
    assert "\x07" not in page
    assert texts(page)[0] == bad.replace("\x07", "\ufffd")


def test_many_results_are_counted() -> None:
    many = replace(RESULT, results=tuple(Result(f"energy.{n}", 1.0, "J") for n in range(1, 31)))
    said = texts(page_of(many))
    assert sum(text.startswith("Energy") for text in said) == 10
    assert said[-1] == "95 % intervals; 20 more in .results, 1 warning in .quality"
    assert page_of(replace(RESULT, results=())).startswith("<div>")
