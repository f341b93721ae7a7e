"""Raw files: opened where a library's error becomes a ReadError, and text decoded to lines."""

from __future__ import annotations

import codecs
import csv
import struct
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from xml.parsers.expat import ExpatError

from labpipe.errors import ReadError, error_text

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
HEAD = 65536
"""Bytes in which the header of an export is looked for."""
_MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)


def unreadable(file: object, place: str, expected: str, found: str, remedy: str) -> ReadError:
    """Make the error for what cannot be read; parameters as of `labpipe.errors.error_text`."""
    return ReadError(error_text(file, place, expected=expected, found=found, remedy=remedy))


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
        message = error_text(path, "", expected="a file", found="none of that name", remedy=_LOOK)
        raise ReadError(message, code="missing_export") from error
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
        kind, head = _odd_kind(path), b""
        if not kind:
            with path.open("rb") as stream:
                head = stream.read(size)
    if kind:
        remedy = "Name one of the files in it." if kind == "a folder" else "Name a plain file."
        raise unreadable(path, "", "a file", kind, remedy)
    if not head:
        remedy = "Save or export it again."
        raise unreadable(path, "", "a file with content", "an empty file (0 bytes)", remedy)
    return head


def _odd_kind(path: Path) -> str:
    """What a path is that is no plain file: reading a pipe would wait for ever."""
    if path.is_dir():
        return "a folder"
    return "a pipe or a device" if path.exists() and not path.is_file() else ""


def _first_line(error: BaseException) -> str:
    said = str(error).strip().splitlines()
    return said[0][:160] if said else type(error).__name__


@dataclass(frozen=True, slots=True)
class Content:
    r"""The bytes of a text export, in an encoding whose signs below 128 are ASCII.

    Parameters
    ----------
    data : without byte order mark, line ends made ``\n`` where they were ``\r`` alone
    encoding : of `data` where the file says it, empty where it does not
    written_in : encoding of the file where the file says it, for people
    as_in_file : whether these are the bytes of the file but for a byte order mark of UTF-8
    """

    data: bytes
    encoding: str = ""
    written_in: str = ""
    as_in_file: bool = False


def read_content(path: Path) -> Content:
    """Read a whole text export.

    Parameters
    ----------
    path : the export

    Raises
    ------
    ReadError
        If it cannot be read, or is empty.
    """
    read_head(path, 1)
    with reading(path, "a readable file"):
        data = path.read_bytes()
    return as_content(data)


def read_beginning(path: Path) -> Content:
    """Read the head of a text export, enough to recognise it."""
    return as_content(read_head(path, HEAD))


def as_content(data: bytes) -> Content:
    """Undo what would keep the bytes from being cut at line ends and separators.

    Parameters
    ----------
    data : as in the file

    Returns
    -------
    The content; UTF-16, with a byte order mark or without, is turned into UTF-8.
    """
    mark, encoding = next(((m, e) for m, e in _MARKS if data.startswith(m)), (b"", ""))
    plain = data[len(mark) :]
    encoding = encoding or _utf16(plain[:HEAD])
    same = not encoding.startswith("utf-16")
    if encoding.startswith("utf-16"):
        even = plain[: len(plain) // 2 * 2]
        plain = even.decode(encoding, errors="replace").encode("utf-8", errors="replace")
    if b"\n" not in plain[:HEAD] and b"\r" in plain[:HEAD]:
        plain, same = plain.replace(b"\r", b"\n"), False
    return Content(plain, "utf-8" if encoding else "", encoding, same)


def _utf16(head: bytes) -> str:
    """Detect UTF-16 without a byte order mark: nearly every second byte is NUL."""
    half = len(head) // 2
    if half < 2 or b"\0" not in head:
        return ""
    if head[1::2].count(0) > 0.9 * half and not head[::2].count(0):
        return "utf-16-le"
    if head[::2].count(0) > 0.9 * half and not head[1::2].count(0):
        return "utf-16-be"
    return ""


def is_blank(data: bytes) -> bool:
    """Check whether there is nothing but white space."""
    return not data[:HEAD].strip() and not data.strip()


def is_binary(content: Content) -> bool:
    """Check whether the head cannot be text."""
    return b"\0" in content.data[:HEAD]


def lines_of(text: str) -> list[str]:
    """Give the lines of a text without their ends."""
    return [line.rstrip("\r") for line in text.split("\n")]


def line_start(data: bytes, lines: int) -> int:
    """Find where the line with this number, counted from 0, begins."""
    at = 0
    for _ in range(lines):
        end = data.find(b"\n", at)
        if end < 0:
            return len(data)
        at = end + 1
    return at


def decode(data: bytes, content: Content, encodings: Sequence[str], path: Path) -> str:
    """Decode a part of an export.

    Parameters
    ----------
    data : the part, which may end in the middle of a sign
    content : it belongs to
    encodings : tried in order; ``detect`` leaves it open
    path : named in errors

    Returns
    -------
    The text.

    Raises
    ------
    ReadError
        If none of the encodings fits.
    """
    if content.encoding:
        return data.decode(content.encoding, errors="replace")
    for encoding in encodings:
        text = _detected(data) if encoding == "detect" else _strictly(data, encoding)
        if text is not None:
            return text
    expected = f"text in {' or '.join(encodings)}"
    remedy = "Name the encoding in a card of your own."
    raise unreadable(path, "", expected, "other bytes", remedy)


def _strictly(data: bytes, encoding: str) -> str | None:
    """Decode without a guess; a sign that the end cuts in two is left out."""
    try:
        return codecs.getincrementaldecoder(encoding)().decode(data, final=False)
    except UnicodeDecodeError:
        return None


def _detected(data: bytes) -> str | None:
    from charset_normalizer import from_bytes

    best = from_bytes(data).best()
    return None if best is None else str(best)
