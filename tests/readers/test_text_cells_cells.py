from __future__ import annotations

import pytest

from labpipe.readers import text_cells as cells
from labpipe.readers.text_cells import (
    are_units,
    bare_unit,
    describe_cell,
    is_closing,
    is_number,
    is_sample,
    is_unit,
    name_and_unit,
    quoted,
    split_line,
)


@pytest.mark.parametrize("cell", ["1", "-.5", "5e-005", " 1,25 ", "1,110,797", "+2."])
def test_numbers(cell: str) -> None:
    assert is_number(cell)


@pytest.mark.parametrize("cell", ["", "-", "1 mm", "nan", "5e", "2,,5", "15:01"])
def test_other_cells(cell: str) -> None:
    assert not is_number(cell)


def test_units() -> None:
    assert all(map(is_unit, ("mm", "kN", "lbf", "sec", "°C", "mm/mm", "%")))
    assert not any(map(is_unit, ("Time", "Force", "Standard travel")))
    assert are_units(["(mm)", "", "[kN]", "s"])
    assert not are_units(["", ""])


@pytest.mark.parametrize("unit", sorted(cells._COMMON))
def test_units_told_at_once_are_units(unit: str) -> None:
    assert any(cells.is_like(unit, si) for si in cells._SI)


def test_a_quote_that_is_not_closed() -> None:
    assert split_line('a,"b,c', ",") == ["a", "b,c"]
    assert split_line("1   2.5", " ") == ["1", "2.5"]


@pytest.mark.parametrize(
    ("cell", "parted"),
    [
        ("Force (N)", ("Force", "N")),
        ("Force [ kN ]", ("Force", "kN")),
        ("Strain 1 (mm (rel))", ("Strain 1", "mm (rel)")),
        ("Force, N", ("Force", "N")),
        ("Kraft / kN", ("Kraft", "kN")),
        ("Load,lbf", ("Load", "lbf")),
        ("Strain, %", ("Strain", "%")),
        ("Load cell, left", None),
        ("Channel, 1", None),
        ("Force/Area", None),
        ("Force", None),
    ],
)
def test_a_unit_in_the_cell_of_the_name(cell: str, parted: tuple[str, str] | None) -> None:
    assert name_and_unit(cell) == parted


def test_brackets_that_a_card_asks_for() -> None:
    assert name_and_unit("Force (N)", "[]") is None
    assert name_and_unit("Force, N", "()") is None
    assert bare_unit("( mm )", "()") == "mm"
    assert bare_unit("mm", "()") is None
    assert bare_unit("mm", "") == "mm"


def test_cells_in_a_message() -> None:
    assert quoted(["a", "", "b"]) == "'a, b'"
    assert quoted(["", ""]) == "nothing"
    assert len(quoted(["x" * 100])) == 62


@pytest.mark.parametrize(
    ("cell", "decimal", "found", "remedy"),
    [
        ("1,020.5", ".", "thousands", "no sign between thousands"),
        ("1.020,5", ",", "thousands", "no sign between thousands"),
        ("1 020,5", ",", "thousands", "no sign between thousands"),
        ("1'020", ".", "thousands", "no sign between thousands"),
        ("-12,5", ".", "a decimal comma", "one decimal sign"),
        ("1,020", ".", "a decimal comma or a sign between thousands", "one decimal sign"),
        ("1.020.500", ",", "1.020.500", "spreadsheet"),
        ("10:00:00.250", ".", "time stamp", "seconds since the start"),
        ("00:01.5", ".", "time stamp", "seconds since the start"),
        ("3/4/2026 1:05 PM", ".", "time stamp", "seconds since the start"),
        ("04-Mar-2026 10:00:00", ".", "time stamp", "seconds since the start"),
        ("2026-03-04T10:00:00Z", ".", "time stamp", "seconds since the start"),
        ("2026-03-04", ".", "time stamp", "a card of your own"),
        ("OVERFLOW", ".", "'OVERFLOW'", "blank cell"),
        ("1e999", ".", "too large", "again"),
        ("O.2", ".", "'O.2'", "again"),
        ("12.5 mm", ".", "'12.5 mm'", "again"),
    ],
)
def test_why_a_cell_is_no_number(cell: str, decimal: str, found: str, remedy: str) -> None:
    _, is_found, to_do = describe_cell(cell, decimal)
    assert cell in is_found
    assert found in is_found
    assert remedy in to_do
    assert ("thousands" in is_found) == ("thousands" in found)
    assert ("time stamp" in is_found) == ("time stamp" in found)


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        (["1", "2,5"], True),
        (["1", ""], True),
        (["10:00:00", "nan", "2"], True),
        (["1,020.5", "2"], True),
        (["nan", "nan"], False),
        (["2026-03-04", ""], False),
        (["Mean", "2"], False),
        (["", ""], False),
    ],
)
def test_rows_of_samples(row: list[str], expected: bool) -> None:
    assert is_sample(row) is expected


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        (["Mean", "2"], True),
        (["", "Max.", "2"], True),
        (["*** end ***"], True),
        (["Écart type"], True),
        (["nan", "2"], False),
        (["N/A", "2"], False),
        (["inf", "2"], False),
        (["1", "Mean"], False),
        (["O.2", "2"], False),
        (["-inf", "2"], False),
        (["", ""], False),
    ],
)
def test_rows_that_close_a_table(row: list[str], expected: bool) -> None:
    assert is_closing(row) is expected
