"""Straight lines over a stretch."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.fits.straight_lines import StraightLine, fit_line
from labpipe.records.estimates import Failure

D = np.linspace(0.002, 0.008, 61)


def test_exact_on_a_line_with_missing_samples() -> None:
    force = 1.5 + 4000.0 * D
    force[[3, 30]] = np.nan
    line = fit_line(D, force)
    assert isinstance(line, StraightLine)
    assert line.slope.value == pytest.approx(4000.0, rel=1e-12)
    assert line.intercept.value == pytest.approx(1.5, rel=1e-10)
    assert (line.n, line.start, line.stop) == (59, 0.002, 0.008)


def test_interval_lies_around_the_value() -> None:
    line = fit_line(D, 4000.0 * D + np.random.default_rng(0).normal(0, 0.3, 61))
    assert isinstance(line, StraightLine)
    for part in (line.slope, line.intercept):
        assert part.interval is not None
        assert part.interval.lower < part.value < part.interval.upper


def test_says_why_not() -> None:
    assert fit_line(D[:5], D[:5]) == Failure(
        "too_few_samples", "5 samples in the stretch, 8 are needed"
    )
    assert fit_line(np.ones(9), D[:9]) == Failure(
        "no_travel", "the displacement does not change over the stretch"
    )
