"""The workbook has a row of names with units, says that it is synthetic, and repeats exactly."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import numpy as np
import openpyxl
import pytest

from labpipe.records.arrays import Floats
from labpipe.virtual_lab.recorders import FrameRecord
from labpipe.virtual_lab.vendor_exports import Run, write_r_controller

STARTED = datetime(2026, 3, 9, 10, 5)
RUN = Run("CT-10-1", STARTED, seed=9)
TIME: Floats = 0.087 + 0.05 * np.arange(30, dtype=np.float64)
RECORD = FrameRecord(time=TIME, displacement=25.4e-3 * TIME, force=4.4482216152605 * (TIME - 0.2))


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("book") / "CT-10-1.xlsx"
    write_r_controller(path, RECORD, RUN)
    return path


def test_rows(file: Path) -> None:
    book = openpyxl.load_workbook(file)
    assert book.sheetnames == ["Test Data"]
    rows = [list(row) for row in book["Test Data"].iter_rows(values_only=True)]
    note = "SYNTHETIC: made by labpipe's virtual lab, seed 9, not a measurement"
    assert rows[0] == [note, None, None]
    assert rows[1:4] == [
        ["Test", "CT-10-1", None],
        ["Date", "03/09/2026 10:05:00", None],
        [None, None, None],
    ]
    assert rows[4] == ["Time (s)", "Force (lbf)", "Displacement (in)"]
    table = np.array(rows[5:], dtype=np.float64)
    np.testing.assert_allclose(table, np.column_stack([TIME, TIME - 0.2, TIME]), atol=5.1e-7)


def test_properties_say_that_it_is_synthetic(file: Path) -> None:
    properties = openpyxl.load_workbook(file).properties
    assert properties.title == "CT-10-1"
    assert properties.description is not None
    assert properties.description.startswith("SYNTHETIC")
    assert properties.created == properties.modified == STARTED


def test_again_is_the_same_to_the_byte(file: Path, tmp_path: Path) -> None:
    again = tmp_path / "CT-10-1.xlsx"
    write_r_controller(again, RECORD, RUN)
    assert again.read_bytes() == file.read_bytes()
