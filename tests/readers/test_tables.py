from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.errors import ReadError
from labpipe.readers.tables import Body, read_numbers
from labpipe.records.arrays import Floats

FILE = Path("take.csv")


def read(text: str, *, stated: int | None = None) -> tuple[Floats, dict[str, str]]:
    body = Body(text.encode(), width=3, first_line=8, stated_rows=stated)
    numbers, notes = read_numbers(body, [0, 2], FILE)
    return numbers, {note.code: note.message for note in notes}


def test_blank_cells_are_nan_and_unwanted_columns_are_left() -> None:
    numbers, notes = read("1,x,2\r\n3,,\r\n4,,NAN\r\n")
    np.testing.assert_array_equal(numbers, [[1, 2], [3, np.nan], [4, np.nan]])
    assert notes == {}


@pytest.mark.parametrize("text", ["", "\r\n", "\n\n", ",,\n,,\n"])
def test_no_rows(text: str) -> None:
    assert len(read(text)[0]) == 0


def test_padding_of_a_spreadsheet_is_no_datum() -> None:
    numbers, notes = read("1,2,3,,\n4,5,6,,\n,,,,\n")
    np.testing.assert_array_equal(numbers, [[1, 3], [4, 6]])
    assert notes == {}


@pytest.mark.parametrize(("text", "rows"), [("1,2,3\n4,5,6", 2), ("1,2,3\n4,5", 1)])
def test_a_last_line_without_its_end(text: str, rows: int) -> None:
    numbers, notes = read(text)
    assert len(numbers) == rows
    assert ("truncated" in notes) == (rows == 1)


def test_a_whole_looking_last_line_is_not_trusted_where_rows_are_missing() -> None:
    numbers, notes = read("1,2,3\n4,5,6", stated=5)
    assert len(numbers) == 1
    assert notes["truncated"] == "the last line (9) is incomplete and was left out"
    assert notes["rows_differ"] == "the header states 5 rows, the file holds 1"


def test_short_lines_are_noted() -> None:
    numbers, notes = read("1,2,3\n4\n5,6,7\n")
    np.testing.assert_array_equal(numbers[:, 1], [3, np.nan, 7])
    assert notes["lines_short"] == (
        "1 lines have too few cells, first line 9: what they lack counts as blank"
    )


def test_a_long_line_is_refused_even_if_a_short_one_makes_up_for_it() -> None:
    expected = r"take\.csv, line 9: expected 3 cells as in the header, found 4\. Export"
    with pytest.raises(ReadError, match=expected):
        read("1,2,3\n4,5,6,7\n8,9\n")


def test_a_cell_that_is_no_number_is_found() -> None:
    with pytest.raises(ReadError, match=r"line 9, cell 3: expected a number or a blank, found 'x'"):
        read("1,2,3\n4,5,x\n")
    with pytest.raises(ReadError, match=r"from line 8 on: expected lines of numbers parted by"):
        read('1,2,3\n4,5,"6\n')


@given(cut=st.integers(0, 200))
def test_a_cut_anywhere_loses_only_the_last_line(cut: int) -> None:
    whole = "".join(f"{i},0,{i}.25\n" for i in range(20))
    numbers, _ = read(whole[:cut], stated=20)
    lines = whole[: cut + 1].count("\n")  # the last line is whole without its line end
    lines = lines if cut >= len(whole) - 1 else whole[:cut].count("\n")
    np.testing.assert_array_equal(numbers[:, 1], np.arange(lines) + 0.25)
