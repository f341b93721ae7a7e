from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.errors import ReadError
from labpipe.readers.number_rows import read_columns
from labpipe.readers.table_body import Body

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


@pytest.mark.parametrize(
    ("cells", "said"),
    [
        (["nan", "2", "NaN"], "2 cells hold 'nan', 'NaN', the first in line 3"),
        (["1", "NA", " n/a "], "2 cells hold 'NA', 'n/a', the first in line 4"),
        (["1", "-", ""], "1 cells hold '-', the first in line 4"),
        (["#N/A", "--", "#DIV/0!"], "3 cells hold '#N/A', '--', '#DIV/0!', the first in line 3"),
        (["-1.#IND", "null", "-5"], "2 cells hold '-1.#IND', 'null', the first in line 3"),
    ],
)
@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_words_for_missing_values(cells: list[str], said: str, separator: str) -> None:
    text = "".join(f"{i}.5{separator}{cell}\n" for i, cell in enumerate(cells))
    columns, notes = read_columns(body(text, separator), FILE)
    assert np.isnan(columns[1]).tolist() == [not cell.strip("-").isdigit() for cell in cells]
    assert columns[0].tolist() == [0.5, 1.5, 2.5]
    assert [(note.code, note.where) for note in notes] == [("missing_words", "Load")]
    assert notes[0].message.startswith(said)


def test_a_word_for_missing_hides_no_bad_cell() -> None:
    with pytest.raises(ReadError, match=r"line 4, column 'Load': .* found 'OVERFLOW'"):
        read_columns(body("1,nan\n2,OVERFLOW\n3,4\n"), FILE)


def test_words_in_blank_separated_rows() -> None:
    columns, notes = read_columns(body("1 nan\n2 3\n", " "), FILE)
    np.testing.assert_array_equal(columns[1], [np.nan, 3.0])
    assert [note.code for note in notes] == ["missing_words"]


@pytest.mark.parametrize(
    ("below", "rows", "line"),
    [
        ("Mean,1.5\nSD,0.5\n", 2, 6),
        ("\nMean:,1.5\n\n[Maximum],3\n\n", 2, 7),
        (",,\nEnd of test", 1, 7),
        ("Results\nFmax (N),1e3\n", 2, 6),
        (",Mean\n", 1, 6),
        ("-- end --", 1, 6),
    ],
)
def test_rows_of_words_below_the_samples(below: str, rows: int, line: int) -> None:
    columns, notes = read_columns(body("1,2\n2,\n3,4\n" + below), FILE)
    np.testing.assert_array_equal(columns[1], [2, np.nan, 4])
    assert [note.code for note in notes] == ["summary_rows_left_out"]
    assert notes[0].message.startswith(f"{rows} rows from line {line} on")


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("1,2\nMean,3\n4,5\n", "line 4, column 'Time': .* found 'Mean'.* between the samples"),
        ("1,2\n2,Mean\n", "line 4, column 'Load': .* found 'Mean'"),
        ("1,2\n2,3\nx,4\n", "line 5, column 'Time': .* found 'x'"),
        ("1,2\n2,3\nInf,4\n", "line 5, column 'Time': .* found 'Inf'"),
        ("Mean,3\nSD,3\n", "line 3, column 'Time': .* found 'Mean'"),
    ],
)
def test_other_words_are_refused(text: str, found: str) -> None:
    with pytest.raises(ReadError, match=found):
        read_columns(body(text), FILE)


def test_a_word_below_a_column_that_nobody_asked_for() -> None:
    text = "1,2\n2,3\nMean,2.5\n"
    rows = Body(text.encode(), NAMES, (1,), 3, ",", some_only=True)
    assert read_columns(rows, FILE)[0][1].tolist() == [2.0, 3.0]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1,2.5\nO.2,3\n", r"a\.csv, line 4, column 'Time': expected a number with a decimal poin"),
        ("1,2.5\n2,3.5,4\n", r"a\.csv, line 4: expected 2 cells as in the header, found 3"),
        ("1,2.5,7\n2,3.5,8\n", r"a\.csv, line 3: expected 2 cells as in the header, found 3"),
        ("0,5,2,25\n", r"line 3: expected 2 cells .* found 4 in '0,5,2,25'\. .* semicolons"),
        ('1,2.5\n2,"3,5"\n', r"line 4, column 'Load': expected a number with a decimal point, fou"),
    ],
)  # fmt: skip
def test_faults(text: str, said: str) -> None:
    with pytest.raises(ReadError, match=said):
        read_columns(body(text), FILE)


def exported(text: str, *, stated: int | None = None) -> tuple[list[float], dict[str, str]]:
    """Read what a recorder's program wrote: the last of three columns."""
    names = ("Frame", "Time", "Force")
    rows = Body(text.encode(), names, (0, 2), 8, ",", ".", stated_rows=stated, as_exported=True)
    columns, notes = read_columns(rows, FILE)
    return columns[2].tolist(), {note.code: note.message for note in notes}


def test_words_for_numbers_in_exports_of_a_recorder() -> None:
    values, notes = exported("1,x,2\r\n3,,\r\n4,,NAN\r\n5,,-Infinity\r\n6,,1110797\r\n7,,1063\r\n")
    np.testing.assert_array_equal(values, [2, np.nan, np.nan, -np.inf, 1110797, 1063])
    assert notes == {}
    with pytest.raises(ReadError, match=r"line 9, column 'Force': expected a number .* found 'x'"):
        exported("1,2,NaN\n4,5,x\n")


@pytest.mark.parametrize("text", ["", "\r\n", "\n\n", ",,\n,,\n"])
def test_no_rows(text: str) -> None:
    assert exported(text)[0] == []


def test_padding_of_a_spreadsheet_is_no_datum() -> None:
    assert exported("1,2,3,,\n4,5,6,,\n,,,,\n") == ([3, 6], {})


def test_a_whole_looking_last_line_is_not_trusted_where_rows_are_missing() -> None:
    values, notes = exported("1,2,3\n4,5,6", stated=5)
    assert len(values) == 1
    assert notes["truncated"] == "the last line (9) is incomplete and was left out"
    assert notes["rows_differ"] == "the header states 5 rows, the file holds 1"


def test_a_number_that_lacks_decimals_was_cut() -> None:
    assert exported("1,0,2.25\n2,0,3.5\n3,0,4.25\n4,0,5.5")[0] == [2.25, 3.5, 4.25]
    assert exported("1,0,2.25\n2,0,3.25\n3,0,14.5")[0] == [2.25, 3.25]


@given(cut=st.integers(0, 200))
def test_a_cut_anywhere_loses_only_the_last_line(cut: int) -> None:
    whole = "".join(f"{i},0,{i}.25\n" for i in range(20))
    values, _ = exported(whole[:cut], stated=20)
    lines = 20 if cut >= len(whole) - 1 else whole[:cut].count("\n")
    np.testing.assert_array_equal(values, np.arange(lines) + 0.25)


@pytest.mark.slow
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
