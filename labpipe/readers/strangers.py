"""Formats that labpipe knows by sight but does not read, so that an error can name them."""

from __future__ import annotations

from pathlib import Path

from labpipe.readers.files import read_head

_BY_FIRST_BYTES = (
    (b"\x89HDF\r\n\x1a\n", "an HDF5 file that is no ControlDesk export"),
    (b"PK\x03\x04", "a zip archive or workbook without a table that labpipe knows"),
    (b"\xd0\xcf\x11\xe0", "an old binary workbook (xls) without a table that labpipe knows"),
    (b"\xff\xfe", "text in UTF-16 without a table that labpipe knows"),
    (b"\xfe\xff", "text in UTF-16 without a table that labpipe knows"),
    (b"MDF     ", "an MDF file of a version other than 4"),
    (b"%PDF", "a PDF document"),
)


def name_format(path: Path) -> str:
    """Say in words what a file that no reader takes appears to be.

    Parameters
    ----------
    path : the file

    Returns
    -------
    What it is, such as ``a C3D file, which is recognised but not read``.
    """
    head = read_head(path, 4096)
    if len(head) >= 512 and head[1] == 0x50 and 0 < head[0] < 64:
        return "a C3D file (motion capture), which is recognised but not read"
    for first, what in _BY_FIRST_BYTES:
        if head.startswith(first):
            return what
    if b"\0" in head:
        return "binary data of an unknown kind"
    first_line = head.decode("utf-8", errors="replace").strip().splitlines()[:1]
    return f"text that begins with '{first_line[0][:40]}'" if first_line else "nothing but blanks"
