"""Wires of a sheet to tables and refusals; the files are looked at end to end."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from labpipe.pipeline.modelling import Modelled, as_json, make_tables
from labpipe.records.wire import WireTable
from labpipe.wire import wire_table as making
from tests.builders.wire_tables import wire_table

SHEET = Path("wires.csv")
GOOD = wire_table("A2").spec
TIGHT = replace(GOOD, name="X1", wire_diameter=1.5e-3, layout="hexagonal", place="line 7")


def test_tables_come_in_the_order_of_the_sheet() -> None:
    told: list[str] = []
    tables, refused = make_tables([replace(GOOD, name="B"), GOOD], SHEET, told.append)
    assert [table.name for table in tables] == told == ["B", "A2"]
    assert not refused


def test_what_is_refused_is_told_with_its_row() -> None:
    tables, refused = make_tables([TIGHT, GOOD], SHEET)
    assert [table.name for table in tables] == ["A2"]
    assert list(refused) == ["X1"]
    assert refused["X1"].startswith(
        "wires.csv, line 7, wire 'X1': expected a wire that can be built and bent, found this: "
    )
    assert refused["X1"].endswith("Check its row against the wire.")
    assert "overlap the bore" in refused["X1"]


def test_two_processes_say_what_one_says() -> None:
    specs = [replace(GOOD, name=f"W{number}") for number in range(25)] + [TIGHT]
    tables, refused = make_tables(specs, SHEET)
    assert [table.name for table in tables] == [spec.name for spec in specs[:-1]]
    assert list(refused) == ["X1"]
    assert (tables[24].moment == making.wire_table(GOOD).moment).all()


def test_json_is_plain_and_whole() -> None:
    table: WireTable = wire_table("A2")
    modelled = Modelled(SHEET, Path("out"), (table,), {"X1": "why"}, ())
    found = json.loads(json.dumps(as_json(modelled), allow_nan=False))
    assert found["sheet"] == "wires.csv"
    assert found["refused"] == {"X1": "why"}
    wire = found["wires"]["A2"]
    assert wire["moment"] == table.moment.tolist()
    assert wire["cantilever"]["force"] == table.tip_force.tolist()
    assert wire["layout"]["layer"] == [0, 1, 1, 1, 1, 1, 1]
