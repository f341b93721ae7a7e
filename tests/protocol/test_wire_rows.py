from __future__ import annotations

import math
import re
from dataclasses import fields
from pathlib import Path
from typing import get_args

import pytest

from labpipe.errors import Fault
from labpipe.protocol.stress_curve import StressPoint, curve_fault, curve_of
from labpipe.protocol.wire_rows import (
    COLUMNS,
    NEEDED,
    WireRow,
    column_name,
    field_of,
    heading_faults,
    parse_row,
    wire_spec,
)
from labpipe.records.wire import LAYOUTS, WireSpec

SILENT = WireSpec("W", 1.6e-3, (1, 6), (0.32e-3,) * 2, (0.2,), 0.3e-3)


A2 = {
    "wire": "A2",
    "wire_diameter_mm": "1.6",
    "strands": "7",
    "strand_diameter_mm": "0.32",
    "lay_angles_deg": "12",
    "insulation_thickness_mm": "0.3",
}


def fault(**cells: str) -> Fault:
    found = parse_row(WireRow, A2 | cells)
    assert isinstance(found, list)
    [only] = found
    return only


def row(**cells: str) -> WireRow:
    found = parse_row(WireRow, A2 | cells)
    assert isinstance(found, WireRow)
    return found


def test_every_number_of_a_spec_has_a_column() -> None:
    elsewhere = {"name", "layout", "stress_table", "insulation_table", "defaults", "place"}
    merged = {"strands", "conductor_area", "strand_diameter"}
    numbers = {field.name for field in fields(WireSpec)} - elsewhere
    assert {field_of(name) for name in COLUMNS} - merged == numbers
    assert get_args(WireRow.model_fields["layout"].annotation) == LAYOUTS


def test_a_heading_however_it_is_written() -> None:
    assert column_name("Wire diameter-MM") == "wire_diameter_mm"
    assert list(heading_faults((*A2, "remark", "Layer Counts"))) == []


def test_a_misspelt_column_is_told_once_with_the_nearest() -> None:
    [(number, fault)] = heading_faults((*list(A2)[:5], "insulation_thicknes_mm"))
    assert (number, fault.found) == (5, "'insulation_thicknes_mm'")
    assert fault.expected.startswith("one of 'insulation_thickness_mm', 'insulation_strain', ")
    assert fault.remedy == "Did you mean 'insulation_thickness_mm'?"


@pytest.mark.parametrize(
    ("written", "meant", "unit"),
    [
        ("wire_diameter_inch", "wire_diameter_mm", "mm"),
        ("wire_diameter", "wire_diameter_mm", "mm"),
        ("conductor_modulus_mpa", "conductor_modulus_gpa", "GPa"),
        ("orientation_rad", "orientation_deg", "deg"),
        ("largest_curvature_per_mm", "largest_curvature_per_m", "1/m"),
        ("tension_kN", "tension_n", "N"),
    ],
)
def test_a_column_in_another_unit_is_to_be_converted(written: str, meant: str, unit: str) -> None:
    [(_, fault)] = heading_faults((*(name for name in A2 if name != meant), written))
    assert (fault.found, fault.remedy) == (repr(written), f"Give it in {unit} as {meant!r}.")


def test_missing_and_repeated_columns() -> None:
    (number, repeated), *missing = heading_faults(("wire", "strands", "strands"))
    assert (number, repeated.expected) == (2, "each column once")
    assert repeated.found == "'strands' again"
    assert {number for number, _ in missing} == {0}
    assert [fault.expected for _, fault in missing] == [
        "a column 'wire_diameter_mm'",
        "a column 'insulation_thickness_mm'",
        "a column 'lay_angles_deg'",
        "a column 'conductor_area_mm2', 'strand_diameter_mm' or 'strand_diameters_mm'",
    ]


def test_numbers_keep_their_unit_until_they_become_si() -> None:
    read = row(lay_angles_deg="12; -15", layer_counts="1;3;3", conductor_modulus_gpa="110")
    assert (read.wire_diameter_mm, read.counts) == (1.6, (1, 3, 3))
    spec = wire_spec(read, (), "row 2", None)
    assert (spec.wire_diameter, spec.conductor_modulus) == (0.0016, 110e9)
    assert spec.lay_angles == pytest.approx((0.20943951, -0.26179939), abs=1e-8)
    assert row(orientation_deg="450") == row(orientation_deg="90")
    assert row(orientation_deg="-720").orientation_deg == 0.0


NO_FILES = ("A/2", "..", "a.", "con", "NUL.csv", "a\tb", "a" * 101)


@pytest.mark.parametrize(
    ("column", "text", "expected", "remedy"),
    [
        ("insulation_poisson", "0.51", "a number from -0.99 to 0.5", "Correct"),
        ("poisson", "-1", "a number from -0.99 to 0.5", "Correct"),
        ("length_mm", "nan", "a number from 1 to 100000 mm", "Correct"),
        ("length_mm", "1e999", "a number from 1 to 100000 mm", "Correct"),
        *(
            ("wire", name, "a name that a file can have", "100 letters at most")
            for name in NO_FILES
        ),
        ("tension_n", "-1", "a number from 0 to 10000000 N", "Correct"),
        ("copper_n", "1", "a number from 0.01 to 0.99", "Correct"),
        ("strands", "6.5", "a whole number from 1 to 2000", "Correct"),
        ("strands", "1e300", "a whole number from 1 to 2000", "unit"),
        ("wire_diameter_mm", "1e300", "a number from 0.05 to 200 mm", "unit"),
        ("length_mm", "85e6", "a number from 1 to 100000 mm", "unit"),
        ("conductor_modulus_gpa", "110e9", "a number from 0.1 to 1000 GPa", "unit"),
        ("lay_angles_deg", "90", "numbers from -80 to 80 deg, separated by ';'", "Correct"),
        ("lay_angles_deg", "12;85", "numbers from -80 to 80 deg, separated by ';'", "unit"),
        ("strand_diameters_mm", "0.3;", "numbers from 0.005 to 50 mm, separated by ';'", "Correct"),
        ("lay_angles_deg", "12;-15,5", "numbers from -80", "decimal point: -15.5."),
        ("length_mm", "1,6", "a number from 1", "decimal point: 1.6."),
        ("length_mm", "1,000", "a number from 1", "Write 1000 or 1.000, as meant."),
        ("length_mm", "1,000,000", "a number from 1", ": 1000000."),
        ("layer_counts", "1,6,12", "whole numbers from 1", "Separate them by ';': 1;6;12."),
        ("lay_angles_deg", "12,15", "numbers", "write 12;15 for two, 12.15 for one."),
    ],
)
def test_numbers_that_are_refused(column: str, text: str, expected: str, remedy: str) -> None:
    found = fault(**{column: text})
    assert (found.path, found.found) == ((column,), repr(text))
    assert found.expected.startswith(expected)
    assert remedy in found.remedy


def test_every_column_with_its_range_and_default_is_documented(repository: Path) -> None:
    page = (repository / "docs" / "how-to" / "wire-sheet.md").read_text(encoding="utf-8")
    documented = dict(re.findall(r"^\| `(\w+)` \| ([^|]*) \|", page, flags=re.MULTILINE))
    assert set(documented) == set(WireRow.model_fields)
    for name, column in COLUMNS.items():
        low, high, default = column.least, column.most, getattr(SILENT, field_of(name), None)
        assert f"| {name.replace('_', ' ')} | {low:.10g} to {high:.10g} |" in page
        assert math.isfinite(high * column.factor)
        if isinstance(default, float) and name not in NEEDED:
            assert float(documented[name]) == pytest.approx(default / column.factor)
            assert low <= default / column.factor <= high


def test_a_mass_that_is_not_that_of_strands_and_wall() -> None:
    """Copper 0.563 mm^2, five sixths of its strands 1 / cos(12 deg) longer, and PVC 1.225 mm^2."""
    found = fault(mass_per_length_g_per_m="20")
    assert (found.path, found.found) == (("mass_per_length_g_per_m",), "20 g/m")
    assert found.expected == (
        "within a third of the 6.856 g/m of the section (strands of 8960 kg/m^3, wall of "
        "1400 kg/m^3)"
    )
    assert "g/m, which is kg/km" in found.remedy
    assert row(mass_per_length_g_per_m="9").has_mass
    assert row(mass_per_length_g_per_m="5.2", conductor_density_kg_per_m3="8900").has_mass
    light = fault(mass_per_length_g_per_m="6.8", conductor_density_kg_per_m3="2700")
    assert light.expected.startswith("within a third of the 3.264 g/m")


Pairs = list[tuple[float, float]]


def points(pairs: Pairs) -> list[StressPoint]:
    return [StressPoint.model_validate({"strain": str(a), "stress_mpa": str(b)}) for a, b in pairs]


def test_a_curve_in_si_without_its_zero() -> None:
    curve = points([(0.0, 0.0), (0.001, 110.0), (0.1, 150.0)])
    assert curve_fault(curve, "stress_table") is None
    assert curve_fault(points([(0.01, 10), (0.3, 20)]), "insulation_table") is None
    assert curve_of(curve) == ((0.001, 0.1), (110e6, 150e6))


METAL, PLASTIC = "stress_table", "insulation_table"


@pytest.mark.parametrize(
    ("table", "pairs", "number", "expected", "found"),
    [
        (METAL, [(0.002, 110), (0.001, 120)], 1, "a strain above 0.002", "0.001"),
        (
            METAL,
            [(0.001, 110), (0.002, 100)],
            1,
            "a stress of 110 MPa or more, and more",
            "100 MPa",
        ),
        (METAL, [(0.001, 0), (0.002, 100)], 0, "a stress of 0 MPa or more, and more", "0 MPa"),
        (METAL, [(0.001, 50), (0.002, 150)], 1, "a slope up to the first, 50 GPa", "100 GPa"),
        (METAL, [(0, 0)], 0, "a point beyond zero", "none"),
        (METAL, [(0, 0), (0.2, 110)], 1, "a first slope of 1 to 1000 GPa", "0.55 GPa"),
        (METAL, [(1e-5, 90000)], 0, "a first slope of 1 to 1000 GPa", "9e+06 GPa"),
        (PLASTIC, [(0.01, 10), (0.05, 18), (0.1, 16)], 2, "a stress of 18 MPa or more", "16 MPa"),
        (PLASTIC, [(0.001, 110), (0.3, 200)], 0, "a first slope of 0.0001 to 10 GPa", "110 GPa"),
    ],
)
def test_points_that_make_no_curve(
    table: str, pairs: Pairs, number: int, expected: str, found: str
) -> None:
    wrong = curve_fault(points(pairs), table)
    assert wrong is not None
    assert (wrong[0], wrong[1].found) == (number, found)
    assert wrong[1].expected.startswith(expected)
