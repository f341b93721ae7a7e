from __future__ import annotations

import numpy as np
import pytest

from labpipe.errors import ProcessingError
from labpipe.records.curve import Direction
from tests.builders.pulls import LINE, pull, pulled
from tests.builders.reduced import RESULTS, loop, reduced


def test_stages_of_one_clock() -> None:
    time, path, force = loop(cycles=3, noise=1e-3)
    test, _ = reduced(time, path, force)
    assert test.aligned is not None
    assert test.curve is not None
    assert set(test.aligned.series) == {"force", "displacement"}
    np.testing.assert_array_equal(test.curve.time, time)
    np.testing.assert_array_equal(test.curve.force, force)
    np.testing.assert_array_equal(test.aligned.series["displacement"].values, path)
    assert [branch.direction for branch in test.curve.branches[:2]] == list(Direction)
    assert [branch.cycle for branch in test.curve.branches] == [1, 1, 2, 2, 3, 3]
    assert test.curve.branches[0].stop_time == pytest.approx(12.0, abs=0.03)


def test_a_column_of_noise_is_no_motion() -> None:
    time, path, force = loop(cycles=3, noise=1e-3)
    noise = 2e-3 * np.random.default_rng(0).standard_normal(len(time))
    test, results = reduced(time, path + noise, force)
    assert test.curve is None
    assert results["initial_stiffness"].why == (
        "no_motion: the motion scatters by 1.97 mm from sample to sample, too much to tell strokes "
        "of min_stroke, 1 mm: is it the right channel?"
    )


def test_results_are_in_the_order_of_the_protocol() -> None:
    _, results = reduced(*loop())
    assert [name.partition(".")[0] for name in results][::2] == [
        "peak_force",
        "peak_displacement",
        "initial_stiffness",
        "unloading_stiffness",
        "energy",
        "residual_displacement",
    ]


def test_smoothing_leaves_the_aligned_data_alone() -> None:
    time, path, force = loop(noise=0.05)
    step = "steps:\n  - {step: smooth, channel: force, method: moving-average, span: 1 s}\n"
    test, _ = reduced(time, path, force, more=step + RESULTS)
    assert test.aligned is not None
    assert test.curve is not None
    np.testing.assert_array_equal(test.aligned.series["force"].values, force)
    assert np.std(np.diff(test.curve.force)) < 0.1 * np.std(np.diff(force))


def test_decimated_displacement_carries_the_branches() -> None:
    step = "steps:\n  - {step: decimate, channel: displacement, factor: 5, method: stride}\n"
    time, path, force = loop()
    test, results = reduced(time, path, force, more=step + RESULTS)
    assert test.curve is not None
    np.testing.assert_array_equal(test.curve.time, time[::5])
    np.testing.assert_allclose(test.curve.force, force[::5], atol=1e-12)
    assert results["energy.1"].value == pytest.approx(0.001, rel=0.02)


def test_a_step_that_cannot_be_done_is_named() -> None:
    step = "steps:\n  - {step: zero, channel: force, over: 30 ms}\n"
    said = (
        r"steps.0 \(zero\): force: 3 samples in the 0.04 s to zero on, 8 are needed, and there are "
        r"50 per second\. Write 'steps.0.over: \{value: 0.17 s, because: \.\.\.\}' under 'over"
    )
    short = [each[:20] for each in loop()]
    with pytest.raises(ProcessingError, match=said):
        reduced(*short, more=step)


def test_the_rig_is_a_check() -> None:
    rig = "rig: {stroke: 12 mm, cycles: 3, crosshead_speed: 1 mm/s}\n"
    test, results = reduced(*loop(cycles=2), more=rig + RESULTS)
    notes = {note.code: note.message for note in test.findings.notes}
    assert notes["cycles_unexpected"] == "2 cycles measured, the protocol expects 3"
    assert notes["stroke_unexpected"] == "a stroke of 10 mm measured, 12 mm expected"
    assert results["peak_force.1"].value == pytest.approx(1.0, rel=0.02)


def test_no_curve_is_asked_for() -> None:
    test, results = reduced(*loop(), more="")
    assert results == {}
    assert test.curve is not None


@pytest.mark.parametrize(
    ("specimen", "old", "known"),
    [
        ("{length: 100 mm}", "", {}),
        ("{length: 100 mm, uncertainty: {length: 1 mm}}", "", {"length": 1e-3}),
        ("{length: 100 mm}", ", length_uncertainty: 2 mm", {"length": 2e-3}),
        (
            "{length: 100 mm, uncertainty: {wall: 1 um, length: 2 mm}}",
            ", length_uncertainty: 2 mm",
            {"length": 2e-3, "wall": 1e-6},
        ),
    ],
)
def test_uncertainties_of_sizes_reach_the_setup(
    specimen: str, old: str, known: dict[str, float]
) -> None:
    bending = f"bending-stiffness, of: stiffness, support: cantilever{old}"
    test, _ = pulled(*pull(), specimen=specimen, results=[LINE, bending])
    assert test.setup.uncertainties == pytest.approx(known)
