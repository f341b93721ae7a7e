"""Stress tables: numbers of Ramberg and Osgood against the formula, laws of wires, faults."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from openpyxl import Workbook, load_workbook
from scipy.integrate import quad
from scipy.optimize import brentq

from labpipe.cli import main
from labpipe.errors import ReadError
from labpipe.studies.stress_tables import Conditions, Proof, ramberg_osgood_curve
from labpipe.studies.wire_specs import read_wire_sheet, read_wires
from labpipe.wire.materials import RambergOsgood
from labpipe.wire.wire_table import wire_table
from tests.builders.wire_tables import spec_of

HEADING = "wire,wire_diameter_mm,strands,strand_diameter_mm,lay_angles_deg,insulation_thickness_mm"
NUMBERS = "modulus_mpa,proof_stress_mpa,exponent,largest_strain"
PVC = Proof(modulus_mpa="900", proof_stress_mpa="11", exponent="4", largest_strain="0.08")


def strain_of(numbers: Proof, stress: float) -> float:
    """The formula as data sheets have it, MPa."""
    over = float(stress / numbers.proof_stress_mpa)
    return stress / numbers.modulus_mpa + float(0.002 * over**numbers.exponent)


def stress_of(numbers: Proof, strain: float) -> float:
    """The formula inverted, MPa."""
    most = 1.000001 * numbers.modulus_mpa * strain
    return float(brentq(lambda stress: strain_of(numbers, stress) - strain, 0.0, most, xtol=1e-13))


@pytest.mark.parametrize(
    ("modulus", "proof", "exponent", "largest"),
    [
        ("900", "11", "4", "0.08"),
        ("20", "1.5", "1.5", "0.5"),
        ("1000", "10", "1.1", "0.1"),
        ("3000", "40", "12", "0.2"),
        ("2500", "55", "100", "0.6"),
        ("110000", "54", "2.9", "0.3"),
    ],
)
def test_straight_lines_are_on_the_formula(
    modulus: str, proof: str, exponent: str, largest: str
) -> None:
    numbers = Proof(
        modulus_mpa=modulus, proof_stress_mpa=proof, exponent=exponent, largest_strain=largest
    )
    strains, stresses = ramberg_osgood_curve(numbers)
    assert len(strains) <= 60
    assert strains[-1] == float(largest)
    assert stresses[-1] == pytest.approx(1e6 * stress_of(numbers, strains[-1]), rel=1e-9)
    some = np.geomspace(1e-4, 1.0, 200) * strains[-1]
    lines = np.interp(some, (0.0, *strains), (0.0, *stresses))
    exact = 1e6 * np.array([stress_of(numbers, strain) for strain in some])
    assert np.all(lines <= exact * (1.0 + 1e-9))
    assert lines == pytest.approx(exact, rel=1e-3)
    assert stresses[0] / strains[0] <= 1e6 * numbers.modulus_mpa


def test_the_proof_stress_leaves_two_thousandths() -> None:
    strains, stresses = ramberg_osgood_curve(PVC)
    strain = float(np.interp(11e6, stresses, strains))
    assert strain - 11e6 / 900e6 == pytest.approx(0.002, abs=1e-5)


def test_it_is_the_curve_of_the_copper_in_other_words() -> None:
    copper = RambergOsgood(110e9, 530e6, 0.44)
    proof = f"{530.0 * 0.002**0.44:.12g}"
    numbers = Proof(
        modulus_mpa="110000",
        proof_stress_mpa=proof,
        exponent=f"{1 / 0.44:.12g}",
        largest_strain="0.1",
    )
    strains, stresses = ramberg_osgood_curve(numbers)
    assert copper.stress(np.array(strains)) == pytest.approx(stresses, rel=1e-9)


def test_the_law_of_a_wire_is_that_of_a_dense_table_and_of_the_formula() -> None:
    spec = spec_of("A2", "A2")
    stress = np.linspace(0.0, stress_of(PVC, 0.08), 3001)[1:]
    strain = [strain_of(PVC, each) for each in stress]
    dense = wire_table(replace(spec, insulation_table=(tuple(strain), tuple(1e6 * stress))))
    made = wire_table(replace(spec, insulation_table=ramberg_osgood_curve(PVC)))
    assert made.curvature[-1] == pytest.approx(100.0)
    end = dense.curvature[-1] * (1.0 - 1e-9)
    shared = made.curvature[made.curvature < end]
    for law in ("moment", "insulation"):
        other = np.interp(shared, dense.curvature, getattr(dense, law))
        assert getattr(made, law)[: len(shared)] == pytest.approx(other, rel=1e-3)
    assert np.interp(0.05, made.tip_deflection, made.tip_force) == pytest.approx(
        np.interp(0.05, dense.tip_deflection, dense.tip_force), rel=1e-3
    )
    outer, bore = 0.8e-3, 0.5e-3
    for curvature in (5.0, 25.0, 90.0):
        by_hand = _bar(PVC, outer, curvature) - _bar(PVC, bore, curvature)
        found = float(np.interp(curvature, made.curvature, made.insulation))
        assert found == pytest.approx(by_hand, rel=2e-3)


def _bar(numbers: Proof, radius: float, curvature: float) -> float:
    """Moment of a full bar, N m: stresses of the formula summed up over its height."""

    def lamina(height: float) -> float:
        width = 2.0 * np.sqrt(radius**2 - height**2)
        return float(1e6 * stress_of(numbers, curvature * height) * height * width)

    return 2.0 * float(quad(lamina, 0.0, radius, epsrel=1e-8)[0])


def written(folder: Path, *lines: str, column: str = "insulation_table") -> Path:
    sheet = folder / "wires.csv"
    sheet.write_text(f"{HEADING},{column}\nA2,1.6,7,0.32,12,0.3,pvc.csv\n")
    (folder / "pvc.csv").write_text("\n".join(lines))
    return sheet


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (["-900,11,4,0.08"], "line 2, column 1 (modulus_mpa): expected a number from 0.1 to"),
        (["900,-11,4,0.08"], "line 2, column 2 (proof_stress_mpa): expected a number from 0.001"),
        (["900,11,0.8,0.08"], "line 2, column 3 (exponent): expected a number from 1.1 to 100, f"),
        (["900,11,4,0.8"], "line 2, column 4 (largest_strain): expected a number from 0.0001 to"),
        (["900,11,4,"], "line 2, column 4 (largest_strain): expected a number from 0.0001 to 0"),
        (
            ["900,11,4,0.01"],
            "line 2, column 4 (largest_strain): expected a largest strain of 0.01422 or more, where"
            " the proof stress is reached, found 0.01. Give the range of the test that the numbers"
            " come from.",
        ),
        (
            ["11000,11,4,0.1"],
            "line 2, column 1 (modulus_mpa): expected a modulus of insulation of 0.1 to 10000 MPa,"
            " found 11000 MPa. Is the unit right?",
        ),
        (
            ["900,11,4,0.08", "800,11,4,0.08"],
            "line 3, column 1: expected one row of numbers, found 2. Make a table of each.",
        ),
    ],
)
def test_numbers_that_are_refused(tmp_path: Path, lines: list[str], said: str) -> None:
    with pytest.raises(ReadError) as refused:
        read_wire_sheet(written(tmp_path, NUMBERS, *lines))
    assert str(refused.value).startswith(f"{tmp_path / 'pvc.csv'}, {said}")


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (
            ["modulus_mpa,exponent,largest_strain", "900,4,0.1"],
            "line 1, column 1: expected a column 'proof_stress_mpa', found 'modulus_mpa', 'expone",
        ),
        (
            [f"{NUMBERS},strain", "900,11,4,0.08,1"],
            "line 1, column 5: expected either points or numbers, so no column 'strain' beside",
        ),
        (
            [f"{NUMBERS},exponent", "900,11,4,0.08,4"],
            "line 1, column 5: expected each column once, found 'exponent' again. Remove one.",
        ),
        (
            ["strain,stress_mpa,temperature", "0.01,10,23"],
            "line 1, column 3: expected a column 'temperature_c', found 'temperature'. Give it in",
        ),
        (
            ["strain,stress_mpa,rate_per_min", "0.01,10,23"],
            "line 1, column 3: expected a column 'strain_rate_per_s', found 'rate_per_min'. Give",
        ),
        (
            ["strain,stress_mpa,temperature_c", "0.01,10,23", "0.1,20,40"],
            "line 3, column 3 (temperature_c): expected '23' as in line 2, column 3: one for the w",
        ),
        (
            ["strain,stress_mpa,temperature_c", "0.01,10,cold"],
            "line 2, column 3 (temperature_c): expected a number from -100 to 400 degC, found 'co",
        ),
        (
            ["strain,stress_mpa", "0.01,10", "0.05,8"],
            "line 3, column 2 (stress_mpa): expected a stress of 10 MPa or more, and more than zer",
        ),
        (
            ["strain,stress_mpa", "0.01,10", "0.01,12"],
            "line 3, column 1 (strain): expected a strain above 0.01, found 0.01. Put the rows in",
        ),
    ],
)
def test_tables_that_are_refused(tmp_path: Path, lines: list[str], said: str) -> None:
    with pytest.raises(ReadError) as refused:
        read_wire_sheet(written(tmp_path, *lines))
    assert str(refused.value).startswith(f"{tmp_path / 'pvc.csv'}, {said}")


def test_rate_and_temperature_of_points_stand_in_any_row(tmp_path: Path) -> None:
    heading = "strain,stress_mpa,from,temperature_c,strain_rate_per_s"
    sheet = read_wires(written(tmp_path, heading, "0.01,10,us,23,", "0.1,20,us,,1e-3"))
    curve = sheet.curves["A2"]["insulation_table"]
    assert curve.words == ("'pvc.csv': 2 points, to a strain of 0.1, at 0.001 1/s and 23 \u00b0C")
    assert sheet.specs[0].insulation_table == curve.curve == ((0.01, 0.1), (10e6, 20e6))
    silent = read_wires(written(tmp_path, "strain,stress_mpa", "0.01,10"))
    [said] = silent.curves["A2"].values()
    assert said.words.endswith("1 point, to a strain of 0.01, rate and temperature not stated")
    assert said.as_json()["temperature"] is None


def test_numbers_may_stand_for_the_strands_too(tmp_path: Path) -> None:
    path = written(tmp_path, NUMBERS, "110000,54,2.3,0.2", column="stress_table")
    [spec] = read_wire_sheet(path)
    assert spec.stress_table is not None
    assert spec.stress_table[0][-1] == 0.2
    with pytest.raises(ReadError, match="a modulus of strands of 1000 to 1e\\+06 MPa, found 900"):
        read_wire_sheet(written(tmp_path, NUMBERS, "900,11,4,0.08", column="stress_table"))


def test_the_model_carries_what_a_sheet_of_a_workbook_states(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    book = Workbook()
    page, table = book.active, book.create_sheet("PVC")
    assert page is not None
    page.append([*HEADING.split(","), "insulation_table"])
    page.append(["A2", 1.6, 7, 0.32, 12, 0.3, "pvc"])
    table.append([*NUMBERS.split(","), "strain_rate_per_s", "temperature_c"])
    table.append([900, 11, 4, 0.08, 0.001, 23])
    book.save("wires.xlsx")
    assert main(["model", "wires.xlsx", "--no-figures"]) == 0
    words = (
        "insulation_table 'pvc': Ramberg-Osgood, modulus 900 MPa, proof stress 11 MPa, exponent 4,"
        " to a strain of 0.08, at 0.001 1/s and 23 \u00b0C"
    )
    assert f"  info: {words}  [A2]\n" in capsys.readouterr().out
    model = json.loads(Path("processed/wires/model.json").read_text())
    said = model["wires"]["A2"]["stress_tables"]["insulation_table"]
    assert (said["modulus"], said["proof_stress"]) == (900e6, 11e6)
    assert (said["strain_rate"], said["temperature"]) == (0.001, pytest.approx(296.15))
    assert said["strain"][-1] == 0.08
    heads, row = load_workbook("processed/wires/wires.xlsx")["wires"].iter_rows(values_only=True)
    assert dict(zip(heads, row, strict=True))["stress tables"] == words


def test_every_column_is_documented_with_its_range(repository: Path) -> None:
    page = (repository / "docs" / "how-to" / "wire-sheet.md").read_text(encoding="utf-8")
    for kind in (Proof, Conditions):
        for name, field in kind.model_fields.items():
            [column] = field.metadata
            least = 0.1 if name == "modulus_mpa" else column.least
            most = 10000.0 if name == "modulus_mpa" else column.most
            assert f"`{name}` | {least:g} to {most:.10g}" in page
