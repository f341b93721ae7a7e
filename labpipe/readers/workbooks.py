"""Cells of whole workbooks (xlsx, xls), parsed in a thread: nothing heavy is imported here."""

from __future__ import annotations

import gc
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

from labpipe.readers.files import read_head, reading

Sheets = Mapping[str, Sequence[Sequence[object]]]

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


def _sheets(path: Path) -> Sheets:
    from python_calamine import CalamineError, CalamineWorkbook

    with reading(path, "a whole workbook", also=(CalamineError,)), _all_is_kept():
        try:
            with CalamineWorkbook.from_path(path) as book:
                return {
                    name: book.get_sheet_by_name(name).to_python(skip_empty_area=False)
                    for name in book.sheet_names
                }
        except CalamineError:
            if not read_head(path, 8).startswith(_XLSX):
                raise
        return _by_openpyxl(path)


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

    with path.open("rb") as stream:
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
