from __future__ import annotations

import pytest

from labpipe.errors import ReadError
from labpipe.readers.load_frame.cards import shipped_cards
from labpipe.readers.load_frame.header import find_header, is_number, is_unit, split_line


@pytest.mark.parametrize("cell", ["1", "-.5", "5e-005", " 1,25 ", "1,110,797", "+2."])
def test_numbers(cell: str) -> None:
    assert is_number(cell)


@pytest.mark.parametrize("cell", ["", "-", "1 mm", "nan", "5e", "2,,5", "15:01"])
def test_other_cells(cell: str) -> None:
    assert not is_number(cell)


def test_units() -> None:
    assert all(map(is_unit, ("mm", "kN", "lbf", "sec", "°C", "mm/mm", "%")))
    assert not any(map(is_unit, ("Time", "Force", "Standard travel")))


def test_a_quote_that_is_not_closed() -> None:
    assert split_line('a,"b,c', ",") == ["a", "b,c"]
    assert split_line("1   2.5", " ") == ["1", "2.5"]


@pytest.mark.parametrize(
    ("card", "lines", "said"),
    [
        (
            "bluehill",
            ["a", "b"],
            r"a\.csv, lines 1 to 2: expected a row of names and rows of numbers",
        ),
        (
            "dion",
            ["S/No;Time", "1;2"],
            r"line 1: expected names with their units in \[\] above the num",
        ),
        (
            "trapezium",
            ["a,b", "1,2"],
            r"line 1: expected a row of names, then a row of units, .* found no",
        ),
        (
            "testxpert-tra",
            ['"a","a"', '"s","s"', "1,2"],
            r"found 'a, a' above 's, s'\. Export the test",
        ),
        (
            "table",
            ["1,2", "3,4"],
            r"line 1: expected a row of names above the numbers, found nothing",
        ),
    ],
)
def test_faults(card: str, lines: list[str], said: str) -> None:
    with pytest.raises(ReadError, match=said):
        find_header(lines, shipped_cards()[card], "a.csv")


def test_names_anyhow() -> None:
    card = shipped_cards()["table"]
    assert find_header(["Time,Force", "1,2"], card, "a").units == ("", "")
    assert find_header(["Time (s),Force [kN]", "1,2"], card, "a").units == ("s", "kN")
    assert find_header(["Time,Force", "(s),(kN)", "1,2"], card, "a").names == ("Time", "Force")
