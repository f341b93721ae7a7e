"""The workbook of modelled wires."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from openpyxl import load_workbook
from openpyxl.workbook import Workbook
from python_calamine import CalamineWorkbook

from labpipe.records.wire import WireTable
from labpipe.report.wire_workbook import (
    MOST_ROWS,
    SUMMARY,
    orientation_spread,
    row_error,
    save_wire_workbook,
    shown_rows,
)
from labpipe.wire.cantilever_curve import force_at
from tests.builders.wire_tables import wire_table
from tests.report.builders_wires import CUT, troubled

REFUSED = {"Z1": "wires.xlsx, row 4: expected a wire that can be built, found this: no room."}


def saved(tables: Sequence[WireTable], folder: Path) -> Workbook:
    save_wire_workbook(tables, folder / "wires.xlsx", refused=REFUSED)
    return load_workbook(folder / "wires.xlsx")


def rows(book: Workbook, name: str) -> list[dict[str, Any]]:
    heads, *below = book[name].iter_rows(values_only=True)
    return [dict(zip(map(str, heads), row, strict=True)) for row in below]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("book")


@pytest.fixture(scope="module")
def book(folder: Path) -> Workbook:
    return saved([wire_table("A1"), troubled()], folder)


SHEETS = ["read me", "wires", "laws", "cantilevers", "onsets of slip", "strands", "notes"]


def of_wire(book: Workbook, name: str, wire: str) -> list[dict[str, Any]]:
    return [row for row in rows(book, name) if row["wire"] == wire]


def test_summary_has_refused_wires_first_and_numbers_as_numbers(book: Workbook) -> None:
    refused, first, second = rows(book, "wires")
    assert refused["wire"] == "Z1"
    assert refused["warnings"] == f"not modelled: {REFUSED['Z1']}"
    assert refused["strands"] is None
    table = wire_table("A1")
    assert first["stick stiffness (N·mm²)"] == pytest.approx(1e6 * table.stick_stiffness)
    assert first["rows of the law"] == first["rows shown"] == len(table.curvature)
    assert first["error between the rows shown, largest (% of moment)"] == 0.0
    force = force_at(table, 20e-3)
    assert first["end load at 20 mm (N)"] == pytest.approx(force)
    assert (second["wire"], second["end load at 20 mm (N)"]) == ("A3", None)
    assert second["warnings"] == CUT.message


def test_law_of_a_wire_and_what_belongs_to_it(book: Workbook) -> None:
    table = wire_table("A1")
    law = of_wire(book, "laws", "A1")
    assert len(law) == len(table.curvature)
    for head, values in {
        "curvature (1/m)": table.curvature,
        "moment (N·mm)": 1e3 * table.moment,
        "lost to yielding (N·mm)": 1e3 * table.plastic,
        "secant stiffness (N·mm²)": 1e6 * table.secant_stiffness,
        "highest moment of all orientations (N·mm)": 1e3 * table.highest_moment,
    }.items():
        np.testing.assert_allclose([row[head] for row in law], values, rtol=1e-14)
    loads = [row["end load (N)"] for row in of_wire(book, "cantilevers", "A1")]
    np.testing.assert_allclose(loads, table.tip_force, rtol=1e-14)
    limit = 1e3 * table.doubtful_deflection
    [summary] = of_wire(book, "wires", "A1")
    assert summary["doubtful beyond, deflection (mm)"] == pytest.approx(limit)
    doubt = [row["doubtful"] for row in of_wire(book, "cantilevers", "A1")]
    assert doubt == [
        "yes" if each > table.doubtful_deflection else None for each in table.tip_deflection
    ]
    assert None in doubt
    assert "yes" in doubt
    found = of_wire(book, "onsets of slip", "A1")
    onsets = [row["strands begin to slip (1/m)"] for row in found]
    np.testing.assert_allclose(onsets, table.slip_onsets)
    strands = of_wire(book, "strands", "A1")
    assert [row["layer"] for row in strands] == [0, 1, 1, 1, 1, 1, 1]
    assert strands[1]["x (mm)"] == pytest.approx(0.26)


@pytest.mark.slow
def test_hundreds_of_wires_share_the_rows(tmp_path: Path) -> None:
    table = wire_table("A1")
    count = 100
    tables = [replace(table, name=f"w{number}") for number in range(count)]
    book = saved(tables, tmp_path)
    last = rows(book, "wires")[-1]
    assert last["rows shown"] == MOST_ROWS // count < last["rows of the law"]
    assert 0.0 < last["error between the rows shown, largest (% of moment)"] < 0.5
    law = of_wire(book, "laws", "w99")
    assert len(law) == last["rows shown"]
    assert law[-1]["curvature (1/m)"] == pytest.approx(table.curvature[-1])


def summary(name: str) -> dict[str, object]:
    table = wire_table(name)
    return {column.heading: column.value(table) for column in SUMMARY}


def test_numbers_of_a_wire_in_the_units_of_the_headings() -> None:
    row = summary("C4")
    assert row["strands"] == 37
    assert row["layers"] == "1 + 6 + 12 + 18"
    assert row["lay angles (deg)"] == "12; -15; 12"
    assert row["wire diameter (mm)"] == pytest.approx(2.1)
    assert row["bore diameter (mm)"] == pytest.approx(1.5)
    assert row["conductor area (mm²)"] == pytest.approx(37 * np.pi / 4 * 0.21**2)
    # Table 3.5 of the source, with its misprints put right: a hexagon has 15.6e-3 N m^2
    assert row["stick stiffness (N·mm²)"] == pytest.approx(15.6e3, rel=5e-3)
    assert row["range, bending radius (mm)"] == pytest.approx(10.5)
    assert row["cantilever length (mm)"] == pytest.approx(85.0)
    assert row["moment at the end (N·mm)"] == pytest.approx(1e3 * wire_table("C4").moment[-1])


def test_force_on_the_curve_and_none_beyond_its_end() -> None:
    table = wire_table("A1")
    columns = {column.heading: column.value for column in SUMMARY}
    said = columns["end load at 5 mm (N)"]
    middle = (table.tip_deflection[3] + table.tip_deflection[4]) / 2.0
    assert table.tip_force[3] < force_at(table, middle) < table.tip_force[4]
    assert force_at(table, table.tip_deflection[-1]) == table.tip_force[-1]
    assert said(table) == force_at(table, 5e-3)
    short = replace(table, tip_deflection=table.tip_deflection[:2], tip_force=table.tip_force[:2])
    assert np.isnan(force_at(short, 5e-3))
    assert said(short) is None
    assert said(troubled()) is None


def test_spread_over_orientations() -> None:
    # PHYSICS: of the friction moment, which is all but the whole moment when slip begins
    spread = orientation_spread(wire_table("A1"))
    assert spread == pytest.approx(11.0, abs=1.0)


@pytest.mark.parametrize("name", ["A1", "A3", "C5"])
@pytest.mark.parametrize("most", [40, 60, 10_000])
def test_rows_that_are_shown_keep_the_law(name: str, most: int) -> None:
    table = wire_table(name)
    shown = shown_rows(table, most)
    last = len(table.curvature) - 1
    assert len(shown) == min(most, last + 1)
    assert (shown[0], shown[-1]) == (0, last)
    assert np.all(np.diff(shown) > 0)
    even = np.linspace(0, last, len(shown)).round().astype(np.int64)
    assert row_error(table, shown) <= min(row_error(table, even), 1.0)


def test_error_between_rows_is_that_of_straight_lines() -> None:
    table = wire_table("A1")
    ends = np.array([0, len(table.curvature) - 1])
    slope = table.moment[-1] / table.curvature[-1]
    worst = np.max(np.abs(slope * table.curvature[1:] / table.moment[1:] - 1.0))
    assert row_error(table, ends) == pytest.approx(100.0 * worst)


def test_other_programs_read_the_same(book: Workbook, folder: Path) -> None:
    assert book.sheetnames == SHEETS
    assert book.active is not None
    assert book.active.title == "wires"
    other = CalamineWorkbook.from_path(folder / "wires.xlsx")
    assert other.sheet_names == book.sheetnames
    for name in book.sheetnames:
        own = [[value or 0 for value in row] for row in book[name].iter_rows(values_only=True)]
        read = [[value or 0 for value in row] for row in other.get_sheet_by_name(name).to_python()]
        assert read == own
