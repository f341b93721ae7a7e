from __future__ import annotations

from pathlib import Path

import pytest

from labpipe.readers.strangers import name_format


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"\x02\x50" + bytes(600), "a C3D file (motion capture), which is recognised but not"),
        (b"\x89HDF\r\n\x1a\n" + bytes(600), "an HDF5 file that is no ControlDesk export"),
        (b"PK\x03\x04rest", "a zip archive or workbook without a table that labpipe knows"),
        (b"MDF     3.30", "an MDF file of a version other than 4"),
        ("t;F".encode("utf-16"), "text in UTF-16"),
        (b"\x01\x00\x02", "binary data of an unknown kind"),
        (b"time;force\n1;2\n", "text that begins with 'time;force'"),
        (b"\n \n", "nothing but blanks"),
    ],
)
def test_what_a_file_appears_to_be(tmp_path: Path, content: bytes, words: str) -> None:
    file = tmp_path / "file.dat"
    file.write_bytes(content)
    assert name_format(file).startswith(words)
