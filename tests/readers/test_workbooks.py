"""Cells of whole workbooks: once, in a thread, by the library that can."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from pathlib import Path

import pytest

from labpipe.errors import ReadError
from labpipe.readers.workbooks import begin_sheets, forget_sheets, is_workbook, open_sheets
from tests.readers.load_frame.exports import ROWS, specimen_sheet, workbook


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
    with pytest.raises(ReadError, match="expected an export, found an empty file"):
        begin_sheets(tmp_path / "empty.xlsx")


def test_a_damaged_one_is_told_when_it_is_opened(tmp_path: Path) -> None:
    file = workbook(tmp_path / "a.xlsx", {"v": specimen_sheet("A")})
    file.write_bytes(file.read_bytes()[:-300])
    begin_sheets(file)
    for _ in range(2):
        with pytest.raises(ReadError, match=r"a\.xlsx: expected a whole workbook, found a damaged"):
            open_sheets(file)


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
