from __future__ import annotations

import pytest

from labpipe.readers.table_body import Body, Shape, chosen_cells
from labpipe.readers.text_cells import PLAIN


def shape(text: str, separator: str = ",") -> Shape:
    data = b"names\n" + text.encode()
    body = Body(data, ("Time", "Load"), (0, 1), 2, separator, start=6)
    return Shape(body, len(data), ".", 2)


def test_rows_are_those_behind_the_names() -> None:
    assert list(shape("1,2\n3\n").rows()) == [["1", "2"], ["3"], []]


@pytest.mark.parametrize("separator", [",", " ", "\t"])
def test_separators_of_each_line(separator: str) -> None:
    starts, counts = shape("1,2\n3\n4,5,6".replace(",", separator), separator).separators
    assert starts.tolist() == [0, 4, 6, 11]
    assert counts.tolist() == [1, 0, 2]


def test_cells_of_some_columns() -> None:
    assert list(chosen_cells([" 1 ", "x", "3"], [0, 2, 5])) == ["1", "3"]


@pytest.mark.parametrize("cell", ["1", "-.5", "1.", "5E-005"])
def test_plain_numbers(cell: str) -> None:
    assert PLAIN["."].fullmatch(cell)
    assert PLAIN[","].fullmatch(cell.replace(".", ","))


@pytest.mark.parametrize("cell", ["nan", "inf", "1_000", "1,5", "0x1", ""])
def test_what_is_no_plain_number(cell: str) -> None:
    assert not PLAIN["."].fullmatch(cell)
