from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.errors import ReadError
from labpipe.readers.load_frame.body import read_columns
from labpipe.readers.load_frame.rows import Body

NAMES = ("Time", "Load")
FILE = Path("a.csv")


def body(
    text: str, separator: str = ",", decimal: str = "auto", columns: tuple[int, ...] = (0, 1)
) -> Body:
    return Body(text.encode(), NAMES, columns, 3, separator, decimal)


def codes(text: str, separator: str = ",") -> list[str]:
    return [note.code for note in read_columns(body(text, separator), FILE)[1]]


@given(
    rows=st.lists(st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6)), min_size=1, max_size=20),
    separator=st.sampled_from([",", ";", "\t", " "]),
    comma=st.booleans(),
    ends=st.sampled_from(["\n", "\r\n"]),
)
def test_what_was_written_is_read(
    rows: list[tuple[float, float]], separator: str, comma: bool, ends: str
) -> None:
    quote = '"' if separator == "," and comma else ""
    text = "".join(separator.join(f"{quote}{cell!r}{quote}" for cell in row) + ends for row in rows)
    if comma:
        text = text.replace(".", ",")
    columns, _ = read_columns(body(text, separator), FILE)
    np.testing.assert_allclose(np.transpose([columns[0], columns[1]]), rows, rtol=1e-14)


def test_blank_cells_and_lines() -> None:
    columns, notes = read_columns(body("1,\n,2\n3,4,,\n\n,,\n\n"), FILE)
    np.testing.assert_array_equal(columns[0], [1, np.nan, 3])
    assert not notes


def test_nothing() -> None:
    assert len(read_columns(body("\r\n"), FILE)[0][1]) == 0


def test_short_lines() -> None:
    (note,) = read_columns(body("1,2\n3\n4,5\n"), FILE)[1]
    assert (note.code, note.message) == (
        "lines_short",
        "1 lines have too few cells, first line 4: what they lack counts as blank",
    )
    assert codes("1 2\n3\n4 5\n", " ") == ["lines_short"]


def test_a_cut_last_line() -> None:
    columns, (note,) = read_columns(body("1,2.25\n2,3.25\n3,4.2"), FILE)
    assert (len(columns[0]), note.code) == (2, "truncated")


@pytest.mark.parametrize("cell", ["1e999", "-1e400"])
def test_a_number_too_large_is_not_missing(cell: str) -> None:
    expected = rf"line 4, column 'Load': expected a number below 1\.8e308, found '{cell}', which is"
    with pytest.raises(ReadError, match=expected):
        read_columns(body(f"1,2\n2,{cell}\n"), FILE)


@pytest.mark.parametrize("word", ["inf", "Infinity", "-INF"])
def test_a_word_for_infinity_is_no_number(word: str) -> None:
    expected = rf"line 4, column 'Load': expected a number with a decimal point, found '{word}'"
    with pytest.raises(ReadError, match=expected):
        read_columns(body(f"1,2\n2,{word}\n"), FILE)


def test_signs_lost_between_thousands() -> None:
    text = "0.1,999\n0.2,1063\n0.3,1110797\n0.4,1162\n"
    with pytest.raises(ReadError, match=r"line 5, column 'Load': .* found '1110797' after '1063'"):
        read_columns(body(text), FILE)
    columns, _ = read_columns(body(text, columns=(0,)), FILE)
    assert list(columns) == [0]
    assert len(read_columns(body(text.replace("\n", ".0\n")), FILE)[0][1]) == 4


def test_nan_is_no_number() -> None:
    with pytest.raises(ReadError, match=r"line 4, column 'Load': expected a number .* found 'nan'"):
        read_columns(body("1,2\n2,nan\n"), FILE)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1,2.5\nO.2,3\n", r"a\.csv, line 4, column 'Time': expected a number with a decimal poin"),
        ("1,2.5\n2,3.5,4\n", r"a\.csv, line 4: expected 2 cells as in the header, found 3"),
        ("1,2.5,7\n2,3.5,8\n", r"a\.csv, line 3: expected 2 cells as in the header, found 3"),
        ('1,2.5\n2,"3,5"\n', r"line 4, column 'Load': expected a number with a decimal point, fou"),
    ],
)  # fmt: skip
def test_faults(text: str, said: str) -> None:
    with pytest.raises(ReadError, match=said):
        read_columns(body(text), FILE)


def test_a_large_file_is_read_straight(tmp_path: Path) -> None:
    """A bad cell in a column that nobody asked for does no harm there either."""
    text = "".join(f"{i}.25,{i}.5\n" for i in range(300_000)) + "1,O\n"
    file = tmp_path / "a.csv"
    file.write_text("Time,Load\ns,N\n" + text, encoding="utf-8")
    data = file.read_bytes()
    large = Body(data, NAMES, (0,), 3, ",", start=14, as_in_file=True, some_only=True)
    columns, _ = read_columns(large, file)
    np.testing.assert_array_equal(columns[0], [*(np.arange(300_000) + 0.25), 1.0])
    with pytest.raises(ReadError, match=r"line 300003, column 'Load': .* found 'O'"):
        read_columns(Body(data, NAMES, (0, 1), 3, ",", start=14, as_in_file=True), file)
