from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from openpyxl import load_workbook
from scipy.integrate import quad
from scipy.optimize import brentq

from labpipe.cli import main
from labpipe.errors import ReadError
from labpipe.mechanics.studies.wire_sheets import (
    Conditions,
    FormulaRow,
    compute_ramberg_osgood,
    read_wire_sheet,
)
from labpipe.mechanics.wire.wire_table import tabulate_wire as table_of
from tests.approved import Approve
from tests.builders.wire_tables import spec_of
from tests.readers.load_frame.exports import workbook

HEADING = "wire,wire_diameter_mm,strands,strand_diameter_mm,lay_angles_deg,insulation_thickness_mm"
WIRE = "A2,1.6,7,0.32,12,0.3"
NUMBERS = "modulus_mpa,proof_stress_mpa,exponent,largest_strain"
PVC = FormulaRow(modulus_mpa="900", proof_stress_mpa="11", exponent="4", largest_strain="0.08")


def strain_of(numbers: FormulaRow, stress: float) -> float:
    """The formula as data sheets have it, MPa."""
    over = float(stress / numbers.proof_stress_mpa)
    return stress / numbers.modulus_mpa + float(0.002 * over**numbers.exponent)


def stress_of(numbers: FormulaRow, strain: float) -> float:
    """The formula inverted, MPa."""
    most = 1.000001 * numbers.modulus_mpa * strain
    return float(brentq(lambda stress: strain_of(numbers, stress) - strain, 0.0, most, xtol=1e-13))


@pytest.mark.parametrize(
    "row",
    [
        "900,11,4,0.08",
        "20,1.5,1.5,0.5",
        "1000,10,1.1,0.1",
        "3000,40,12,0.2",
        "2500,55,100,0.6",
        "110000,54,2.9,0.3",
    ],
)
def test_straight_lines_are_on_the_formula(row: str) -> None:
    numbers = FormulaRow.model_validate(dict(zip(NUMBERS.split(","), row.split(","), strict=True)))
    strains, stresses = compute_ramberg_osgood(numbers)
    assert len(strains) <= 60
    assert strains[-1] == numbers.largest_strain
    assert stresses[-1] == pytest.approx(1e6 * stress_of(numbers, strains[-1]), rel=1e-9)
    grid = np.geomspace(1e-4, 1.0, 200) * strains[-1]
    lines = np.interp(grid, (0.0, *strains), (0.0, *stresses))
    exact = 1e6 * np.array([stress_of(numbers, strain) for strain in grid])
    assert np.all(lines <= exact * (1.0 + 1e-9))
    assert lines == pytest.approx(exact, rel=1e-3)
    assert stresses[0] / strains[0] <= 1e6 * numbers.modulus_mpa


def test_the_law_of_a_wire_is_that_of_the_formula() -> None:
    table = table_of(replace(spec_of("A2", "A2"), insulation_table=compute_ramberg_osgood(PVC)))
    assert table.curvature[-1] == pytest.approx(100.0)
    for curvature in (5.0, 25.0, 90.0):
        by_hand = _bar(PVC, 0.8e-3, curvature) - _bar(PVC, 0.5e-3, curvature)
        insulation = float(np.interp(curvature, table.curvature, table.insulation))
        assert insulation == pytest.approx(by_hand, rel=2e-3)


def _bar(numbers: FormulaRow, radius: float, curvature: float) -> float:
    """Moment of a full bar, N m: stresses of the formula summed up over its height."""

    def lamina(height: float) -> float:
        width = 2.0 * np.sqrt(radius**2 - height**2)
        return float(1e6 * stress_of(numbers, curvature * height) * height * width)

    return 2.0 * float(quad(lamina, 0.0, radius, epsrel=1e-8)[0])


def write_sheet(
    folder: Path, *lines: str, column: str = "insulation_table", file: str = ""
) -> Path:
    """Write a sheet of one wire, and beside it the table that it names."""
    sheet = folder / "wires.csv"
    sheet.write_text(f"{HEADING},{column}\n{WIRE},{file or 'pvc.csv'}\n")
    (folder / "pvc.csv").write_text("\n".join(lines))
    return sheet


def refusal(path: Path) -> str:
    with pytest.raises(ReadError) as refused:
        read_wire_sheet(path)
    return str(refused.value)


TEMPERATURE = "strain,stress_mpa,temperature_c"
REFUSED: list[tuple[str, ...]] = [
    *((NUMBERS, row) for row in ("-900,11,4,0.08", "900,-11,4,0.08", "900,11,0.8,0.08")),
    *((NUMBERS, row) for row in ("900,11,4,0.8", "900,11,4,", "900,11,4,0.01", "11000,11,4,0.1")),
    (NUMBERS, "900,11,4,0.08", "800,11,4,0.08"),
    ("modulus_mpa,exponent,largest_strain", "900,4,0.1"),
    (f"{NUMBERS},strain", "900,11,4,0.08,1"),
    (f"{NUMBERS},exponent", "900,11,4,0.08,4"),
    ("strain,stress_mpa,temperature", "0.01,10,23"),
    ("strain,stress_mpa,rate_per_min", "0.01,10,23"),
    (TEMPERATURE, "0.01,10,23", "0.1,20,40"),
    (TEMPERATURE, "0.01,10,cold"),
    ("strain,stress_mpa", "0.01,10", "0.05,8"),
    ("strain,stress_mpa", "0.01,10", "0.01,12"),
]


def test_tables_that_are_refused(tmp_path: Path, approved: Approve) -> None:
    messages = [refusal(write_sheet(tmp_path, *lines)) for lines in REFUSED]
    strands = write_sheet(tmp_path, NUMBERS, "900,11,4,0.08", column="stress_table")
    messages.append(refusal(strands))
    for name in ("../pvc.csv", "none.csv"):
        messages.append(refusal(write_sheet(tmp_path, *REFUSED[-1], file=name)))
    both = write_sheet(tmp_path, "strain,stress_mpa", "1e-3,110", column="copper_n,stress_table")
    both.write_text(both.read_text().replace(",pvc", ",0.4,pvc"))
    messages.append(refusal(both))
    approved(messages)


def write_book(path: Path, name: str, *rows: list[object]) -> Path:
    wires: list[list[object]] = [[*HEADING.split(","), "stress_table"], [*WIRE.split(","), name]]
    return workbook(path, {"wires": wires, "soft": rows})


def test_tables_of_a_workbook_that_are_refused(tmp_path: Path, approved: Approve) -> None:
    heading: list[object] = ["strain", "stress_mpa"]
    cases: list[tuple[str, list[list[object]]]] = [
        ("soft", [["strain", "stress"], [0.1, 1]]),
        ("soft", [heading]),
        ("sofd", [heading]),
        ("soft", [heading, [0.001, "x"], [5, None]]),
        ("soft", [heading, [0.002, 110], [0.001, 120]]),
        ("soft", [heading, [0, 0], [0.2, 110]]),
        ("soft", [heading, [0.001, 50], [0.002, 150]]),
    ]
    book = tmp_path / "w.xlsx"
    approved(refusal(write_book(book, name, *rows)) for name, rows in cases)


def test_a_table_takes_the_place_of_the_numbers(tmp_path: Path) -> None:
    """Of points or of numbers, for strands or insulation, beside a csv or in a workbook."""
    points = "strain,stress_mpa", "0.001,110", "0.1,150"
    sheet = write_sheet(tmp_path, *points, column="stress_table")
    sheet.write_text(sheet.read_text() + WIRE.replace("A2", "A4") + ",pvc.csv")
    first, second = read_wire_sheet(sheet).specs
    assert first.stress_table == ((0.001, 0.1), (110e6, 150e6))
    assert second.stress_table is first.stress_table
    assert not {"conductor_modulus", "copper_k", "copper_n"} & set(first.defaults)
    [spec] = read_wire_sheet(write_sheet(tmp_path, "strain,stress_mpa", "0.01,10", "0.1,24")).specs
    assert spec.insulation_table == ((0.01, 0.1), (10e6, 24e6))
    assert not {"insulation_modulus", "insulation_strain"} & set(spec.defaults)
    strands = write_sheet(tmp_path, NUMBERS, "110000,54,2.3,0.2", column="stress_table")
    [spec] = read_wire_sheet(strands).specs
    assert spec.stress_table is not None
    assert spec.stress_table[0][-1] == 0.2
    rows: list[list[object]] = [["Strain", "stress_MPa", "from"], [0, 0, "us"], [0.001, 110, "us"]]
    [spec] = read_wire_sheet(write_book(tmp_path / "w.xlsx", "SOFT", *rows)).specs
    assert spec.stress_table == ((0.001,), (110e6,))


def test_rate_and_temperature_of_points_stand_in_any_row(tmp_path: Path) -> None:
    heading = "strain,stress_mpa,from,temperature_c,strain_rate_per_s"
    sheet = read_wire_sheet(write_sheet(tmp_path, heading, "0.01,10,us,23,", "0.1,20,us,,1e-3"))
    curve = sheet.curves["A2"]["insulation_table"]
    assert curve.description == (
        "'pvc.csv': 2 points, to a strain of 0.1, at 0.001 1/s and 23 \u00b0C"
    )
    silent = read_wire_sheet(write_sheet(tmp_path, "strain,stress_mpa", "0.01,10"))
    [stated] = silent.curves["A2"].values()
    assert stated.description.endswith(
        "1 point, to a strain of 0.01, rate and temperature not stated"
    )
    assert stated.build_json()["temperature"] is None


def test_the_model_carries_what_a_sheet_of_a_workbook_states(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    wires = [[*HEADING.split(","), "insulation_table"], [*WIRE.split(","), "pvc"]]
    heading = [*NUMBERS.split(","), "strain_rate_per_s", "temperature_c"]
    table: list[list[object]] = [list(heading), [900, 11, 4, 0.08, 0.001, 23]]
    workbook(tmp_path / "wires.xlsx", {"wires": wires, "PVC": table})
    assert main(["model", "wires.xlsx", "--no-figures"]) == 0
    text = (
        "insulation_table 'pvc': Ramberg-Osgood, modulus 900 MPa, proof stress 11 MPa, exponent 4,"
        " to a strain of 0.08, at 0.001 1/s and 23 \u00b0C"
    )
    assert f"  info: {text}  [A2]\n" in capsys.readouterr().out
    model = json.loads(Path("processed/wires/model.json").read_text())
    stated = model["wires"]["A2"]["stress_tables"]["insulation_table"]
    assert (stated["modulus"], stated["proof_stress"]) == (900e6, 11e6)
    assert (stated["strain_rate"], stated["temperature"]) == (0.001, pytest.approx(296.15))
    assert stated["strain"][-1] == 0.08
    heads, row = load_workbook("processed/wires/wires.xlsx")["wires"].iter_rows(values_only=True)
    assert dict(zip(heads, row, strict=True))["stress tables"] == text


def test_every_column_is_documented_with_its_range(repository: Path) -> None:
    page = (repository / "docs" / "how-to" / "wire-sheet.md").read_text(encoding="utf-8")
    for kind in (FormulaRow, Conditions):
        for name, field in kind.model_fields.items():
            [column] = field.metadata
            least = 0.1 if name == "modulus_mpa" else column.minimum
            most = 10000.0 if name == "modulus_mpa" else column.maximum
            assert f"`{name}` | {least:g} to {most:.10g}" in page
