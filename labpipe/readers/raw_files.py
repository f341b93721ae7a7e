"""Read bytes, encoding and lines of raw files; convert errors of libraries to `ReadError`."""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from labpipe.errors import LabpipeError, ReadError

_EXPORT_AGAIN = "Export the recording again; the file may have been cut off while copying."
HEAD_BYTES = 65536
"""Bytes in which the header of an export is searched."""
_BYTE_ORDER_MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)


class ContentError(ValueError):
    """Content of a file that cannot be read; `naming_file` converts it to a `ReadError`.

    Its arguments are those of `ReadError.about` without the file.
    """

    @classmethod
    def of(cls, name: str, place: str = "", /, **facts: object) -> Self:
        """Make an error from a template; see `ReadError.about`."""
        return cls(name, place, facts)


@contextmanager
def naming_file(path: Path) -> Iterator[None]:
    """Convert a `ContentError` to a `ReadError` that names the file.

    Parameters
    ----------
    path : the export
    """
    try:
        yield
    except ContentError as error:
        name, place, facts = error.args
        raise ReadError.about(name, path, place, **facts) from error.__cause__


@contextmanager
def reading(path: Path, content: str, *, remedy: str = _EXPORT_AGAIN) -> Iterator[None]:
    """Convert errors of a format library, or of opening, to a `ReadError` that names the file.

    Parameters
    ----------
    path : the export
    content : expected content, such as ``a whole MAT v5 file``
    remedy : what the operator can do

    Raises
    ------
    ReadError
        Instead of every error, as libraries raise errors of any class for damaged files. A
        `LabpipeError` is not converted.
    """
    try:
        with naming_file(path):
            yield
    except LabpipeError:
        raise
    except FileNotFoundError as error:
        raise ReadError.about("readers.no_such_file", path) from error
    except PermissionError as error:
        raise ReadError.about("readers.not_permitted", path) from error
    except Exception as error:
        if isinstance(error, OSError) and error.filename is not None:
            raise ReadError.about("readers.cannot_open", path, reason=error.strerror) from error
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0][:160]
        raise ReadError.about(
            "readers.damaged", path, content=content, reason=reason, remedy=remedy
        ) from error


def read_head(path: Path, size: int = HEAD_BYTES) -> bytes:
    """Read the first bytes of an export.

    Parameters
    ----------
    path : the export
    size : maximum number of bytes

    Returns
    -------
    The bytes.

    Raises
    ------
    ReadError
        If the file does not exist, is a folder, a pipe or a device, is not readable, or is empty.
    """
    with reading(path, "a readable file"):
        if path.is_dir():
            raise ReadError.about("readers.folder", path)
        if path.exists() and not path.is_file():  # reading a pipe would block
            raise ReadError.about("readers.no_plain_file", path)
        with path.open("rb") as stream:
            head = stream.read(size)
    if not head:
        raise ReadError.about("readers.empty_file", path)
    return head


_MINUS_SIGN = "\u2212".encode()
_BARE_D_EXPONENT = re.compile(rb"[Dd][+-]\d{2,3}(?!\w)")
_D_EXPONENT = re.compile(rb"(?<![\w.])([+-]?\d*[.,]\d+)[Dd]([+-]\d{2,3})(?!\w)")


@dataclass(frozen=True, slots=True)
class Content:
    r"""The bytes of a text export, in an encoding compatible with ASCII.

    Parameters
    ----------
    data : without byte order mark; ``\r`` replaced by ``\n`` if the head has no ``\n``
    encoding : of `data`: ``utf-8`` if a byte order mark or NUL bytes show the encoding of the file,
        else empty
    written_in : encoding of the file if they show it, else empty; for messages
    """

    data: bytes
    encoding: str = ""
    written_in: str = ""


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
    return normalise_content(data)


def normalise_content(data: bytes) -> Content:
    """Normalise encoding and line ends, so that the bytes can be split into cells.

    Parameters
    ----------
    data : as in the file

    Returns
    -------
    The content; UTF-16, with or without a byte order mark, is converted to UTF-8. Half a UTF-16
    unit at the end is omitted. A minus sign is a hyphen, and ``1.5D+02`` is ``1.5E+02``.
    """
    mark, encoding = next(((m, e) for m, e in _BYTE_ORDER_MARKS if data.startswith(m)), (b"", ""))
    text_bytes = data[len(mark) :]
    encoding = encoding or _detect_utf16(text_bytes[:HEAD_BYTES])
    if encoding.startswith("utf-16"):
        even = text_bytes[: len(text_bytes) // 2 * 2]
        text_bytes = even.decode(encoding, errors="replace").encode("utf-8", errors="replace")
    if b"\n" not in text_bytes[:HEAD_BYTES] and b"\r" in text_bytes[:HEAD_BYTES]:
        text_bytes = text_bytes.replace(b"\r", b"\n")
    text_bytes = text_bytes.replace(_MINUS_SIGN, b"-")
    # The pattern of a number is slow. It is needed only if an exponent occurs up to the last D.
    end = max(map(text_bytes.rfind, (b"D", b"d"))) + 5
    exponents = _BARE_D_EXPONENT.finditer(text_bytes, 0, end)
    if any(_D_EXPONENT.search(text_bytes, max(x.start() - 40, 0), x.end()) for x in exponents):
        text_bytes = _D_EXPONENT.sub(rb"\1E\2", text_bytes)
    return Content(text_bytes, "utf-8" if encoding else "", encoding)


def _detect_utf16(head: bytes) -> str:
    """Detect UTF-16 without a byte order mark; return an empty text for another encoding.

    Of every second byte, more than 90 % are NUL; of the others, none.
    """
    for encoding, letters, zeros in (
        ("utf-16-le", head[::2], head[1::2]),
        ("utf-16-be", head[1::2], head[::2]),
    ):
        if len(head) > 3 and zeros.count(0) > 0.9 * (len(head) // 2) and not letters.count(0):
            return encoding
    return ""


def is_blank(data: bytes) -> bool:
    """Return whether all bytes are white space."""
    return not data[:HEAD_BYTES].strip() and not data.strip()


def is_binary(content: Content) -> bool:
    """Return whether the head contains a NUL byte, which text does not."""
    return b"\0" in content.data[:HEAD_BYTES]


def split_lines(text: str) -> list[str]:
    """Split a text into lines without line ends."""
    return [line.rstrip("\r") for line in text.split("\n")]


def skip_lines(data: bytes, number: int) -> bytes:
    """Return the lines after the first `number` ones; empty if there are fewer."""
    parts = data.split(b"\n", number)
    return parts[number] if len(parts) > number else b""


def decode(data: bytes, content: Content, encodings: Sequence[str]) -> str:
    """Decode a part of an export.

    Parameters
    ----------
    data : the part, which may end within a character
    content : the whole export
    encodings : tried in order if `content` has no encoding; ``detect`` detects the encoding

    Returns
    -------
    The text.

    Raises
    ------
    ContentError
        If `content` has no encoding, and none of `encodings` fits.
    """
    if content.encoding:
        return data.decode(content.encoding, errors="replace")
    for encoding in encodings:
        if encoding == "detect":
            from charset_normalizer import from_bytes

            match = from_bytes(data).best()
            # A lone byte, such as the micro sign in cp1252, is not half of a Chinese character.
            is_chinese = match is not None and max(str(match)) >= "\u2e80"
            if match is not None and (not is_chinese or re.search(rb"[\x80-\xff]{2}", data)):
                return str(match)
        else:
            with suppress(UnicodeDecodeError):  # a character cut at the end is omitted
                return codecs.getincrementaldecoder(encoding)().decode(data, final=False)
    raise ContentError.of("readers.encoding", encodings=" or ".join(encodings))
