"""Takes saved as xlsx, told from other archives; what is in them: `test_motive_csv`."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest

from labpipe.errors import ReadError
from labpipe.readers import motive_xlsx


def test_a_workbook_of_something_else(tmp_path: Path) -> None:
    from openpyxl import Workbook

    file = tmp_path / "other.xlsx"
    book = Workbook()
    book.active.append(["time", "force"])  # type: ignore[union-attr]
    book.save(file)
    assert not motive_xlsx.recognise(file)
    with pytest.raises(ReadError, match=r"expected a sheet whose first cell is Format Version"):
        motive_xlsx.read(file)
    archive = tmp_path / "files.zip"
    with zipfile.ZipFile(archive, "w") as parts:
        parts.writestr("readme.txt", "Format Version")
    assert not motive_xlsx.recognise(archive)
    archive.write_bytes(archive.read_bytes()[:-30])
    assert not motive_xlsx.recognise(archive)
