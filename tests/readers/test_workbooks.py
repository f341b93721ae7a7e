"""Cells of whole workbooks: once, in a thread, by the library that can."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from pathlib import Path

import pytest

from labpipe.errors import ReadError
from labpipe.readers import read_export
from labpipe.readers.sheet_cells import read_campaign_sheet
from labpipe.readers.unknown_files import describe_unknown
from labpipe.readers.workbooks import (
    begin_sheets,
    cells_of,
    forget_sheets,
    is_workbook,
    open_sheets,
)
from tests.readers.load_frame.exports import (
    ROWS,
    changed,
    locked_workbook,
    specimen_sheet,
    stray,
    workbook,
)


@pytest.fixture(autouse=True)
def forgotten() -> Iterator[None]:
    yield
    forget_sheets()


def test_a_workbook_is_parsed_once(tmp_path: Path) -> None:
    file = workbook(tmp_path / "a.xlsx", {"v": specimen_sheet("A", ROWS)})
    assert is_workbook(file)
    begin_sheets(file)
    assert open_sheets(file) is open_sheets(file)
    assert gc.isenabled()
    first = open_sheets(file)
    workbook(file, {"v": specimen_sheet("B", [*ROWS, ROWS[0]])})
    assert len(open_sheets(file)["v"]) == len(first["v"]) + 1


def test_what_is_no_workbook_is_left_alone(tmp_path: Path) -> None:
    begin_sheets(tmp_path)
    begin_sheets(tmp_path / "none.xlsx")
    (tmp_path / "a.csv").write_text("a,b", encoding="utf-8")
    begin_sheets(tmp_path / "a.csv")
    (tmp_path / "empty.xlsx").touch()
    with pytest.raises(ReadError, match="expected a file with content, found an empty file"):
        begin_sheets(tmp_path / "empty.xlsx")


def test_a_damaged_one_is_told_when_it_is_opened(tmp_path: Path) -> None:
    file = workbook(tmp_path / "a.xlsx", {"v": specimen_sheet("A")})
    file.write_bytes(file.read_bytes()[:-300])
    begin_sheets(file)
    for _ in range(2):
        with pytest.raises(ReadError, match=r"a\.xlsx: expected a whole workbook, found a damaged"):
            open_sheets(file)


def test_a_workbook_with_a_password(tmp_path: Path) -> None:
    file = locked_workbook(tmp_path / "a.xlsx")
    for read in (open_sheets, read_campaign_sheet, read_export):
        with pytest.raises(ReadError, match=r"a\.xlsx: .* one with a password\. .* a copy without"):
            read(file)
    assert describe_unknown(file).what == "a workbook with a password"


def test_openpyxl_steps_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A workbook that calamine refuses is read by openpyxl, to the same cells."""
    import python_calamine

    file = workbook(tmp_path / "a.xlsx", {"v": specimen_sheet("A", [*ROWS, (1, 2, "")])})
    whole = open_sheets(file)
    forget_sheets()

    def refuse(path: object) -> None:
        raise python_calamine.CalamineError

    monkeypatch.setattr(python_calamine.CalamineWorkbook, "from_path", refuse)
    assert open_sheets(file) == whole
    forget_sheets()


@pytest.fixture
def large(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A workbook that counts as large."""
    monkeypatch.setattr("labpipe.readers.workbooks._LARGE", 0)
    return workbook(tmp_path / "a.xlsx", {"v": specimen_sheet("A", [*ROWS, (1, 2, "")])})


def test_a_large_workbook_is_read_in_a_process_of_its_own(
    large: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as here:
        here.setattr("labpipe.readers.workbooks.cells_of", None)
        sheets = open_sheets(large)
    assert sheets == cells_of(large)


def test_a_stray_cell_in_a_large_workbook_ends_that_process_alone(large: Path) -> None:
    changed(large, stray())
    with pytest.raises(ReadError, match=r"sheet 'v', cell XFD1048576: expected cells that lie"):
        open_sheets(large)


def test_a_large_workbook_that_calamine_refuses(
    large: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    refuse = "raise python_calamine.CalamineError('synthetic')"
    monkeypatch.setattr("labpipe.readers.workbooks._CHILD", f"import python_calamine\n{refuse}")
    assert open_sheets(large) == cells_of(large)


OLD = b"\xd0\xcf\x11\xe0synthetic"
ENDS = {
    "import os; os.abort()": "no reason",
    "import os, sys; print('out of memory\\nat', file=sys.stderr); os.abort()": "out of memory",
    "raise MemoryError": "MemoryError",
    "import time; time.sleep(60)": "not read within 0 s",
    "print('no pickle')": "its cells could not be passed on",
}


@pytest.mark.parametrize("script", ENDS)
def test_an_old_workbook_that_ends_the_process_that_reads_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str
) -> None:
    path = tmp_path / "a.xls"
    path.write_bytes(OLD)
    monkeypatch.setattr("labpipe.readers.workbooks._CHILD", script)
    if "sleep" in script:
        monkeypatch.setattr("labpipe.readers.workbooks._PATIENCE", 0.3)
    with pytest.raises(ReadError, match=rf"a whole workbook, found a damaged one \({ENDS[script]}"):
        open_sheets(path)


@pytest.mark.slow
@pytest.mark.realdata
@pytest.mark.parametrize(
    ("place", "said"),
    [
        (b"\xff\xff\xff\xff", r"a\.xls: expected a whole workbook, found a damaged one"),
        (
            b"\xff\xff\xff\x00",
            r"a\.xls, sheet 'cotton-4', cell IV65536: expected cells that lie to",
        ),
    ],
    ids=["137 GB of cells", "the last cell that there is"],
)
def test_a_wrong_place_in_an_old_workbook(
    realdata: Path, tmp_path: Path, place: bytes, said: str
) -> None:
    """A number of the yarn tests, said to stand in another row and column."""
    content = bytearray((realdata / "zwick" / "yarn_compressionTests.xls").read_bytes())
    number = b"\x03\x02\x0e\x00"
    at = content.index(number, len(content) // 2) + len(number)
    content[at : at + 4] = place
    (tmp_path / "a.xls").write_bytes(content)
    with pytest.raises(ReadError, match=said):
        open_sheets(tmp_path / "a.xls")
