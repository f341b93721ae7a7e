from __future__ import annotations

import pytest

from labpipe.readers import text_cells as cells
from labpipe.readers.text_cells import (
    are_units,
    bare_unit,
    is_number,
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
