from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.curve import Interval
from labpipe.records.estimates import Estimate, Failure, widened

LOPSIDED = Estimate(1.0, 0.1, 9, Interval(0.9, 1.4))


def test_they_are_values() -> None:
    assert Estimate(1.0, 0.1, 5) == Estimate(1.0, 0.1, 5)
    assert Failure("gap", "3 samples") != Failure("gap", "4 samples")


def test_an_uncertain_input_widens() -> None:
    assert widened(Estimate(1.0, 3.0, 9), 4.0) == Estimate(1.0, 5.0, 9)
    found = widened(LOPSIDED, 0.1)
    assert found.interval is not None
    assert 1.0 - found.interval.lower == pytest.approx(np.hypot(0.1, 0.196), rel=1e-3)
    assert found.interval.upper - 1.0 == pytest.approx(np.hypot(0.4, 0.196), rel=1e-3)
    assert widened(LOPSIDED) == LOPSIDED


def test_an_interval_beside_its_value_widens_about_its_middle() -> None:
    """Half width 0.1 about 0.8; 0.196 on top in quadrature."""
    off = Estimate(1.0, 0.05, 9, Interval(0.7, 0.9))
    found = widened(off, 0.1).interval
    assert found is not None
    half = np.hypot(0.1, 0.1959964)
    assert (found.lower, found.upper) == pytest.approx((0.8 - half, 0.8 + half), rel=1e-6)
