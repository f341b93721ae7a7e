"""Cells of workbooks (xlsx, xls): their extent, and parsing in a thread or a child process.

The libraries allocate a table for each sheet, from its first cell to its last one: one stray cell
in the last corner of a sheet needs hundreds of gigabytes, and the process is killed.
"""

from __future__ import annotations

import gc
import re
import warnings
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Final
from xml.etree import ElementTree
from xml.parsers import expat

from labpipe.errors import ReadError
from labpipe.readers.raw_files import read_head, reading, unreadable

if TYPE_CHECKING:
    from python_calamine import CalamineWorkbook


Sheets = Mapping[str, Sequence[Sequence[object]]]

_CHILD = """
import pickle, sys
try:
    import resource
    resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[2]),) * 2)
except (ImportError, OSError, ValueError):
    pass  # no such limit on this system
from labpipe.readers.workbooks import cells_of
pickle.dump(cells_of(sys.argv[1]), sys.stdout.buffer, protocol=5)
"""
_REFUSED = "labpipe.errors.ReadError: "
_CHILD_BYTES = 4 << 30
"""Memory limit of a child process; the largest sheet of an old workbook needs 1 GB."""
_CHILD_SECONDS = 120.0
_XLSX, _XLS = b"PK\x03\x04", b"\xd0\xcf\x11\xe0"
MAX_CELLS: Final = 10_000_000
"""Cells allowed for any workbook: some 400 MB."""
MAX_SPARSITY: Final = 20
"""Beyond that, allowed cells per filled cell."""
_LARGE_BYTES = 2_000_000
"""Uncompressed size; checking takes a second per 100 MB."""
_CHUNK_BYTES = 1 << 20
_CELL = re.compile(rb'<c(?: r="([A-Z]{1,3})(\d{1,7})"|[^a-zA-Z])')
"""A cell as most programs write it, or in another way."""
_PREFIXED_CELLS = (b":c ", b":c>", b":c/", b":c\t", b":c\n", b":c\r")
_PLACE = re.compile(r"([A-Za-z]+)(\d+)")
_TEXT_KINDS = ("str", "inlineStr")
"""Types of cells that are text, even if empty."""
_UTF16 = (b"\xff\xfe", b"\xfe\xff")
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


def begin_sheets(path: Path) -> None:
    """Start parsing a file in the background, if it is a workbook.

    Parameters
    ----------
    path : the file

    Raises
    ------
    ReadError
        If the file is empty or not readable. `open_sheets` reports all other faults.
    """
    if path.is_file() and is_workbook(path):
        _start_parsing(path)


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
    return _start_parsing(path).result()


def forget_sheets() -> None:
    """Clear the cached workbook."""
    _parsing.cache_clear()


def _start_parsing(path: Path) -> Future[Sheets]:
    about = path.stat()
    return _parsing(path, about.st_mtime_ns, about.st_size)


@lru_cache(maxsize=1)
def _parsing(path: Path, mtime: int, size: int) -> Future[Sheets]:  # noqa: ARG001  versions
    pool = ThreadPoolExecutor(max_workers=1)
    parsing = pool.submit(_sheets, path)
    pool.shutdown(wait=False)
    return parsing


@contextmanager
def open_workbook(
    path: Path, what: str, *, max_cells: int = MAX_CELLS
) -> Iterator[CalamineWorkbook]:
    """Open an xlsx workbook after checking its extent.

    Parameters
    ----------
    path : the workbook
    what : the expected content, for messages
    max_cells : cells allowed for any workbook

    Yields
    ------
    The workbook.

    Raises
    ------
    ReadError
        If it is damaged or of another format, or its cells are too far apart; also for errors while
        it is open.
    """
    from python_calamine import CalamineError, CalamineWorkbook

    with reading(path, what, also=(CalamineError,)):
        if is_locked(path):
            raise _password_error(path)
        check_extent(path, max_cells=max_cells)
        with CalamineWorkbook.from_path(path) as book:
            yield book


def _sheets(path: Path) -> Sheets:
    from python_calamine import CalamineError

    with reading(path, "a whole workbook", also=(CalamineError, _ChildError)), _without_collector():
        if not read_head(path, 8).startswith(_XLSX):
            return _read_in_child(path)
        if not is_large(path):
            check_extent(path)
        try:
            return _read_in_child(path) if is_large(path) else cells_of(path)
        except CalamineError:
            pass
        except _ChildError as error:
            check_extent(path)
            if not error.is_refusal:
                raise
        return _by_openpyxl(path)


def cells_of(path: Path) -> Sheets:
    """Read the cells of all sheets in this process; see `open_sheets`."""
    from python_calamine import CalamineWorkbook

    sheets: dict[str, Sequence[Sequence[object]]] = {}
    with CalamineWorkbook.from_path(path) as book:
        for name in book.sheet_names:
            sheet = book.get_sheet_by_name(name)
            check_size(path, name, sheet.total_height, sheet.total_width)
            sheets[name] = sheet.to_python(skip_empty_area=False)
            check_table(path, name, sheets[name])
    return sheets


class _ChildError(Exception):
    """The child process that reads a workbook failed; a refusal if its library gave a reason."""

    def __init__(self, message: str, *, is_refusal: bool = False) -> None:
        super().__init__(message)
        self.is_refusal = is_refusal


def _read_in_child(path: Path) -> Sheets:
    """Read a workbook in a child process.

    A wrong place or length in it can exhaust the memory, which kills the process.
    """
    import os
    import pickle
    import subprocess
    import sys

    command = [sys.executable, "-c", _CHILD, str(path), str(_CHILD_BYTES)]
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
        if message.startswith("python_calamine.PasswordError"):
            raise _password_error(path)
        if message.startswith(_REFUSED):
            raise ReadError(message.removeprefix(_REFUSED))
        raise _ChildError(message, is_refusal=message.startswith("python_calamine."))
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
    """Read a workbook that calamine refuses with the slower but more tolerant library."""
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


@dataclass(slots=True)
class _SheetExtent:
    """Extent, number and last place of the cells of a sheet."""

    rows: int = 0
    columns: int = 0
    cells: int = 0
    last: str = ""

    @property
    def size(self) -> int:
        """Return the number of cells of the table."""
        return self.rows * self.columns

    def add(self, column: int, row: int) -> None:
        """Add one cell, its place counted from 1."""
        if column * row >= self.columns * self.rows:
            self.last = f"{column_letters(column)}{row}"
        self.rows, self.columns = max(self.rows, row), max(self.columns, column)
        self.cells += 1


def is_large(path: Path) -> bool:
    """Return whether a workbook is so large that `check_extent` is slow."""
    with zipfile.ZipFile(path) as parts:
        return sum(part.file_size for part in parts.infolist()) > _LARGE_BYTES


def check_extent(path: Path, *, max_cells: int = MAX_CELLS) -> None:
    """Refuse a workbook whose cells are so far apart that its tables exhaust the memory.

    Parameters
    ----------
    path : a zip archive
    max_cells : cells allowed for any workbook

    Raises
    ------
    ReadError
        If the extent is too large for the number of cells, with the sheet and its last cell; or if
        the archive is a spreadsheet of another format than xlsx.

    Notes
    -----
    Cells with only a style do not count. Other faults of the archive raise the errors of the
    libraries.
    """
    with zipfile.ZipFile(path) as parts:
        _refuse_others(parts, path)
        sheets = [name for name in parts.namelist() if _is_sheet(parts, name)]
        if _is_compact([_quick_extent(parts, name) for name in sheets], max_cells):
            return
        extent = {name: _exact_extent(parts, name) for name in sheets}
        if not _is_compact(list(extent.values()), max_cells):
            worst = max(extent, key=lambda name: extent[name].size)
            raise _sparse_error(path, _title(parts, worst), extent[worst])


def check_size(path: Path, sheet: str, rows: int, columns: int) -> None:
    """Refuse a sheet that is too large, before it is allocated.

    Parameters
    ----------
    path, sheet : as for `check_table`
    rows, columns : counted by the library

    Raises
    ------
    ReadError
        As `check_extent`.
    """
    if rows * columns > 4 * MAX_CELLS:
        last = f"{column_letters(columns)}{rows}"
        raise _sparse_error(path, sheet, _SheetExtent(rows, columns, last=last), filled="few")


def check_table(path: Path, sheet: str, rows: Sequence[Sequence[object]]) -> None:
    """Refuse a sheet that is nearly empty: searching it would take minutes.

    Parameters
    ----------
    path : of the workbook, for messages
    sheet : its name
    rows : cells, all rows of equal length; a blank one is an empty text

    Raises
    ------
    ReadError
        As `check_extent`.
    """
    size = len(rows) * len(rows[0]) if rows else 0
    if size <= MAX_CELLS:
        return
    filled = sum(cell != "" for row in rows for cell in row)
    if size > MAX_SPARSITY * filled:
        columns = len(rows[0])
        extent = _SheetExtent(len(rows), columns, filled, f"{column_letters(columns)}{len(rows)}")
        raise _sparse_error(path, sheet, extent)


def _is_compact(extents: list[_SheetExtent], max_cells: int) -> bool:
    filled = sum(extent.cells for extent in extents)
    return sum(extent.size for extent in extents) <= max(max_cells, MAX_SPARSITY * filled)


def _refuse_others(parts: zipfile.ZipFile, path: Path) -> None:
    names = parts.namelist()
    found = next((kind for name, kind in _OTHER_FORMATS.items() if name in names), None)
    remedy = "Save it as xlsx in the spreadsheet program."
    if found is None and not any(name.startswith("xl/") for name in names):
        found, remedy = "a zip archive of something else", "Unpack it, and name the export in it."
    if found is not None:
        raise unreadable(path, "", "an xlsx workbook", found, remedy)


def _is_sheet(parts: zipfile.ZipFile, name: str) -> bool:
    with parts.open(name) as part:
        head = part.read(4096)
    return b"worksheet" in head or head.startswith(_UTF16)


def _chunks(parts: zipfile.ZipFile, name: str) -> Iterator[bytes]:
    with parts.open(name) as part:
        while chunk := part.read(_CHUNK_BYTES):
            yield chunk


def _quick_extent(parts: zipfile.ZipFile, name: str) -> _SheetExtent:
    """Return the extent of all cells, blank ones included, by a fast text search."""
    extent, rest = _SheetExtent(), b""
    for chunk in _chunks(parts, name):
        data = rest + chunk
        cut = data.rfind(b"<") if len(data) < 2 * _CHUNK_BYTES else len(data)
        places = _CELL.findall(data, 0, cut)
        rest = data[cut:]
        is_prefixed = any(mark in data for mark in _PREFIXED_CELLS)
        if is_prefixed or (b"", b"") in places or data.startswith(_UTF16):
            return _exact_extent(parts, name)
        columns, rows = ({place[i] for place in places} for i in (0, 1))
        extent.columns = max(extent.columns, *(_number(column.decode()) for column in columns), 0)
        extent.rows = max(extent.rows, *map(int, rows), 0)
        extent.cells += len(places)
    return extent


def _exact_extent(parts: zipfile.ZipFile, name: str) -> _SheetExtent:
    """Return the extent of the filled cells, blank text included, as the libraries count it."""
    extent, at = _SheetExtent(), [0, 0]
    is_filled, kind = False, ""

    def begin(tag: str, attributes: dict[str, str]) -> None:
        nonlocal is_filled, kind
        kind, place = tag.rpartition(":")[2], attributes.get("r", "")
        if kind == "row":
            at[:] = [0, int(place) if place else at[1] + 1]
        elif kind == "c":
            match = _PLACE.fullmatch(place)
            at[:] = [_number(match[1].upper()), int(match[2])] if match else [at[0] + 1, at[1]]
            is_filled = attributes.get("t") in _TEXT_KINDS

    def inside(text: str) -> None:
        nonlocal is_filled
        is_filled = is_filled or kind == "v" or bool(text.strip())

    def end(tag: str) -> None:
        if tag.rpartition(":")[2] == "c" and is_filled:
            extent.add(at[0], max(at[1], 1))

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = begin, end
    parser.CharacterDataHandler = inside
    for chunk in _chunks(parts, name):
        parser.Parse(chunk, False)
    parser.Parse(b"", True)
    return extent


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


def _sparse_error(path: Path, sheet: str, extent: _SheetExtent, filled: str = "") -> ReadError:
    return unreadable(
        path,
        f"sheet '{sheet}', cell {extent.last}",
        "cells close together",
        f"a sheet of {extent.rows} rows and {extent.columns} columns with"
        f" {filled or extent.cells} filled cells",
        "Delete the rows and columns behind the table, and save the workbook.",
    )
