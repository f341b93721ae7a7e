from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from openpyxl import load_workbook

from labpipe.errors import StoreError
from labpipe.report.calibration_workbook import save_calibration_workbook
from tests.report.builders_calibrations import group, report


def test_sheets_with_headings_that_stay_in_view(tmp_path: Path) -> None:
    save_calibration_workbook(report(), tmp_path / "a.xlsx")
    book = load_workbook(tmp_path / "a.xlsx")
    assert book.sheetnames[:3] == ["read me", "summary", "solutions"]
    assert book.active is not None
    assert book.active.title == "summary"
    assert all(sheet.freeze_panes and sheet.tables for sheet in book.worksheets[1:])
    assert book["summary"]["A1"].font.bold
    assert book["agreement"]["B2"].value == pytest.approx(85.0)


def test_text_stays_text_and_what_is_not_finite_is_empty(tmp_path: Path) -> None:
    odd = replace(group("A3", 0.12, samples=1), wire="=1+1", is_calibrated=False)
    own = replace(report(), groups=(odd,))
    save_calibration_workbook(own, tmp_path / "a.xlsx")
    book = load_workbook(tmp_path / "a.xlsx")
    assert (book["agreement"]["A2"].value, book["agreement"]["A2"].data_type) == ("=1+1", "s")
    assert book["forces"]["F1"].value == "force, lower (N)"
    assert (book["forces"]["A2"].value, book["forces"]["F2"].value) == ("=1+1", None)


def test_file_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r": expected a workbook that can be written, found "):
        save_calibration_workbook(report(), tmp_path)
