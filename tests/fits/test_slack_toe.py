"""Slack by toe compensation."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.fits.slack import fit_slack
from labpipe.records.estimates import Estimate, Failure

D = np.linspace(0.0, 0.02, 401)
F = 5000.0 * np.maximum(D - 0.002, 0.0)


def test_foot_of_the_line() -> None:
    found = fit_slack(D, F, start_share=0.1, stop_share=0.3)
    assert isinstance(found, Estimate)
    assert found.value == pytest.approx(0.002, rel=1e-9)


def test_interval_holds_the_slack_in_noise() -> None:
    noise = np.random.default_rng(0).normal(0, 0.3, len(D))
    found = fit_slack(D, F + noise, start_share=0.1, stop_share=0.3)
    assert isinstance(found, Estimate)
    assert found.interval is not None
    assert found.interval.lower < 0.002 < found.interval.upper
    assert found.interval.upper - found.interval.lower < 3e-4


def test_says_why_not() -> None:
    few = fit_slack(D[:5], F[:5], start_share=0.1, stop_share=0.3)
    assert few == Failure("too_few_samples", "5 samples, 8 are needed")
    late = fit_slack(D[150:], F[150:], start_share=0.1, stop_share=0.3)
    assert late == Failure("not_reached", "the branch begins at 27.5 N, above 10% of 90 N")
    coarse = fit_slack(D[::40], F[::40], start_share=0.1, stop_share=0.3)
    assert coarse == Failure("too_few_samples", "2 samples in the linear region, 8 are needed")
    wild = fit_slack(
        D, 3.0 + np.random.default_rng(3).normal(0, 3.0, len(D)), start_share=0.1, stop_share=0.7
    )
    assert isinstance(wild, Failure)
