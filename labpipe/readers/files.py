"""Opening exports: the one place where a library error becomes a ReadError."""

from __future__ import annotations

import csv
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from xml.parsers.expat import ExpatError

from labpipe.errors import ReadError, complaint

BROKEN: tuple[type[Exception], ...] = (
    OSError,  # h5py and the operating system
    EOFError,
    ValueError,  # also pandas' ParserError and every UnicodeError
    LookupError,
    TypeError,  # scipy meets a tag that its tables do not know
    AttributeError,  # a file that is not of the shape its header promises
    ArithmeticError,
    AssertionError,
    MemoryError,  # a damaged length asks for more than there is
    RuntimeError,  # h5py; NotImplementedError and RecursionError too
    ExpatError,  # damaged XML inside an MF4
    SyntaxError,  # as ElementTree calls damaged XML inside a workbook
    struct.error,
    zlib.error,
    zipfile.BadZipFile,
    csv.Error,
)
"""What the format libraries were seen to raise, or say they raise, for damaged files."""

_LOOK = "Check the name and the folder."
_CUT = "Export the recording again; the file may have been cut off while copying."


def unreadable(file: object, place: str, expected: str, found: str, remedy: str) -> ReadError:
    """Make the error for what cannot be read; parameters as of `labpipe.errors.complaint`."""
    return ReadError(complaint(file, place, expected=expected, found=found, remedy=remedy))


@contextmanager
def reading(
    path: Path, what: str, *, also: tuple[type[BaseException], ...] = (), remedy: str = _CUT
) -> Iterator[None]:
    """Turn what a format library raises for a broken file into a ReadError that names the file.

    Parameters
    ----------
    path : the export
    what : what was expected, such as ``a whole MAT v5 file``
    also : errors that only one library knows
    remedy : what the person at the bench can do

    Raises
    ------
    ReadError
        In the place of every error of `BROKEN` and `also`.
    """
    try:
        yield
    except FileNotFoundError as error:
        raise ReadError(_absent(path)) from error
    except PermissionError as error:
        found = "one that may not be read"
        raise unreadable(path, "", "a file", found, "Check its permissions.") from error
    except (*BROKEN, *also) as error:
        if isinstance(error, OSError) and error.filename is not None:
            found = f"one that cannot be opened ({error.strerror})"
            raise unreadable(path, "", "a file", found, _LOOK) from error
        found = f"a damaged one ({_first_line(error)})"
        raise unreadable(path, "", what, found, remedy) from error


def read_head(path: Path, size: int = 65536) -> bytes:
    """Read the first bytes of an export.

    Parameters
    ----------
    path : the export
    size : how many bytes at the most

    Returns
    -------
    The bytes.

    Raises
    ------
    ReadError
        If there is no such file, it is a folder, a pipe or a device, it may not be read, or it is
        empty.
    """
    with reading(path, "a readable file"):
        kind = _odd_kind(path)
        head = b"" if kind else _beginning(path, size)
    if kind:
        remedy = "Name one of the files in it." if kind == "a folder" else "Name a plain file."
        raise unreadable(path, "", "a file", kind, remedy)
    if not head:
        found, remedy = "an empty file (0 bytes)", "Save or export it again."
        expected = "a file with content"
        raise unreadable(path, "", expected, found, remedy)
    return head


def _odd_kind(path: Path) -> str:
    """What a path is that is no plain file: reading a pipe would wait for ever."""
    if path.is_dir():
        return "a folder"
    return "a pipe or a device" if path.exists() and not path.is_file() else ""


def _beginning(path: Path, size: int) -> bytes:
    with path.open("rb") as stream:
        return stream.read(size)


def _absent(path: Path) -> str:
    return complaint(path, "", expected="a file", found="none of that name", remedy=_LOOK)


def _first_line(error: BaseException) -> str:
    said = str(error).strip().splitlines()
    return said[0][:160] if said else type(error).__name__
