"""Bad load-frame exports, each in a small synthetic file: refused in words, or told."""

from __future__ import annotations

import re

import numpy as np
import pytest

from labpipe.errors import ReadError
from labpipe.readers import READERS, read_export, recognise_export
from tests.builders import load_frames as frames
from tests.builders.load_frames import EXAMPLES, FORCE, TIME, TRAVEL, N
from tests.builders.readings import Written, channel, codes, refused, time
from tests.builders.small_tests import Run

WORKBOOKS = {"testxpert-xlsx", "testresources", "table-workbook"}
TEXTS = sorted(set(EXAMPLES) - WORKBOOKS)


REGROUPED = [
    *([0.0, "0.5", 1.0], [0.1, "801", 2.0], [0.2, "1,063", 3.0]),
    *([0.3, "1,110,797", 4.0], [0.4, "1,162", 5.0]),
]


def test_regrouped_thousands_are_refused(write: Written) -> None:
    """Digits are lost: 1,063 was 1.063 or 1063, and 1,110,797 was neither."""
    content = frames.bluehill(preamble=2, rows=REGROUPED)
    text = refused(write(content), "Extension")
    # Names in line 4, units in line 5: the first number with a group is in line 8.
    assert re.search(r"line [89]\b", text)
    assert re.search(r"1,063|1,110,797", text)


def test_regrouped_thousands_far_down_are_refused(write: Written) -> None:
    rows: list[list[object]] = [[0.1 * i, f"{0.001 * i:.3f}", 1.0] for i in range(3000)]
    rows += [[300.0, "1,110,797", 1.0]]
    refused(write(frames.bluehill(preamble=0, rows=rows)), "line 3003", "Extension", "1,110,797")


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("sign", [",", "."])
def test_regrouped_thousands_of_any_locale_are_refused(
    write: Written, separator: str, sign: str
) -> None:
    decimal = "," if sign == "." and separator != "," else "."
    grouped = [0.5, f"1{sign}063", f"1{sign}110{sign}797", f"1{sign}162"]
    rows = [[0.1 * i, cell, 1.0 + i] for i, cell in enumerate(grouped)]
    head = frames.lines([["Time", "Extension", "Load"], ["(s)", "(mm)", "(N)"]], separator)
    content = head + frames.lines(rows, separator, decimal=decimal)
    text = refused(write(content.encode()), "Extension")
    assert re.search(r"line [45]\b", text)


@pytest.mark.parametrize("kind", ["text", "workbook"])
def test_regrouped_thousands_whose_signs_are_gone_are_refused(write: Written, kind: str) -> None:
    """Whole numbers that jump a thousandfold and back, as zeros at their ends are not written."""
    whole = [935, 999, 1063, 1110797, 1162]
    rows: list[list[object]] = [[0.1 * i, cell, 1.5] for i, cell in enumerate(whole)]
    if kind == "text":
        file = write(frames.bluehill(preamble=0, rows=rows))
        refused(file, "line 6", "Extension", "'1110797' after '1063'", "digits are lost")
        return
    names: frames.Row = ["Time (s)", "Extension (mm)", "Load (N)"]
    file = write(frames.workbook({"Sheet1": [names, *rows]}), "synthetic.xlsx")
    refused(file, "row 5", "Extension", "'1110797' after '1063'", "digits are lost")


def test_a_spike_is_no_regrouped_number(write: Written) -> None:
    rows = frames.pull(TIME, TRAVEL, FORCE)
    rows[20][2] = 1000 * FORCE[20]
    recording = read_export(write(frames.bluehill(preamble=0, rows=rows)))
    assert channel(recording, "Load").values[20] == pytest.approx(1000 * FORCE[20])


def test_a_number_too_large_is_not_counted_as_missing(write: Written) -> None:
    rows = frames.pull(TIME, TRAVEL, FORCE)
    rows[20][2] = "1e999"
    refused(write(frames.bluehill(preamble=0, rows=rows)), "line 23", "Load", "1e999", "too large")


def test_regrouped_thousands_in_a_workbook_are_refused(write: Written) -> None:
    sheet: list[frames.Row] = [
        ["Time (s)", "Load (lbf)", "Position (in)"],
        *([0.1, 1.0, "1,063"], [0.2, 2.0, "1,110,797"]),
    ]
    file = write(frames.workbook({"Sheet1": sheet}), "synthetic.xlsx")
    refused(file, "row 2", "Position", "1,063")


@pytest.mark.parametrize("row", [2, 30])
def test_mixed_decimal_signs_in_a_column(write: Written, row: int) -> None:
    rows = [[frames.number(cell, ",") for cell in cells] for cells in frames.pull(FORCE, TIME)]
    mixed: list[list[object]] = [[*cells] for cells in rows]
    mixed[row][0] = "12.5"
    content = (
        frames.italian_suite().decode("utf-8-sig").split("Traversa")[0]
        + "Carico ;Tempo \r\nN;sec\r\n"
        + frames.lines(mixed, ";")
    )
    refused(write(content.encode("utf-8-sig")), f"line {row + 9}", "Carico", "12.5")


@pytest.mark.parametrize("kind", ["tabs", "semicolons"])
def test_a_decimal_comma_among_points(write: Written, kind: str) -> None:
    separator = "\t" if kind == "tabs" else ";"
    rows = frames.pull(TRAVEL, FORCE, TIME)
    rows[20][1] = "12,5"
    refused(write(frames.mts_suite(separator, rows=rows)), "line 29", "Load", "12,5")


def test_a_word_among_numbers(write: Written) -> None:
    rows = frames.pull(TIME, TRAVEL, FORCE)
    rows[9][2] = "overload"
    refused(write(frames.bluehill(preamble=0, rows=rows)), "line 12", "Load", "overload")


def test_bluehill_without_its_row_of_units(write: Written) -> None:
    content = frames.bluehill(preamble=0).replace(b"(s),(mm),(N)\r\n", b"")
    refused(write(content), "unit", dialect=["bluehill"])


def test_test_suite_without_its_row_of_units(write: Written) -> None:
    content = frames.mts_suite().replace(b"mm\tN\tsec\r\n", b"")
    refused(write(content), "unit")


@pytest.mark.parametrize("dialect", sorted(EXAMPLES))
def test_the_wrong_dialect_is_named(write: Written, dialect: str) -> None:
    other = "catman" if dialect != "catman" else "bluehill"
    name, content = EXAMPLES[other]
    text = refused(write(content(), name), dialect=[dialect])
    assert dialect in text
    assert other in text


def test_an_unknown_dialect_lists_the_nearest(write: Written) -> None:
    refused(write(frames.catman()), "'catmann'", "catman", dialect=["catmann"])


@pytest.mark.parametrize("dialect", TEXTS)
def test_cut_off_in_a_number(write: Written, dialect: str) -> None:
    """A last line that is cut is told or refused, never read as a sample of its own."""
    name, content = EXAMPLES[dialect]
    whole = content()
    wide = 2 if whole[1:2] == b"\0" or whole.startswith(b"\xff\xfe") else 1
    body = whole.rstrip(b"\r\n\0") if wide == 1 else whole[: -2 * (not whole.endswith(b"\n\0"))]
    ends = "\n".encode("utf-16-le") if wide == 2 else b"\n"
    last = body.rstrip(b"\r\n\0").rfind(ends) + len(ends)
    cut = whole[: last + 3 * wide]
    rows = max(len(clock.time) for clock in read_export(write(whole, name)).clocks)
    try:
        recording = read_export(write(cut, name), "load-frame")
    except ReadError:
        refused(write(cut, name))
        return
    assert max(len(clock.time) for clock in recording.clocks) <= rows
    warned = [note for note in recording.notes if note.severity.value != "info"]
    assert warned, "a row with fewer cells than names is worth a warning"


def test_resaved_without_a_line_end_and_without_zeros_loses_no_sample(write: Written) -> None:
    """Numbers as short as they can be written: the last one may have fewer digits than others."""
    rows = frames.pull(TIME, TRAVEL, np.round(FORCE, 2))
    rows[10][2] = rows[-1][2] = 40.5
    whole = frames.bluehill(preamble=0, rows=rows).replace(b'"', b"").rstrip(b"\r\n")
    recording = read_export(write(whole))
    assert len(time(recording)) == N
    assert "truncated" not in codes(recording)
    cut = read_export(write(whole.removesuffix(b"0.5")))
    assert len(time(cut)) == N - 1
    assert "truncated" in codes(cut)


@pytest.mark.parametrize("dialect", sorted(WORKBOOKS))
def test_half_a_workbook(write: Written, dialect: str) -> None:
    name, content = EXAMPLES[dialect]
    whole = content()
    refused(write(whole[: len(whole) // 2], name))


@pytest.mark.parametrize("dialect", sorted(EXAMPLES))
def test_nul_bytes_in_the_middle(write: Written, dialect: str) -> None:
    """A block of zeros, as a full disk or a pulled stick leaves."""
    name, content = EXAMPLES[dialect]
    whole = content()
    half = len(whole) // 2 // 2 * 2
    refused(write(whole[:half] + bytes(200) + whole[half + 200 :], name))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"Dear Sir,\r\nthe force was 12 N at the time, see page 3.\r\n", "Dear Sir,"),
        (b"name,street,town\r\nsynthetic,1,nowhere\r\n", "name,street,town"),
        (b"1,2,3\r\n4,5,6\r\n", "a table of 3 columns separated by commas, without names"),
        (b"\r\n \r\n\r\n", "nothing but blanks"),
        ("time,force\r\nnever,none\r\n".encode("utf-16"), "text that begins with 'time,force'"),
        (bytes(range(256)) * 4, "binary"),
    ],
)
def test_a_csv_that_is_no_export(write: Written, run: Run, content: bytes, said: str) -> None:
    file = write(content, "letter.csv")
    with pytest.raises(ReadError, match=r"letter\.csv: expected an export of a known format") as e:
        recognise_export(file)
    assert said in str(e.value)
    ran = run("inspect", file)
    assert ran.status == 2
    assert "Traceback" not in ran.err
    assert ": expected " in ran.err


def test_an_empty_file(write: Written) -> None:
    refused(write(b""), "an empty file (0 bytes)")


def test_a_workbook_without_a_test(write: Written) -> None:
    content = frames.workbook({"Addresses": [["name", "town"], ["synthetic", "nowhere"]]})
    file = write(content, "addresses.xlsx")
    assert not any(reader.recognise(file) for reader in READERS.values())
    with pytest.raises(ReadError, match=r"addresses\.xlsx: expected an export of a known format"):
        recognise_export(file)


@pytest.mark.parametrize("dialect", TEXTS)
def test_time_that_runs_backwards_is_refused(write: Written, dialect: str) -> None:
    """Not read as another clock, nor sorted: two rows changed places."""
    name, content = EXAMPLES[dialect]
    whole = content()
    wide = whole[1:2] == b"\0" or whole.startswith(b"\xff\xfe")
    text = whole.decode("utf-16-le" if wide else "latin-1")
    rows = text.split("\n")
    at = len(rows) - 20
    rows[at], rows[at + 4] = rows[at + 4], rows[at]
    swapped = "\n".join(rows).encode("utf-16-le" if wide else "latin-1")
    refused(write(swapped, name), "expected time that increases")


def test_two_columns_of_one_name(write: Written) -> None:
    """Told apart by their paths, or refused; never one in the place of the other."""
    rows = frames.pull(TIME, TRAVEL, 2 * TRAVEL, FORCE)
    names = ("Time", "Extension", "Extension", "Load")
    content = frames.bluehill(names=names, units=("(s)", "(mm)", "(mm)", "(N)"), rows=rows)
    recording = read_export(write(content))
    paths = [each.path for each in recording.channels]
    assert len(set(paths)) == 3
    with pytest.raises(ReadError, match="only one channel"):
        read_export(write(content), "load-frame", channels=["Extension"])
