from __future__ import annotations

from pathlib import Path

import pytest

from labpipe.errors import ReadError
from labpipe.readers.motive_table import Header, parse_header

FILE = Path("take.csv")
LINE_1 = "Format Version,1.23,Export Frame Rate,120.000000,Length Units,Meters"
LABELS = [",Type,Marker,Marker,Marker", ",Name,A,A,A", ",ID,1,1,1"]
QUANTITY, AXES = ",,Position,Position,Position", "Frame,Time (Seconds),X,Y,Z"
WHOLE = [LINE_1, "", *LABELS, QUANTITY, AXES]


def parse(*lines: str) -> Header:
    return parse_header([line.split(",") if line else [] for line in lines], FILE)


def test_columns_are_found_by_words() -> None:
    header = parse(*WHOLE)
    (group,) = header.groups
    assert (group.type, group.name, group.id) == ("Marker", "A", "1")
    assert group.axes("Position", "XYZ") == [2, 3, 4]
    assert group.axes("Rotation", "XYZW") is None
    assert (header.time_column, header.width, header.rows) == (1, 5, 7)


def test_a_parent_row_and_more_blank_lines_do_not_matter() -> None:
    lines = [LINE_1, "", ",,,,", *LABELS, ",Parent,,,", QUANTITY, AXES]
    assert parse(*lines).groups == parse(*WHOLE).groups


def test_rows_without_words_are_taken_in_order() -> None:
    wordless = [line.replace("Type", "").replace("Name", "").replace("ID", "") for line in LABELS]
    header = parse(LINE_1, "", *wordless, QUANTITY, "Frame,Time,X,Y,Z")
    assert header.groups == parse(*WHOLE).groups


def test_a_column_of_time_codes_is_stepped_over() -> None:
    labels = ["," + line for line in [*LABELS, QUANTITY]]
    header = parse(LINE_1, "", *labels, "Frame,Time (Seconds),TimeCode,X,Y,Z")
    assert header.groups[0].axes("Position", "XYZ") == [3, 4, 5]
    assert header.time_column == 1


def test_the_same_name_and_id_twice_are_two_objects() -> None:
    rows = [
        line + line.replace(",Type", "").replace(",Name", "").replace(",ID", "") for line in LABELS
    ]
    header = parse(LINE_1, "", *rows, QUANTITY + ",Position" * 3, AXES + ",X,Y,Z")
    assert [group.axes("Position", "XYZ") for group in header.groups] == [[2, 3, 4], [5, 6, 7]]


def test_a_comma_inside_a_value_of_line_1() -> None:
    line = LINE_1.replace("Export", "Take Notes,wet, cold,Export")
    header = parse(line, *WHOLE[1:])
    assert header.about["Take Notes"] == "wet, cold"
    assert header.rate == 120.0


@pytest.mark.parametrize(
    ("text", "rate"), [("120.000000", 120.0), ("120", 120.0), ("", None), ("0", None), ("x", None)]
)
def test_the_rate(text: str, rate: float | None) -> None:
    assert parse(LINE_1.replace("120.000000", text), *WHOLE[1:]).rate == rate


def test_the_capture_rate_stands_in() -> None:
    assert parse(LINE_1.replace("Export", "Capture"), *WHOLE[1:]).rate == 120.0


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "1.23",
            "3.00",
            r"line 1: expected Format Version 1\.x after the first comma, found '3",
        ),
        ("1.23", "", r"found no version\. Export the take with Format Version 1\.2x"),
        (
            "Meters",
            "Furlongs",
            r"line 1: expected Length Units, one of Meters, .*found 'Fur",
        ),
        ("Frame,Time", "Image,Time", r"lines 1 to 7: expected a header row that begins with Frame"),
        (
            ",ID,1,1,1",
            ",Mass,1,1,1",
            r"lines 2 to 6: expected header rows Type, Name, ID, fo",
        ),
        ("Type,Marker", "Type,", r"line 7, cell 3: expected a column with a type, found none"),
    ],
)
def test_headers_that_are_refused(old: str, new: str, expected: str) -> None:
    lines = [line.replace(old, new) for line in WHOLE]
    with pytest.raises(
        ReadError, match=r"^take\.csv, " if "no version" not in expected else "^take"
    ):
        parse(*lines)
    with pytest.raises(ReadError, match=expected):
        parse(*lines)
