from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.store import layout
from labpipe.store.layout import Field, branch_table, link_name


@given(st.lists(st.text(max_size=8), max_size=8))
def test_link_names_are_free_and_plain(names: list[str]) -> None:
    taken: list[str] = ["time"]
    for name in names:
        taken.append(link_name(name, taken))
    assert len(set(taken)) == len(taken)
    assert not any("/" in name or " " in name or name in {"", "."} for name in taken)


def test_plain_names_stay() -> None:
    assert link_name("force", ["time"]) == "force"
    assert link_name("time", ["time", "time_2"]) == "time_3"
    assert link_name("..", []) == "unnamed"


TABLES = {
    "branches": (layout.BRANCH_COLUMNS, branch_table("s")),
    "slips": (layout.SLIP_COLUMNS, layout.SLIP_TABLE),
    "lines": (layout.LINE_COLUMNS, layout.LINE_TABLE),
}


@pytest.mark.parametrize("table", TABLES.values(), ids=TABLES)
def test_every_column_of_a_table_has_its_unit(
    table: tuple[tuple[tuple[str, str], ...], Field],
) -> None:
    columns, kind = table
    units = str(kind.unit).split(", ")
    assert len(units) == len(columns)
    for unit, (_, number) in zip(units, columns, strict=True):
        assert (unit == "text") == number.startswith("S")
        assert (unit in ("sample", "1")) == (number == "int64")


def test_branches_are_timed_on_the_clock_of_the_curve() -> None:
    assert branch_table("1").unit == "sample, sample, 1, text, 1, 1"
