from __future__ import annotations

from pathlib import Path

import pytest

from labpipe.readers.number_rows import first_fault, jump_fault
from labpipe.readers.table_body import Body, Shape

FILE = Path("a.csv")


def shape(text: str, decimal: str = ".", separator: str = ",") -> Shape:
    body = Body(text.encode(), ("Time", "Load"), (0, 1), 3, separator)
    return Shape(body, len(text), decimal, 2)


AGAIN = "Export the test again; the file may have been cut off or edited."


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "1,2\n3,x\n",
            "line 4, column 'Load': expected a number with a decimal point, found 'x'",
        ),
        ("1,2\n3,4,x\n", "line 4: expected 2 cells as in the header, found 3"),
        (
            "1,1e999\n",
            "line 3, column 'Load': expected a number below 1.8e308, found '1e999', which is too"
            " large",
        ),
        ("1,2\n", "from line 3 on: expected rows of numbers, found others"),
    ],
)
def test_the_first_fault(text: str, said: str) -> None:
    assert first_fault(shape(text), FILE) == f"a.csv, {said}. {AGAIN}"


def test_signs_between_thousands() -> None:
    said = first_fault(shape("1;1,063\n2;1,110,797\n", separator=";"), FILE)
    assert "found '1,063' (and '1,110,797' in line 4). A spreadsheet took the decimal sign" in said


def test_a_jump_of_whole_numbers() -> None:
    assert jump_fault(shape("1,999\n2,1063\n3,1110797\n"), 1, (1, 2), FILE) == (
        "a.csv, line 5, column 'Load': expected numbers that do not jump a thousandfold and back,"
        " found '1110797' after '1063'. A spreadsheet took the decimal sign for a sign between"
        " thousands and the digits are lost: export the test again and do not save it from a"
        " spreadsheet."
    )


def test_a_jump_of_numbers_with_their_signs() -> None:
    assert jump_fault(shape("1,1063.0\n2,1110797.0\n"), 1, (0, 1), FILE) is None
