"""Public tensile tests of steel by a protocol alone, against what their laboratories certify."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.judges.plain.judge import process

PROTOCOL = """\
version: 1
name: steel
about: Tensile test of steel
sources:
  frame:
    reader: load-frame
    dialect: [table, bluehill]
    channels:
      force: {channel: [Force, Load], scale_uncertainty: 0.58 %, zero_drift: 0.12 %}
      travel:
        channel: [Machine Displacement, Crosshead separation]
        scale_uncertainty: 0.58 %
specimen: {section: {area: AREA mm^2}, uncertainty: {length: 0.5 mm}}
curve: {force: force, displacement: travel, failure: {force_below: 80 %}}
branches: {channel: travel, min_stroke: 1 mm}
results:
  - {result: peak-force}
  - {result: stiffness, from: 0.4 mm, to: 0.6 mm}
  - {result: modulus, of: stiffness, area: stated}
  - {result: failure}
"""
SHEET = """\
test: T
protocol: ./steel.yaml
specimen: {type: steel, spool: "1", sample: "1", length: 30 mm}
files: {frame: export.csv}
"""
ISO, BAM = 26, 6
QUICK = {0}
BY_STANDARD = """\
test: T
protocol: iso-6892
specimen:
  {{type: steel, spool: "1", sample: "1", gauge_length: {gauge} mm, section: {{area: {area} mm^2}}}}
files: {{frame: export.csv}}
"""


def _judged(
    folder: Path, export: Path, area: float, peak: float, columns: tuple[np.ndarray, np.ndarray]
) -> None:
    """Peak by the laboratory; stiffness by a least-squares line over the plain columns.

    The records end while the necked specimen still carries some 70 % of its largest force.
    """
    protocol = PROTOCOL.replace("AREA", f"{area:.6g}").encode()
    files = {"steel.yaml": protocol, "export.csv": export.read_bytes()}
    ran = process(folder, SHEET, files)
    found = ran.results["peak_force.1"]
    assert found["status"] == "ok"
    assert found["value"] == pytest.approx(peak, rel=1e-3)
    assert found["lower"] <= peak <= found["upper"]
    travel, force = columns
    last = int(np.argmax(travel > 0.6))
    window = slice(int(np.argmax(travel >= 0.4)), last)
    slope = 1e3 * np.polyfit(travel[window], force[window], 1)[0]
    assert ran.results["stiffness"]["value"] == pytest.approx(slope, rel=1e-6)
    modulus = ran.results["modulus"]
    assert modulus["status"] == "doubtful"
    assert "machine_compliance" in modulus["code"]
    lost = int(np.flatnonzero(force >= 0.8 * force.max())[-1])
    failure = ran.results["failure_displacement"]
    assert (failure["status"], failure["value"]) == ("ok", pytest.approx(1e-3 * travel[lost]))
    assert not [name for name in ran.results if name.startswith("slip")]


def _marked(count: int) -> list[object]:
    return [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in range(count)]


@pytest.mark.parametrize("number", _marked(ISO))
def test_round_steel_of_iso_6892(realdata: Path, tmp_path: Path, number: int) -> None:
    exports = sorted((realdata / "iso6892").glob("*.csv"))
    assert len(exports) == ISO
    lines = exports[number].read_text(encoding="utf-8-sig").splitlines()
    said = dict(re.findall(r"^(.+?):\t([\d.]+)", "\n".join(lines[:23]), re.MULTILINE))
    rows = np.array([[float(cell) for cell in line.split("\t")[:4]] for line in lines[25:]])
    area = float(said["Original cross-section"])
    peak = float(said["Ultimate tensile strength"]) * area
    _judged(tmp_path, exports[number], area, peak, (rows[:, 3], 1e3 * rows[:, 2]))


@pytest.mark.parametrize("number", _marked(BAM))
def test_flat_steel_with_certified_values(realdata: Path, tmp_path: Path, number: int) -> None:
    exports = sorted((realdata / "bam_s355").glob("Z*.csv"))
    assert len(exports) == BAM
    table = (realdata / "bam_s355" / "S355_data.csv").read_text(encoding="utf-8-sig")
    certified = {row["testpiece"]: row for row in csv.DictReader(table.splitlines(), delimiter=";")}
    said = certified[exports[number].stem]
    lines = exports[number].read_text(encoding="utf-8-sig").splitlines()[2:]
    rows = np.array(
        [[float(cell.replace(",", ".")) for cell in line.split(";")[:3]] for line in lines]
    )
    area = float(said["d1 / a1"]) * float(said["b1"])
    _judged(
        tmp_path, exports[number], area, 1e3 * float(said["Fm"]), (rows[:, 1], 1e3 * rows[:, 2])
    )


def _by_standard(folder: Path, export: Path, gauge: float, area: str) -> dict[str, dict[str, Any]]:
    sheet = BY_STANDARD.format(gauge=gauge, area=area)
    return process(folder, sheet, {"export.csv": export.read_bytes()}).results


def test_proof_stress_and_strength_of_the_laboratory_by_the_shipped_protocol(
    realdata: Path, tmp_path: Path
) -> None:
    """All tests at once: the share of intervals that hold is a number of the whole set."""
    is_inside, half_widths, is_doubtful = [], [], []
    for export in sorted((realdata / "iso6892").glob("*.csv")):
        head = export.read_text(encoding="utf-8-sig").splitlines()[:23]
        said = dict(re.findall(r"^(.+?):\t([\d.]+)", "\n".join(head), re.MULTILINE))
        rows = _by_standard(tmp_path / export.stem, export, 25.0, said["Original cross-section"])
        for name, key, scale, limit in (
            ("tensile_strength", "Ultimate tensile strength", 1e6, 1e-4),
            ("proof_stress_0_2", "Yield stress at 0.2% plastic strain", 1e6, 3e-3),
            ("proof_stress_1", "Yield stress at 1% plastic strain", 1e6, 3e-3),
            ("plastic_elongation_at_maximum_force", "Uniform elongation", 0.01, 3e-3),
            ("plastic_elongation_at_break", "Elongation after fracture", 0.01, 3e-3),
        ):
            assert rows[name]["status"] == "ok"
            assert rows[name]["value"] == pytest.approx(scale * float(said[key]), rel=limit), name
        slope, modulus = (
            1e6 * float(said["Slope of linear-elastic region"]),
            rows["elastic_modulus"],
        )
        is_inside.append(modulus["lower"] <= slope <= modulus["upper"])
        half_widths.append(0.5 * (modulus["upper"] - modulus["lower"]) / slope)
        is_doubtful += [row["status"] == "doubtful" for row in rows.values()]
        assert not [name for name in rows if name.startswith("slip")]
    assert len(is_inside) == ISO
    assert 0.93 <= np.mean(is_inside) <= 0.98
    assert np.median(half_widths) <= 0.015
    assert np.mean(is_doubtful) <= 0.10


@pytest.mark.parametrize("number", range(BAM))
def test_yield_stress_of_certified_steel_by_the_shipped_protocol(
    realdata: Path, tmp_path: Path, number: int
) -> None:
    """Certified stresses are whole MPa; the moduli are doubtful, as the elastic lines bend."""
    export = sorted((realdata / "bam_s355").glob("Z*.csv"))[number]
    table = (realdata / "bam_s355" / "S355_data.csv").read_text(encoding="utf-8-sig")
    rows_of_table = csv.DictReader(table.splitlines(), delimiter=";")
    said = next(row for row in rows_of_table if row["testpiece"] == export.stem)
    area = said["S0"].replace(",", ".")
    rows = _by_standard(tmp_path, export, 50.0, area)
    upper = 1e9 * float(said["FeH"]) / float(area)
    assert rows["upper_yield_stress"]["value"] == pytest.approx(upper, rel=5e-3)
    if said["Rp0,2"]:
        proof = 1e6 * float(said["Rp0,2"])
        assert rows["proof_stress_0_2"]["value"] == pytest.approx(proof, rel=3e-3)
    # The record was thinned: its largest force is up to 0.07 % below the certified one.
    strength = 1e9 * float(said["Fm"]) / float(area)
    assert rows["tensile_strength"]["value"] == pytest.approx(strength, rel=1e-3)
    assert rows["elastic_modulus"]["status"] == "doubtful"
    assert rows["elongation_at_break"]["code"] == "extensometer_off"


def test_modulus_of_a_film_in_the_strain_window_of_its_laboratory(
    realdata: Path, tmp_path: Path
) -> None:
    """The export states modulus, strength and strain at the largest force, by its program."""
    export = next((realdata / "zwick").glob("Zugversuch*.TRA"))
    sheet = BY_STANDARD.format(gauge=80.0, area="2.261").replace("iso-6892", "iso-527-tape")
    rows = process(tmp_path, sheet, {"export.csv": export.read_bytes()}).results
    assert rows["elastic_modulus"]["value"] == pytest.approx(1096.58e6, rel=1e-4)
    assert rows["tensile_strength"]["value"] == pytest.approx(37.5775e6, rel=1e-4)
    elongation = rows["elongation_at_maximum_force"]["value"]
    assert elongation == pytest.approx(2.87605, abs=5e-4)  # counted from the toe
