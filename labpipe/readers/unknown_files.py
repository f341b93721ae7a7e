"""Description of files of unknown formats, and what to do with them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from labpipe.readers.raw_files import as_content, is_binary, lines_of, read_head
from labpipe.readers.text_cells import is_sample, split_line
from labpipe.readers.workbooks import is_locked

_EXPORT_KNOWN = "Export the recording in one of these formats."
_UNPACK = "Unpack it, and name the export in it."
_WRITE_CARD = (
    "If a testing machine's program wrote it, a card of a dozen lines makes labpipe read it: see"
    " docs/how-to/new-dialect.md."
)
_SAVE_AS_CSV = "Save it as csv with names and units."
_BY_FIRST_BYTES = (
    (b"\x89HDF\r\n\x1a\n", "an HDF5 file that is no ControlDesk export", _EXPORT_KNOWN),
    (b"PK\x03\x04", "a workbook without a table of time and force or travel", _WRITE_CARD),
    (b"\xd0\xcf\x11\xe0", "an old workbook (xls) without a table of time and force", _WRITE_CARD),
    (b"MDF     ", "an MDF file of a version other than 4", _EXPORT_KNOWN),
    (b"TDSm", "a TDMS file (LabVIEW)", _SAVE_AS_CSV),
    (b"LabVIEW Measurement", "an LVM file (LabVIEW)", _WRITE_CARD),
    (b"NO_OF_FRAMES", "a TSV file of Qualisys (motion capture)", _EXPORT_KNOWN),
    (b"PathFileType", "a TRC file (motion capture)", _EXPORT_KNOWN),
    (b"\x1f\x8b", "a packed file (gzip)", _UNPACK),
    (b"7z\xbc\xaf\x27\x1c", "a packed file (7z)", _UNPACK),
    (b"Rar!", "a packed file (rar)", _UNPACK),
    (b"%PDF", "a PDF document", _EXPORT_KNOWN),
    (b"\x89PNG", "a picture", _EXPORT_KNOWN),
    (b"\xff\xd8\xff", "a picture", _EXPORT_KNOWN),
    (b"\x93NUMPY", "an array of numpy", _SAVE_AS_CSV),
    (b"PAR1", "a Parquet file", _SAVE_AS_CSV),
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
    content = as_content(head)
    if is_binary(content):
        return UnknownFile("binary data of an unknown kind", _EXPORT_KNOWN)
    lines = lines_of(content.data.decode("utf-8", errors="replace"))
    first_line = next((line.strip()[:40] for line in lines if line.strip()), "")
    if any(_has_table(lines, separator) for separator in "\t;, "):
        return UnknownFile(f"a table that begins with '{first_line}'", _WRITE_CARD)
    return UnknownFile(f"text that begins with '{first_line}'", _EXPORT_KNOWN)


def _has_table(lines: Sequence[str], separator: str) -> bool:
    """Return whether two successive lines hold several numbers each."""
    rows = ([cell for cell in split_line(line, separator) if cell.strip()] for line in lines)
    are_samples = (len(row) > 1 and is_sample(row) for row in rows)
    return any(one and two for one, two in pairwise(are_samples))
