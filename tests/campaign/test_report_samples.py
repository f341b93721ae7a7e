from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.campaign.report_samples import frames_at_steps, sample_of
from labpipe.process.run import process_test
from labpipe.records.drawn import DrawnShapes
from labpipe.records.group import Sample
from labpipe.records.result import TestResult
from labpipe.store.read import Drawable, read_result
from tests.builders.pulls import broken, pull, slipped
from tests.builders.tensile_tests import TensileLab, write_pull


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two pulls until they broke, the second with a slip."""
    home = tmp_path_factory.mktemp("done")
    for seed, name in enumerate(("T-1", "T-2")):
        lab = TensileLab(home, name)
        travel, force = pull(stiffness=5e3, slack=0.001, seed=seed)
        force = slipped(travel, force, (0.012, 3.0)) if name == "T-2" else force
        write_pull(lab, "tensile", broken(travel, force, at=0.018), travel)
        lab.sheet.write_text(lab.sheet.read_text("utf-8").replace("synthetic", "tube"), "utf-8")
        lab.override("curve.slips.decision", "repaired")
        process_test(lab.sheet, figures=False)
    return home / "processed"


def kept(result: TestResult, source: str = "") -> Sample:
    return sample_of(Drawable(result, None, None), source=source)


def read(done: Path, name: str) -> TestResult:
    return read_result(done / "c" / name / "result.h5")


def test_a_sample_keeps_thinned_branches_up_to_the_failure(done: Path) -> None:
    result = read(done, "T-1")
    sample = kept(result, "here")
    assert (sample.test, sample.source, sample.specimen.type) == ("T-1", "here", "tube")
    (branch,) = sample.loading
    assert not sample.unloading
    assert 400 < len(branch.displacement) <= 1000
    assert (np.diff(branch.displacement) > 0.0).all()
    failure = next(each.value for each in result.results if each.name == "failure_displacement")
    assert failure is not None
    assert branch.displacement[-1] == pytest.approx(failure, abs=4e-5)
    assert branch.force.min() > -0.1
    line = 5e3 * np.maximum(branch.displacement, 0.0)
    np.testing.assert_allclose(branch.force, line, atol=0.15)
    np.testing.assert_array_equal(branch.force, branch.as_measured)


def test_a_repaired_slip_is_seen_in_the_force_as_measured(done: Path) -> None:
    sample = kept(read(done, "T-2"))
    (branch,), (slip,) = sample.loading, sample.slips
    added = branch.force - branch.as_measured
    at = branch.displacement
    assert np.abs(added[at < slip.position - 1e-4]).max() == 0.0
    np.testing.assert_allclose(added[at > slip.position + 1e-4], slip.drop)


def test_unloading_grows_too(done: Path) -> None:
    result = read(done, "T-1")
    curve = result.curve
    assert curve is not None
    back = replace(curve.branches[0], direction=type(curve.branches[0].direction).UNLOADING)
    turned = replace(curve, displacement=-curve.displacement, branches=(back,))
    sample = kept(replace(result, curve=turned))
    assert not sample.loading
    assert (np.diff(sample.unloading[0].displacement) > 0.0).all()


def test_a_test_without_a_curve(done: Path) -> None:
    sample = kept(replace(read(done, "T-1"), curve=None))
    assert sample.loading == sample.unloading == ()


def test_frames_at_round_steps_of_the_first_loading(done: Path) -> None:
    result = read(done, "T-1")
    assert result.curve is not None
    time = np.arange(result.curve.time[0], result.curve.time[-1], 0.02)
    frames, deflection = frames_at_steps(result, time)
    steps = np.diff(deflection)
    assert 4 <= len(frames) <= 7
    np.testing.assert_allclose(deflection, 0.005 * np.arange(len(frames)), atol=1e-4)
    assert (steps > 0.0).all()
    assert len(frames_at_steps(replace(result, curve=None), time)[0]) == 0


def test_where_a_sample_comes_from_is_kept(done: Path) -> None:
    result = read(done, "T-1")
    shapes = DrawnShapes(np.array([0.0, 0.01]), np.zeros((2, 3, 2)))
    sample = sample_of(Drawable(result, shapes, None), source="", label="c/T-1")
    assert (sample.label, sample.run, sample.shapes) == ("c/T-1", result.run, shapes)
    assert [each.sha256 for each in sample.inputs] == [each.sha256 for each in result.inputs]
    assert sample.run
