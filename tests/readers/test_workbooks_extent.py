"""Workbooks with a cell far from the others: refused, before a library asks for all memory."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from labpipe.errors import ReadError
from labpipe.readers import read_export, recognise_export
from labpipe.readers.curve_files import CurveColumn, read_curve
from labpipe.readers.sheet_cells import read_campaign_sheet
from labpipe.readers.workbooks import (
    check_extent,
    check_size,
    check_table,
    forget_sheets,
    open_sheets,
)
from labpipe.studies.wire_specs import read_wire_sheet
from tests.readers.load_frame.exports import (
    LAST,
    ROWS,
    Change,
    changed,
    specimen_sheet,
    stray,
    workbook,
)


@pytest.fixture
def book(tmp_path: Path) -> Path:
    sheets: dict[str, list[list[object]]] = {
        "Values 1": specimen_sheet("A", ROWS),
        "Notes": [["a note"]],
    }
    return workbook(tmp_path / "a.xlsx", sheets)


def test_cells_that_lie_together(book: Path) -> None:
    check_extent(book)


@pytest.mark.parametrize("place", [LAST, "A1048576000", "XFD2000", "XFE1048576"])
def test_a_stray_cell_is_named(book: Path, place: str) -> None:
    with pytest.raises(ReadError) as refused:
        check_extent(changed(book, stray(place)))
    assert re.fullmatch(
        rf"{re.escape(str(book))}, sheet 'Values 1', cell {place}: expected cells that lie"
        r" together, found a sheet of \d+ rows and \d+ columns with 22 filled cells\. Delete the"
        r" rows and columns behind the table, and save the workbook\.",
        str(refused.value),
    )


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
    check_extent(changed(book, change))
    assert len(open_sheets(book)["Values 1"]) < 30_000
    forget_sheets()


OTHERWISE: dict[str, Change] = {
    "single quotes": lambda text: stray()(text).replace(f'r="{LAST}"', f"r='{LAST}'"),
    "another order": lambda text: stray()(text).replace(f'r="{LAST}" s="0"', f's="0" r="{LAST}"'),
    "blanks": lambda text: stray()(text).replace(f'<c r="{LAST}"', f'<c  r="{LAST}"'),
    "prefix": lambda text: (
        stray()(text)
        .replace("<worksheet xmlns=", "<x:worksheet xmlns:x=")
        .replace("<", "<x:")
        .replace("<x:x:", "<x:")
        .replace("<x:/", "</x:")
        .replace("<x:?", "<?")
    ),
    "no places of cells": lambda text: re.sub(r'<c r="[A-Z]+\d+"', "<c", stray("A99999999")(text)),
    **{
        f"blank text in {cell}": lambda text, cell=cell: text.replace(  # type: ignore[misc]
            "</sheetData>", f'<row r="1048576"><c r="{LAST}"{cell}</c></row></sheetData>'
        )
        for cell in (
            ' t="inlineStr"><is><t> </t></is>',
            ' t="inlineStr"><is><t></t></is>',
            ' t="str"><v></v>',
            "><v> </v>",
        )
    },
    "one long line": lambda text: stray()(text.replace("<v>", "<v>" + " " * 3_000_000, 1)),
}


@pytest.mark.parametrize("change", OTHERWISE.values(), ids=OTHERWISE)
def test_a_stray_cell_written_otherwise(book: Path, change: Change) -> None:
    with pytest.raises(ReadError, match=r"sheet 'Values 1', cell \w+: expected cells that lie"):
        check_extent(changed(book, change))


def test_a_sheet_of_a_name_that_nobody_knows(book: Path) -> None:
    changed(book, stray())
    changed(book, lambda _: "<no", "xl/workbook.xml")
    with pytest.raises(ReadError, match=r"sheet 'xl/worksheets/sheet1\.xml', cell XFD1048576"):
        check_extent(book)


@pytest.mark.parametrize(
    ("part", "what"),
    [
        ("content.xml", "an OpenDocument spreadsheet (ods)"),
        ("xl/workbook.bin", "a binary workbook (xlsb)"),
    ],
)
def test_spreadsheets_of_other_formats(tmp_path: Path, part: str, what: str) -> None:
    path = tmp_path / "a.ods"
    with zipfile.ZipFile(path, "w") as parts:
        parts.writestr(part, "<synthetic/>")
    with pytest.raises(ReadError) as refused:
        check_extent(path)
    assert str(refused.value) == (
        f"{path}: expected an xlsx workbook, found {what}. Save it as xlsx in the spreadsheet"
        " program."
    )


MOTIVE: list[list[object]] = [["Format Version", "1.23"], ["", 1.0]]
PLAIN: list[list[object]] = [["deflection / mm", "force / N"], [1.0, 2.0]]


def test_other_archives(tmp_path: Path) -> None:
    path = tmp_path / "exports.zip"
    with zipfile.ZipFile(path, "w") as parts:
        parts.writestr("a.csv", "synthetic")
    with pytest.raises(ReadError) as refused:
        recognise_export(path)
    assert str(refused.value) == (
        f"{path}: expected an xlsx workbook, found a zip archive of something else. Unpack it, and"
        " name the export in it."
    )


def read_a_curve(path: Path) -> object:
    return read_curve(path, CurveColumn("deflection", "m"), CurveColumn("force", "N"))


WHO_OPENS: dict[str, Callable[[Path], object]] = {
    "load frame": lambda path: read_export(path, "load-frame"),
    "motive": lambda path: read_export(path, "motive-xlsx"),
    "wire sheet": read_wire_sheet,
    "campaign sheet": read_campaign_sheet,
    "curve": read_a_curve,
}


@pytest.mark.parametrize("opens", WHO_OPENS.values(), ids=WHO_OPENS)
def test_whoever_opens_a_workbook_is_safe(tmp_path: Path, opens: Callable[[Path], object]) -> None:
    table = MOTIVE if opens is WHO_OPENS["motive"] else PLAIN
    path = changed(workbook(tmp_path / "a.xlsx", {"Take": table}), stray())
    with pytest.raises(ReadError, match=r"sheet 'Take', cell XFD1048576: expected cells that lie"):
        opens(path)
    forget_sheets()


def test_a_table_that_is_all_but_empty(tmp_path: Path) -> None:
    blank: list[object] = [""] * 5000
    rows = [["a", *blank[1:]], *[blank] * 2500]
    with pytest.raises(ReadError, match=r"sheet 'v', cell GJH2501: expected cells that lie togeth"):
        check_table(tmp_path / "a.xls", "v", rows)
    check_table(tmp_path / "a.xls", "v", [[1.0] * 5000] * 2500)
    check_table(tmp_path / "a.xls", "v", rows[:1000])
    check_table(tmp_path / "a.xls", "v", [])


def test_a_table_that_is_too_large_to_be_laid_out(tmp_path: Path) -> None:
    with pytest.raises(
        ReadError, match=r"cell CGOH874: .* 874 rows and 57858 columns with few fil"
    ):
        check_size(tmp_path / "a.xls", "v", 874, 57858)
    check_size(tmp_path / "a.xls", "v", 1_048_576, 38)
