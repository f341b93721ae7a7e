"""Files as bytes and text, and what a file appears to be that no reader takes."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from labpipe.errors import ReadError
from labpipe.readers import describe_unknown
from labpipe.readers.raw_files import (
    add_file_name,
    decode,
    is_binary,
    map_read_errors,
    normalise_content,
    read_head,
)
from tests.approved import Approve


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
def test_encodings(encoding: str) -> None:
    content = normalise_content("Kraft\n1\n".encode(encoding))
    assert content.data == b"Kraft\n1\n"
    assert not is_binary(content)


def test_signs_and_exponents_of_other_programs() -> None:
    text = "A1.5D-02\n\u22121.5D+02,-.5d-10;+2,5D+100 3D-12\n"
    expected = b"A1.5D-02\n-1.5E+02,-.5E-10;+2,5E+100 3D-12\n"
    for encoding in ("utf-8", "utf-16"):
        assert normalise_content(text.encode(encoding)).data == expected


def test_the_encoding_may_be_left_open() -> None:
    text = "Время испытания;Сила растяжения;Перемещение траверсы\n" * 20
    content = normalise_content(text.encode("cp1251"))
    assert decode(content.data, content, ("utf-8", "detect")) == text
    content = normalise_content("Time (s),Force (N)\n1,2\n".encode("cp500"))
    with pytest.raises(ReadError, match="other bytes"), add_file_name(Path("a.csv")):
        decode(content.data, content, ("utf-8", "detect"))
    content = normalise_content(b"\xff\xd6")
    expected = r"a\.csv: expected text in utf-8 or gb2312, found other by"
    with pytest.raises(ReadError, match=expected), add_file_name(Path("a.csv")):
        decode(b"\xff\xd6\xff", content, ("utf-8", "gb2312"))


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
    with pytest.raises(ReadError) as refused, map_read_errors(tmp_path / "take.csv", "a file"):
        raise PermissionError
    approved([*messages, str(refused.value)])


STRANGERS = [
    b"\x02\x50" + bytes(600),
    b"\x89HDF\r\n\x1a\n" + bytes(600),
    b"PK\x03\x04rest",
    b"MDF     3.30",
    b"TDSm" + bytes(40),
    b"LabVIEW Measurement\t\n",
    b"\x1f\x8b\x08" + bytes(40),
    b'\xef\xbb\xbf<?xml version="1.0"?><a/>',
    b"\n {}",
    b"\x01\x00\x02",
    b"Dear Sir,\n\nthe force\n",
    b"\n \n",
]
TABLES = [
    "a,b\n1,2\n3,4\n",
    "p\n\nx;y;z\n1,5;2;\n3;4;5",
    "1\t2\n3\t4\n",
    "  1  2 3\n 4 5  6\n",
    "a,b,c,d,e\n1,2,3,4,5\n1,2,3,4,5\n",
]


def test_what_a_file_appears_to_be(tmp_path: Path, approved: Approve) -> None:
    def described(content: bytes) -> str:
        (tmp_path / "file.dat").write_bytes(content)
        stranger = describe_unknown(tmp_path / "file.dat")
        return f"{stranger.kind}. {stranger.remedy}"

    tables = [described(text.encode()) for text in TABLES]
    assert tables == [described(text.encode("utf-16")) for text in TABLES]
    approved([*map(described, STRANGERS), *tables])


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
    assert describe_unknown(realdata / name).kind.startswith(words)
