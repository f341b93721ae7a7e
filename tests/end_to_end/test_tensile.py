"""The main job on synthetic tensile tests: export to results, against the truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from labpipe.cli import main
from labpipe.records.curve import SlipDecision
from labpipe.store.result_files import read_result
from labpipe.virtual_lab.tensile import (
    GripSlip,
    TensileScenario,
    build_corrugated_tube,
    build_pet_tape,
    build_stiff_bar,
    build_twist_tube,
)
from tests.builders.small_tests import Run, state
from tests.builders.tensile_tests import TensileLab, make_tensile, true_results

SLIPS = (GripSlip(18.75e-3, 0.47), GripSlip(30.85e-3, 0.81))
"""Those of the source's specimen."""
_TUBE, _TAPE = (
    build_corrugated_tube("CT-10-slit-2", gain_error=0.002),
    build_pet_tape("1", gain_error=-0.003),
)
KINDS: dict[str, TensileScenario] = {
    "corrugated-tube": replace(_TUBE, slips=SLIPS),
    "driven back": replace(
        build_corrugated_tube("CT-10-3"), frame=replace(_TUBE.frame, unloads=True, overrun=0.0)
    ),
    "twist-tube": build_twist_tube("1b", gain_error=0.001),
    "twist-tube, other spool": build_twist_tube("2a", slack=0.8e-3, peak_force=400.0),
    "pet-tape": _TAPE,
    "pet-tape, 10 Hz": replace(
        build_pet_tape("2"), instruments=replace(_TAPE.instruments, rate=10.0)
    ),
    "corrugated-tube, 10 Hz": replace(
        build_corrugated_tube("CT-10-1"), instruments=replace(_TUBE.instruments, rate=10.0)
    ),
    "stiff-bar": build_stiff_bar(gain_error=0.001),
}
VARIANTS = {"driven back", "twist-tube, other spool", "pet-tape, 10 Hz", "corrugated-tube, 10 Hz"}
SEED = 1
Make = Callable[[str], TensileLab]


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Make:
    """Give a test of a kind, each processed once by the command."""

    def made(kind: str) -> TensileLab:
        lab = make_tensile(tmp_path_factory.mktemp("lab"), KINDS[kind], SEED)
        before = state(lab.home / "raw")
        assert main(["process", str(lab.raw), "--no-figures"]) == 0
        assert state(lab.home / "raw") == before
        return lab

    return cache(made)


TOLERANCES = {
    # Relative; the load cell is off by up to 0.3 %, which nothing can see.
    "peak_force.1": 0.006,
    "stiffness": 0.01,
    "stiffness_first": 0.02,
    "stiffness_second": 0.01,
    "stiffness_first_per_peak_force": 0.02,
    "stiffness_second_per_peak_force": 0.01,
    "segment_stiffness_first": 0.02,
    "segment_stiffness_second": 0.01,
    "modulus_thin_wall": 0.01,
    "modulus_annulus": 0.01,
    "modulus": 0.02,
    "energy_to_break": 0.01,
    "compliance": 0.01,
}
NEAR = {
    # m; one sampling step of the twist tubes is 50 um, of the tapes 25 um, of the tubes 21 um
    "peak_displacement.1": 1e-5,
    "failure_displacement": 1.2e-4,
    "break_point": 1.5e-4,
    "slack": 1e-4,
    "slip_position.1": 6e-5,
    "slip_position.2": 6e-5,
}


@pytest.mark.parametrize(
    "kind",
    [pytest.param(kind, marks=[pytest.mark.slow] if kind in VARIANTS else []) for kind in KINDS],
)
def test_every_number_within_a_tolerance(done: Make, kind: str) -> None:
    lab, truths = done(kind), true_results(KINDS[kind], SEED)
    assert {result["status"] for result in lab.results.values()} == {"ok"}
    assert bool(read_result(lab.result).slips) == (kind == "corrugated-tube")
    for name, found in lab.results.items():
        truth, estimate = truths[name], found["estimate"]
        below, above = estimate - found["lower"], found["upper"] - estimate
        assert found["level"] == 0.95
        # A wide net of two half widths: coverage is counted elsewhere, over many seeds.
        assert truth - 2.0 * above <= estimate <= truth + 2.0 * below, name
        if name == "failure_force":  # the sample before the loss, which may have begun in its step
            assert found["lower"] < truth < 1.006 * found["upper"]
        elif name in TOLERANCES:
            assert found["value"] == pytest.approx(truth, rel=TOLERANCES[name]), name
        elif name in NEAR:
            assert abs(found["value"] - truth) < NEAR[name], name
        else:
            assert name.startswith("slip_drop."), name
            assert abs(found["value"] - truth) < 0.1, name


def test_slips_are_in_the_ledger_and_repaired(done: Make) -> None:
    lab = done("corrugated-tube")
    result = read_result(lab.result)
    assert [slip.decision for slip in result.slips] == [SlipDecision.REPAIRED] * 2
    curve, aligned = result.curve, result.aligned
    assert curve is not None
    assert aligned is not None
    added = curve.force - aligned.series["force"].values
    first, second = result.slips
    np.testing.assert_allclose(added[: first.start], 0.0)
    np.testing.assert_allclose(added[first.stop : second.start], first.drop)
    np.testing.assert_allclose(added[second.stop :], first.drop + second.drop)
    assert lab.notes["slip_repaired"].endswith("is added to the curve after the slip")


def test_what_the_frame_gives_is_taken_off(tmp_path: Path, run: Run, done: Make) -> None:
    """The bar's own stretch is counted in: 3 % of what was found."""
    found = done("stiff-bar").results["compliance"]["value"]
    lab = make_tensile(tmp_path, KINDS["twist-tube"], SEED)
    lab.override("curve.compliance", f"{{value: {1e6 * found:.6g} um/N, uncertainty: 5 %}}")
    assert run("process", lab.raw, "--no-figures").status == 0
    plain, corrected = done("twist-tube").results, lab.results
    truth = lab.truth
    for region in ("first", "second"):
        name = f"stiffness_{region}"
        assert corrected[name]["value"] > plain[name]["value"]
        alone = truth[f"specimen_stiffness_{region}"]
        assert corrected[name]["value"] == pytest.approx(alone, rel=0.006)
    said = f"{1e6 * found:.4g} um/N x force was subtracted from the displacement, "
    assert lab.notes["compliance_removed"].startswith(said)


def test_parts_out_of_order_and_one_without_samples(tmp_path: Path, run: Run) -> None:
    """Two parts are the whole but for the two samples that the program loses between them."""
    whole = build_twist_tube("2b")
    parts = replace(whole, export=replace(whole.export, part_at=4.5))
    labs = [make_tensile(tmp_path / name, each) for name, each in (("1", whole), ("2", parts))]
    for lab in labs:
        assert run("process", lab.raw, "--no-figures").status == 0
    (one, two), (first, second) = (lab.results for lab in labs), labs
    assert len(second.summary["inputs"]) == 3
    assert len(first.summary["inputs"]) == 1
    assert second.notes["no_samples"].startswith("only a byte order mark")
    assert set(one) == set(two)
    for name in set(one) - {"energy_to_break"}:
        assert two[name]["value"] == pytest.approx(one[name]["value"], rel=1e-9), name
    # The trapezoids bridge the two samples that are gone.
    assert two["energy_to_break"]["value"] == pytest.approx(
        one["energy_to_break"]["value"], rel=1e-4
    )


ACME = """\
program = "Acme Bench"
about = "Synthetic: semicolons and decimal comma, names above units."
recognise = ['\\AACME Bench export']
encodings = ["utf-8"]
separators = [";"]
decimal = ","
names = "above units"
time = ["Zeit"]
"""


def test_a_card_of_the_lab(
    done: Make, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same numbers in a layout that only the lab's own card knows give the same results."""
    lab = make_tensile(tmp_path, KINDS["pet-tape"], SEED)
    rows = [
        line.split("\t") for line in lab.export.read_text("utf-8-sig").splitlines() if "\t" in line
    ]
    lab.export.unlink()
    names = {"Crosshead ": "Querhaupt", "Load ": "Zugkraft", "Time ": "Zeit", "sec": "s"}
    body = [";".join(names.get(cell, cell).replace(".", ",") for cell in row) for row in rows]
    (lab.raw / "pull.csv").write_text("\n".join(["ACME Bench export", *body, ""]), encoding="utf-8")
    sheet = lab.sheet.read_text("utf-8")
    start = sheet.index("files:")
    lab.sheet.write_text(sheet[:start] + "files: {frame: pull.csv}\n", encoding="utf-8")
    for word, name in (("force", "Zugkraft"), ("displacement", "Querhaupt")):
        lab.override(f"sources.frame.channels.{word}.channel", name)
    lab.override("sources.frame.dialect", "acme")
    monkeypatch.chdir(tmp_path)
    ran = run("process", lab.raw, "--no-figures")
    assert ran.status == 2
    assert "acme" in ran.err
    (tmp_path / "dialects").mkdir()
    (tmp_path / "dialects" / "acme.toml").write_text(ACME, encoding="utf-8")
    assert run("process", lab.raw, "--no-figures").status == 0
    usual = done("pet-tape").results
    for name, found in lab.results.items():
        assert found["value"] == pytest.approx(usual[name]["value"], rel=1e-9), name
    key = lab.summary["run"]
    (tmp_path / "dialects" / "acme.toml").write_text(f"{ACME}\n# another card\n", encoding="utf-8")
    assert run("process", lab.raw, "--no-figures").status == 0
    changed = lab.summary
    assert [entry["role"] for entry in changed["inputs"]] == ["frame", "dialect"]
    assert changed["inputs"][1]["file"] == "acme.toml"
    assert changed["run"] != key
    (tmp_path / "dialects" / "acme.toml").unlink()
    assert run("process", lab.result, "--no-figures").status == 0
    assert lab.summary == changed
