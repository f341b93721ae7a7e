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
    """Error of the content of a file, which `add_file_name` converts to a `ReadError`.

    The arguments of the error are those of `ReadError.about` without the file.
    """

    @classmethod
    def of(cls, name: str, place: str = "", /, **facts: object) -> Self:
        """Make an error from a template, as `ReadError.about` does."""
        return cls(name, place, facts)


def require(condition: bool, message: str) -> None:
    """Raise ValueError if a condition on the content of a file is not fulfilled."""
    if not condition:
        raise ValueError(message)


@contextmanager
def add_file_name(path: Path) -> Iterator[None]:
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
def map_read_errors(path: Path, content: str, *, remedy: str = _EXPORT_AGAIN) -> Iterator[None]:
    """Convert errors of opening or parsing a file to a `ReadError` that names the file.

    Parameters
    ----------
    path : the export
    content : expected content, such as ``a whole MAT v5 file``
    remedy : what the operator can do

    Raises
    ------
    ReadError
        For every error. Libraries raise errors of any class for damaged files. A `LabpipeError`
        passes unchanged.
    """
    try:
        with add_file_name(path):
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
        text = re.sub(r"'?<\S+ object at 0x\w+>'?", "the file", str(error).strip())
        reason = (text.splitlines() or [type(error).__name__])[0][:160]
        facts = {"content": content, "reason": reason, "remedy": remedy}
        raise ReadError.about("readers.damaged", path, **facts) from error


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
    with map_read_errors(path, "a readable file"):
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
    data : bytes without byte order mark; ``\r`` is replaced by ``\n`` if the head has no ``\n``
    encoding : encoding of `data`: ``utf-8`` if `file_encoding` is known, else empty
    file_encoding : encoding of the file if a byte order mark or NUL bytes show it, else empty
    """

    data: bytes
    encoding: str = ""
    file_encoding: str = ""


def read_content(path: Path) -> Content:
    """Read a whole text export.

    Parameters
    ----------
    path : the export

    Raises
    ------
    ReadError
        If the file cannot be read, or is empty.
    """
    read_head(path, 1)
    with map_read_errors(path, "a readable file"):
        data = path.read_bytes()
    return normalise_content(data)


def normalise_content(data: bytes) -> Content:
    """Normalise encoding, line ends and numbers, so that the bytes can be split into cells.

    Parameters
    ----------
    data : bytes of the file

    Returns
    -------
    The content. UTF-16, with or without a byte order mark, is converted to UTF-8. Half a UTF-16
    unit at the end is omitted. A minus sign becomes a hyphen, and ``1.5D+02`` becomes ``1.5E+02``.
    """
    mark, encoding = next(((m, e) for m, e in _BYTE_ORDER_MARKS if data.startswith(m)), (b"", ""))
    text_bytes = data[len(mark) :]
    encoding = encoding or _detect_utf16(text_bytes[:HEAD_BYTES])
    if encoding.startswith("utf-16"):
        pairs = text_bytes[: len(text_bytes) // 2 * 2]
        text_bytes = pairs.decode(encoding, errors="replace").encode("utf-8", errors="replace")
    if b"\n" not in text_bytes[:HEAD_BYTES] and b"\r" in text_bytes[:HEAD_BYTES]:
        text_bytes = text_bytes.replace(b"\r", b"\n")
    text_bytes = text_bytes.replace(_MINUS_SIGN, b"-")
    # The pattern of a number is slow. It is needed only if an exponent occurs up to the last D.
    search_end = max(map(text_bytes.rfind, (b"D", b"d"))) + 5
    exponents = _BARE_D_EXPONENT.finditer(text_bytes, 0, search_end)
    if any(_D_EXPONENT.search(text_bytes, max(x.start() - 40, 0), x.end()) for x in exponents):
        text_bytes = _D_EXPONENT.sub(rb"\1E\2", text_bytes)
    return Content(text_bytes, "utf-8" if encoding else "", encoding)


def _detect_utf16(head: bytes) -> str:
    """Detect UTF-16 without a byte order mark, and return an empty text for another encoding.

    In UTF-16, every second byte is the high byte of a character. Of these, more than 90 % are NUL,
    while no low byte is.
    """
    even_bytes, odd_bytes = head[::2], head[1::2]
    pairs = {"utf-16-le": (even_bytes, odd_bytes), "utf-16-be": (odd_bytes, even_bytes)}
    for encoding, (low_bytes, high_bytes) in pairs.items():
        if len(head) > 3 and high_bytes.count(0) > 0.9 * len(odd_bytes) and not low_bytes.count(0):
            return encoding
    return ""


def is_blank(data: bytes) -> bool:
    """Return whether all bytes are white space."""
    return not data[:HEAD_BYTES].strip() and not data.strip()


def is_binary(content: Content) -> bool:
    """Return whether the head contains a NUL byte, which no text contains."""
    return b"\0" in content.data[:HEAD_BYTES]


def split_lines(text: str) -> list[str]:
    """Split a text into lines without line ends."""
    return [line.rstrip("\r") for line in text.split("\n")]


def decode(data: bytes, content: Content, encodings: Sequence[str]) -> str:
    """Decode a part of an export.

    Parameters
    ----------
    data : bytes of the part, which may end within a character
    content : the whole export
    encodings : encodings that are tried in this order if `content` states no encoding; ``detect``
        detects the encoding

    Returns
    -------
    The text.

    Raises
    ------
    ContentError
        If `content` states no encoding, and none of `encodings` fits.
    """
    if content.encoding:
        return data.decode(content.encoding, errors="replace")
    for encoding in encodings:
        if encoding == "detect":
            from charset_normalizer import from_bytes

            match = from_bytes(data).best()
            # A lone byte, such as the micro sign in cp1252, is not half of a Chinese character.
            is_chinese = match is not None and max(str(match)) >= "\u2e80"
            is_readable = match is not None and "0".encode(match.encoding) == b"0"  # like ASCII
            if is_readable and (not is_chinese or re.search(rb"[\x80-\xff]{2}", data)):
                return str(match)
        else:
            with suppress(UnicodeDecodeError):  # an incomplete character at the end is omitted
                return codecs.getincrementaldecoder(encoding)().decode(data, final=False)
    raise ContentError.of("readers.encoding", encodings=" or ".join(encodings))
