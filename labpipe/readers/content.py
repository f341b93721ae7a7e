"""Text exports as bytes: byte order marks, UTF-16, and what the rest is encoded in."""

from __future__ import annotations

import codecs
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from labpipe.readers.files import read_head, reading, unreadable

HEAD = 65536
"""Bytes in which the header of an export is looked for."""

_MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)


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
    """Tell UTF-16 without a byte order mark: nearly every second byte is NUL."""
    half = len(head) // 2
    if half < 2 or b"\0" not in head:
        return ""
    if head[1::2].count(0) > 0.9 * half and not head[::2].count(0):
        return "utf-16-le"
    if head[::2].count(0) > 0.9 * half and not head[1::2].count(0):
        return "utf-16-be"
    return ""


def is_blank(data: bytes) -> bool:
    """Tell whether there is nothing but white space."""
    return not data[:HEAD].strip() and not data.strip()


def is_binary(content: Content) -> bool:
    """Tell whether the head cannot be text."""
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
