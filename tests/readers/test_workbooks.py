"""Workbooks: read once, refused where a cell lies far away, and as tables of a person."""

from __future__ import annotations

import datetime
import re
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from labpipe.errors import ReadError
from labpipe.mechanics.studies.wire_sheets import read_wire_sheet
from labpipe.readers import describe_unknown, read_export, recognise_export
from labpipe.readers.curve_files import CurveColumn, read_curve
from labpipe.readers.workbooks import (
    Cell,
    Table,
    clear_sheet_cache,
    is_workbook,
    list_sheets,
    open_sheets,
    read_campaign_sheet,
    read_csv_cells,
    read_workbook_cells,
    split_table,
)
from tests.approved import Approve
from tests.readers.load_frame.exports import (
    LAST,
    ROWS,
    Change,
    changed,
    locked_workbook,
    specimen_sheet,
    stray,
    workbook,
)


@pytest.fixture(autouse=True)
def forgotten() -> Iterator[None]:
    yield
    clear_sheet_cache()


def test_a_workbook_is_parsed_once(tmp_path: Path) -> None:
    file = workbook(tmp_path / "a.xlsx", {"v": specimen_sheet("A", ROWS)})
    assert is_workbook(file)
    assert open_sheets(file) is open_sheets(file)
    first = open_sheets(file)
    workbook(file, {"v": specimen_sheet("B", [*ROWS, ROWS[0]])})
    assert len(open_sheets(file)["v"]) == len(first["v"]) + 1
    file.write_bytes(file.read_bytes()[:-300])
    for _ in range(2):
        with pytest.raises(ReadError, match=r"a\.xlsx: expected a whole workbook, found a damaged"):
            open_sheets(file)


@pytest.fixture
def book(tmp_path: Path) -> Path:
    sheets: dict[str, list[list[object]]] = {
        "Values 1": specimen_sheet("A", ROWS),
        "Notes": [["a note"]],
    }
    return workbook(tmp_path / "a.xlsx", sheets)


WHO_OPENS: dict[str, Callable[[Path], object]] = {
    "load frame": lambda path: read_export(path, "load-frame"),
    "motive": lambda path: read_export(path, "motive-xlsx"),
    "wire sheet": read_wire_sheet,
    "campaign sheet": read_campaign_sheet,
    "curve": lambda path: read_curve(
        path, CurveColumn("deflection", "m"), CurveColumn("force", "N")
    ),
}


@pytest.mark.parametrize("opens", WHO_OPENS)
def test_whoever_opens_a_workbook_is_safe(tmp_path: Path, opens: str) -> None:
    table: list[list[object]] = [["deflection / mm", "force / N"], [1.0, 2.0]]
    if opens == "motive":
        table = [["Format Version", "1.23"], ["", 1.0]]
    path = changed(workbook(tmp_path / "a.xlsx", {"Take": table}), stray())
    with pytest.raises(ReadError, match=r"sheet1, cell XFD1048576: expected cells close"):
        WHO_OPENS[opens](path)


@pytest.mark.parametrize(
    "change",
    [
        stray("Z20000"),
        stray(LAST, ""),
        lambda text: text.replace(
            "</sheetData>", f'<row r="9999999"><c r="{LAST}"/></row></sheetData>'
        ),
    ],
    ids=["not far", "a style alone", "an empty cell"],
)
def test_what_does_no_harm(book: Path, change: Change) -> None:
    changed(book, change)
    assert len(open_sheets(book)["Values 1"]) < 30_000


def archive(path: Path, part: str) -> Path:
    with zipfile.ZipFile(path, "w") as parts:
        parts.writestr(part, "<synthetic/>")
    return path


def refusal(read: Callable[[Path], object], path: Path) -> str:
    with pytest.raises(ReadError) as refused:
        read(path)
    return str(refused.value)


def wires(path: Path) -> Table:
    rows = read_workbook_cells(path) if path.suffix == ".xlsx" else read_csv_cells(path)
    return split_table(rows, path, rows_of="one row per wire")


def test_workbooks_that_are_refused(tmp_path: Path, book: Path, approved: Approve) -> None:
    """With a stray cell, locked, other archives.

    Then tables without rows, bytes of another encoding, cells without a value.
    """
    whole, messages = book.read_bytes(), []
    for place in (LAST, "A1048576000", "XFD2000", "XFE1048576"):
        book.write_bytes(whole)
        messages.append(refusal(open_sheets, changed(book, stray(place))))
    locked = locked_workbook(tmp_path / "locked.xlsx")
    assert describe_unknown(locked).kind == "a workbook with a password"
    messages += [refusal(read, locked) for read in (open_sheets, read_campaign_sheet, read_export)]
    messages += [
        refusal(open_sheets, archive(tmp_path / "a.ods", "content.xml")),
        refusal(open_sheets, archive(tmp_path / "a.xlsb", "xl/workbook.bin")),
        refusal(recognise_export, archive(tmp_path / "exports.zip", "a.csv")),
    ]
    path = tmp_path / "a.csv"
    for text in (b"test,sample\n", b",\n\n", "test;type\nÄ;A\n".encode("cp1252")):
        path.write_bytes(text)
        messages.append(refusal(read_campaign_sheet, path))
    path.write_bytes(b"a,b\n1,2,3\n")
    messages.append(refusal(wires, path))
    rows = [["wire", "length_mm"], ["A1", "=80+5"], ["A2", "#DIV/0!"]]
    path = workbook(tmp_path / "errors.xlsx", {"Sheet": rows})
    approved([*messages, refusal(wires, path)])


def test_sheets_by_number_and_by_name(tmp_path: Path) -> None:
    path = workbook(
        tmp_path / "a.xlsx", {"notes": [["a note"]], "wires": [["wire", "strands"], ["A1", 7]]}
    )
    assert list_sheets(path) == {"notes": True, "wires": True}
    assert read_workbook_cells(path) == [[Cell("a note", "cell A1")]]
    first, second = read_workbook_cells(path, "wires", "sheet 'wires'")[1]
    assert (first, second.text) == (Cell("A1", "sheet 'wires', cell A2"), "7")


@pytest.mark.parametrize(
    ("stored", "unread"),
    [
        ('t="str"><f>80+5</f><v></v>', ""),  # an empty text on purpose
        ("><f>80+5</f><v>85</v>", ""),
        ('t="e"><f>80+5</f><v>#N/A</v>', "the error #N/A"),
    ],
)
def test_formulas_with_a_stored_value(tmp_path: Path, stored: str, unread: str) -> None:
    path = workbook(tmp_path / "a.xlsx", {"Sheet": [["wire", "=80+5"]]})
    pattern = r'(<c r="B1")[^>]*><f>80\+5</f><v\s*(?:/>|></v>)'
    changed(path, lambda text: re.sub(pattern, r"\1 " + stored, text))
    cells = [cell.fault for row in read_workbook_cells(path) for cell in row]
    assert [text for text in cells if text] == ([unread] if unread else [])


def texts(sheet: Table) -> list[list[str]]:
    return [[cell.text for cell in row] for row in (sheet.heading, *sheet.rows)]


def test_a_workbook_as_a_person_sees_it(tmp_path: Path) -> None:
    rows: list[list[object]] = [
        [],
        ["test", "sample", "date", "length (mm)", None],
        ["A 1 ", 1, datetime.datetime(2026, 3, 4), 85.5, None],
        [],
        ["A2", "01", datetime.datetime(2026, 3, 4, 9, 58), None, None],
    ]
    sheet = read_campaign_sheet(workbook(tmp_path / "a.xlsx", {"Sheet": rows}))
    assert texts(sheet) == [
        ["test", "sample", "date", "length (mm)"],
        ["A 1", "1", "2026-03-04", "85.5"],
        ["A2", "01", "2026-03-04 09:58:00", ""],
    ]
    assert sheet.heading[1] == Cell("sample", "cell B2")
    assert sheet.rows[1][1].place == "cell B5"


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
@pytest.mark.parametrize("hint", [False, True])
def test_a_csv_however_it_is_parted(
    tmp_path: Path, separator: str, encoding: str, hint: bool
) -> None:
    path = tmp_path / "a.csv"
    text = '\ntest|sample|because\nÄ1|01|"two\nlines"\n||\nA2|1\n'.replace("|", separator)
    path.write_text(f"sep={separator}{text}" if hint else text, encoding=encoding)
    sheet = read_campaign_sheet(path)
    assert texts(sheet) == [
        ["test", "sample", "because"],
        ["Ä1", "01", "two\nlines"],
        ["A2", "1", ""],
    ]
    assert sheet.rows[1][0] == Cell("A2", "line 6, column 1")
