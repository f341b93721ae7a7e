"""Small synthetic exports of load frames, written from the descriptions of the formats."""

from __future__ import annotations

import re
import struct
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

Change = Callable[[str], str]

ROWS = [(0.1, 0.5, 2.25), (0.2, 0.75, 4.5), (0.3, 1.0, 8.125), (0.4, 1.25, 9.5)]
"""Time s, displacement mm, force N."""


def workbook(path: Path, sheets: Mapping[str, Sequence[Sequence[object]]]) -> Path:
    """A synthetic workbook."""
    import openpyxl

    book = openpyxl.Workbook(write_only=True)
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append(list(row))
    book.save(path)
    return path


def locked_workbook(path: Path) -> Path:
    """A synthetic workbook with a password: the outer document, its encrypted part all zeros."""
    none, end = 0xFFFFFFFF, 0xFFFFFFFE

    def entry(name: str, kind: int, child: int = none, start: int = end, size: int = 0) -> bytes:
        text = f"{name}\0".encode("utf-16-le")
        links = (len(text), kind, 1, none, none, child)
        return struct.pack("<64sHBBIII36xIQ", text, *links, start, size)

    begin = (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", 0x3E, 3, 0xFFFE, 9, 6)
    head = struct.pack("<8s16x5H6x", *begin) + struct.pack("<9I", 0, 1, 1, 0, 4096, end, 0, end, 0)
    sectors = struct.pack("<109I", 0, *[none] * 108)
    chain = struct.pack("<128I", end - 1, end, *range(3, 10), end, *[none] * 118)
    folder = entry("Root Entry", 5, child=1) + entry("EncryptedPackage", 2, start=2, size=4096)
    path.write_bytes(head + sectors + chain + folder + 2 * entry("", 0) + bytes(4096))
    return path


def specimen_sheet(specimen: str, rows: Sequence[Sequence[object]] = ROWS) -> list[list[object]]:
    """A synthetic sheet of one specimen."""
    head: list[list[object]] = [[specimen] * 3, ["Test time", "Strain", "Standard force"]]
    return [*head, ["s", "mm", "N"], *(list(row) for row in rows)]


LAST = "XFD1048576"
"""The last cell that a sheet can have."""


def changed(path: Path, change: Change, part: str = "xl/worksheets/sheet1.xml") -> Path:
    """Change the text of one part of a workbook."""
    with zipfile.ZipFile(path) as parts:
        content = {name: parts.read(name) for name in parts.namelist()}
    text = content[part].decode()
    content[part] = change(text).encode()
    assert content[part].decode() != text
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as parts:
        for name, data in content.items():
            parts.writestr(name, data)
    return path


def stray(place: str = LAST, value: str = "<v>1</v>") -> Change:
    """One more row with one cell, as a slip of the hand leaves it."""
    row = re.sub(r"\D", "", place)
    cell = f'<row r="{row}"><c r="{place}" s="0">{value}</c></row>'
    return lambda text: text.replace("</sheetData>", f"{cell}</sheetData>")
