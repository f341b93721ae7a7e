from __future__ import annotations

import math
import re
from dataclasses import fields
from pathlib import Path
from typing import get_args

import pytest

from labpipe.protocol.wire_rows import (
    REQUIRED_CELLS,
    WIRE_COLUMNS,
    StressPoint,
    WireRow,
    build_wire_spec,
    convert_stress_points,
    find_heading_faults,
    get_spec_field,
    normalise_heading,
)
from labpipe.records.wire import LAYOUTS, WireSpec
from tests.approved import Approve

SILENT = WireSpec("W", 1.6e-3, (1, 6), (0.32e-3,) * 2, (0.2,), 0.3e-3)


A2 = {
    "wire": "A2",
    "wire_diameter_mm": "1.6",
    "strands": "7",
    "strand_diameter_mm": "0.32",
    "lay_angles_deg": "12",
    "insulation_thickness_mm": "0.3",
}


def row(**cells: str) -> WireRow:
    wire_row, faults = WireRow.read(A2 | cells)
    assert wire_row is not None
    assert not faults
    return wire_row


def test_every_number_of_a_spec_has_a_column() -> None:
    elsewhere = {"name", "layout", "stress_table", "insulation_table", "defaults", "place"}
    merged = {"strands", "conductor_area", "strand_diameter"}
    numbers = {field.name for field in fields(WireSpec)} - elsewhere
    assert {get_spec_field(name) for name in WIRE_COLUMNS} - merged == numbers
    assert get_args(WireRow.model_fields["layout"].annotation) == LAYOUTS


def test_numbers_keep_their_unit_until_they_become_si() -> None:
    wire_row = row(lay_angles_deg="12; -15", layer_counts="1;3;3", conductor_modulus_gpa="110")
    assert (wire_row.wire_diameter_mm, wire_row.strands_per_layer) == (1.6, (1, 3, 3))
    spec = build_wire_spec(wire_row, (), "row 2", None)
    assert (spec.wire_diameter, spec.conductor_modulus) == (0.0016, 110e9)
    assert spec.lay_angles == pytest.approx((0.20943951, -0.26179939), abs=1e-8)
    assert row(orientation_deg="450") == row(orientation_deg="90")
    assert row(orientation_deg="-720").orientation_deg == 0.0


def test_every_column_with_its_range_and_default_is_documented(repository: Path) -> None:
    page = (repository / "docs" / "how-to" / "wire-sheet.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \| (.*) \|$", page, flags=re.MULTILINE)
    documented = {name: cells.split(" | ") for name, cells in rows}
    assert set(documented) == set(WireRow.model_fields)
    for name, column in WIRE_COLUMNS.items():
        low, high, default = (
            column.minimum,
            column.maximum,
            getattr(SILENT, get_spec_field(name), None),
        )
        assert documented[name][1] == f"{low:.10g} to {high:.10g}"
        assert math.isfinite(high * column.factor)
        if isinstance(default, float) and name not in REQUIRED_CELLS:
            assert float(documented[name][0]) == pytest.approx(default / column.factor)
            assert low <= default / column.factor <= high


Pairs = list[tuple[float, float]]


def points(pairs: Pairs) -> list[StressPoint]:
    return [StressPoint.model_validate({"strain": str(a), "stress_mpa": str(b)}) for a, b in pairs]


def test_a_curve_in_si_without_its_zero() -> None:
    curve = points([(0.0, 0.0), (0.001, 110.0), (0.1, 150.0)])
    assert convert_stress_points(curve) == ((0.001, 0.1), (110e6, 150e6))


def test_a_heading_and_a_mass_that_are_right() -> None:
    """Copper 0.563 mm^2, five sixths of its strands 1 / cos(12 deg) longer, and PVC 1.225 mm^2."""
    assert normalise_heading("Wire diameter-MM") == "wire_diameter_mm"
    assert list(find_heading_faults((*A2, "remark", "Layer Counts"))) == []
    assert row(mass_per_length_g_per_m="9").mass_per_length_g_per_m == 9.0
    assert row(mass_per_length_g_per_m="5.2", conductor_density_kg_per_m3="8900")


HEADINGS = [
    (*list(A2)[:5], "insulation_thicknes_mm"),
    *(
        (*(name for name in A2 if name != meant), written)
        for written, meant in (
            ("wire_diameter_inch", "wire_diameter_mm"),
            ("wire_diameter", "wire_diameter_mm"),
            ("conductor_modulus_mpa", ""),
            ("orientation_rad", ""),
            ("largest_curvature_per_mm", ""),
            ("tension_kN", ""),
        )
    ),
    ("wire", "strands", "strands"),
]
CELLS = {
    "insulation_poisson": ["0.51"],
    "poisson": ["-1"],
    "length_mm": ["nan", "1e999", "85e6", "1,6", "1,000", "1,000,000", "85 mm"],
    "wire": ["A/2", "..", "a.", "con", "NUL.csv", "a\tb", "a" * 101],
    "tension_n": ["-1"],
    "copper_n": ["1"],
    "strands": ["6.5", "1e300"],
    "wire_diameter_mm": ["1e300"],
    "conductor_modulus_gpa": ["110e9"],
    "lay_angles_deg": ["90", "12;85", "12;-15,5", "12,15"],
    "strand_diameters_mm": ["0.3;"],
    "layer_counts": ["1,6,12"],
    "mass_per_length_g_per_m": ["20"],
}


def test_wires_that_are_refused(approved: Approve) -> None:
    """By their columns and by their cells."""
    faults = [fault for heading in HEADINGS for fault in find_heading_faults(heading)]
    for column, texts in CELLS.items():
        for text in texts:
            _, found = WireRow.read(A2 | {column: text})
            assert found
            faults += [(0, fault) for fault in found]
    light = {"mass_per_length_g_per_m": "6.8", "conductor_density_kg_per_m3": "2700"}
    _, found = WireRow.read(A2 | light)
    assert found
    faults += [(0, fault) for fault in found]
    approved(
        f"{place} {fault.path}: expected {fault.expected}, found {fault.found}. {fault.remedy}"
        for place, fault in faults
    )
