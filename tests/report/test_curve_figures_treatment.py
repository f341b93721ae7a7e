from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.result import TestResult
from labpipe.report.curve_figures import Treatment, treatment, treatment_of_force
from tests.store.builders_result import build_result

FILTERED = build_result(half_cycle=0.5, cycles=1, force_rate=50.0)


@pytest.fixture
def as_recorded() -> TestResult:
    """A test whose curve is what was aligned."""
    assert FILTERED.curve is not None
    assert FILTERED.aligned is not None
    series = {name: each.values for name, each in FILTERED.aligned.series.items()}
    curve = replace(FILTERED.curve, force=series["force"], displacement=series["displacement"])
    return replace(FILTERED, curve=curve)


def changed(result: TestResult, name: str, values: Floats) -> TestResult:
    assert result.curve is not None
    both = {"force": result.curve.force, "displacement": result.curve.displacement, name: values}
    curve = replace(result.curve, force=both["force"], displacement=both["displacement"])
    return replace(result, curve=curve)


def test_a_filter_changes_every_sample() -> None:
    assert treatment(FILTERED) is treatment_of_force(FILTERED) is Treatment.FILTERED


def test_nothing_was_done(as_recorded: TestResult) -> None:
    assert treatment(as_recorded) is Treatment.NONE
    assert as_recorded.curve is not None
    ended = as_recorded.curve.force.copy()
    ended[-10:] = np.nan  # cut at a slip
    assert treatment_of_force(changed(as_recorded, "force", ended)) is Treatment.NONE


def test_slips_slack_and_strays_are_corrections(as_recorded: TestResult) -> None:
    assert as_recorded.curve is not None
    force, travel = as_recorded.curve.force, as_recorded.curve.displacement
    repaired = np.where(np.arange(len(force)) > 40, force + 0.3, force)
    repaired[20] += 5.0
    assert treatment_of_force(changed(as_recorded, "force", repaired)) is Treatment.CORRECTED
    assert treatment(changed(as_recorded, "displacement", travel - 1e-3)) is Treatment.CORRECTED


def test_give_of_the_frame_is_a_correction(as_recorded: TestResult) -> None:
    assert as_recorded.curve is not None
    curve = as_recorded.curve
    softer = changed(as_recorded, "displacement", curve.displacement - 1e-4 * curve.force)
    note = QualityNote("compliance_removed", Severity.INFO, "displacement", "Taken off.")
    assert treatment(softer) is Treatment.FILTERED
    assert treatment(replace(softer, quality=(note,))) is Treatment.CORRECTED
    smoothed = changed(softer, "force", curve.force * (1.0 + 1e-4 * curve.time))
    assert treatment(replace(smoothed, quality=(note,))) is Treatment.FILTERED


def test_without_samples_nothing_says_that_it_was_not_filtered(as_recorded: TestResult) -> None:
    assert treatment(replace(as_recorded, aligned=None)) is Treatment.FILTERED
    assert treatment(replace(as_recorded, curve=None)) is Treatment.FILTERED
    assert as_recorded.curve is not None
    none = np.full(len(as_recorded.curve.force), np.nan)
    assert treatment_of_force(changed(as_recorded, "force", none)) is Treatment.FILTERED
