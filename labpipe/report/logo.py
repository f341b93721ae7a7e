"""Logo of a report as a picture in the page."""

from __future__ import annotations

import base64
from io import BytesIO
from pathlib import Path

from labpipe.errors import UsageError, error_text

_MAX_LOGO_BYTES = 200_000
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
        If it cannot be read, has another format, is damaged or too large for a mailed page.
    """
    try:
        if not path.is_file():
            raise _logo_error(path, "a folder or a device" if path.exists() else "nothing there")
        size = path.stat().st_size
        content = path.read_bytes() if size <= _MAX_LOGO_BYTES else b""
    except OSError as error:
        raise _logo_error(path, error.strerror or "a file that cannot be read") from error
    if not content:
        raise _logo_error(path, f"{size} bytes")
    return (
        f"data:{_KINDS[_picture_format(path, content)]};base64,{base64.b64encode(content).decode()}"
    )


def _picture_format(path: Path, content: bytes) -> str:
    """Return the format of a complete picture."""
    max_pixels = 4_000_000
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(BytesIO(content), formats=tuple(_KINDS)) as picture:
            picture_format, pixels = str(picture.format), picture.width * picture.height
            if pixels > max_pixels:
                raise _logo_error(path, f"a picture of {picture.width} x {picture.height} points")
            picture.load()
    except UnidentifiedImageError as error:
        raise _logo_error(path, "a file of another format") from error
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise _logo_error(path, f"a damaged picture ({error})") from error
    return picture_format


def _logo_error(path: Path, content: str) -> UsageError:
    expected = f"a picture, PNG or JPEG, of at most {_MAX_LOGO_BYTES // 1000} kB"
    remedy = "Save the logo as PNG, about 600 points wide, or omit --logo."
    return UsageError(error_text(path, "", expected=expected, found=content, remedy=remedy))
