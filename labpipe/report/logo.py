"""The logo of a report: a picture read into the page, or one message that says why not."""

from __future__ import annotations

import base64
from io import BytesIO
from pathlib import Path

from labpipe.errors import UsageError, error_text

_MOST_BYTES = 200_000
_MOST_PIXELS = 4_000_000
_KINDS = {"PNG": "image/png", "JPEG": "image/jpeg"}


def read_logo(path: Path) -> str:
    """Read a picture for page one.

    Parameters
    ----------
    path : a PNG or a JPEG

    Returns
    -------
    The picture as a ``data:`` address.

    Raises
    ------
    UsageError
        If it cannot be read, is none of these, is damaged, or too large for a page that is mailed.
    """
    try:
        if not path.is_file():
            raise _refused(path, "a folder or a device" if path.exists() else "nothing there")
        size = path.stat().st_size
        content = path.read_bytes() if size <= _MOST_BYTES else b""
    except OSError as error:
        raise _refused(path, error.strerror or "a file that cannot be read") from error
    if not content:
        raise _refused(path, f"{size} bytes")
    return f"data:{_KINDS[_kind(path, content)]};base64,{base64.b64encode(content).decode()}"


def _kind(path: Path, content: bytes) -> str:
    """Format of a whole picture."""
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(BytesIO(content), formats=tuple(_KINDS)) as picture:
            kind, pixels = str(picture.format), picture.width * picture.height
            if pixels > _MOST_PIXELS:
                raise _refused(path, f"a picture of {picture.width} x {picture.height} points")
            picture.load()
    except UnidentifiedImageError as error:
        raise _refused(path, "a file that is no such picture") from error
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise _refused(path, f"a damaged picture ({error})") from error
    return kind


def _refused(path: Path, found: str) -> UsageError:
    expected = f"a picture, PNG or JPEG, of at most {_MOST_BYTES // 1000} kB"
    remedy = "Save the logo as PNG, about 600 points wide, or leave --logo away."
    return UsageError(error_text(path, "", expected=expected, found=found, remedy=remedy))
