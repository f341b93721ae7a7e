"""Laws of the lines of harnesses, and what is said of files that have none."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from labpipe.decks.slider_table import sliders_json
from labpipe.errors import LabpipeError
from labpipe.law.sliders import slider_moment
from labpipe.protocol.load import load_harness
from labpipe.studies.harness_section import Material, material_of
from labpipe.studies.wire_specs import read_wire_sheet
from labpipe.wire.wire_table import wire_table
from tests.builders.harness_files import SHEET, STIFFNESS, arch, written


def material(folder: Path, section: str, *, wires: Path | None = None, line: str = "") -> Material:
    file = written(folder, arch(section, line=line))
    return material_of(load_harness(file), file, wires)


def test_a_wire_has_the_law_of_its_sheet(tmp_path: Path) -> None:
    found = material(tmp_path, "{wire: A2}")
    table = wire_table(next(spec for spec in read_wire_sheet(SHEET) if spec.name == "A2"))
    section = found.sections[0]({})
    moments = slider_moment(section.law, table.curvature[1:])
    assert moments == pytest.approx(table.moment[1:], rel=0.01)
    assert section.mass_per_length == pytest.approx(table.mass_per_length)
    assert section.torsional_stiffness == pytest.approx(table.torsional_stiffness)
    assert found.diameter == pytest.approx(1.6e-3)
    assert found.limit == pytest.approx(table.doubtful_curvature)
    assert found.limit_words == "the straight line of its insulation"
    assert (found.beliefs, found.best) == ((), {})
    assert [each.role for each in found.files] == ["wires"]


def test_a_deck_has_the_same_law(tmp_path: Path) -> None:
    spec = next(spec for spec in read_wire_sheet(SHEET) if spec.name == "A2")
    (tmp_path / "A2.sliders.json").write_text(sliders_json(wire_table(spec)), encoding="utf-8")
    found = material(tmp_path, "{sliders: A2.sliders.json, diameter: 1.6 mm}")
    wire = material(tmp_path, "{wire: A2}")
    own, other = found.sections[0]({}), wire.sections[0]({})
    assert own.law.stiffnesses == pytest.approx(other.law.stiffnesses, rel=1e-6)
    assert own.mass_per_length == pytest.approx(other.mass_per_length)
    assert found.name == "A2"
    assert found.limit == pytest.approx(wire.limit)
    assert found.limit_words == wire.limit_words
    stiffer = found.sections[0]({"law_factor": np.log(2.0), "mass_factor": np.log(3.0)})
    assert stiffer.law.stiffnesses == pytest.approx(2.0 * own.law.stiffnesses)
    assert stiffer.law.stiffness == pytest.approx(2.0 * own.law.stiffness)
    assert stiffer.mass_per_length == pytest.approx(3.0 * own.mass_per_length)
    assert stiffer.torsional_stiffness == own.torsional_stiffness


def test_two_stiffnesses(tmp_path: Path) -> None:
    found = material(tmp_path, STIFFNESS)
    section = found.sections[0]({})
    assert section.law.stiffness == pytest.approx(150e-6)
    assert np.isinf(section.axial_stiffness)
    assert (found.limit, found.limit_words) == (80.0, "'largest_curvature' of the file")


def test_what_the_file_states_is_believed(tmp_path: Path) -> None:
    curl = "  spool: {curvature: 2 1/m, spread: 0.4 1/m}\n"
    section = STIFFNESS.replace("}", ", stiffness_uncertainty: 10 %}")
    (belief,) = material(tmp_path, section, line=curl).beliefs
    assert belief.names == ("law_factor", "free_curvature_1", "free_curvature_2")
    assert np.diag(belief.steps) == pytest.approx([0.1, 0.4, 0.4])
    assert dict.fromkeys(belief.causes) == {"stiffness as stated": None, "curl of the spool": None}
    assert belief.inputs() == dict.fromkeys(belief.names, 0.0)


def test_another_sheet_in_its_place(tmp_path: Path) -> None:
    other = tmp_path / "other.csv"
    other.write_text(
        "wire,wire_diameter_mm,strands,strand_diameter_mm,insulation_thickness_mm,lay_angles_deg\n"
        "X,1.6,7,0.32,0.3,12\n"
    )
    assert material(tmp_path, "{wire: X}", wires=other).name == "X"


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ("{wire: A22}", "line.section.wire: expected a wire of"),
        ("{wire: A22}", "such as A2, "),
        ("{wire: A2, calibration: wires.xlsx}", "expected a calibration.json with solutions"),
        (
            "{sliders: wires.xlsx, diameter: 2 mm}",
            "expected a deck that labpipe wrote, found a dam",
        ),
        ("{sliders: list.json, diameter: 2 mm}", "expected a deck that labpipe wrote, found somet"),
        ("{sliders: none.json, diameter: 2 mm}", "found why there is none: it stiffens."),
        (
            "{sliders: open.json, diameter: 2 mm}",
            "open.json: expected the law of a wire with its range, found none under 'range'. "
            "`labpipe model` writes <wire>.sliders.json.",
        ),
        ("{sliders: low.json, diameter: 2 mm}", "found this: stiffnesses=[-1.0]: allowed are"),
    ],
)
def test_a_file_without_a_law(tmp_path: Path, section: str, message: str) -> None:
    deck = {"stiffness": 1e-4, "stiffnesses": [-1.0], "slip_curvatures": [1.0]}
    ranged = deck | {"range": {"curvature": [0.1, 9.0]}, "torsional_stiffness": 1e-4}
    for name, said in {
        "list": [],
        "none": {"reason": "it stiffens"},
        "open": deck,
        "low": ranged,
    }.items():
        (tmp_path / f"{name}.json").write_text(json.dumps(said), encoding="utf-8")
    with pytest.raises(LabpipeError) as raised:
        material(tmp_path, section)
    assert message in str(raised.value)
