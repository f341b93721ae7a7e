"""Cells of workbooks (xlsx, xls), parsed in this process or in a child process.

The libraries allocate a table for each sheet, from its first cell to its last one: one stray cell
in the last corner of a sheet needs hundreds of gigabytes, and the process is killed. So only a
small xlsx whose cells are close together is parsed in this process.
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
from labpipe.errors import ReadError
from labpipe.readers.workbooks import cells_of
path = pathlib.Path(sys.argv[1])
try:
    sheets = cells_of(path, lambda name: print(f"sheet '{name}'", file=sys.stderr, flush=True))
except ReadError as error:
    sheets = error
pickle.dump(sheets, sys.stdout.buffer, protocol=5)
"""
_CHILD_BYTES = 4 << 30
"""Memory limit of a child process; the largest sheet of an old workbook needs 1 GB."""
_CHILD_SECONDS = 120.0
_XLSX, _XLS = b"PK\x03\x04", b"\xd0\xcf\x11\xe0"
_MAX_CELLS = 10_000_000
"""Cells allowed for any workbook: some 400 MB."""
_MAX_SPARSITY = 20
"""Beyond that, allowed cells per filled cell."""
_LARGE_BYTES = 2_000_000
"""Uncompressed size of a workbook that is always parsed in a child process."""
_FAR_CELLS_REMEDY = "Delete the rows and columns behind the table, and save the workbook."
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

    with reading(path, "a whole workbook", also=(CalamineError,)):
        if not read_head(path, 8).startswith(_XLSX):
            return _read_in_child(path)
        _refuse_others(path)
        return cells_of(path) if _is_small_and_compact(path) else _read_in_child(path)


def cells_of(path: Path, before: Callable[[str], None] = lambda _: None) -> Sheets:
    """Read the cells of all sheets in this process; see `open_sheets`.

    Parameters
    ----------
    path : the workbook
    before : called with the name of each sheet before it is parsed
    """
    from python_calamine import CalamineWorkbook, PasswordError

    sheets = {}
    try:
        with CalamineWorkbook.from_path(path) as book:
            for name in book.sheet_names:
                before(name)
                sheets[name] = _rows(path, name, book.get_sheet_by_name(name))
    except PasswordError as error:
        remedy = "Open it in the spreadsheet program and save a copy without a password."
        raise unreadable(
            path, "", "a workbook that opens", "one with a password", remedy
        ) from error
    return sheets


def _rows(path: Path, name: str, sheet: CalamineSheet) -> list[list[Any]]:
    """Return the cells of a sheet; refuse one that is nearly empty: searching it takes minutes."""
    rows, columns = sheet.total_height + 1, sheet.total_width + 1  # they count from 0
    if rows * columns > _MAX_CELLS:
        filled = sum(cell != "" for row in sheet.iter_rows() for cell in row)
        if rows * columns > _MAX_SPARSITY * filled:
            found = f"a sheet of {rows} rows and {columns} columns with {filled} cells"
            place = f"sheet '{name}', cell {column_letters(columns)}{rows}"
            raise unreadable(path, place, "cells close together", found, _FAR_CELLS_REMEDY)
    return sheet.to_python(skip_empty_area=False)


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
            command, capture_output=True, timeout=_CHILD_SECONDS, check=True, env=environment
        )
        sheets: Sheets | ReadError = pickle.loads(child.stdout)
    except subprocess.TimeoutExpired as error:
        found = f"one that was not read within {_CHILD_SECONDS:.0f} s"
        raise unreadable(path, "", "a whole workbook", found, _FAR_CELLS_REMEDY) from error
    except (subprocess.CalledProcessError, pickle.UnpicklingError) as error:
        lines = (getattr(error, "stderr", b"") or b"").decode(errors="replace").splitlines()
        raise _child_error(path, lines) from error
    if isinstance(sheets, ReadError):
        raise sheets
    return sheets


def _child_error(path: Path, lines: Sequence[str]) -> ReadError:
    """Return the error on a workbook whose reading ended the child process.

    The process names each sheet before parsing it.
    """
    place = next((line for line in reversed(lines) if line.startswith("sheet '")), "")
    memory = next((line for line in lines if "memory" in line.casefold()), "")
    if memory:
        found = f"cells so far apart that the memory did not suffice ({memory})"
        return unreadable(path, place, "cells close together", found, _FAR_CELLS_REMEDY)
    found = f"a damaged one ({lines[-1] if lines else 'no reason'})"
    remedy = "Open it in the spreadsheet program and save it again as xlsx."
    return unreadable(path, place, "a whole workbook", found, remedy)


def _is_small_and_compact(path: Path) -> bool:
    """Return whether a workbook is small, and its sheets can be parsed without a memory limit."""
    with zipfile.ZipFile(path) as parts:
        if sum(part.file_size for part in parts.infolist()) > _LARGE_BYTES:
            return False
        texts = [parts.read(name) for name in parts.namelist() if name.endswith(".xml")]
    sizes = [_size(text) for text in texts if b"worksheet" in text[:4096].replace(b"\0", b"")]
    return None not in sizes and sum(size or 0 for size in sizes) <= _MAX_CELLS


def _size(text: bytes) -> int | None:
    """Return rows times columns of a sheet, blank cells included, by a search of its text.

    None if the places of its cells are not written as most programs write them.
    """
    cells: list[tuple[bytes, bytes]] = _CELL.findall(text)
    is_plain = b"<c " in text or b"<sheetData/>" in text
    if not is_plain or len(cells) < text.count(b"</c>"):
        return None
    max_columns: int = 26 ** max((len(letters) for letters, _ in cells), default=0)
    return max((int(row) for _, row in cells), default=0) * max_columns


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


def column_letters(number: int) -> str:
    """Return the letters of a column counted from 1: AB for 28."""
    letters = ""
    while number:
        number, letter = divmod(number - 1, 26)
        letters = chr(ord("A") + letter) + letters
    return letters
