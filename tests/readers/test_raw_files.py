"""Files as bytes and text, and what a file appears to be that no reader takes."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from labpipe.errors import ReadError
from labpipe.readers.raw_files import (
    as_content,
    decode,
    is_binary,
    read_head,
    reading,
)
from labpipe.readers.unknown_files import describe_unknown
from tests.approved import Approve


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
def test_encodings(encoding: str) -> None:
    content = as_content("Kraft\n1\n".encode(encoding))
    assert content.data == b"Kraft\n1\n"
    assert not is_binary(content)


def test_the_encoding_may_be_left_open() -> None:
    text = "Время испытания;Сила растяжения;Перемещение траверсы\n" * 20
    content = as_content(text.encode("cp1251"))
    assert decode(content.data, content, ("utf-8", "detect"), Path("a")) == text


def test_none_fits() -> None:
    content = as_content(b"\xff\xd6")
    with pytest.raises(
        ReadError, match=r"a\.csv: expected text in utf-8 or gb2312, found other by"
    ):
        decode(b"\xff\xd6\xff", content, ("utf-8", "gb2312"), Path("a.csv"))


def test_what_cannot_be_opened_is_named(tmp_path: Path, approved: Approve) -> None:
    """An absent file, a folder, an empty file, names that lead nowhere; no pipe is waited for."""
    (tmp_path / "empty.csv").touch()
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    os.mkfifo(tmp_path / "pipe")
    messages = []
    for name in ("absent.csv", ".", "empty.csv", "a" * 300, "loop", "pipe"):
        with pytest.raises(ReadError) as refused:
            read_head(tmp_path / name)
        messages.append(str(refused.value))
    with pytest.raises(ReadError) as refused, reading(tmp_path / "take.csv", "a file"):
        raise PermissionError
    approved([*messages, str(refused.value)])


CARD = "see docs/how-to/new-dialect.md."


@pytest.mark.parametrize(
    ("content", "words", "remedy"),
    [
        (
            b"\x02\x50" + bytes(600),
            "a C3D file (motion capture), which is recognised",
            "Export the",
        ),
        (b"\x89HDF\r\n\x1a\n" + bytes(600), "an HDF5 file that is no ControlDesk export", "Export"),
        (b"PK\x03\x04rest", "a workbook without a table of time and force or travel", "If a test"),
        (b"MDF     3.30", "an MDF file of a version other than 4", "Export the recording"),
        (b"TDSm" + bytes(40), "a TDMS file (LabVIEW)", "Export it as text or as a workbook"),
        (b"LabVIEW Measurement\t\n", "an LVM file (LabVIEW)", "If a testing machine's program"),
        (b"\x1f\x8b\x08" + bytes(40), "a packed file (gzip)", "Unpack it, and name the export in"),
        (b'\xef\xbb\xbf<?xml version="1.0"?><a/>', "XML", "Export the recording"),
        (b"\n {}", "JSON", "Export the recording"),
        (b"\x01\x00\x02", "binary data of an unknown kind", "Export the recording"),
        (b"Dear Sir,\n\nthe force\n", "text that begins with 'Dear Sir,'", "Export the recording"),
        (b"\n \n", "nothing but blanks", "Export the recording"),
    ],
)
def test_what_a_file_appears_to_be(tmp_path: Path, content: bytes, words: str, remedy: str) -> None:
    file = tmp_path / "file.dat"
    file.write_bytes(content)
    stranger = describe_unknown(file)
    assert stranger.what.startswith(words)
    assert stranger.remedy.startswith(remedy)


TABLES = {
    "a table of 2 columns separated by commas, called 'a', 'b'": "a,b\n1,2\n3,4\n",
    "a table of 3 columns separated by semicolons, called 'x', 'y', 'z'": (
        "p\n\nx;y;z\n1,5;2;\n3;4;5"
    ),
    "a table of 2 columns separated by tabs, without names": "1\t2\n3\t4\n",
    "a table of 3 columns separated by blanks, without names": "  1  2 3\n 4 5  6\n",
    "a table of 5 columns separated by commas, called 'a', 'b', 'c', 'd' ...": (
        "a,b,c,d,e\n1,2,3,4,5\n1,2,3,4,5\n"
    ),
}


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
@pytest.mark.parametrize("what", TABLES)
def test_a_table_is_described(tmp_path: Path, what: str, encoding: str) -> None:
    file = tmp_path / "table.csv"
    file.write_bytes(TABLES[what].encode(encoding))
    stranger = describe_unknown(file)
    assert stranger.what == what
    assert stranger.remedy.startswith("A table is known by its names and units: time, and force ")
    assert stranger.remedy.endswith(CARD)


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("tdms/DG1_u1.tdms", "a TDMS file"),
        ("lvm/with_comments.lvm", "an LVM file"),
        ("qtm/mocap.tsv", "a TSV file of Qualisys"),
        ("c3d/sprintbasket.c3d", "a C3D file"),
        ("harness/topology.vec", "XML"),
    ],
)
def test_real_strangers(realdata: Path, name: str, words: str) -> None:
    assert describe_unknown(realdata / name).what.startswith(words)
