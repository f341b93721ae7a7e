"""The stages of one test, corrections of its curve, and remedies for failed numbers."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.cli import main
from labpipe.errors import ProcessingError
from labpipe.process.curve_corrections import correct_curve
from labpipe.protocol.schema import CurveBlock
from labpipe.records.arrays import Floats
from labpipe.records.causes import COMPLIANCE
from labpipe.records.curve import Direction, SlipDecision
from labpipe.records.estimates import Failure
from labpipe.records.quality import Severity
from labpipe.uncertainty.intervals import Measured
from tests.builders.pulls import LINE, STEP, broken, codes, pull, pulled, slipped
from tests.builders.reasons import doubted, why
from tests.builders.reduced import loop, reduced
from tests.builders.tensile_tests import TensileLab, write_pull


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
        "no_motion: the noise of the motion is 1.97 mm, too much to distinguish strokes of "
        "min_stroke, 1 mm: is it the right channel?"
    )


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


SLOPE = "stiffness, from: 2 mm, to: 10 mm"


SLIPS = ((0.006, 3.0), (0.012, 2.0))


def test_give_of_the_frame_is_taken_off() -> None:
    """A pull through 1 um/N looks softer: 1 / (1 / 5000 + 1e-6)."""
    travel, force = pull()
    plain, before = pulled(travel, force, results=[SLOPE])
    test, after = pulled(travel, force, curve="compliance: {value: 1 um/N}", results=[SLOPE])
    assert before["stiffness"].value == pytest.approx(5000.0, rel=1e-3)
    assert after["stiffness"].value == pytest.approx(1.0 / (1.0 / 5000.0 - 1e-6), rel=1e-3)
    assert test.curve is not None
    assert plain.curve is not None
    given = plain.curve.displacement - test.curve.displacement
    np.testing.assert_allclose(given, 1e-6 * plain.curve.force, atol=1e-15)
    said = codes(test)["compliance_removed"]
    assert said == "1 um/N x force subtracted from the displacement, at most 99.9 um"


def test_uncertain_give_widens_the_interval() -> None:
    travel, force = pull()
    curve = "compliance: {value: 10 um/N, uncertainty: 10 %}"
    _, results = pulled(travel, force, curve=curve, results=[SLOPE])
    found = results["stiffness"]
    assert found.value is not None
    assert found.interval is not None
    # k = 1 / (1/5000 - C), so dk = k^2 dC
    assert found.interval.standard_error == pytest.approx(found.value**2 * 1e-6, rel=0.05)


def test_give_and_slack_move_what_the_displacement_may_be() -> None:
    """11 um/N in place of 10 um/N; the slack that was taken off is the same for both."""
    travel, force = pull(slack=2e-3)
    curve = "compliance: {value: 10 um/N, uncertainty: 10 %}, slack: {from: 10 %, to: 30 %}"
    test, _ = pulled(travel, force, curve=curve, results=[SLOPE])
    assert test.curve is not None
    moved = test.displacement.moved[COMPLIANCE] - test.displacement.values
    np.testing.assert_allclose(moved, -1e-6 * test.curve.force, atol=1e-15)
    assert isinstance(test.slack, Measured)
    assert test.slack.value == pytest.approx(2e-3, rel=0.01)


def test_repaired_slips_add_up() -> None:
    travel, force = pull()
    curve = "slips: {decision: repaired, min_drop: 0.5 N}"
    test, results = pulled(travel, slipped(travel, force, *SLIPS), curve=curve, results=[SLOPE])
    assert [slip.decision for slip in test.slips] == [SlipDecision.REPAIRED] * 2
    assert test.curve is not None
    assert test.curve.force[-50:].mean() == pytest.approx(force[-50:].mean(), abs=0.1)
    assert results["stiffness"].value == pytest.approx(5000.0, rel=2e-3)
    assert results["stiffness"].status == "ok"
    message = next(note.message for note in test.findings.notes if note.code == "slip_repaired")
    assert message.startswith("the force falls suddenly by ")
    assert message.endswith(": added back to the rest of the curve")


def test_cut_ends_the_curve_before_the_first_slip() -> None:
    travel, force = pull()
    curve = "failure: {force_below: 50 %}, slips: {decision: cut, min_drop: 0.5 N}"
    test, results = pulled(
        travel,
        slipped(travel, force, *SLIPS),
        curve=curve,
        results=["peak-force", "peak-displacement", SLOPE, "failure"],
    )
    assert test.curve is not None
    kept = test.slips[0].start + 1
    assert np.isnan(test.curve.force[kept:]).all()
    (branch,) = test.curve.branches
    assert branch.stop == kept
    assert results["peak_displacement.1"].value == pytest.approx(0.006, abs=2 * STEP)
    assert results["peak_force.1"].value == pytest.approx(30.0, abs=0.2)
    assert results["stiffness"].why.startswith("not_reached: the branch reaches 5.98 mm, ")
    assert results["failure_force"].why == "cut: the curve ends at a slip"
    assert codes(test)["slip_cut"].endswith("the curve ends before it")


def test_failure_moves_up_with_what_was_added_back() -> None:
    travel, force = pull()
    torn = broken(travel, slipped(travel, force, (0.006, 3.0)), at=0.018)
    curve = "failure: {force_below: 50 %}, slips: {decision: repaired, min_drop: 0.5 N}"
    test, results = pulled(travel, torn, curve=curve, results=["failure"])
    found = results["failure_force"]
    assert found.value == pytest.approx(90.0, abs=0.3)
    assert found.interval is not None
    assert found.interval.lower < 90.0 < found.interval.upper
    assert test.curve is not None
    # What is left of the broken specimen is not raised.
    assert test.curve.force[-1] == pytest.approx(torn[-1])


def test_slack_moves_all_displacements() -> None:
    travel, force = pull(slack=0.003)
    torn = broken(travel, force, at=0.016)
    curve = "failure: {force_below: 50 %}, slack: {from: 10 %, to: 30 %}"
    test, results = pulled(travel, torn, curve=curve, results=["failure"])
    assert isinstance(test.slack, Measured)
    assert test.slack.value == pytest.approx(0.003, abs=1e-5)
    assert test.curve is not None
    np.testing.assert_allclose(test.curve.displacement, travel - test.slack.value)
    assert results["failure_displacement"].value == pytest.approx(0.013, abs=2 * STEP)
    message = f"{1e3 * test.slack.value:.4g} mm of slack subtracted from the displacement"
    assert codes(test)["slack_removed"] == message


def test_slack_that_cannot_be_found_makes_displacements_doubtful() -> None:
    travel, force = pull(slack=0.003)
    torn = broken(travel, force, at=0.016)
    curve = "failure: {force_below: 50 %}, slack: {from: 10 %, to: 10.1 %}"
    test, results = pulled(travel, torn, curve=curve, results=["failure", "slack"])
    assert isinstance(test.slack, Failure)
    assert results["slack"].why.startswith("too_few_samples: ")
    assert results["failure_displacement"].status == "doubtful"
    assert results["failure_displacement"].why.startswith(
        "slack_unknown: slack not found, so not subtracted ("
    )


def test_a_curve_without_a_toe_is_not_moved() -> None:
    """Steepest where it begins: the line at 10 to 30 % meets zero force far before the start."""
    travel, force = pull()
    bent = 100.0 * (1.0 - np.exp(-travel / 0.004)) + (force - 5e3 * travel)
    test, results = pulled(
        travel + 0.001, bent, curve="slack: {from: 40 %, to: 70 %}", results=["slack"]
    )
    assert results["slack"].why.startswith("no_toe: the line meets zero force at -")
    assert "before the first sample at 1 mm and " in results["slack"].why
    assert test.curve is not None
    np.testing.assert_allclose(test.curve.displacement, travel + 0.001)
    assert not doubted(test)
    (note,) = (note for note in test.findings.notes if note.code == "no_toe")
    assert note.severity is Severity.WARNING


def test_a_preload_is_no_missing_toe() -> None:
    """A line that begins at 10 N is carried back to zero force, 2 mm before the start."""
    travel, force = pull()
    test, results = pulled(
        travel, force + 10.0, curve="slack: {from: 20 %, to: 50 %}", results=["slack"]
    )
    assert results["slack"].value == pytest.approx(-0.002, abs=2e-5)
    assert test.curve is not None
    assert test.curve.displacement[0] == pytest.approx(0.002, abs=2e-5)


def test_zero_of_the_force_is_in_the_interval_of_the_slack() -> None:
    """0.05 N of zero over 5000 N/m are 10 um of slack."""
    travel, force = pull(slack=0.003)
    test, _ = pulled(travel, force)
    force_signal = replace(test.raw_force, zero_error=0.05)
    raw = {**test.signals.raw, "force": force_signal}
    test = replace(test, signals=replace(test.signals, raw=raw))
    block = CurveBlock.model_validate(
        {"force": "force", "displacement": "displacement", "slack": {"from": "10 %", "to": "30 %"}}
    )
    test, _ = correct_curve(test, block)
    assert isinstance(test.slack, Measured)
    assert test.slack.error == pytest.approx(1e-5, rel=0.1)


def test_more_give_than_the_test_has_is_refused() -> None:
    """5 N/mm is 200 um/N in all: a frame of 300 um/N would leave the specimen shorter."""
    message = (
        r"curve\.compliance: expected a compliance below that of this test, 200\.?\d* um/N in "
        r"loading, found 300 um/N, with which the specimen would get shorter\. Check its unit"
    )
    with pytest.raises(ProcessingError, match=message):
        pulled(*pull(), curve="compliance: {value: 300 um/N}")


def test_a_bad_sample_is_bridged_and_told() -> None:
    travel, force = pull()
    bad = broken(travel, force, at=0.018)
    bad[500] = 1200.0
    test, results = pulled(
        travel, bad, curve="failure: {force_below: 50 %}", results=["peak-force", "failure"]
    )
    assert codes(test)["stray_samples"] == (
        "1 outliers of the force, the first 1200 N at 50.000 s: replaced by interpolation"
    )
    assert test.curve is not None
    assert test.curve.force[500] == pytest.approx(50.0, abs=0.2)
    assert results["failure_displacement"].value == pytest.approx(0.018, abs=2 * STEP)
    assert results["peak_force.1"].value == pytest.approx(90.0, abs=0.3)


SAID = re.compile(r"'([\w.-]+): \{value: (.+?), because: \.\.\.\}'")


SLACK, BREAK = {"slack"}, {"failure_displacement", "failure_force", "energy_to_break"}


def bent_over(travel: Floats, *, knee: float, most: float) -> Floats:
    """Force of a wire that yields, N: steep at first, and flat then."""
    return np.asarray(most * np.tanh(np.maximum(travel, 0.0) / knee))


def ends_in(force: Floats, *shares: float) -> Floats:
    """The last samples at these shares of the largest force."""
    return np.concatenate([force[: -len(shares)], force.max() * np.array(shares)])


ROWS = 90


COARSE = np.linspace(0.0, 12e-3, ROWS)
"""A sample each 0.13 mm."""


LATE = np.linspace(0.7e-3, 80e-3, ROWS)


FINE = np.linspace(0.0, 12e-3, 400)


PULLS = {
    "too few samples": (
        COARSE,
        ends_in(bent_over(COARSE - 0.3e-3, knee=0.6e-3, most=76.0), 0.02, 0.0),
        {*SLACK, "stiffness"},
        {"curve.slack.to", "results.stiffness.to"},
    ),
    "begins late, never breaks": (
        LATE,
        3.0 + bent_over(LATE, knee=60e-3, most=12.0),
        {*SLACK, *BREAK, "stiffness"},
        {
            *("curve.slack", "results.slack", "results.failure", "results.energy-to-break"),
            *("results.stiffness.from", "results.stiffness.to"),
        },
    ),
    "stops in mid-break": (
        FINE,
        ends_in(bent_over(FINE - 1e-3, knee=6e-3, most=100.0), 0.73, 0.72),
        BREAK,
        {"curve.failure.force_below"},
    ),
    "stops while it necks": (
        FINE,
        ends_in(bent_over(FINE - 1e-3, knee=6e-3, most=100.0), *np.linspace(1.0, 0.7, 40)),
        BREAK,
        {"curve.failure.force_below", "curve.failure.within"},
    ),
}


def processed(lab: TensileLab) -> Mapping[str, Mapping[str, str]]:
    main(["process", str(lab.raw), "--no-figures"])
    return lab.results


@pytest.mark.parametrize("name", PULLS)
def test_what_is_told_makes_it_available(tmp_path: Path, name: str) -> None:
    travel, force, failed, keys = PULLS[name]
    lab = TensileLab(tmp_path, "T-1")
    noise = np.random.default_rng(3).normal(0.0, 0.02, len(force))
    write_pull(lab, "tensile", force + noise, travel, rate=10.0)
    found = processed(lab)
    assert {key for key in found if found[key]["status"] == "failed"} == failed
    told = {key: value for each in failed for key, value in SAID.findall(why(found[each]))}
    assert set(told) == keys
    for key, value in told.items():
        lab.override(key, value)
    after = processed(lab)
    assert not {key for key in after if after[key]["status"] == "failed"}
    assert len(after) == len(found) - sum(finding in failed for finding in set(found) - set(after))


def test_too_short_for_slips_is_said() -> None:
    travel, force = pull(length=0.0012)
    test, _ = pulled(travel, force, curve="slips: {decision: marked, min_drop: 0.5 N}")
    assert codes(test)["slips_not_looked_for"] == "60 samples in the branch, 64 are needed"
