from __future__ import annotations

import base64
from io import BytesIO
from pathlib import Path

import pytest
from PIL import Image

from labpipe.errors import UsageError
from labpipe.report.logo import read_logo


def picture(kind: str, size: tuple[int, int] = (30, 10)) -> bytes:
    file = BytesIO()
    Image.new("RGB", size).save(file, kind)
    return file.getvalue()


@pytest.mark.parametrize("kind", ["PNG", "JPEG"])
def test_a_picture_is_read_into_the_page(kind: str, tmp_path: Path) -> None:
    content = picture(kind)
    (tmp_path / "logo").write_bytes(content)
    head, _, data = read_logo(tmp_path / "logo").partition(",")
    assert head == f"data:image/{kind.lower()};base64"
    assert base64.b64decode(data) == content


def test_what_is_no_picture_is_one_message(tmp_path: Path) -> None:
    for content, fault in (
        (b"<svg onload='x'/>", "a file of another format"),
        (b"", "0 bytes"),
        (picture("GIF"), "a file of another format"),
        (picture("PNG")[:45], "a damaged picture"),
        (picture("PNG", (3000, 3000)), "a picture of 3000 x 3000 points"),
        (b"\x89PNG" + bytes(300_000), "300004 bytes"),
    ):
        (tmp_path / "logo").write_bytes(content)
        with pytest.raises(UsageError, match=f"expected a picture, PNG or JPEG, .*found {fault}"):
            read_logo(tmp_path / "logo")
    with pytest.raises(UsageError, match="found nothing there"):
        read_logo(tmp_path / "none")
    with pytest.raises(UsageError, match="found a folder or a device"):
        read_logo(tmp_path)
