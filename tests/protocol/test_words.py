from __future__ import annotations

from typing import Any

import pytest
from pydantic import TypeAdapter, ValidationError

from labpipe.protocol.words import FileStem, Remark, Snake, Text


@pytest.mark.parametrize(
    ("kind", "value", "message"),
    [
        (Text, True, "expected text, found 'True'."),
        (Text, "", "expected text, found ''."),
        (
            FileStem,
            "a/b",
            "expected a name of letters, digits, '-', '_', '.' and '+', found 'a/b'.",
        ),
        (
            Snake,
            "Force",
            "expected a name of small letters, digits and '_', a letter first, found 'Force'.",
        ),
    ],
)
def test_what_is_refused_is_told(kind: Any, value: object, message: str) -> None:
    with pytest.raises(ValidationError) as info:
        TypeAdapter(kind).validate_python(value)
    assert info.value.errors()[0]["msg"].strip() == message


def test_numbers_of_other_yaml_readers_are_text() -> None:
    assert TypeAdapter(Text).validate_python(1) == "1"


def test_a_remark_may_be_left_out() -> None:
    assert TypeAdapter(Remark).validate_python(None) == ""
