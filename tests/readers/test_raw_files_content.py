from __future__ import annotations

from pathlib import Path

import pytest

from labpipe.errors import ReadError
from labpipe.readers.raw_files import (
    as_content,
    decode,
    is_binary,
    line_start,
    lines_of,
    read_content,
)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
def test_encodings(encoding: str) -> None:
    content = as_content("Kraft\n1\n".encode(encoding))
    assert content.data == b"Kraft\n1\n"
    assert not is_binary(content)


def test_old_line_ends() -> None:
    assert as_content(b"a\r1\r").data == b"a\n1\n"


def test_other_bytes_are_binary() -> None:
    assert is_binary(as_content(bytes(range(200)) * 4))


def test_half_a_sign_at_the_end_is_left_out() -> None:
    content = as_content("Größe".encode())
    assert decode(content.data[:3], content, ("utf-8",), Path("a")) == "Gr"


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


def test_an_empty_file(tmp_path: Path) -> None:
    (tmp_path / "a.csv").touch()
    with pytest.raises(
        ReadError, match=r"a\.csv: expected a file with content, found an empty file"
    ):
        read_content(tmp_path / "a.csv")


def test_where_lines_begin() -> None:
    assert [line_start(b"a\nbc\nd", number) for number in range(4)] == [0, 2, 5, 6]
    assert lines_of("a\r\nb") == ["a", "b"]
