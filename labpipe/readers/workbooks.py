"""Cells of whole workbooks (xlsx, xls), parsed in a thread: nothing heavy is imported here."""

from __future__ import annotations

import gc
import warnings
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from labpipe.errors import ReadError
from labpipe.readers.files import read_head, reading

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


def is_workbook(path: Path) -> bool:
    """Tell whether a file is a zip archive or an old binary document, by its first bytes."""
    return read_head(path, 8).startswith((_XLSX, _XLS))


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
def opened_workbook(
    path: Path, what: str, *, most: int | None = None
) -> Iterator[CalamineWorkbook]:
    """Open an xlsx workbook whose cells lie together.

    Parameters
    ----------
    path : the workbook
    what : what was expected, for messages
    most : cells that may be laid out in any case; None for `extent.MOST`

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

    from labpipe.readers.extent import MOST, check_extent

    with reading(path, what, also=(CalamineError,)):
        check_extent(path, most=MOST if most is None else most)
        with CalamineWorkbook.from_path(path) as book:
            yield book


def _sheets(path: Path) -> Sheets:
    from python_calamine import CalamineError

    from labpipe.readers.extent import check_extent, is_large

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

    from labpipe.readers.extent import check_size, check_table

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
