"""Motive takes that a spreadsheet saved as xlsx: told here at little cost, read by `motive_csv`."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from labpipe.readers.files import BROKEN, read_head

if TYPE_CHECKING:
    from labpipe.readers.channels import Wanted
    from labpipe.records.recording import Recording

_SHEET_HEAD = 200_000
_SHEETS = ("xl/sharedStrings.xml", "xl/worksheets/sheet1.xml")


def recognise(path: Path) -> bool:
    """Tell whether a file is a spreadsheet that holds a Motive table, by its first cell."""
    if not read_head(path, 4).startswith(b"PK\x03\x04"):
        return False
    try:
        with zipfile.ZipFile(path) as parts:
            inside = [name for name in _SHEETS if name in parts.namelist()]
            return any(b"Format Version" in _part_head(parts, name) for name in inside)
    except BROKEN:
        return False


def read(path: Path, *, channels: Sequence[Wanted] | None = None) -> Recording:
    """Read a Motive CSV export that a spreadsheet saved as xlsx: `motive_csv.read_xlsx`."""
    from labpipe.readers.motive_csv import read_xlsx

    return read_xlsx(path, channels=channels)


def _part_head(parts: zipfile.ZipFile, name: str) -> bytes:
    with parts.open(name) as part:
        return part.read(_SHEET_HEAD)
