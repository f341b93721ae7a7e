"""Rows of numbers in text: cells, words and cuts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.errors import ReadError
from labpipe.readers.number_table import (
    Body,
    build_cell_error,
    drop_incomplete_line,
    read_columns,
    split_name_and_unit,
)
from labpipe.readers.raw_files import add_file_name
from tests.approved import Approve

NAMES = ("Time", "Load")


FILE = Path("a.csv")


def body(
    text: str, separator: str = ",", decimal: str = "auto", columns: tuple[int, ...] = (0, 1)
) -> Body:
    return Body(text.encode(), NAMES, columns, 3, separator, decimal)


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
    columns, _ = read_columns(body(text, separator))
    np.testing.assert_allclose(np.transpose([columns[0], columns[1]]), rows, rtol=1e-14)


def test_blank_cells_and_short_lines() -> None:
    columns, notes = read_columns(body("1,\n,2\n3,4,,\n\n,,\n\n"))
    np.testing.assert_array_equal([columns[0], columns[1]], [[1, np.nan, 3], [np.nan, 2, 4]])
    assert not notes
    columns, notes = read_columns(replace(body("1,\n\n4,5\n3\n"), others_numeric=True))
    np.testing.assert_array_equal(columns[0], [1, np.nan, 4, 3])
    assert not notes
    for values in (
        "974\n999.5\n",
        "25\n24.985\n",
        "0\n0.999\n",
        "1.5\n",
        "1000\n1.011\n",
        "5\n1.0115\n",
    ):
        assert read_columns(body(values, columns=(0,)))[0][0][0] == float(values.split()[0])


@pytest.mark.parametrize(
    "cells",
    [
        ["nan", "2", "NaN"],
        ["1", "NA", " n/a "],
        ["1", "-", ""],
        ["#N/A", "--", "#DIV/0!"],
        ["-1.#IND", "null", "-5"],
    ],
)
@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_words_for_missing_values(cells: list[str], separator: str) -> None:
    text = "".join(f"{i}.5{separator}{cell}\n" for i, cell in enumerate(cells))
    columns, _ = read_columns(body(text, separator))
    missing = [not cell.strip("-").isdigit() for cell in cells]
    assert np.isnan(columns[1]).tolist() == missing[: len(columns[1])]
    assert columns[0].tolist() == [0.5, 1.5, 2.5]


@pytest.mark.parametrize(
    ("below", "rows", "line"),
    [
        ("Mean,1.5\nSD,0.5\n", 2, 6),
        ("\nMean:,1.5\n\n[Maximum],3\n\n", 2, 7),
        (",,\nEnd of test", 1, 7),
        ("Results\nFmax (N),1e3\n", 2, 6),
        (",Mean\n", 1, 6),
        ("-- end --", 1, 6),
        (",Max.,2\nÉcart type", 2, 6),
        ("*** end ***", 1, 6),
    ],
)
def test_rows_of_words_below_the_samples(below: str, rows: int, line: int) -> None:
    columns, notes = read_columns(body("1,2\n2,\n3,4\n" + below))
    np.testing.assert_array_equal(columns[1], [2, np.nan, 4])
    assert [note.code for note in notes] == ["summary_rows_left_out"]
    assert notes[0].message.startswith(f"{rows} rows from line {line} on")


REFUSED = [
    "1,2\n2,1e999\n",
    "1,2\n2,-1e400\n",
    "1,2\n2,inf\n",
    "1,2\n2,-INF\n",
    "1,nan\n2,OVERFLOW\n3,4\n",
    "1,2\nMean,3\n4,5\n",
    "1,2\n2,Mean\n",
    "1,2\n2,3\nx,4\n",
    "1,2\n2,3\nInf,4\n",
    "Mean,3\nSD,3\n",
    "1,2.5\nO.2,3\n",
    "1,2.5\n2,3.5,4\n",
    "1,2.5,7\n2,3.5,8\n",
    "1,2.5\n-inf,2\n",
    "0,5,2,25\n",
    "1,2\n2,\u0663\n",
    "1,2\n2,\xa03\n",
    "1,-937\n2,-974\n3,-1.011\n4,-1.048\n",
    '1,2.5\n2,"3,5"\n',
]
UNEVEN = ["1,2\n3\n\n4,5\n", '1,2\n"3"\n4,5\n6\n', "1,2\n3,4\n5,6,\n", "1,2\n3\n4,5"]


def refusal(rows: Body) -> ReadError:
    with pytest.raises(ReadError) as refused, add_file_name(FILE):
        read_columns(rows)
    return refused.value


def test_rows_that_are_refused(approved: Approve) -> None:
    uneven = [replace(body(text), others_numeric=True) for text in UNEVEN]
    bodies = [body("1 2\n3\n4 5\n", " "), *uneven, *map(body, REFUSED)]
    approved(map(refusal, bodies))
    columns, _ = read_columns(body(REFUSED[-1], columns=(0,)))
    assert list(columns) == [0]


def exported(text: str, *, stated: int | None = None) -> tuple[list[float], dict[str, str]]:
    """Read what a recorder's program wrote: the last of three columns."""
    names = ("Frame", "Time", "Force")
    rows = Body(text.encode(), names, (0, 2), 8, ",", ".", stated_rows=stated, as_exported=True)
    columns, notes = read_columns(rows)
    return columns[2].tolist(), {note.code: note.message for note in notes}


def test_what_a_recorder_exports() -> None:
    """Words are blank or infinite; padding is no datum; a number that lacks decimals was cut."""
    values, notes = exported("1,x,2\r\n3,,\r\n4,,NAN\r\n5,,-Infinity\r\n6,,1110797\r\n7,,1063\r\n")
    np.testing.assert_array_equal(values, [2, np.nan, np.nan, -np.inf, 1110797, 1063])
    assert notes == {}
    message = r"line 9, column 'Force': expected a number .* found 'x'"
    with pytest.raises(ReadError, match=message), add_file_name(FILE):
        exported("1,2,NaN\n4,5,x\n")
    assert exported("1,2,3,,\n4,5,6,,\n,,,,\n") == ([3, 6], {})
    assert exported("1,0,2.25\n2,0,3.5\n3,0,4.25\n4,0,5.5")[0] == [2.25, 3.5, 4.25]
    assert exported("1,0,2.25\n2,0,3.25\n3,0,14.5")[0] == [2.25, 3.25]


@given(cut=st.integers(0, 200))
def test_a_cut_anywhere_loses_only_the_last_line(cut: int) -> None:
    whole = "".join(f"{i},0,{i}.25\n" for i in range(20))
    values, _ = exported(whole[:cut], stated=20)
    lines = 20 if cut >= len(whole) - 1 else whole[:cut].count("\n")
    np.testing.assert_array_equal(values, np.arange(lines) + 0.25)


def is_whole(text: str) -> bool:
    rows, notes = drop_incomplete_line(body(text))
    assert rows.data.decode() in {text, text[: text.rfind("\n") + 1]}
    return not notes


CUT = [
    *(f"1,2.25\n2,3.25\n{last}" for last in ("3", "3,", "3,4.", "3,4.2", "3,4.25e", "3,x")),
    "1,2.25E-02\n2,3.25E-0",
    "1,2.25E-02\n2,3.25",
    "1,2.25\n2,3.5\n3,3.125\n4,5",
    "1,359.35\n2,0.0022123\n3,0.0022456\n4,0.00",
]
"""In the last one small numbers above do not vouch for one that was cut."""
WHOLE = [
    *(f"1,2.25\n2,3.25\n{last}" for last in ("3,4.25", "3,400", "3,4.25\n", "3,4.2,", "\r", "")),
    "1,2.25E-02\n2,3.25E-01",
    "1,2.25\n2,3.5\n3,3.125\n4,5.5",
    "1,2.25\n2,3\n3,3.125\n4,5",
]
"""Zeros at the end may not be written: a short number may be whole."""


@pytest.mark.parametrize("text", CUT + WHOLE)
def test_a_last_line_is_whole_or_cut(text: str) -> None:
    assert is_whole(text) == (text in WHOLE)


@given(seed=st.integers(0, 999), keep=st.integers(1, 300))
def test_a_resaved_file_loses_nothing(seed: int, keep: int) -> None:
    """Numbers written as short as they are, the last one no shorter than many others."""
    values = np.random.default_rng(seed).integers(0, 10_000, keep + 30) / 100.0
    shortest = values[np.argmin([len(f"{value:g}") for value in values[:-1]])]
    values[-1] = shortest
    values[-2] = shortest
    text = "\n".join(f"{i},{value:g}" for i, value in enumerate(values))
    assert is_whole(text)


@pytest.mark.parametrize(
    ("cell", "parted"),
    [
        ("Force (N)", ("Force", "N")),
        ("Force [ kN ]", ("Force", "kN")),
        ("Strain 1 (mm (rel))", ("Strain 1", "mm (rel)")),
        ("Force, N", ("Force", "N")),
        ("Kraft / kN", ("Kraft", "kN")),
        ("Load,lbf", ("Load", "lbf")),
        ("Strain, %", ("Strain", "%")),
        ("Load cell, left", None),
        ("Channel, 1", None),
        ("Force/Area", None),
        ("Force", None),
    ],
)
def test_a_unit_in_the_cell_of_the_name(cell: str, parted: tuple[str, str] | None) -> None:
    assert split_name_and_unit(cell) == parted


NO_NUMBERS = {
    ".": [
        *("1,020.5", "1'020", "-12,5", "1,020", "10:00:00.250", "00:01.5", "3/4/2026 1:05 PM"),
        *("04-Mar-2026 10:00:00", "2026-03-04T10:00:00Z", "2026-03-04", "OVERFLOW", "1e999"),
        *("O.2", "12.5 mm"),
    ],
    ",": ["1.020,5", "1 020,5", "1.020.500"],
}
"""Cells by the decimal sign of their file."""


def test_why_a_cell_is_no_number(approved: Approve) -> None:
    errors = (
        build_cell_error(cell, decimal, f"decimal {decimal}").args
        for decimal, cells in NO_NUMBERS.items()
        for cell in cells
    )
    approved(ReadError.about(name, FILE, place, **facts) for name, place, facts in errors)
