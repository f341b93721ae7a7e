from __future__ import annotations

from pathlib import Path

import pytest

from labpipe.readers.sheet_cells import Cell
from labpipe.readers.wire_columns import Faults
from labpipe.readers.wire_names import check_names


def told(*names: str) -> list[str]:
    faults = Faults(Path("w.csv"))
    check_names([Cell(name, f"cell A{row}") for row, name in enumerate(names, start=2)], faults)
    return [each.removeprefix("w.csv, ") for each in faults.told]


def test_names_of_wires() -> None:
    assert told("A2", "A 2", "B1.5", "Ä") == []


def test_a_name_that_is_missing() -> None:
    assert told("A2", "") == ["cell A3 (wire): expected a name, found a blank cell. Name the wire."]


@pytest.mark.parametrize("name", ["A/2", "..", "a.", "con", "NUL.csv", "a\tb"])
def test_names_that_no_file_can_have(name: str) -> None:
    assert told(name) == [
        f"cell A2 (wire): expected a name that a file can have, found {name!r}."
        ' Leave out \\ / : * ? " < > |, and dots at either end; use 100 letters at most.'
    ]


def test_a_name_that_is_too_long() -> None:
    assert told("a" * 101) == [
        "cell A2 (wire): expected a name that a file can have, found 'aaaaaaaaaaaaaaaaaaaa'... of"
        ' 101 letters. Leave out \\ / : * ? " < > |, and dots at either end; use 100 letters at'
        " most."
    ]


def test_a_name_that_comes_again_is_told_with_both_cells() -> None:
    assert told("A2", "A3", "A2") == [
        "cell A4 (wire): expected each wire once, found 'A2' again, as in cell A2."
        " Give each wire a name of its own."
    ]


@pytest.mark.parametrize(
    ("first", "second"), [("A2", "a2"), ("STRASSE", "straße"), ("caf\u00e9", "CAFE\u0301")]
)
def test_names_that_share_a_file_are_told_with_both_cells(first: str, second: str) -> None:
    assert told(first, second) == [
        f"cell A3 (wire): expected names that differ in more than the case of letters, which"
        f" files and labels ignore, found {second!r}, and {first!r} in cell A2."
        f" Give each wire a name of its own."
    ]
