from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.store import layout
from labpipe.store.layout import link_name


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


TABLES = {name: table for name, table in vars(layout).items() if isinstance(table, layout.Table)}


@pytest.mark.parametrize("table", TABLES.values(), ids=TABLES)
def test_every_column_of_a_table_has_its_axis_and_unit(table: layout.Table) -> None:
    assert table.scale in table.columns
    for kind in table.columns.values():
        assert kind.axes == (table.axis,)
        assert (kind.unit == "text") == (kind.dtype == "text")
        assert (kind.dtype == "int64") <= (kind.unit in ("sample", "1"))


def test_tables_are_all_there() -> None:
    assert len(TABLES) == 7
