from __future__ import annotations

from typing import Annotated, Any

import pytest
from pydantic import TypeAdapter, ValidationError

from labpipe.protocol.grammar import validated
from labpipe.protocol.values import (
    FileStem,
    Line,
    Remark,
    Text,
    file_inside,
    is_name_of_a_test,
)
from labpipe.records.declarations import Snake

LINE = "text on one line, without control characters"


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
        (Line, "A\a2", rf"expected {LINE}, found 'A\x072'."),
        (Line, "\ud800", rf"expected {LINE}, found '\ud800'."),
        (Line, "A2\n", rf"expected {LINE}, found 'A2\n'."),
        (
            FileStem,
            "nul.1",
            "expected a name that every system takes, of 120 letters at the most, found 'nul.1'.",
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
        TypeAdapter(validated(kind)).validate_python(value)
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


@pytest.mark.parametrize("text", ["a $x_1$ <b> & \U0001f600", "one line\nand another\tone"])
def test_text_is_taken_as_it_is(text: str) -> None:
    assert TypeAdapter(Text).validate_python(text) == text


@pytest.mark.parametrize("name", ["A2-085-1", "0333", "Größe_1", "v1.2+b", "console", "a" * 120])
def test_names_of_tests(name: str) -> None:
    assert is_name_of_a_test(name)
    assert TypeAdapter(FileStem).validate_python(name) == name


@pytest.mark.parametrize(
    "name", ["", ".", "..", "../x", "a/b", r"a\b", "a b", "CON", "lpt1.x", "a.", "ö" * 61, "a\n"]
)
def test_what_cannot_be_the_name_of_a_test(name: str) -> None:
    assert not is_name_of_a_test(name)
    with pytest.raises(ValidationError):
        TypeAdapter(FileStem).validate_python(name)
