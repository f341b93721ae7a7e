from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from labpipe.records.wire import WireTable
from labpipe.report.wire_workbook import (
    SUMMARY,
    orientation_spread,
    row_error,
    shown_rows,
)
from labpipe.wire.cantilever_curve import force_at
from tests.builders.wire_tables import wire_table
from tests.report.builders_wires import troubled


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


def test_onsets_outside_the_range_are_not_told() -> None:
    table = wire_table("A1")
    columns = {column.heading: column.value for column in SUMMARY}
    beyond = replace(table, slip_onsets=np.array([0.03, np.inf]))
    assert columns["last slip (1/m)"](beyond) == pytest.approx(0.03)
    never = replace(table, slip_onsets=np.array([np.inf]))
    assert columns["first slip (1/m)"](never) == "beyond"
    assert columns["last slip (1/m)"](never) == "beyond"
    assert columns["first slip (1/m)"](replace(table, slip_onsets=np.zeros(1))) == "at once"


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


def straight() -> WireTable:
    table = wire_table("A1")
    fields = (
        "curvature", "moment", "stick", "slip", "bending", "plastic", "insulation",
        "tangent_stiffness", "secant_stiffness", "lowest_moment", "highest_moment",
    )  # fmt: skip
    cut: dict[str, Any] = {name: getattr(table, name)[:1] for name in fields}
    return replace(table, **cut)


def test_a_table_of_zero_curvature_alone() -> None:
    table = straight()
    assert orientation_spread(table) is None
    assert shown_rows(table, 2).tolist() == [0]


@pytest.mark.parametrize("name", ["A1", "A3", "C5"])
@pytest.mark.parametrize("most", [40, 60, 10_000])
def test_rows_that_are_shown_keep_the_law(name: str, most: int) -> None:
    table = wire_table(name)
    rows = shown_rows(table, most)
    last = len(table.curvature) - 1
    assert len(rows) == min(most, last + 1)
    assert (rows[0], rows[-1]) == (0, last)
    assert np.all(np.diff(rows) > 0)
    even = np.linspace(0, last, len(rows)).round().astype(np.int64)
    assert row_error(table, rows) <= min(row_error(table, even), 1.0)


def test_error_between_rows_is_that_of_straight_lines() -> None:
    table = wire_table("A1")
    ends = np.array([0, len(table.curvature) - 1])
    slope = table.moment[-1] / table.curvature[-1]
    worst = np.max(np.abs(slope * table.curvature[1:] / table.moment[1:] - 1.0))
    assert row_error(table, ends) == pytest.approx(100.0 * worst)
