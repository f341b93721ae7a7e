"""Types of the words in YAML: text, names of files, names of channels."""

from __future__ import annotations

import re
from pathlib import PurePosixPath, PureWindowsPath
from typing import Annotated, Final
from unicodedata import category

from pydantic import BeforeValidator, WithJsonSchema

from labpipe.protocol.faults import error_of

_UNSAID: Final = frozenset({"Cc", "Cs"})
"""Control signs and halves of signs, which no file system takes."""


def _text(value: object) -> str:
    """Take text, and the numbers that other YAML readers make of unquoted text such as 1."""
    if isinstance(value, bool) or not isinstance(value, str | int | float) or not str(value):
        raise error_of(expected="text", found=value)
    return str(value)


def _word(pattern: str, meaning: str) -> BeforeValidator:
    def check(value: object) -> str:
        if re.fullmatch(pattern, _text(value)) is None:
            raise error_of(expected=meaning, found=value)
        return str(value)

    return BeforeValidator(check)


def file_inside(folder: str, remedy: str) -> BeforeValidator:
    """Take the name of a file that is in a folder or below it.

    Parameters
    ----------
    folder : in words, such as ``the folder of the test``
    remedy : what to do about a file elsewhere

    Returns
    -------
    Validator that refuses what is no text or has control signs, a path from the root (of POSIX or
    of Windows, on either system), and one with ``..``.
    """

    def check(value: object) -> str:
        if (
            not isinstance(value, str)
            or not value.strip()
            or not _UNSAID.isdisjoint(map(category, value))
        ):
            raise error_of(expected="the name of a file", found=value)
        roots = PurePosixPath(value).is_absolute() or PureWindowsPath(value).anchor
        if roots or ".." in PureWindowsPath(value).parts:
            raise error_of(expected=f"a file inside {folder}", found=value, remedy=remedy)
        return value

    return BeforeValidator(check)


Text = Annotated[
    str, BeforeValidator(_text), WithJsonSchema({"type": ["string", "number"], "minLength": 1})
]
Remark = Annotated[
    str,
    BeforeValidator(lambda value: "" if value is None else value),
    WithJsonSchema({"type": ["string", "null"]}),
]
"""Text that may be empty or left out."""
FileStem = Annotated[
    str,
    _word(r"\w[\w.+-]*", "a name of letters, digits, '-', '_', '.' and '+'"),
    WithJsonSchema({"type": ["string", "number"], "pattern": r"^\w[\w.+-]*$"}),
]
Snake = Annotated[
    str,
    _word(r"[a-z][a-z0-9_]*", "a name of small letters, digits and '_', a letter first"),
    WithJsonSchema({"type": "string", "pattern": r"^[a-z][a-z0-9_]*$"}),
]
