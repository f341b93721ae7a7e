from __future__ import annotations

from dataclasses import replace

import pytest

from labpipe.records.quality import QualityNote, Severity
from labpipe.report.wording import footnote, printable, scale, shortened, title, why_missing
from tests.store.builders_result import build_result

RESULT = build_result(half_cycle=0.2, cycles=1, force_rate=50.0)


def test_display_units() -> None:
    shown = scale(RESULT, "displacement", "m")
    assert shown.label("Displacement") == "Displacement (mm)"
    assert 0.053 * shown.factor == 53.0
    assert scale(replace(RESULT, display={}), "force", "N") == (1.0, "N")


def test_title_names_test_specimen_and_protocol() -> None:
    assert title(RESULT) == "A2-085-1  ·  A2, spool A2-s1, sample 1  ·  wire-cantilever"


def test_footnote_counts_what_is_not_fine() -> None:
    assert footnote(RESULT) == "Of 3 results: 1 doubtful, 1 failed."
    assert footnote(replace(RESULT, results=RESULT.results[:1])) == ""


def test_reason_is_the_first_error() -> None:
    note = QualityNote("no_overlap", Severity.ERROR, "force", "The clocks do not overlap.")
    failed = replace(RESULT, quality=(*RESULT.quality, note))
    expected = "There is no curve to draw. The clocks do not overlap."
    assert why_missing(failed, "curve") == expected
    assert why_missing(RESULT, "curve") == "There is no curve to draw."


@pytest.mark.parametrize("most", [3, 4, 9, 10])
def test_shortened_names_have_their_ends(most: int) -> None:
    assert shortened("0123456789", 10) == "0123456789"
    short = shortened("0123456789abc", most)
    assert len(short) == most
    assert (short[0], short[-1]) == ("0", "c")


def test_only_what_cannot_be_shown_is_replaced() -> None:
    assert printable("a\u202eb\u2066") == "a\ufffdb\ufffd"  # else all behind it reads backwards
    assert printable("a\tb\n\x00\x9f\ud800\ufffe $x_1$ \U0001f600") == (
        "a\tb\n\ufffd\ufffd\ufffd\ufffd $x_1$ \U0001f600"
    )
