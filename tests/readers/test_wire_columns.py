from __future__ import annotations

import math
import re
from dataclasses import fields
from pathlib import Path

import pytest

from labpipe.readers.sheet_cells import Cell
from labpipe.readers.wire_columns import (
    COLUMNS,
    KNOWN,
    LIMITS,
    Column,
    Faults,
    check_heading,
    column_name,
    default_words,
    numbers_in,
)
from labpipe.records.wire import WireSpec

SILENT = WireSpec("W", 1.6e-3, (1, 6), (0.32e-3,) * 2, (0.2,), 0.3e-3)
BY_NAME = {column.name: column for column in COLUMNS}
WHOLE_HEADING = [
    *("wire", "wire_diameter_mm", "strands", "strand_diameter_mm"),
    *("lay_angles_deg", "insulation_thickness_mm"),
]


def told(*names: str) -> list[str]:
    faults = Faults(Path("w.xlsx"))
    check_heading([Cell(name, f"cell {i}") for i, name in enumerate(names)], faults)
    return faults.told


def read(text: str, column: str) -> tuple[tuple[float, ...] | None, list[str]]:
    faults = Faults(Path("w.xlsx"))
    return numbers_in(Cell(text, "cell B2"), BY_NAME[column], faults), faults.told


def test_every_number_of_a_spec_has_a_column() -> None:
    elsewhere = {"name", "layout", "stress_table", "defaults", "place"}
    merged = {"strands", "conductor_area", "strand_diameter"}
    assert {column.field for column in COLUMNS} - merged == {
        each.name for each in fields(WireSpec)
    } - elsewhere
    assert len(set(KNOWN)) == len(KNOWN)


def test_a_heading_however_it_is_written() -> None:
    assert column_name(Cell("Wire diameter-MM", "")) == "wire_diameter_mm"
    assert told(*WHOLE_HEADING, "remark", "Layer Counts") == []


def test_a_misspelt_column_is_told_once_with_the_nearest() -> None:
    assert told(*WHOLE_HEADING[:5], "insulation_thicknes_mm") == [
        "w.xlsx, cell 5: expected one of 'insulation_thickness_mm', 'insulation_modulus_mpa',"
        " 'friction_insulation', ..., found 'insulation_thicknes_mm'."
        " Did you mean 'insulation_thickness_mm'?"
    ]


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
    [message] = (
        told(*WHOLE_HEADING, written)
        if meant not in WHOLE_HEADING
        else told(*(name for name in WHOLE_HEADING if name != meant), written)
    )
    assert message.endswith(f"found {written!r}. Give it in {unit} as {meant!r}.")


def test_missing_and_repeated_columns() -> None:
    assert told("wire", "strands", "strands") == [
        "w.xlsx, cell 2: expected each column once, found 'strands' again."
        " Remove or rename one of them.",
        "w.xlsx, cell 0: expected a column 'wire_diameter_mm', found none. Add it.",
        "w.xlsx, cell 0: expected a column 'insulation_thickness_mm', found none. Add it.",
        "w.xlsx, cell 0: expected a column 'lay_angles_deg', found none. Add it.",
        "w.xlsx, cell 0: expected a column 'conductor_area_mm2', 'strand_diameter_mm' or"
        " 'strand_diameters_mm', found none of them. Add one.",
    ]


def test_numbers_become_si() -> None:
    assert read("1.4", "wire_diameter_mm") == ((0.0014,), [])
    assert read("110", "conductor_modulus_gpa") == ((110e9,), [])
    angles, _ = read("12; -15", "lay_angles_deg")
    assert angles == pytest.approx((0.20943951, -0.26179939), abs=1e-8)
    assert read("1;6;12", "layer_counts") == ((1.0, 6.0, 12.0), [])


@pytest.mark.parametrize(
    ("text", "column", "message"),
    [
        ("x", "poisson", "expected a number above -1, up to 0.5, found 'x'. Correct the cell."),
        ("nan", "length_mm", "expected a number > 0 in mm, found 'nan'. Correct the cell."),
        ("inf", "length_mm", "expected a number > 0 in mm, found 'inf'. Correct the cell."),
        ("1e999", "length_mm", "expected a number > 0 in mm, found '1e999'. Correct the cell."),
        ("-1", "tension_n", "expected a number >= 0 in N, found '-1'. Correct the cell."),
        ("1", "copper_n", "expected a number between 0 and 1, found '1'. Correct the cell."),
        ("6.5", "strands", "expected a whole number >= 1, found '6.5'. Correct the cell."),
        (
            "90",
            "lay_angles_deg",
            "expected angles between -90 and 90 deg, parted by ';', found '90'. Correct the cell.",
        ),
        (
            "0.3;",
            "strand_diameters_mm",
            "expected numbers > 0 in mm, parted by ';', found '0.3;'. Correct the cell.",
        ),
        (
            "12;-15,5",
            "lay_angles_deg",
            "expected a number with a point, found the decimal comma of '-15,5'. Write -15.5.",
        ),
        (
            "1,000",
            "length_mm",
            "expected a number with a point, found the comma of '1,000'."
            " Write 1000 or 1.000, as meant.",
        ),
        (
            "1,6,12",
            "layer_counts",
            "expected whole numbers >= 1, parted by ';', found '1,6,12'. Part them by ';': 1;6;12.",
        ),
        (
            "12,15",
            "lay_angles_deg",
            "expected angles between -90 and 90 deg, parted by ';', found '12,15'."
            " Part numbers by ';': write 12;15 for two, 12.15 for one.",
        ),
        ("1e300", "wire_diameter_mm", "expected 0.05 to 200 mm, found '1e300'. Is the unit right?"),
        ("85e6", "length_mm", "expected 1 to 100000 mm, found '85e6'. Is the unit right?"),
        ("1e300", "strands", "expected 1 to 2000, found '1e300'. Is the unit right?"),
        ("12;85", "lay_angles_deg", "expected -80 to 80 deg, found '12;85'. Is the unit right?"),
        (
            "110e9",
            "conductor_modulus_gpa",
            "expected 0.1 to 1000 GPa, found '110e9'. Is the unit right?",
        ),
    ],
)
def test_numbers_that_are_refused(text: str, column: str, message: str) -> None:
    assert read(text, column) == (None, [f"w.xlsx, cell B2 ({column}): {message}"])


def test_defaults_in_words() -> None:
    assert default_words("insulation_modulus") == "insulation modulus 1000 MPa"
    assert default_words("friction_strand") == "friction strand 0.21"
    assert default_words("orientation") == "orientation 0 deg"
    assert default_words("layout") == "layout auto"
    assert default_words("largest_curvature").endswith("a bending radius of five wire diameters")
    with pytest.raises(ValueError, match=r"name: allowed are fields with a default"):
        default_words("name")


def test_columns_state_their_unit_in_their_name() -> None:
    endings = {"mm": "_mm", "mm^2": "_mm2", "deg": "_deg", "MPa": "_mpa", "GPa": "_gpa"}
    endings |= {"N": "_n", "1/m": "_per_m"}

    def agrees(column: Column) -> bool:
        return not column.unit or column.name.endswith(endings[column.unit])

    assert all(agrees(column) for column in COLUMNS)


def test_every_column_and_its_default_is_documented(repository: Path) -> None:
    page = (repository / "docs" / "how-to" / "wire-sheet.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \| ([^|]*) \|", page, flags=re.MULTILINE)
    assert {name for name, _ in rows} == set(KNOWN)
    documented = dict(rows)
    for column in COLUMNS:
        default = getattr(SILENT, column.field, None)
        if isinstance(default, float) and not column.is_needed:
            assert float(documented[column.name]) == pytest.approx(default / column.factor)


def test_every_column_of_numbers_has_limits_around_its_default() -> None:
    assert set(LIMITS) == set(BY_NAME)
    for column in COLUMNS:
        low, high = LIMITS[column.name]
        default = getattr(SILENT, column.field, None)
        if isinstance(default, float):
            assert low <= default / column.factor <= high
        assert math.isfinite(high * column.factor)


def test_an_orientation_of_more_than_a_turn_is_what_is_left_of_it() -> None:
    assert read("450", "orientation_deg") == read("90", "orientation_deg")
    assert read("-720", "orientation_deg") == ((0.0,), [])


def test_a_column_like_none_is_told_what_a_sheet_has() -> None:
    assert told(*WHOLE_HEADING, "Farbe") == [
        "w.xlsx, cell 6: expected a column of a wire sheet, such as 'wire', 'wire_diameter_mm',"
        " 'strands', 'insulation_thickness_mm', 'lay_angles_deg', found 'Farbe'."
        " Correct its name, or remove the column."
    ]


def test_every_limit_is_documented(repository: Path) -> None:
    page = (repository / "docs" / "how-to" / "wire-sheet.md").read_text(encoding="utf-8")
    for name, (low, high) in LIMITS.items():
        assert f"| {name.replace('_', ' ')} | {low:.10g} to {high:.10g} |" in page
