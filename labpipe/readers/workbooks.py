"""Cells of whole workbooks (xlsx, xls): how far they reach, and parsed in a thread or a child.

The libraries make a table of every sheet, from its first cell to its last one: one stray cell in
the last corner of a sheet asks for hundreds of gigabytes, and the process is ended.
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
    pass  # no such limit here: a process that asks for too much is ended all the same
from labpipe.readers.workbooks import cells_of
pickle.dump(cells_of(sys.argv[1]), sys.stdout.buffer, protocol=5)
"""
_REFUSED = "labpipe.errors.ReadError: "
_MEMORY, _PATIENCE = 4 << 30, 120.0
"""Bytes and seconds that a child may take; the largest sheet of an old workbook takes 1 GB."""
_XLSX, _XLS = b"PK\x03\x04", b"\xd0\xcf\x11\xe0"
MOST: Final = 10_000_000
"""Cells that may be laid out in any case: some 400 MB."""
SPARSE: Final = 20
"""Beyond that, as many cells are laid out as this many times those that are filled."""
_BEYOND = 4 * MOST
_LARGE = 2_000_000
"""Bytes, once unpacked: at about 100 MB a second."""
_CHUNK = 1 << 20
_HEAD = 4096
_CELL = re.compile(rb'<c(?: r="([A-Z]{1,3})(\d{1,7})"|[^a-zA-Z])')
"""A cell as nearly every program writes it, or in another way."""
_PREFIXED = (b":c ", b":c>", b":c/", b":c\t", b":c\n", b":c\r")
_PLACE = re.compile(r"([A-Za-z]+)(\d+)")
_TEXTS = ("str", "inlineStr")
"""Kinds of cells that are text, even with nothing in them."""
_UTF16 = (b"\xff\xfe", b"\xfe\xff")
_LOCKED = "EncryptedPackage".encode("utf-16-le")
"""Name of the part that holds a workbook with a password, in an old binary document."""
_OTHERS = {
    "content.xml": "an OpenDocument spreadsheet (ods)",
    "xl/workbook.bin": "a binary workbook (xlsb)",
}


def is_workbook(path: Path) -> bool:
    """Check whether a file is a zip archive or an old binary document, by its first bytes."""
    return read_head(path, 8).startswith((_XLSX, _XLS))


def is_locked(path: Path) -> bool:
    """Check whether a file is a workbook with a password, in the format of today."""
    return read_head(path, 8).startswith(_XLS) and _LOCKED in path.read_bytes()


def _locked(path: Path) -> ReadError:
    remedy = "Open it in the spreadsheet program and save a copy without a password."
    return unreadable(path, "", "a workbook that opens", "one with a password", remedy)


def begin_sheets(path: Path) -> None:
    """Begin to parse a file, if it is a workbook, while its caller does something else.

    Parameters
    ----------
    path : the file

    Raises
    ------
    ReadError
        If the file is empty or may not be read. All else that is wrong with it, `open_sheets` says.
    """
    if path.is_file() and is_workbook(path):
        _opening(path)


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
        If it is no whole workbook.

    Notes
    -----
    Recognising and reading ask for the same workbook one after the other; what was read last is
    kept until `forget_sheets`, as parsing it is nearly all of the work.
    """
    return _opening(path).result()


def forget_sheets() -> None:
    """Let go of the workbook that was read last."""
    _parsing.cache_clear()


def _opening(path: Path) -> Future[Sheets]:
    about = path.stat()
    return _parsing(path, about.st_mtime_ns, about.st_size)


@lru_cache(maxsize=1)
def _parsing(path: Path, mtime: int, size: int) -> Future[Sheets]:  # noqa: ARG001  versions
    pool = ThreadPoolExecutor(max_workers=1)
    parsing = pool.submit(_sheets, path)
    pool.shutdown(wait=False)
    return parsing


@contextmanager
def opened_workbook(path: Path, what: str, *, most: int = MOST) -> Iterator[CalamineWorkbook]:
    """Open an xlsx workbook whose cells lie together.

    Parameters
    ----------
    path : the workbook
    what : what was expected, for messages
    most : cells that may be laid out in any case

    Yields
    ------
    The workbook.

    Raises
    ------
    ReadError
        If it is damaged or of another format, or its cells are too far apart; also for what goes
        wrong while it is open.
    """
    from python_calamine import CalamineError, CalamineWorkbook

    with reading(path, what, also=(CalamineError,)):
        if is_locked(path):
            raise _locked(path)
        check_extent(path, most=most)
        with CalamineWorkbook.from_path(path) as book:
            yield book


def _sheets(path: Path) -> Sheets:
    from python_calamine import CalamineError

    with reading(path, "a whole workbook", also=(CalamineError, _ChildError)), _all_is_kept():
        if not read_head(path, 8).startswith(_XLSX):
            return _in_a_child(path)
        if not is_large(path):
            check_extent(path)
        try:
            return _in_a_child(path) if is_large(path) else cells_of(path)
        except CalamineError:
            pass
        except _ChildError as error:
            check_extent(path)
            if not error.is_refusal:
                raise
        return _by_openpyxl(path)


def cells_of(path: Path) -> Sheets:
    """Read the cells of all sheets, whatever becomes of this process; see `open_sheets`."""
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
    """A process that read a workbook did not end well; a refusal, if its library said why."""

    def __init__(self, message: str, *, is_refusal: bool = False) -> None:
        super().__init__(message)
        self.is_refusal = is_refusal


def _in_a_child(path: Path) -> Sheets:
    """Read a workbook in a process of its own.

    A wrong place or length in it asks for more memory than there is, and that ends a process.
    """
    import os
    import pickle
    import subprocess
    import sys

    command = [sys.executable, "-c", _CHILD, str(path), str(_MEMORY)]
    known = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    try:
        child = subprocess.run(
            command, capture_output=True, timeout=_PATIENCE, check=False, env=known
        )
    except subprocess.TimeoutExpired as error:
        message = f"not read within {_PATIENCE:.0f} s"
        raise _ChildError(message) from error
    if child.returncode:
        said = child.stderr.decode(errors="replace").strip().splitlines() or ["no reason"]
        message = said[-1 if child.returncode == 1 else 0]  # its error, or its last words
        if message.startswith("python_calamine.PasswordError"):
            raise _locked(path)
        if message.startswith(_REFUSED):
            raise ReadError(message.removeprefix(_REFUSED))
        raise _ChildError(message, is_refusal=message.startswith("python_calamine."))
    try:
        sheets: Sheets = pickle.loads(child.stdout)
    except pickle.UnpicklingError as error:
        message = "its cells could not be passed on"
        raise _ChildError(message) from error
    return sheets


@contextmanager
def _all_is_kept() -> Iterator[None]:
    """Keep the collector from looking for garbage among cells again and again: there is none."""
    was_at_work = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_at_work:
            gc.enable()


def _by_openpyxl(path: Path) -> Sheets:
    """Read a workbook that calamine refuses with the slower but more patient library."""
    import openpyxl

    with path.open("rb") as stream, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of what it leaves out, which is not read here
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
class _Reach:
    """How far the cells of a sheet reach, how many there are, and which is the last one."""

    rows: int = 0
    columns: int = 0
    cells: int = 0
    last: str = ""

    @property
    def size(self) -> int:
        """Cells of the table."""
        return self.rows * self.columns

    def add(self, column: int, row: int) -> None:
        """Take in one cell, its place counted from 1."""
        if column * row >= self.columns * self.rows:
            self.last = f"{column_letters(column)}{row}"
        self.rows, self.columns = max(self.rows, row), max(self.columns, column)
        self.cells += 1


def is_large(path: Path) -> bool:
    """Whether a workbook is so large that `check_extent` takes long; needs a whole archive."""
    with zipfile.ZipFile(path) as parts:
        return sum(part.file_size for part in parts.infolist()) > _LARGE


def check_extent(path: Path, *, most: int = MOST) -> None:
    """Refuse a workbook whose cells are so far apart that its tables would fill the memory.

    Parameters
    ----------
    path : a zip archive
    most : cells that may be laid out in any case

    Raises
    ------
    ReadError
        If the cells reach too far for their number, with the sheet and its last cell; or if the
        archive is a spreadsheet of another format than xlsx.

    Notes
    -----
    Cells without content, which only carry a style, do not count. What is wrong with the archive
    otherwise is raised as the libraries raise it.
    """
    with zipfile.ZipFile(path) as parts:
        _refuse_others(parts, path)
        sheets = [name for name in parts.namelist() if _is_sheet(parts, name)]
        if _is_small([_quick_reach(parts, name) for name in sheets], most):
            return
        reach = {name: _exact_reach(parts, name) for name in sheets}
        if not _is_small(list(reach.values()), most):
            worst = max(reach, key=lambda name: reach[name].size)
            raise _too_far(path, _title(parts, worst), reach[worst])


def check_size(path: Path, sheet: str, rows: int, columns: int) -> None:
    """Refuse a sheet that is larger than any that can be worked with, before it is laid out.

    Parameters
    ----------
    path, sheet : as for `check_table`
    rows, columns : as the library counts them

    Raises
    ------
    ReadError
        As `check_extent`.
    """
    if rows * columns > _BEYOND:
        last = f"{column_letters(columns)}{rows}"
        raise _too_far(path, sheet, _Reach(rows, columns, last=last), filled="few")


def check_table(path: Path, sheet: str, rows: Sequence[Sequence[object]]) -> None:
    """Refuse a sheet that was laid out and is all but empty: to look through it takes minutes.

    Parameters
    ----------
    path : of the workbook, for messages
    sheet : its name
    rows : of cells, all of one length; a blank one is an empty text

    Raises
    ------
    ReadError
        As `check_extent`.
    """
    size = len(rows) * len(rows[0]) if rows else 0
    if size <= MOST:
        return
    filled = sum(cell != "" for row in rows for cell in row)
    if size > SPARSE * filled:
        columns = len(rows[0])
        reach = _Reach(len(rows), columns, filled, f"{column_letters(columns)}{len(rows)}")
        raise _too_far(path, sheet, reach)


def _is_small(reaches: list[_Reach], most: int) -> bool:
    filled = sum(reach.cells for reach in reaches)
    return sum(reach.size for reach in reaches) <= max(most, SPARSE * filled)


def _refuse_others(parts: zipfile.ZipFile, path: Path) -> None:
    names = parts.namelist()
    found = next((what for name, what in _OTHERS.items() if name in names), None)
    remedy = "Save it as xlsx in the spreadsheet program."
    if found is None and not any(name.startswith("xl/") for name in names):
        found, remedy = "a zip archive of something else", "Unpack it, and name the export in it."
    if found is not None:
        raise unreadable(path, "", "an xlsx workbook", found, remedy)


def _is_sheet(parts: zipfile.ZipFile, name: str) -> bool:
    with parts.open(name) as part:
        head = part.read(_HEAD)
    return b"worksheet" in head or head.startswith(_UTF16)


def _chunks(parts: zipfile.ZipFile, name: str) -> Iterator[bytes]:
    with parts.open(name) as part:
        while chunk := part.read(_CHUNK):
            yield chunk


def _quick_reach(parts: zipfile.ZipFile, name: str) -> _Reach:
    """Reach of all cells, also of blank ones: by words, which is faster than by parsing."""
    reach, rest = _Reach(), b""
    for chunk in _chunks(parts, name):
        data = rest + chunk
        cut = data.rfind(b"<") if len(data) < 2 * _CHUNK else len(data)
        found = _CELL.findall(data, 0, cut)
        rest = data[cut:]
        is_prefixed = any(words in data for words in _PREFIXED)
        if is_prefixed or (b"", b"") in found or data.startswith(_UTF16):
            return _exact_reach(parts, name)
        columns, rows = ({finding[i] for finding in found} for i in (0, 1))
        reach.columns = max(reach.columns, *(_number(column.decode()) for column in columns), 0)
        reach.rows = max(reach.rows, *map(int, rows), 0)
        reach.cells += len(found)
    return reach


def _exact_reach(parts: zipfile.ZipFile, name: str) -> _Reach:
    """Reach of the cells that hold anything, were it blank text: the libraries lay these out."""
    reach, at = _Reach(), [0, 0]
    is_filled, kind = False, ""

    def begin(tag: str, attributes: dict[str, str]) -> None:
        nonlocal is_filled, kind
        kind, place = tag.rpartition(":")[2], attributes.get("r", "")
        if kind == "row":
            at[:] = [0, int(place) if place else at[1] + 1]
        elif kind == "c":
            match = _PLACE.fullmatch(place)
            at[:] = [_number(match[1].upper()), int(match[2])] if match else [at[0] + 1, at[1]]
            is_filled = attributes.get("t") in _TEXTS

    def inside(text: str) -> None:
        nonlocal is_filled
        is_filled = is_filled or kind == "v" or bool(text.strip())

    def end(tag: str) -> None:
        if tag.rpartition(":")[2] == "c" and is_filled:
            reach.add(at[0], max(at[1], 1))

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = begin, end
    parser.CharacterDataHandler = inside
    for chunk in _chunks(parts, name):
        parser.Parse(chunk, False)
    parser.Parse(b"", True)
    return reach


def _number(letters: str) -> int:
    """Number of a column, counted from 1: 28 for AB."""
    number = 0
    for letter in letters:
        number = 26 * number + ord(letter) - ord("A") + 1
    return number


def column_letters(number: int) -> str:
    """Letters of a column counted from 1: AB for 28."""
    letters = ""
    while number:
        number, letter = divmod(number - 1, 26)
        letters = chr(ord("A") + letter) + letters
    return letters


def _title(parts: zipfile.ZipFile, name: str) -> str:
    """What a person calls a sheet; the name of its part where the archive does not say."""
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


def _too_far(path: Path, sheet: str, reach: _Reach, filled: str = "") -> ReadError:
    return unreadable(
        path,
        f"sheet '{sheet}', cell {reach.last}",
        "cells that lie together",
        f"a sheet of {reach.rows} rows and {reach.columns} columns with"
        f" {filled or reach.cells} filled cells",
        "Delete the rows and columns behind the table, and save the workbook.",
    )
