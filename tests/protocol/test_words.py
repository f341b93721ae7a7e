from __future__ import annotations

from typing import Annotated, Any

import pytest
from pydantic import TypeAdapter, ValidationError

from labpipe.protocol.words import FileStem, Remark, Snake, Text, file_inside


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


NAME = TypeAdapter(Annotated[str, file_inside("the folder of the test", "Copy it.")])


@pytest.mark.parametrize("name", ["a.csv", "below/a.csv", "..a.csv", "DAQ\u00a0- \u2026 力.txt"])
def test_a_file_is_in_its_folder_or_below(name: str) -> None:
    assert NAME.validate_python(name) == name


@pytest.mark.parametrize(
    "name", ["../a.csv", "a/../../b", r"a\..\b", "/a.csv", r"C:\a.csv", "C:a.csv"]
)
def test_a_file_elsewhere_is_refused(name: str) -> None:
    with pytest.raises(ValidationError) as info:
        NAME.validate_python(name)
    expected = f"expected a file inside the folder of the test, found {name!r}. Copy it."
    assert info.value.errors()[0]["msg"] == expected


@pytest.mark.parametrize("value", [" ", "", 1, None, "a\0b", "a\nb", "a\ud800"])
def test_what_is_no_name_of_a_file_is_refused(value: object) -> None:
    with pytest.raises(ValidationError, match="expected the name of a file"):
        NAME.validate_python(value)


def test_a_remark_may_be_left_out() -> None:
    assert TypeAdapter(Remark).validate_python(None) == ""
