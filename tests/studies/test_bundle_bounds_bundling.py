"""Bundles from words and from test sheets."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from labpipe.errors import LabpipeError, ProcessingError, UsageError
from labpipe.studies.bundle_bounds import Conduit, as_json, model_bundle
from labpipe.wire.bundle_model import bundle_model
from tests.builders.bundles import EXAMPLES, bundle, example_wires

SHEET = """\
test: TWB-1
protocol: force-displacement
specimen:
  type: TWB
  spool: s1
  sample: 1
  bundle: {BUNDLE}
files: {frame: a.csv}
"""


def sheet(folder: Path, block: str) -> Path:
    path = folder / "test.yaml"
    path.write_text(SHEET.replace("{BUNDLE}", block), encoding="utf-8")
    return path


def test_words_to_numbers_and_files(tmp_path: Path) -> None:
    out = tmp_path / "out"
    modelled = model_bundle("7 B1", wires=EXAMPLES, out=out)
    plain = bundle_model(bundle(("B1", 7)), example_wires())
    assert (modelled.name, modelled.conduits) == ("7 B1", ())
    assert modelled.model.high == plain.high
    assert modelled.wanted_bore == pytest.approx(1.1e-3 * (7 / 0.7) ** 0.5)
    assert [file.relative_to(out).as_posix() for file in modelled.files] == [
        *("bundle.json", "figures/bundle.svg"),
    ]
    said = json.loads((out / "bundle.json").read_text(encoding="utf-8"))
    assert said["doubtful_curvature"] == plain.doubtful_curvature
    assert said["doubtful_curvature_stick"] == plain.doubtful_curvature_stick
    assert said["doubtful"] == plain.is_doubtful.tolist()
    assert said["doubtful_stick"] == plain.is_doubtful_stick.tolist()
    assert said == json.loads(json.dumps(as_json(modelled)))
    assert said["high"] == plain.high
    assert said["moment_stick"] == plain.moment_stick.tolist()
    assert said["packing_fraction"] is None
    assert said["bundle"]["wires"] == [{"type": "B1", "number": 7, "diameter": None}]
    assert [note["code"] for note in said["notes"]] == ["copper_yields", "insulation_doubtful"]


def test_folder_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    model_bundle("4 B1 + 3 B2", wires=EXAMPLES, arrangement="asymmetric", figures=False)
    assert (tmp_path / "processed/bundles/4-B1-3-B2-asymmetric/bundle.json").is_file()


def test_the_best_filled_bore_is_chosen(tmp_path: Path) -> None:
    modelled = model_bundle(
        "7 B1", wires=EXAMPLES, bores=(3.2e-3, 3.5e-3, 10.7e-3), out=tmp_path, figures=False
    )
    assert modelled.model.bundle.conduit_bore == 3.5e-3
    assert modelled.model.packing_fraction == pytest.approx(7 * 1.1**2 / 3.5**2)
    assert [conduit.holds for conduit in modelled.conduits] == [False, True, True]
    assert modelled.conduits[1] == Conduit(3.5e-3, modelled.model.packing_fraction or 0.0, True)


def test_a_test_sheet(tmp_path: Path) -> None:
    path = sheet(
        tmp_path,
        "{wires: {B1: 4, B2: 3}, arrangement: asymmetric, conduit: tube, conduit_bore: 6 mm}",
    )
    for what in (path, tmp_path):
        modelled = model_bundle(str(what), wires=EXAMPLES, out=tmp_path / "out", figures=False)
        assert modelled.name == "TWB-1"
        assert modelled.model.layout.arrangement == "asymmetric"
        assert modelled.model.bundle.conduit_bore == 6e-3
    other = model_bundle(
        str(path),
        wires=EXAMPLES,
        arrangement="symmetric",
        bores=(5e-3,),
        out=tmp_path / "out",
        figures=False,
    )
    assert other.model.layout.arrangement == "symmetric"
    assert other.model.bundle.conduit_bore == 5e-3


@pytest.mark.parametrize(
    ("what", "error", "words"),
    [
        ("7 B9", UsageError, r"expected a row for each wire of the bundle, B9 too, found rows for "
         r"A1, .*\. Add the row, or name another wire sheet with --wire\.$"),
        ("B1 seven", UsageError, r"^B1 seven: expected wires by type"),
        (f"{'9' * 500} B1", UsageError, r"expected a whole number from 1 to 1000"),
        ("nowhere/test.yaml", LabpipeError, r"nowhere/test\.yaml: expected "),
    ],
)  # fmt: skip
def test_bundles_that_cannot_be(
    tmp_path: Path, what: str, error: type[LabpipeError], words: str
) -> None:
    with pytest.raises(error, match=words):
        model_bundle(what, wires=EXAMPLES, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_an_arrangement_that_there_is_not(tmp_path: Path) -> None:
    path = sheet(tmp_path, "{wires: {B1: 4, B2: 3}}")
    words = (
        r"^--arrangement: expected one of packed, symmetric, asymmetric, found 'round'\. "
        r"Choose one, or leave it out\.$"
    )
    with pytest.raises(UsageError, match=words):
        model_bundle(str(path), wires=EXAMPLES, arrangement="round", out=tmp_path / "out")


def test_no_conduit_is_wide_enough(tmp_path: Path) -> None:
    words = (
        r"^7 B1: expected a bundle whose wires lie beside each other, inside its conduit, found "
        r"this: the narrowest arrangement found needs a bore of 3\.3 mm, and the conduits "
        r"have 3 mm\. "
        r"Check the wires, their positions and the bore\.$"
    )
    with pytest.raises(ProcessingError, match=words):
        model_bundle("7 B1", wires=EXAMPLES, bores=(3e-3,), out=tmp_path / "out")


def test_a_sheet_without_a_bundle(tmp_path: Path) -> None:
    path = sheet(tmp_path, "")
    path.write_text(path.read_text().replace("  bundle: \n", ""), encoding="utf-8")
    words = (
        r"test\.yaml, specimen: expected a bundle, found none\. Write what the bundle is made of, "
        r"such as 'bundle: \{wires: \{B1: 7\}\}'\.$"
    )
    with pytest.raises(UsageError, match=words):
        model_bundle(str(path), wires=EXAMPLES, out=tmp_path / "out")


def test_a_wire_that_cannot_be_built(tmp_path: Path) -> None:
    """A hexagon of 19 strands that is 10 um too large for its bore, though the copper would fit."""
    wires = tmp_path / "wires.csv"
    wires.write_text(
        "wire,wire_diameter_mm,strands,strand_diameter_mm,lay_angles_deg,insulation_thickness_mm,"
        "layout\nX1,1.78,19,0.24,12;-15,0.3,hexagonal\n",
        encoding="utf-8",
    )
    words = (
        r"wires\.csv, line 2.*: expected a wire 'X1' that can be modelled, found this: .*strands "
        r"overlap the bore .* by 1e-05 m.*\. Check its row against the wire\.$"
    )
    with pytest.raises(ProcessingError, match=words):
        model_bundle("7 X1", wires=wires, out=tmp_path / "out")
