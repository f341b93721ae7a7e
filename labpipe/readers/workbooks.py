"""Cells of workbooks (xlsx, xls), parsed in this process or in a child process.

The libraries allocate a table for each sheet, from its first cell to its last one: one stray cell
in the last corner of a sheet needs hundreds of gigabytes, and the process is killed. So only a
small xlsx whose cells are close together is parsed in this process.
"""

from __future__ import annotations

import gc
import re
import warnings
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from xml.etree import ElementTree

from labpipe.errors import ReadError
from labpipe.readers.raw_files import read_head, reading, unreadable

if TYPE_CHECKING:
    from python_calamine import CalamineSheet


Sheets = Mapping[str, Sequence[Sequence[object]]]

_CHILD = """
import pathlib, pickle, sys
try:
    import resource
    resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[2]),) * 2)
except (ImportError, OSError, ValueError):
    pass  # no such limit on this system
from labpipe.readers.workbooks import cells_of
pickle.dump(cells_of(pathlib.Path(sys.argv[1])), sys.stdout.buffer, protocol=5)
"""
_REFUSED = "labpipe.errors.ReadError: "
_CHILD_SECONDS = 120.0
_XLSX, _XLS = b"PK\x03\x04", b"\xd0\xcf\x11\xe0"
MAX_CELLS: Final = 10_000_000
"""Cells allowed for any workbook: some 400 MB."""
MAX_SPARSITY: Final = 20
"""Beyond that, allowed cells per filled cell."""
_LARGE_BYTES = 2_000_000
"""Uncompressed size of a workbook that is always parsed in a child process."""
_CELL = re.compile(rb'<c r="([A-Z]{1,3})(\d{1,7})"')
"""A cell as most programs write it."""
_PASSWORD_PART = "EncryptedPackage".encode("utf-16-le")
"""Name of the part of an encrypted workbook, in an old binary document."""
_OTHER_FORMATS = {
    "content.xml": "an OpenDocument spreadsheet (ods)",
    "xl/workbook.bin": "a binary workbook (xlsb)",
}


def is_workbook(path: Path) -> bool:
    """Return whether a file is a zip archive or an old binary document, by its first bytes."""
    return read_head(path, 8).startswith((_XLSX, _XLS))


def is_locked(path: Path) -> bool:
    """Return whether a file is an xlsx workbook with a password."""
    return read_head(path, 8).startswith(_XLS) and _PASSWORD_PART in path.read_bytes()


def _password_error(path: Path) -> ReadError:
    remedy = "Open it in the spreadsheet program and save a copy without a password."
    return unreadable(path, "", "a workbook that opens", "one with a password", remedy)


def open_sheets(path: Path) -> Sheets:
    """Read the cells of all sheets.

    Parameters
    ----------
    path : the workbook

    Returns
    -------
    Rows of cells by sheet, row and column 1 first.

    Raises
    ------
    ReadError
        If it is not a complete workbook.

    Notes
    -----
    Recognition and reading need the same workbook; the last one is cached until `forget_sheets`,
    as parsing takes most of the time.
    """
    about = path.stat()
    sheets = _parsed(path, about.st_mtime_ns, about.st_size)
    if isinstance(sheets, ReadError):
        raise sheets
    return sheets


def forget_sheets() -> None:
    """Clear the cached workbook."""
    _parsed.cache_clear()


@lru_cache(maxsize=1)
def _parsed(path: Path, mtime: int, size: int) -> Sheets | ReadError:  # noqa: ARG001  versions
    """Return the cells of a workbook, or the fault that all who recognise formats will meet."""
    try:
        return _sheets(path)
    except ReadError as error:
        return error


def _sheets(path: Path) -> Sheets:
    from python_calamine import CalamineError

    with reading(path, "a whole workbook", also=(CalamineError, _ChildError)), _without_collector():
        if not read_head(path, 8).startswith(_XLSX):
            return _read_in_child(path)
        _refuse_others(path)
        if _is_small_and_compact(path):
            return cells_of(path)
        try:
            return _read_in_child(path)
        except _ChildError:
            _refuse_sparse(path)
            raise


def cells_of(path: Path) -> Sheets:
    """Read the cells of all sheets in this process; see `open_sheets`.

    An xlsx that calamine refuses is read by openpyxl, which is slower and more tolerant.
    """
    from python_calamine import CalamineError, CalamineWorkbook, PasswordError

    try:
        with CalamineWorkbook.from_path(path) as book:
            return {
                name: _rows(path, name, book.get_sheet_by_name(name)) for name in book.sheet_names
            }
    except PasswordError as error:
        raise _password_error(path) from error
    except CalamineError:
        if not read_head(path, 8).startswith(_XLSX):
            raise
    return _by_openpyxl(path)


def _rows(path: Path, name: str, sheet: CalamineSheet) -> list[list[Any]]:
    """Return the cells of a sheet; refuse one that is nearly empty: searching it takes minutes."""
    rows, columns = sheet.total_height + 1, sheet.total_width + 1  # they count from 0
    if rows * columns > MAX_CELLS:
        filled = sum(cell != "" for row in sheet.iter_rows() for cell in row)
        if rows * columns > MAX_SPARSITY * filled:
            raise _SheetExtent(rows, columns, filled).sparse_error(path, name)
    return sheet.to_python(skip_empty_area=False)


class _ChildError(Exception):
    """The child process that reads a workbook failed."""


def _read_in_child(path: Path) -> Sheets:
    """Read a workbook in a child process.

    A wrong place or length in it can exhaust the memory, which kills the process.
    """
    # Memory limit of a child process; the largest sheet of an old workbook needs 1 GB.
    memory_limit = 4 << 30
    import os
    import pickle
    import subprocess
    import sys

    command = [sys.executable, "-c", _CHILD, str(path), str(memory_limit)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    try:
        child = subprocess.run(
            command, capture_output=True, timeout=_CHILD_SECONDS, check=False, env=environment
        )
    except subprocess.TimeoutExpired as error:
        message = f"not read within {_CHILD_SECONDS:.0f} s"
        raise _ChildError(message) from error
    if child.returncode:
        lines = child.stderr.decode(errors="replace").strip().splitlines() or ["no reason"]
        message = lines[-1 if child.returncode == 1 else 0]  # its error, or the crash message
        if message.startswith(_REFUSED):
            raise ReadError(message.removeprefix(_REFUSED))
        raise _ChildError(message)
    try:
        sheets: Sheets = pickle.loads(child.stdout)
    except pickle.UnpicklingError as error:
        message = "its cells could not be transferred"
        raise _ChildError(message) from error
    return sheets


@contextmanager
def _without_collector() -> Iterator[None]:
    """Pause garbage collection, which would scan all cells repeatedly."""
    was_at_work = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_at_work:
            gc.enable()


def _by_openpyxl(path: Path) -> Sheets:
    import openpyxl

    with path.open("rb") as stream, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about omitted parts, which are not read here
        book = openpyxl.load_workbook(stream, read_only=True, data_only=True)
        return {
            sheet.title: [
                ["" if cell is None else _plain(cell) for cell in row]
                for row in sheet.iter_rows(values_only=True)
            ]
            for sheet in book.worksheets
        }


def _plain(cell: object) -> object:
    return float(cell) if isinstance(cell, int) and not isinstance(cell, bool) else cell


@dataclass(frozen=True, slots=True)
class _SheetExtent:
    """Extent of a sheet, and the number of its cells, blank ones perhaps included."""

    rows: int
    columns: int
    cells: int

    @property
    def size(self) -> int:
        """Return the number of cells of the table."""
        return self.rows * self.columns

    def sparse_error(self, path: Path, sheet: str) -> ReadError:
        """Return the error on a sheet whose cells are too far apart."""
        return unreadable(
            path,
            f"sheet '{sheet}', cell {column_letters(self.columns)}{self.rows}",
            "cells close together",
            f"a sheet of {self.rows} rows and {self.columns} columns with {self.cells} cells",
            "Delete the rows and columns behind the table, and save the workbook.",
        )


def _is_small_and_compact(path: Path) -> bool:
    """Return whether a workbook is small, and its sheets can be parsed without a memory limit."""
    with zipfile.ZipFile(path) as parts:
        if sum(part.file_size for part in parts.infolist()) > _LARGE_BYTES:
            return False
        extents = [_extent(parts, name) for name in _sheet_parts(parts)]
    return None not in extents and _are_compact([extent for extent in extents if extent])


def _are_compact(extents: Sequence[_SheetExtent]) -> bool:
    filled = sum(extent.cells for extent in extents)
    return sum(extent.size for extent in extents) <= max(MAX_CELLS, MAX_SPARSITY * filled)


def _refuse_sparse(path: Path) -> None:
    """Refuse a workbook that could not be parsed if its cells are far apart."""
    max_part_bytes = 1 << 28
    with zipfile.ZipFile(path) as parts:
        for name in _sheet_parts(parts):
            if parts.getinfo(name).file_size < max_part_bytes:
                extent = _extent(parts, name)
                if extent is not None and not _are_compact([extent]):
                    raise extent.sparse_error(path, _title(parts, name))


def _sheet_parts(parts: zipfile.ZipFile) -> list[str]:
    """Return the names of the parts that are sheets, wherever the archive keeps them."""
    names = []
    for name in parts.namelist():
        with parts.open(name) as part:
            if b"worksheet" in part.read(4096).replace(b"\0", b""):  # also in UTF-16
                names.append(name)
    return names


def _extent(parts: zipfile.ZipFile, name: str) -> _SheetExtent | None:
    """Return the extent of all cells of a sheet, blank ones included, by a search of its text.

    None if the places of its cells are not written as most programs write them.
    """
    text = parts.read(name)
    places = _CELL.findall(text)
    is_plain = b"<c " in text or b"<sheetData/>" in text
    if not is_plain or len(places) < text.count(b"</c>"):
        return None
    columns, rows = ({place[i] for place in places} for i in (0, 1))
    return _SheetExtent(
        max(map(int, rows), default=0),
        max((_number(column.decode()) for column in columns), default=0),
        len(places),
    )


def _refuse_others(path: Path) -> None:
    with zipfile.ZipFile(path) as parts:
        names = parts.namelist()
    format_name = next((text for name, text in _OTHER_FORMATS.items() if name in names), None)
    remedy = "Save it as xlsx in the spreadsheet program."
    if format_name is None and not any(name.startswith("xl/") for name in names):
        format_name, remedy = (
            "a zip archive of something else",
            "Unpack it, and name the export in it.",
        )
    if format_name is not None:
        raise unreadable(path, "", "an xlsx workbook", format_name, remedy)


def _number(letters: str) -> int:
    """Return the number of a column, counted from 1: 28 for AB."""
    number = 0
    for letter in letters:
        number = 26 * number + ord(letter) - ord("A") + 1
    return number


def column_letters(number: int) -> str:
    """Return the letters of a column counted from 1: AB for 28."""
    letters = ""
    while number:
        number, letter = divmod(number - 1, 26)
        letters = chr(ord("A") + letter) + letters
    return letters


def _title(parts: zipfile.ZipFile, name: str) -> str:
    """Return the name of a sheet; the name of its part if the archive has none."""
    try:
        links = ElementTree.fromstring(parts.read("xl/_rels/workbook.xml.rels"))
        book = ElementTree.fromstring(parts.read("xl/workbook.xml"))
    except (KeyError, ElementTree.ParseError):
        return name
    targets = {link.get("Id"): link.get("Target", "") for link in links}
    for sheet in book.iter():
        link = next((value for key, value in sheet.items() if key.endswith("}id")), None)
        target = targets.get(link, "")
        if target and name.endswith(target.lstrip("./")):
            return sheet.get("name", name)
    return name
