from __future__ import annotations

from pathlib import Path

import pytest

from labpipe.errors import ReadError
from labpipe.readers.load_frame.cards import shipped_cards
from labpipe.readers.load_frame.place import Place, decimal_of, line_start, lines_of


def test_where_lines_begin() -> None:
    assert [line_start(b"a\nbc\nd", number) for number in range(4)] == [0, 2, 5, 6]
    assert lines_of("a\r\nb") == ["a", "b"]


def test_the_decimal_sign_of_the_card_or_of_the_export() -> None:
    path = Path("a.dat")
    assert decimal_of("", Place(path, shipped_cards()["microtest"])) == "."
    stating = Place(path, shipped_cards()["mts-793"])
    assert decimal_of("MTS793|MPT|DEU|1|2|,|.", stating) == ","
    expected = r"a\.dat, line 1: expected the decimal sign that this program states, found 'MTS793'"
    with pytest.raises(ReadError, match=expected):
        decimal_of("MTS793\nrest", stating)
