"""Description of files of unknown formats, and what to do with them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from labpipe.readers.raw_files import Content, as_content, lines_of, read_head
from labpipe.readers.text_cells import is_sample, split_line
from labpipe.readers.workbooks import is_locked

_EXPORT_KNOWN = "Export the recording in one of these formats."
_UNPACK_REMEDY = "Unpack it, and name the export in it."
_CARD_REMEDY = (
    "If a testing machine's program wrote it, a card of a dozen lines makes labpipe read it: see"
    " docs/how-to/new-dialect.md."
)
_KNOWN_BY = "A table is known by its names and units: time, and force or travel."
_BY_FIRST_BYTES = (
    (b"\x89HDF\r\n\x1a\n", "an HDF5 file that is no ControlDesk export", _EXPORT_KNOWN),
    (b"PK\x03\x04", "a workbook without a table of time and force or travel", _CARD_REMEDY),
    (
        b"\xd0\xcf\x11\xe0",
        "an old workbook (xls) without a table of time and force",
        _CARD_REMEDY,
    ),
    (b"MDF     ", "an MDF file of a version other than 4", _EXPORT_KNOWN),
    (b"TDSm", "a TDMS file (LabVIEW)", "Export it as text or as a workbook, with names and units."),
    (b"LabVIEW Measurement", "an LVM file (LabVIEW)", _CARD_REMEDY),
    (b"NO_OF_FRAMES", "a TSV file of Qualisys (motion capture)", _EXPORT_KNOWN),
    (b"PathFileType", "a TRC file (motion capture)", "Export the take as csv."),
    (b"\x1f\x8b", "a packed file (gzip)", _UNPACK_REMEDY),
    (b"7z\xbc\xaf\x27\x1c", "a packed file (7z)", _UNPACK_REMEDY),
    (b"Rar!", "a packed file (rar)", _UNPACK_REMEDY),
    (b"%PDF", "a PDF document", _EXPORT_KNOWN),
    (b"\x89PNG", "a picture", _EXPORT_KNOWN),
    (b"\xff\xd8\xff", "a picture", _EXPORT_KNOWN),
    (b"\x93NUMPY", "an array of numpy", "Save it as csv with names and units."),
    (b"PAR1", "a Parquet file", "Save it as csv with names and units."),
    (b"<?xml", "XML", _EXPORT_KNOWN),
    (b"{", "JSON", _EXPORT_KNOWN),
)


class UnknownFile(NamedTuple):
    """A file of an unknown format.

    Parameters
    ----------
    what : its kind, such as ``a C3D file (motion capture)``
    remedy : what to do
    """

    what: str
    remedy: str


def describe_unknown(path: Path) -> UnknownFile:
    """Describe a file of an unknown format.

    Parameters
    ----------
    path : the file
    """
    head = read_head(path)
    if len(head) >= 512 and head[1] == 0x50 and 0 < head[0] < 64:
        return UnknownFile(
            "a C3D file (motion capture), which is recognised but not read", _EXPORT_KNOWN
        )
    if is_locked(path):
        return UnknownFile("a workbook with a password", "Save a copy of it without a password.")
    for first, what, remedy in _BY_FIRST_BYTES:
        if head.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(first):
            return UnknownFile(what, remedy)
    return _describe_content(as_content(head))


def _describe_content(content: Content) -> UnknownFile:
    if b"\0" in content.data:
        return UnknownFile("binary data of an unknown kind", _EXPORT_KNOWN)
    lines = lines_of(content.data.decode("utf-8", errors="replace"))
    first = next((line.strip() for line in lines if line.strip()), "")
    if not first:
        return UnknownFile("nothing but blanks", _EXPORT_KNOWN)
    if any(_has_table(lines, separator) for separator in "\t;, "):
        return UnknownFile(
            f"a table that begins with '{first[:40]}'", f"{_KNOWN_BY} {_CARD_REMEDY}"
        )
    return UnknownFile(f"text that begins with '{first[:40]}'", _EXPORT_KNOWN)


def _has_table(lines: Sequence[str], separator: str) -> bool:
    """Return whether two successive lines hold several numbers each."""
    rows = ([cell for cell in split_line(line, separator) if cell.strip()] for line in lines)
    are_samples = (len(row) > 1 and is_sample(row) for row in rows)
    return any(one and two for one, two in pairwise(are_samples))
