"""Bending tests of the virtual lab, export to results and law, against their truth."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import binomtest

from labpipe.cli import main
from labpipe.process.reading import convert_channels
from labpipe.process.story import reduce_recordings
from labpipe.protocol.load import parse_protocol
from labpipe.records.arrays import Floats
from labpipe.records.curve import Bending, PointFlag
from labpipe.records.result import Status
from labpipe.results.measured_law import evaluate_law
from labpipe.store.result_files import read_result
from labpipe.virtual_lab import observe, simulate_test
from labpipe.virtual_lab.cantilever_scenarios import CantileverScenario
from labpipe.virtual_lab.three_point import build_conduit_scenario
from tests.builders.bent_tests import law_moment
from tests.builders.reasons import why
from tests.builders.small_tests import Lab, LabFolder, Run, make_lab, small_scenario, state
from tests.builders.tensile_tests import recordings_of
from tests.coverage.lab_bending import on_a_string, taped_bundle

FULL = CantileverScenario(name="T1")
"""The usual test with all its mishaps, at 10 kHz."""
QUICK = replace(FULL, clocks=replace(FULL.clocks, rate=1000.0))
"""At 1 kHz, as in the demo."""


@pytest.mark.parametrize(
    ("scenario", "ppm"),
    [(QUICK, 30.0), pytest.param(FULL, 10.0, marks=pytest.mark.slow)],
    ids=["quick", "full size"],
)
def test_a_wire_with_mishaps(tmp_path: Path, scenario: CantileverScenario, ppm: float) -> None:
    """A tenth of the samples of a full-size test: its limit of 10 ppm becomes 30."""
    lab = make_lab(tmp_path, scenario)
    raw = state(lab.home / "raw")
    assert main(["process", str(lab.raw)]) == 0
    assert state(lab.home / "raw") == raw
    results, truth, made = lab.results, lab.truth, read_result(lab.result)
    assert results["clock_offset"]["value"] == pytest.approx(truth["clock"]["offset"], abs=5e-3)
    drift = truth["clock"]["drift"]
    assert results["clock_drift"]["value"] == pytest.approx(drift, abs=1e-6 * ppm)
    curve, cell = made.curve, truth["scenario"]["load_cell"]
    assert curve is not None
    true = {
        name: np.interp(curve.time, truth["time"], truth[name]) for name in ("deflection", "force")
    }
    off = curve.displacement - true["deflection"]
    assert np.sqrt(np.nanmean(off**2)) < 1e-4
    assert np.isfinite(off).mean() > 0.99
    off = curve.force - true["force"] * cell["gain"] / truth["true_gain"]
    assert np.sqrt(np.nanmean(off**2)) < cell["noise"]
    # A wide net: coverage at 95 % is counted elsewhere, over many seeds.
    for cycle, numbers in enumerate(truth["cycles"], start=1):
        for name, wanted, near in (
            ("residual_displacement", numbers["residual_deflection"], 1e-4),
            ("peak_displacement", numbers["peak_deflection"], 2e-4),  # of noisy frames
            ("peak_force", numbers["peak_force"], 0.01 * numbers["peak_force"]),
            ("energy", numbers["energy"], 0.02 * numbers["energy"]),
        ):
            result = results[f"{name}.{cycle}"]
            assert (result["status"], result["level"]) == ("ok", 0.95)
            assert abs(result["value"] - wanted) < min(near, result["upper"] - result["lower"])
    events, shape = {event["kind"]: event for event in truth["mishaps"]}, made.shape
    assert shape is not None
    relabelled = (shape.flags == PointFlag.RELABELLED).any(axis=1)
    for kind in ("switch", "unlabelled"):
        assert relabelled[events[kind]["start"] : events[kind]["stop"]].mean() > 0.95
    assert {"label_switch", "track_merged", "labels_repaired"} & {
        note.code for note in made.quality
    }
    _holds_the_law(made.bending, scenario)
    assert (lab.processed / "figures" / "moment-curvature.svg").is_file()


def _holds_the_law(bending: Bending | None, scenario: CantileverScenario) -> None:
    assert bending is not None
    law = bending.law
    assert law is not None
    true = law_moment(scenario.mechanics.wire.build_law(), law.curvature)
    assert law.floor < 0.15
    assert law.is_known.sum() >= 38
    assert law.moment[law.is_known] == pytest.approx(true[law.is_known], rel=0.03)
    above = law.curvature > 0.5
    assert law.moment[above] == pytest.approx(true[above], rel=0.012)
    assert law.curvature[-1] > 28.0
    assert set(bending.cloud.branch.tolist()) == set(range(6))


def test_120_frames_per_second_and_millimetres(tmp_path: Path, run: Run) -> None:
    usual = small_scenario()
    scenario = replace(usual, length_unit="mm", clocks=replace(usual.clocks, fps=120.0))
    lab = make_lab(tmp_path, scenario)
    assert run("process", lab.raw, "--no-figures").status == 0
    for name in ("peak", "residual"):
        truth = lab.truth["cycles"][0][f"{name}_deflection"]
        assert lab.results[f"{name}_displacement.1"]["value"] == pytest.approx(truth, abs=1e-4)


def test_quick_test_with_mishaps(tmp_path: Path, run: Run) -> None:
    """Strokes of 5 s with all mishaps: numbers keep finite errors."""
    usual = small_scenario(rate=500.0)
    mechanics = replace(usual.mechanics, stroke=0.02)
    lab = make_lab(tmp_path, replace(usual, mechanics=mechanics, mishaps=QUICK.mishaps))
    assert run("process", lab.raw, "--no-figures").status == 0
    for name, found in lab.results.items():
        assert found["lower"] < found["estimate"] < found["upper"], name
        assert found["status"] == "ok" or why(found).startswith("alignment_drift: "), name


@pytest.mark.parametrize(
    ("name", "seed", "has_frame"),
    [("CWB-1", 0, True), pytest.param("CWB-2a", 1, False, marks=pytest.mark.slow)],
)
def test_a_bundle_in_a_conduit(
    tmp_path: Path, run: Run, name: str, seed: int, *, has_frame: bool
) -> None:
    """With the export of the frame, or by the speed of the crosshead."""
    lab = LabFolder(tmp_path, name)
    simulate_test(replace(build_conduit_scenario(name), has_frame_export=has_frame), lab.raw, seed)
    assert run("process", lab.raw, "--no-figures").status == 0
    results, truth = lab.results, lab.truth
    assert {result["status"] for result in results.values()} == {"ok"}
    wanted = {f"{kind}.1": truth[kind] for kind in ("peak_force", "peak_displacement", "energy")}
    wanted["bending_stiffness"] = truth["bending_stiffness"]
    wanted["mid_span_curvature"] = max(truth["curvature"])
    # Which end of a specimen is its first is nobody's to say.
    turned = max(map(abs, truth["twist"]))
    wanted["twist"] = float(np.copysign(turned, results["twist"]["estimate"]))
    for result, value in wanted.items():
        # A wide net: coverage at 95 % is counted elsewhere, over many seeds.
        width = results[result]["upper"] - results[result]["lower"]
        assert results[result]["estimate"] == pytest.approx(value, abs=width), result


BUNDLE_RESULTS = (
    *("initial_stiffness", "bending_stiffness", "kink_displacement", "kink_force", "end_slope"),
    *("loading_stiffness.1", "loading_stiffness.2", "hardening.2"),
)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_taped_bundle(repository: Path, tmp_path: Path, seed: int) -> None:
    results, truth = on_a_string(taped_bundle(seed), seed, tmp_path, repository / "protocols")
    named = {result.name: result for result in results}
    for name in BUNDLE_RESULTS:
        interval = named[name].interval
        assert interval is not None, name
        width = interval.upper - interval.lower
        assert named[name].value == pytest.approx(truth[name], abs=width), name
    assert not [result for result in results if result.status is Status.FAILED]


LAWS = 120
CURVATURES: Floats = np.array([1.0, 3.0, 6.0, 12.0, 20.0, 26.0])


@pytest.mark.slow
def test_intervals_of_the_law_cover(repository: Path) -> None:
    """In tests the offsets of whose protocol are off by as much as it says."""
    scenario = replace(QUICK, mechanics=replace(QUICK.mechanics, cycles=2))
    true = law_moment(scenario.mechanics.wire.build_law(), CURVATURES)
    shipped = (repository / "protocols" / "wire-cantilever.yaml").read_text(encoding="utf-8")
    hits = np.zeros(len(CURVATURES), dtype=int)
    for seed in range(LAWS):
        rng, text = np.random.default_rng([seed, 11]), shipped
        for key, nominal in (("grip_offset", 6.0), ("pull_offset", 4.0)):
            assert f"{key}: {nominal:g} mm" in text
            drawn = nominal + 0.1 * rng.standard_normal()
            text = text.replace(f"{key}: {nominal:g} mm", f"{key}: {drawn:.6f} mm")
        plan, seen = parse_protocol(text, "p.yaml"), recordings_of(observe(scenario, seed))
        force = convert_channels(seen["force"], plan.sources["force"], Path("force.mat"))
        done: Any = reduce_recordings({"force": force, "markers": seen["markers"]}, plan)
        law = done.reduced_test.bending.law
        points = evaluate_law(
            law.knots,
            law.compliance,
            law.compliance_covariance,
            CURVATURES,
            scale_error=law.scale_error,
        )
        moment, error = points["moment"]
        hits += np.abs(moment - true) <= 1.96 * error
    chances = [binomtest(int(count), LAWS, 0.95).pvalue for count in hits]
    assert min(chances) > 0.01 / len(CURVATURES), f"covered of {LAWS}: {hits} at {CURVATURES}"


def test_the_same_inputs_give_the_same_files(pristine: Lab, tmp_path: Path, run: Run) -> None:
    """Also from the result file alone, wherever it lies."""
    kept = tmp_path / "elsewhere" / "result.h5"
    kept.parent.mkdir()

    def processed(source: Path, name: str) -> dict[str, str]:
        assert run("process", source, "--out", tmp_path / name, "--no-figures").status == 0
        return {file: digest for file, (digest, _) in state(tmp_path / name).items()}

    first = processed(pristine.raw, "one")
    assert set(first) == {"T1/result.h5", "T1/summary.json"}
    assert processed(pristine.raw, "two") == first
    shutil.copy(tmp_path / "one" / "T1" / "result.h5", kept)
    assert processed(kept, "again") == first
