"""Figures of modelled wires: stiffness, moments, cantilevers, comparisons, sections."""

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

from labpipe.mechanics.wire.first_loading import interpolate_end_load
from labpipe.records.arrays import Floats
from labpipe.records.wire import WireTable
from labpipe.report.plot_records import Line, split_at_gaps
from labpipe.report.wire_report import (
    STIFFNESS_SCALE,
    choose_law_rows,
    compute_orientation_spread,
    compute_row_error,
    make_cantilever_page,
    make_comparison_page,
    make_moment_page,
    make_section_plot,
    make_sections_page,
    make_stiffness_page,
    make_strand_lines,
    make_summary_record,
    save_wire_workbook,
)
from tests.approved import Approve
from tests.builders.wire_tables import wire_table
from tests.report.builders_wires import CUT, compressed_wire, troubled
from tests.report.figure_words import all_words


def scaled(table: WireTable, factor: float) -> WireTable:
    original = table.layout
    layout = replace(
        original, x=factor * original.x, y=factor * original.y, diameter=factor * original.diameter,
        bore_radius=factor * original.bore_radius, wire_radius=factor * original.wire_radius,
    )  # fmt: skip
    return replace(table, layout=layout)


def outlines(line: Line) -> list[Floats]:
    """Outlines of the areas of a line, shape (points, 2) each."""
    return split_at_gaps(line.x, line.y)


def test_compressed_strands_fill_their_circle_with_their_areas() -> None:
    table, areas = compressed_wire(), []
    for strand in (strand for line in make_strand_lines(table.layout) for strand in outlines(line)):
        x, y = strand.T
        areas.append(abs(x @ np.roll(y, 1) - y @ np.roll(x, 1)) / 2.0)
    assert areas == pytest.approx([0.35e-6 / 7] * 7, rel=2e-3)
    page = make_sections_page("sections-1", [table])
    assert page.note.startswith("Compressed strands: sectors of rings with the ar")


def test_strands_wall_bore_and_bar_to_scale() -> None:
    table = wire_table("A3")
    layout = table.layout
    circles = [circle for line in make_strand_lines(layout) for circle in outlines(line)]
    assert [np.ptp(circle[:, 0]) for circle in circles] == pytest.approx([0.24e-3] * 19, rel=1e-3)
    centres = [circle[:-1].mean(axis=0) for circle in circles]
    np.testing.assert_allclose(centres, np.column_stack([layout.x, layout.y]), atol=1e-9)
    lines = {line.look: line for line in make_section_plot(table, 9e-4, STIFFNESS_SCALE).lines}
    sizes = {"insulation_wall": 1.8e-3, "bore": 1.2e-3, "scale_bar": 0.5e-3}
    for look, size in sizes.items():
        assert np.nanmax(lines[look].x) - np.nanmin(lines[look].x) == pytest.approx(size, rel=1e-3)


def test_words(approved: Approve) -> None:
    a1, a3 = wire_table("A1"), wire_table("A3")
    base = a1.layout
    coreless = replace(
        base, x=base.x[1:4], y=base.y[1:4], layer=base.layer[1:4] - 1, diameter=base.diameter[1:4]
    )
    mixed = replace(a3.spec, layer_counts=(1, 6, 12), strand_diameters=(0.3e-3, 0.25e-3, 0.25e-3))
    stiff = replace(a1, stick_stiffness=51.57, name="a long  name " + "x" * 40)
    at_rest = replace(a3, tip_deflection=np.zeros(1), tip_force=np.zeros(1))
    close_limits = replace(a1, slip_stiffness=0.9 * a1.stick_stiffness)
    pages = {
        "stiffness": make_stiffness_page(a3),
        "limits near each other": make_stiffness_page(close_limits),
        "a stiff wire": make_stiffness_page(stiff),
        "no slip": make_stiffness_page(replace(a1, slip_onsets=np.array([np.inf]))),
        "warnings": make_stiffness_page(troubled()),
        "moment": make_moment_page(wire_table("C4")),
        "cantilever": make_cantilever_page(a3),
        "cantilever at rest": make_cantilever_page(at_rest),
        "no cantilever": make_cantilever_page(troubled()),
        "comparison": make_comparison_page("figure", [a1, wire_table("A2"), a3]),
        "comparison with a stiff wire": make_comparison_page("figure", [a1, stiff]),
        "sections": make_sections_page("figure", [a1, replace(a3, spec=mixed), stiff]),
        "sections unlike in size": make_sections_page("figure", [a1, scaled(a1, 5.0)]),
        "section without core": make_sections_page("figure", [replace(a1, layout=coreless)]),
    }
    approved(all_words(pages))


REFUSED = {"Z1": "wires.xlsx, row 4: expected a wire that can be built, found this: no room."}
TABLE = wire_table("A1")


def saved(tables: Sequence[WireTable], folder: Path) -> Workbook:
    save_wire_workbook(tables, folder / "wires.xlsx", refusals=REFUSED)
    return load_workbook(folder / "wires.xlsx")


def rows(book: Workbook, name: str, wire: str = "A1") -> list[dict[str, Any]]:
    """Rows of a wire by their heads."""
    heads, *cells = book[name].iter_rows(values_only=True)
    records = [dict(zip(map(str, heads), row, strict=True)) for row in cells]
    return [row for row in records if row["wire"] == wire]


def test_sheets_of_two_wires_and_a_refused_one(tmp_path: Path) -> None:
    book = saved([TABLE, troubled()], tmp_path)
    (refused,), (first,), (second,) = (rows(book, "wires", name) for name in ("Z1", "A1", "A3"))
    assert refused["warnings"] == f"not modelled: {REFUSED['Z1']}"
    assert refused["strands"] is None
    assert first["rows of the law"] == first["rows shown"] == len(TABLE.curvature)
    assert first["error between the rows shown, largest (% of moment)"] == 0.0
    limit = pytest.approx(1e3 * TABLE.doubtful_deflection)
    assert first["doubtful beyond, deflection (mm)"] == limit
    assert (second["end load at 20 mm (N)"], second["warnings"]) == (None, CUT.message)
    for sheet, head, values in (
        ("laws", "curvature (1/m)", TABLE.curvature),
        ("laws", "moment (N·mm)", 1e3 * TABLE.moment),
        ("laws", "lost to yielding (N·mm)", 1e3 * TABLE.plastic),
        ("laws", "secant stiffness (N·mm²)", 1e6 * TABLE.secant_stiffness),
        ("laws", "highest moment of all orientations (N·mm)", 1e3 * TABLE.highest_moment),
        ("cantilevers", "end load (N)", TABLE.tip_force),
    ):
        np.testing.assert_allclose([row[head] for row in rows(book, sheet)], values, rtol=1e-14)
    doubts = [row["doubtful"] == "yes" for row in rows(book, "cantilevers")]
    assert doubts == (TABLE.tip_deflection > TABLE.doubtful_deflection).tolist()
    assert book.active is not None
    assert book.active.title == "wires"
    reread = CalamineWorkbook.from_path(tmp_path / "wires.xlsx")  # as other programs read it
    sheets = ["read me", "wires", "laws", "cantilevers", "notes"]
    assert reread.sheet_names == book.sheetnames == sheets
    for name in sheets:
        cells = [[value or 0 for value in row] for row in book[name].iter_rows(values_only=True)]
        read = [[value or 0 for value in row] for row in reread.get_sheet_by_name(name).to_python()]
        assert read == cells


def test_numbers_of_a_wire_in_the_units_of_the_headings() -> None:
    table = wire_table("C4")
    row = make_summary_record(table)
    texts = {"strands": 37, "layers": "1 + 6 + 12 + 18", "lay angles (deg)": "12; -15; 12"}
    assert {head: row[head] for head in texts} == texts
    for head, value in {
        "wire diameter (mm)": 2.1,
        "bore diameter (mm)": 1.5,
        "conductor area (mm²)": 37 * np.pi / 4 * 0.21**2,
        "range, bending radius (mm)": 10.5,
        "cantilever length (mm)": 85.0,
        "moment at the end (N·mm)": 1e3 * table.moment[-1],
    }.items():
        assert row[head] == pytest.approx(value), head
    # Table 3.5 of the source, with its misprints put right: a hexagon has 15.6e-3 N m^2
    assert row["stick stiffness (N·mm²)"] == pytest.approx(15.6e3, rel=5e-3)


def test_force_on_the_curve_and_none_beyond_its_end() -> None:
    middle = (TABLE.tip_deflection[3] + TABLE.tip_deflection[4]) / 2.0
    assert TABLE.tip_force[3] < interpolate_end_load(TABLE, middle) < TABLE.tip_force[4]
    at_end = interpolate_end_load(TABLE, TABLE.tip_deflection[-1])
    assert at_end == pytest.approx(TABLE.tip_force[-1], rel=1e-12)
    assert make_summary_record(TABLE)["end load at 5 mm (N)"] == interpolate_end_load(TABLE, 5e-3)
    short = replace(TABLE, tip_deflection=TABLE.tip_deflection[:2], tip_force=TABLE.tip_force[:2])
    assert np.isnan(interpolate_end_load(short, 5e-3))
    third = (2.0 * short.tip_deflection[0] + short.tip_deflection[1]) / 3.0
    expected = (2.0 * short.tip_force[0] + short.tip_force[1]) / 3.0
    assert interpolate_end_load(short, third) == pytest.approx(expected)
    # of the friction moment, which is all but the whole moment when slip begins
    assert compute_orientation_spread(TABLE) == pytest.approx(11.0, abs=1.0)


@pytest.mark.parametrize("name", ["A1", "A3", "C5"])
@pytest.mark.parametrize("max_rows", [40, 10_000])
def test_rows_that_are_shown_keep_the_law(name: str, max_rows: int) -> None:
    table = wire_table(name)
    shown = choose_law_rows(table, max_rows)
    last_row = len(table.curvature) - 1
    assert len(shown) == min(max_rows, last_row + 1)
    assert (shown[0], shown[-1]) == (0, last_row)
    assert np.all(np.diff(shown) > 0)
    even = np.linspace(0, last_row, len(shown)).round().astype(np.int64)
    assert compute_row_error(table, shown) <= min(compute_row_error(table, even), 1.0)
    slope = table.moment[-1] / table.curvature[-1]
    worst = np.max(np.abs(slope * table.curvature[1:] / table.moment[1:] - 1.0))
    assert compute_row_error(table, np.array([0, last_row])) == pytest.approx(100.0 * worst)
