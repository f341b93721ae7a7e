from __future__ import annotations

import pytest

from labpipe.errors import ReadError
from labpipe.readers.load_frame.cards import shipped_cards
from labpipe.readers.load_frame.column_titles import find_header


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
            r"line 1: expected a row of units above the numbers, found 'a, b'\. ",
        ),
        (
            "trapezium",
            ["s,N", "1,2"],
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


def test_a_list_of_names() -> None:
    lines = ["Nsig\t2", "Sig1\tTime (min)", "Sig2\tStrain", "StartOfData", "1\t2"]
    found = find_header(lines, shipped_cards()["dma-q800"], "a")
    assert (found.names, found.units, found.first) == (("Time", "Strain"), ("min", ""), 4)
    with pytest.raises(
        ReadError, match=r"a: expected a line '\^StartOfData.* found none in 3 line"
    ):
        find_header(lines[:3], shipped_cards()["dma-q800"], "a")
    with pytest.raises(
        ReadError, match=r"a, lines 1 to 1: expected names in lines '\^Sig.*found no"
    ):
        find_header(["Nsig\t2", *lines[3:]], shipped_cards()["dma-q800"], "a")


def test_the_first_separator_that_gives_numbers() -> None:
    card = shipped_cards()["table"]
    assert find_header(["a;b", "1,5;2,5"], card, "a").separator == ";"
    assert find_header(["a,b", "1.5,2.5"], card, "a").separator == ","


@pytest.mark.parametrize("after", [0, 1, 2])
@pytest.mark.parametrize(
    ("card", "lines"),
    [
        ("bluehill", ["Specimen,1", "Time,Load", "(s),(N)", "0.1,2.5", "0.2,3.5"]),
        ("table", ["Pull of a wire", "Time,Load", "s,N", "0.1,2.5", "0.2,3.5"]),
        ("testxpert-tra", ['"Pull"', '"Zeit","Kraft"', '"s","N"', "0.1,2.5", "0.2,3.5"]),
    ],
)
def test_a_blank_row_is_no_header(card: str, lines: list[str], after: int) -> None:
    """Between title and names, names and units, units and numbers."""
    whole = [*lines[: after + 1], ",", "", *lines[after + 1 :]]
    header = find_header(whole, shipped_cards()[card], "a.csv")
    assert [name.rstrip() for name in header.names] == [
        cell.strip('"') for cell in lines[1].split(",")
    ]
    assert header.units == ("s", "N")
    assert header.first == 5


def test_the_line_of_a_fault_is_that_of_the_file() -> None:
    lines = ["Pull", "", "a,b", "", "1,2"]
    with pytest.raises(ReadError, match=r"line 3: expected a row of units above the numbers, fou"):
        find_header(lines, shipped_cards()["mts-testsuite"], "a.csv")
