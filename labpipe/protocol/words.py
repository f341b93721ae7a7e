"""Types of the words in YAML: text, names of files, names of channels."""

from __future__ import annotations

import re
from pathlib import PurePosixPath, PureWindowsPath
from typing import Annotated, Any

from pydantic import BeforeValidator, WithJsonSchema

from labpipe.protocol.faults import error_of
from labpipe.records.setting_types import Word

_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff\ufffe\uffff]")
"""Ends of lines, and characters that no page, workbook or drawing can hold."""
_NAME = re.compile(r"\w[\w.+-]*")
_DEVICE = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)
_LONGEST_NAME = 120
"""Bytes; file systems take 255, and an ending follows."""


def _text(value: object) -> str:
    """Take text, and the numbers that other YAML readers make of unquoted text such as 1."""
    if isinstance(value, bool) or not isinstance(value, str | int | float) or not str(value):
        raise error_of(expected="text", found=value)
    return str(value)


def _line(value: object) -> str:
    text = _text(value)
    if _CONTROL.search(text) is not None:
        raise error_of(expected="text on one line, without control characters", found=value)
    return text


def is_name_of_a_test(text: str) -> bool:
    """Whether a text can be the name of a test, whose files go to a folder of that name.

    Parameters
    ----------
    text : any

    Returns
    -------
    False for what leads elsewhere (``../x``), and for what some file system does not take.
    """
    fits = _NAME.fullmatch(text) is not None and len(text.encode()) <= _LONGEST_NAME
    return fits and _DEVICE.fullmatch(text) is None and not text.endswith(".")


def _file_stem(value: object) -> str:
    text = _text(value)
    if _NAME.fullmatch(text) is None:
        expected = "a name of letters, digits, '-', '_', '.' and '+'"
        raise error_of(expected=expected, found=value)
    if not is_name_of_a_test(text):
        expected = f"a name that every system takes, of {_LONGEST_NAME} letters at the most"
        raise error_of(expected=expected, found=value)
    return text


def parse_word(of: Word, value: object) -> str:
    """Take a text that has a form.

    Parameters
    ----------
    of : the form
    value : the text

    Raises
    ------
    PydanticCustomError
        If it has another form.
    """
    if re.fullmatch(of.pattern, _text(value)) is None:
        raise error_of(expected=of.meaning, found=value)
    return str(value)


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
        if not isinstance(value, str) or not value.strip() or _CONTROL.search(value) is not None:
            raise error_of(expected="the name of a file", found=value)
        roots = PurePosixPath(value).is_absolute() or PureWindowsPath(value).anchor
        if roots or ".." in PureWindowsPath(value).parts:
            raise error_of(expected=f"a file inside {folder}", found=value, remedy=remedy)
        return value

    return BeforeValidator(check)


def one_or_several(item: dict[str, Any]) -> WithJsonSchema:
    """Describe, for editors, one value or a list of at least one.

    Parameters
    ----------
    item : JSON Schema of one
    """
    return WithJsonSchema({"anyOf": [item, {"type": "array", "minItems": 1, "items": item}]})


Text = Annotated[
    str, BeforeValidator(_text), WithJsonSchema({"type": ["string", "number"], "minLength": 1})
]
Line = Annotated[
    str, BeforeValidator(_line), WithJsonSchema({"type": ["string", "number"], "minLength": 1})
]
"""Text that stands in headings, tables and drawings."""
Remark = Annotated[
    str,
    BeforeValidator(lambda value: "" if value is None else value),
    WithJsonSchema({"type": ["string", "null"]}),
]
"""Text that may be empty or left out."""
FileStem = Annotated[
    str,
    BeforeValidator(_file_stem),
    WithJsonSchema({"type": ["string", "number"], "pattern": r"^\w[\w.+-]*$"}),
]
