"""The stages of one test, corrections of its curve, and remedies for failed numbers."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from labpipe.cli import main
from labpipe.errors import ProcessingError
from labpipe.records.arrays import Floats
from labpipe.records.causes import COMPLIANCE
from labpipe.records.curve import Direction
from tests.builders.pulls import LINE, STEP, broken, pull, pulled, slipped
from tests.builders.reasons import why
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
    reason = results["initial_stiffness"].reason_text
    assert reason.startswith("no_motion: the noise of the motion is 1.97 mm")


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


TRAVEL, PULL = pull()
LOOSE = pull(slack=2e-3)[1]
TORN = broken(TRAVEL, slipped(TRAVEL, PULL, (0.006, 3.0)), at=0.018)
NOT_TORN = np.where(TRAVEL <= 0.018, PULL, TORN)
GIVES = "compliance: {value: 10 um/N, uncertainty: 10 %}"
FAILS = "failure: {force_below: 50 %}"
CORRECTED: dict[str, tuple[Floats, str, Floats, Floats]] = {
    "the frame gives way": (PULL, GIVES, TRAVEL - 1e-5 * PULL, PULL),
    "slack": (LOOSE, "slack: {from: 10 %, to: 30 %}", TRAVEL - 2e-3, LOOSE),
    "a slip, and what is left of a broken specimen": (
        *(TORN, f"{FAILS}, slips: {{decision: repaired, min_drop: 0.5 N}}"),
        *(TRAVEL, NOT_TORN),
    ),
    "a slip that ends the curve": (
        *(TORN, "slips: {decision: cut, min_drop: 0.5 N}"),
        *(TRAVEL, np.where(TRAVEL < 0.00599, PULL, np.nan)),
    ),
    "a bad sample": (np.where(np.arange(1000) == 500, 1200.0, PULL), "", TRAVEL, PULL),
}


@pytest.mark.parametrize("name", CORRECTED)
def test_corrections_of_a_curve(name: str) -> None:
    """What they make of results is in the records of results."""
    force, block, expected_path, expected_force = CORRECTED[name]
    test, _ = pulled(TRAVEL, force, curve=block)
    curve = test.required_curve
    np.testing.assert_allclose(curve.displacement, expected_path, atol=2e-5)
    np.testing.assert_allclose(curve.force, expected_force, atol=0.2)
    if block == GIVES:  # 11 um/N in place of 10 um/N
        moved = test.displacement.variants[COMPLIANCE] - test.displacement.values
        np.testing.assert_allclose(moved, -1e-6 * PULL, atol=1e-15)


@pytest.mark.parametrize("path_sign", [1.0, -1.0])
@pytest.mark.parametrize("force_sign", [1.0, -1.0])
def test_the_frame_deforms_with_the_specimen_whatever_the_signs(
    path_sign: float, force_sign: float
) -> None:
    test, _ = pulled(path_sign * TRAVEL, force_sign * PULL, curve=f"reverse: [], {GIVES}")
    expected = path_sign * (TRAVEL - 1e-5 * PULL)
    np.testing.assert_allclose(test.required_curve.displacement, expected, atol=1e-12)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_specimen_breaks_within_the_next_step_whatever_the_signs(sign: float) -> None:
    force = sign * broken(TRAVEL, PULL, at=0.018)
    block = f"reverse: [], {FAILS}"
    _, results = pulled(sign * TRAVEL, force, curve=block, results=["failure"])
    result = results["failure_displacement"]
    assert result.interval is not None
    nearest, farthest = sorted((sign * result.interval.lower, sign * result.interval.upper))
    assert nearest == pytest.approx(0.018 - STEP)
    assert farthest - nearest == pytest.approx(STEP, rel=0.05)


@pytest.mark.parametrize(("path_sign", "force_sign"), [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0)])
def test_slips_of_falling_signals_are_not_searched(path_sign: float, force_sign: float) -> None:
    block = "reverse: [], slips: {decision: repaired, min_drop: 0.5 N}"
    test, _ = pulled(path_sign * TRAVEL, force_sign * TORN, curve=block)
    assert "slips_not_looked_for" in {note.code for note in test.findings.notes}


def test_more_give_than_the_test_has_is_refused() -> None:
    """5 N/mm is 200 um/N in all: a frame of 300 um/N would leave the specimen shorter."""
    message = (
        r"curve\.compliance: expected a compliance below that of this test, 200\.?\d* um/N in "
        r"loading, found 300 um/N, by which the corrected displacement decreases in loading\."
    )
    with pytest.raises(ProcessingError, match=message):
        pulled(*pull(), curve="compliance: {value: 300 um/N}")


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
        {"results.slack", "results.stiffness"},
    ),
    "begins late, never breaks": (
        LATE,
        3.0 + bent_over(LATE, knee=60e-3, most=12.0),
        {*SLACK, *BREAK, "stiffness"},
        {"results.slack", "results.failure", "results.energy-to-break", "results.stiffness"},
    ),
    "stops in mid-break": (
        FINE,
        ends_in(bent_over(FINE - 1e-3, knee=6e-3, most=100.0), 0.73, 0.72),
        BREAK,
        {"results.failure", "results.energy-to-break"},
    ),
    "stops while it necks": (
        FINE,
        ends_in(bent_over(FINE - 1e-3, knee=6e-3, most=100.0), *np.linspace(1.0, 0.7, 40)),
        BREAK,
        {"results.failure", "results.energy-to-break"},
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
    old = processed(lab)
    assert {key for key in old if old[key]["status"] == "failed"} == failed
    stated = {key: value for result in failed for key, value in SAID.findall(why(old[result]))}
    assert set(stated) == keys
    for key, value in stated.items():
        lab.override(key, value)
    new = processed(lab)
    assert not {key for key in new if new[key]["status"] == "failed"}
    assert len(new) == len(old) - sum(finding in failed for finding in set(old) - set(new))
